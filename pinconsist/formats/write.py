"""Mechanism → URDF and loop file.

The body of a joint becomes a link, named after the first body frame at the origin of the joint; every other frame
becomes a massless link, fixed at its placement. Numbers are written with all digits.
"""

import os
import re
import tempfile
import warnings
from importlib import import_module
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin
import yaml

from ..errors import FormatError, InputError
from ..files import require_writable, suffixed, written_whole
from ..mechanism.checks import require_mechanism, require_no_contacts
from ..mechanism.lie import integrate
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import by_joint
from ..mechanism.rows import LoopRows
from .catalogue import Source
from .joints import VALUES
from .load import read_scene
from .reading import parsed, text
from .records import contact_entries, force_entries, loop_entries
from .urdf import INERTIA, UNLIMITED, origin

WRITERS = {".sdf": "sdf", ".xml": "mjcf", ".mjcf": "mjcf", ".usda": "usd", ".usd": "usd"}
"""Suffix → the kind of file, other than URDF, and the module ``write_…`` that writes it."""
_STANDARD_GRAVITY = (0.0, 0.0, -9.81)
_ROUNDING_OF_TEXT = 1e-9
_JOINTS = {  # Pinocchio's name → (type in URDF, axis or None if the joint has its own, type in the loop file)
    "FreeFlyer": ("floating", (), None),
    "Planar": ("planar", (0.0, 0.0, 1.0), None),
    "Spherical": ("revolute", (1.0, 0.0, 0.0), "spherical"),
    "Translation": ("prismatic", (1.0, 0.0, 0.0), "translation"),
    "R[XYZ]|RevoluteUnaligned": ("revolute", None, None),
    "RUB[XYZ]|RevoluteUnboundedUnaligned": ("revolute", None, "unbounded"),
    "P[XYZ]|PrismaticUnaligned": ("prismatic", None, None),
    "H[XYZ]|HelicalUnaligned": ("revolute", None, "helical"),
}


def write(mechanism: Mechanism, path) -> Path:
    """Write a mechanism as a file: URDF, SDF, MJCF or USD.

    A URDF is written with its loop file, ``<stem>.urdf`` and ``<stem>.yaml``. Both are written atomically and replace
    existing files. Before that, they are read back and compared: the tree in the order of its joints, inertias, joint
    types, damping, friction and rotor inertia (armature), limits of hinges and sliders, gravity, loops, couplings and
    drives, forces, guess, motorised joints, duration, and the shapes of URDF scenes. Mesh files are not copied: files
    in other folders are found by ``load(..., package_dirs=...)``. Frames keep their names and placements; a frame is
    added to joints without one, and a link to those without a body frame.

    The other formats can represent less: items that they cannot represent raise an error that names them before
    anything is written. They are also read back, and the accelerations of both mechanisms must agree. In SDF, joint
    positions are zero where the loops are closed, see ``write_sdf``. In MuJoCo, loops of an MJCF file are soft
    constraints (``write_mjcf``); here they are rigid. Shapes and contacts are written with URDF only, contacts in its
    loop file.

    Parameters
    ----------
    mechanism : Mechanism
    path : path-like
        The file; its extension selects the format: ``.urdf``, which is added if there is none, ``.sdf``, ``.xml`` or
        ``.mjcf``, ``.usda`` or ``.usd`` (both as text). The stem becomes the name.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        Items that the format cannot represent, by name: user-defined functions, unsupported joint types; or a folder
        that does not exist.
    MissingExtraError
        usd-core or MuJoCo are not installed.
    """
    require_mechanism(mechanism, "write")
    if not isinstance(path, (str, os.PathLike)):
        raise InputError(f"write needs the path of a file, got {path!r}")
    if Path(path).suffix.lower() in WRITERS:
        return _write_other(mechanism, Path(path))
    path = suffixed(path, ".urdf")
    require_writable(path)
    urdf, joints = _urdf(mechanism, path.stem)
    scene = _loop_file(mechanism, joints)
    try:
        back = _read_back(urdf, scene, path.stem)
        if back.joints != mechanism.joints:
            scene["joint_order"] = list(mechanism.joints)
            back = _read_back(urdf, scene, path.stem)
    except FormatError as error:
        raise InputError(f"{mechanism.name} cannot be written as a readable URDF: {error.reason}") from error
    if not _same(mechanism, back):
        raise InputError(f"{mechanism.name} cannot be written as URDF: it reads back differently. Please report this")
    with written_whole(path) as robot, written_whole(path.with_suffix(".yaml")) as loops:
        robot.write(urdf.encode())
        loops.write(_yaml(scene))
    return path


