"""The elements and attributes that readers of XML act on: what a file has beside them is counted.

A grammar is a mapping from a tag to its attributes and the tags of its children; an element that is not in it, such as
a visual, is not looked into, as it has no effect or a reader of its own.
"""

from collections.abc import Iterable, Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element

from .ignored import Ignored
from .reading import shown

_EVERYWHERE = ("name", "xmlns", "version")


class Known(NamedTuple):
    """What is known of an element; None for children that are counted elsewhere."""

    attributes: Iterable[str] = ()
    children: Iterable[str] | None = ()


def count_unknown(element: Element, grammar: Mapping[str, Known], ignored: Ignored) -> None:
    """Count the attributes and children that the grammar does not have, in an element and those below it."""
    waiting = [element]
    while waiting:
        node = waiting.pop()
        tag = shown(str(node.tag))
        known = grammar.get(tag)
        if known is None:
            continue
        for key in node.keys():
            if "}" not in key and key not in known.attributes and key not in _EVERYWHERE:
                ignored.add(f"<{key[:60]}=> of {tag}")
        for child in node:
            own = shown(str(child.tag))
            if known.children is not None and own not in known.children and own not in grammar:
                ignored.add(f"<{own[:60]}> of {tag}")
        waiting += node


_ORIGIN, _END, _VALUE = ("xyz", "rpy"), ("link", "xyz", "rpy"), ("value",)
_ENDS = "link1 link2 predecessor successor parent child link_a link_b linkA linkB body1 body2".split()
_ORIGINS = [f"{end}_origin" for end in _ENDS] + [f"origin_{end}" for end in _ENDS]
_LOOP = Known(("type", *_ENDS, "ratio"), ("origin", "axis", "limit", "dynamics", "mimic", "ratio", *_ENDS, *_ORIGINS))
URDF: dict[str, Known] = {
    "robot": Known(("type",), None),
    "link": Known(("type",), None),
    "inertial": Known((), ("origin", "mass", "inertia")),
    "origin": Known(_ORIGIN),
    "mass": Known(_VALUE),
    "inertia": Known(("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "joint": Known(("type",), None),
    "parent": Known(_END, ("origin",)),
    "child": Known(_END, ("origin",)),
    "axis": Known(("xyz",)),
    "limit": Known(("lower", "upper", "effort", "velocity")),
    "dynamics": Known(("damping", "friction")),
    "mimic": Known(("joint", "multiplier", "offset")),
    "calibration": Known(("rising", "falling", "reference_position")),
    "safety_controller": Known(("soft_lower_limit", "soft_upper_limit", "k_position", "k_velocity")),
    "ratio": Known(_VALUE),
    "frame": Known(("link", *_ORIGIN)),
    **dict.fromkeys(("loop_joint", "loop", "loop_closure", "loop_constraint", "constraint", "coupling"), _LOOP),
    **dict.fromkeys(_ENDS[:4] + _ENDS[6:], Known((*_END, *_VALUE), ("origin",))),
    **dict.fromkeys(_ORIGINS, Known(_ORIGIN)),
}
"""Of URDF, and of the elements that close loops in it."""

_NUMBERS = """mass ixx ixy ixz iyy iyz izz density lower upper effort velocity stiffness dissipation damping friction
spring_reference spring_stiffness multiplier offset reference initial_position screw_thread_pitch thread_pitch
gearbox_ratio gearbox_reference_body use_parent_model_frame static self_collide allow_auto_disable kinematic gravity
enable_wind must_be_base_link uri placement_frame parent child""".split()
SDF: dict[str, Known] = {
    "sdf": Known((), ("model", "world", "light", "actor", "include", "gui", "scene")),
    "world": Known((), None),
    "model": Known(("canonical_link", "placement_frame", "included version", "type"), None),
    "include": Known(("merge",), ("uri", "name", "pose", "static", "placement_frame", "plugin", "model")),
    "link": Known(("gravity", "self_collide", "kinematic", "type"), None),
    "pose": Known(("relative_to", "rotation_format", "degrees", "frame")),
    "inertial": Known(("auto", "density"), (
        "pose", "mass", "inertia", "density", "fluid_added_mass", "auto_inertia_params", "frame")),
    "inertia": Known((), ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")),
    "frame": Known(("attached_to",), ("pose",)),
    "joint": Known(("type",), None),
    "axis": Known((), None),
    "axis2": Known((), None),
    "xyz": Known(("expressed_in",)),
    "limit": Known((), ("lower", "upper", "effort", "velocity", "stiffness", "dissipation")),
    "dynamics": Known((), ("damping", "friction", "spring_reference", "spring_stiffness")),
    "mimic": Known(("joint", "axis", "multiplier", "offset"), ("multiplier", "offset", "reference")),
    **dict.fromkeys(_NUMBERS, Known()),
}  # fmt: skip
"""Of SDF: worlds, models, links and joints."""