def _write_other(mechanism, path) -> Path:
    """Write an SDF, MJCF or USD file."""
    require_writable(path)
    kind = WRITERS[path.suffix.lower()]
    writer = import_module(f".write_{kind}", __package__)
    links, mounted = _frame_names(mechanism.model)
    names = [links[joint] for joint in range(mechanism.model.njoints)]
    frames = [(link, joint, place) for _, link, joint, place in mounted]
    try:
        require_no_contacts(mechanism, "such a file", " as pinconsist has them")
        text = writer.document(mechanism, path.stem, names, frames)
        with tempfile.TemporaryDirectory() as folder:
            copy = Path(folder) / path.name
            copy.write_text(text, encoding="utf-8")
            floats = kind == "sdf" and writer.floats(mechanism)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # those of the file are shown when it is loaded
                back = read_scene(Source(copy, path.stem), free_flyer=floats)
        writer.require_same(mechanism, back)
    except InputError as error:
        title = {"sdf": "SDF", "mjcf": "MJCF", "usd": "USD"}[kind]
        reason = error.reason if isinstance(error, FormatError) else str(error)
        raise InputError(f"{mechanism.name} cannot be written as {title}: {reason}") from error
    with written_whole(path) as file:
        file.write(text.encode())
    return path


def _loop_file(mechanism, joints) -> dict:
    model = mechanism.model
    if np.any(model.gravity.angular):
        raise InputError(f"{mechanism.name}: gravity has an angular part, which a file cannot store")
    gravity = model.gravity.linear.tolist()
    scene = {
        "gravity": gravity if tuple(gravity) != _STANDARD_GRAVITY else None,
        "joints": joints,
        "loops": loop_entries(mechanism),
        "forces": force_entries(mechanism),
        "contacts": contact_entries(mechanism),
        "guess": by_joint(mechanism, mechanism.guess),
        "actuated": list(mechanism.actuated),
        "duration": mechanism.duration if mechanism.duration != Mechanism.duration else None,
    }
    return {key: value for key, value in scene.items() if value}


def _yaml(scene) -> bytes:
    return yaml.safe_dump(scene, sort_keys=False, allow_unicode=True, default_flow_style=None, width=120).encode()


def _read_back(urdf, scene, name):
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"{name}.urdf"
        path.write_text(urdf, encoding="utf-8")
        path.with_suffix(".yaml").write_bytes(_yaml(scene))
        return read_scene(Source(path, name))


def _same(mechanism, back) -> bool:
    """Whether the equations of motion that were read back are those of the mechanism: a final safety check."""
    if (back.joints, back.nq, back.nv, back.nc) != (mechanism.joints, mechanism.nq, mechanism.nv, mechanism.nc):
        return False
    rng = np.random.default_rng(0)
    q = integrate(mechanism.model, mechanism.guess, rng.uniform(-0.5, 0.5, mechanism.nv))
    v = rng.uniform(-1, 1, mechanism.nv)
    pairs = zip(_equations(mechanism, q, v), _equations(back, q, v), strict=True)
    return all(
        np.allclose(one, two, rtol=_ROUNDING_OF_TEXT, atol=_ROUNDING_OF_TEXT * (1 + np.abs(one).max(initial=0)))
        for one, two in pairs
    )


def _equations(mechanism, q, v):
    """M, nle, Φ and J."""
    model, data = mechanism.model, mechanism.model.createData()
    M = np.triu(pin.crba(model, data, q))
    bias = pin.rnea(model, data, q, v, np.zeros(model.nv))
    return M, np.array(bias), *LoopRows(model, mechanism.loops).at(q)


def _urdf(mechanism, name) -> tuple[str, dict]:
    """A URDF document, and the settings of joints that belong in the loop file (its key ``joints``)."""
    model = mechanism.model
    robot = Element("robot", name=name)
    links, mounted = _frame_names(model)
    shapes, settings = {}, {}
    if mechanism.geometry is not None:
        for link in parsed(mechanism.geometry.urdf.encode()).findall("link"):
            shapes[link.get("name")] = [*link.findall("visual"), *link.findall("collision")]
    for joint, inertia in enumerate(model.inertias):
        link = SubElement(robot, "link", name=links[joint])
        link.extend(shapes.get(links[joint], ()))
        if joint or inertia.mass:
            _inertial(link, inertia)
    for joint in range(1, model.njoints):
        if given := _joint(robot, mechanism, joint, links):
            settings[model.names[joint]] = given
    for mount, link, joint, place in mounted:
        SubElement(robot, "link", name=link).extend(shapes.get(link, ()))
        _join(robot, mount, "fixed", links[joint], link, place)
    indent(robot)
    return '<?xml version="1.0" encoding="utf-8"?>\n' + tostring(robot, encoding="unicode") + "\n", settings


def _frame_names(model):
    """The link of each joint, and the frames to mount on links: (name of the fixed joint, link, joint, placement)."""
    frames = list(enumerate(model.frames))[1:]
    fixed = {i: frame for i, frame in frames if frame.type == pin.FrameType.FIXED_JOINT}
    taken_links = {"universe"} | {frame.name for _, frame in frames}
    taken_joints = set(model.names) | {frame.name for frame in fixed.values()}
    links, carried, bodies, mounted = {}, set(), {}, []
    for i, frame in frames:
        if frame.type != pin.FrameType.BODY:
            continue
        if frame.parentJoint not in links and _same_place(frame.placement, pin.SE3.Identity()):
            links[frame.parentJoint] = frame.name
            carried.add(i)
        elif frame.parentFrame in fixed and _same_place(frame.placement, fixed[frame.parentFrame].placement):
            bodies.setdefault(frame.parentFrame, i)
    for joint in range(model.njoints):
        if joint not in links:
            links[joint] = _unused(f"{model.names[joint]}_body" if joint else "ground", taken_links)
    for i, frame in fixed.items():
        body = bodies.get(i)
        carried |= {i, body}
        link = model.frames[body].name if body else _unused(f"{frame.name}_body", taken_links)
        mounted.append((frame.name, link, frame.parentJoint, frame.placement))
    for i, frame in frames:
        own = frame.name == model.names[frame.parentJoint] and _same_place(frame.placement, pin.SE3.Identity())
        if i not in carried and not own:
            mount = _unused(f"{frame.name}_mount", taken_joints)
            mounted.append((mount, frame.name, frame.parentJoint, frame.placement))
    return links, mounted


def _unused(name, taken):
    while name in taken:
        name += "_"
    taken.add(name)
    return name


def _same_place(place, other):
    return np.array_equal(place.homogeneous, other.homogeneous)


def _inertial(link, inertia):
    node = SubElement(link, "inertial")
    SubElement(node, "origin", xyz=text(*inertia.lever))
    SubElement(node, "mass", value=text(inertia.mass))
    values = inertia.inertia[np.triu_indices(3)]
    SubElement(node, "inertia", {key: text(value) for key, value in zip(INERTIA, values, strict=True)})


def _join(robot, name, kind, parent, child, place):
    joint = SubElement(robot, "joint", name=name, type=kind)
    origin(joint, place)
    SubElement(joint, "parent", link=parent)
    SubElement(joint, "child", link=child)
    return joint


def _joint(robot, mechanism, joint, links):
    """Write a joint; return its settings in the loop file."""
    model = mechanism.model
    kind, axis, replaced = _kind(mechanism, joint)
    ends = (links[model.parents[joint]], links[joint])
    node = _join(robot, model.names[joint], kind, *ends, model.jointPlacements[joint])
    given = {"type": replaced} if replaced else {}
    v, size = model.idx_vs[joint], model.nvs[joint]
    values = {key: getattr(model, VALUES[key][0])[v : v + size].tolist() for key in VALUES}
    if len(axis):
        SubElement(node, "axis", xyz=text(*axis))
    if size == 1:
        dynamics = {key: text(*values.pop(key)) for key in ("damping", "friction")}
        if set(dynamics.values()) != {"0"}:
            SubElement(node, "dynamics", dynamics)
        _limits(node, model, joint)
    for key, amounts in values.items():
        if any(amounts):
            given[key] = amounts if len(set(amounts)) > 1 else amounts[0]
    return given


def _limits(node, model, joint):
    """Write the limits of a joint: urdfdom needs all four numbers, or a continuous joint."""
    q, v = model.idx_qs[joint], model.idx_vs[joint]
    limits = {"effort": model.upperEffortLimit[v], "velocity": model.upperVelocityLimit[v]}
    ends = {"lower": -np.inf, "upper": np.inf}
    if model.nqs[joint] == 1:
        ends = {"lower": model.lowerPositionLimit[q], "upper": model.upperPositionLimit[q]}
    if node.get("type") == "revolute" and min(map(abs, ends.values())) >= UNLIMITED:
        node.set("type", "continuous")
        if min(map(abs, limits.values())) >= UNLIMITED:
            return
    else:
        limits |= ends
    SubElement(node, "limit", {key: text(np.clip(value, -UNLIMITED, UNLIMITED)) for key, value in limits.items()})


def _kind(mechanism, joint):
    """(type in URDF, axis, type in the loop file) of a joint; InputError for a kind that neither file can describe."""
    model = mechanism.model
    which = model.joints[joint].shortname().removeprefix("JointModel")
    found = next((each for pattern, each in _JOINTS.items() if re.fullmatch(pattern, which)), None)
    if found is None:
        reason = "which neither URDF nor a loop file can describe; build it from hinges and sliders"
        raise InputError(f"{mechanism.name}: joint {model.names[joint]!r} is a {which} joint, {reason}")
    kind, axis, replaced = found
    if axis is not None:
        return found
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    twist = np.reshape(pin.getJointJacobian(model, data, joint, pin.LOCAL), (6, -1))[:, model.idx_vs[joint]]
    axis = twist[:3] if kind == "prismatic" else twist[3:]
    return kind, axis, f"helical {float(twist[:3] @ axis)!r}" if replaced == "helical" else replaced
