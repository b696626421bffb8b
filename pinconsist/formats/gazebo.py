"""What Gazebo adds to a URDF and to the models of an SDF file: joints and plugins that join bodies.

* ``<gazebo><joint>``: a joint of SDF, added after the conversion of the URDF. Its pose is in the child, its axis in the
  frame of the joint, or in the model's frame with ``use_parent_model_frame``.
* ``DetachableJoint``, a system of gz-sim: ``child_link`` is welded to ``parent_link`` where it is at the start. A child
  model that is not in the file cannot be attached, and is counted as without effect.
* ``AttachLinks`` of gz_attach_links: the links ``parent`` and ``child`` are welded where they are at the start.
* plugins of mimic joints: ``mimicJoint`` = multiplier · ``joint`` + offset.
* the closed-loop plugin of pegasus_gazebo_plugins: a hinge about the y axis of a frame at ``position`` and ``rotation``
  in ``child``.
"""

from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from ..mechanism.checks import workspace
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import GROUND
from .closures import WITH_AXIS, Closure, kind_of
from .extensions import Names, pose, value, values, warn_without_effect, word
from .reading import Node

Y_AXIS, Z_AXIS = (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)
_SDF_KINDS = ("frame", "hinge", "slider", "point", "universal")


def reads(plugin: Element) -> bool:
    """Whether a plugin is one that this module reads."""
    return _reader(plugin) is not None


def _reader(plugin):
    name = plugin.get("name", "").rpartition("::")[2]
    words = f"{name} {plugin.get('filename', '')}".lower().replace("_", "").replace("-", "")
    if "detachablejoint" in words and plugin.find("child_model") is not None:
        return _detachable
    if "attachlinks" in words and plugin.find("parent") is not None and plugin.find("child") is not None:
        return _attached
    if "mimic" in words and plugin.find("mimicJoint") is not None and plugin.find("joint") is not None:
        return _mimic
    if "closedloop" in words and plugin.find("parent") is not None and plugin.find("child") is not None:
        return _closed_loop
    return None


def joined(holder: Node, names: Names, ignored) -> Iterator:
    """The closures and couplings of the plugins of a ``<gazebo>`` element or a model."""
    for plugin in holder.children("plugin"):
        read = _reader(plugin.xml)
        if read is not None:
            plugin.name = f"plugin {plugin.get('name').rpartition('::')[2]}"
            yield from read(plugin, names, ignored)


def _detachable(node, names, ignored):
    model, child = word(node, "child_model"), word(node, "child_link")
    own = model in (names.title, "__model__") or child in names.links
    if not own and f"{model}::{child}" in names.links:
        own, child = True, f"{model}::{child}"
    if not own:
        ignored.add(f"plugin DetachableJoint of the model {model[:40]!r}, which is not in the file")
        return
    yield _welded(node, names.link(word(node, "parent_link"), node.name), names.link(child, node.name))


def _attached(node, names, ignored):
    yield _welded(node, *(names.link(word(node, tag), node.name) for tag in ("parent", "child")))


def _welded(node, parent, child) -> Closure:
    if parent == child:
        raise node.error(f"parent and child are the same link {parent!r}")
    return Closure(f"{parent}-{child}", "frame", parent, child, pin.SE3.Identity())


def _mimic(node, names, ignored):
    if word(node, "mimicJoint") in names.fixed:
        ignored.add("mimic plugin of a fixed joint")
        return
    follower, leader = names.joint(word(node, "mimicJoint"), node.name), names.joint(word(node, "joint"), node.name)
    if follower == leader:
        raise node.error("the joint follows itself")
    yield Coupling(follower, follower, leader, value(node, "multiplier", 1.0), value(node, "offset", 0.0))


def _closed_loop(node, names, ignored):
    parent, child = (names.link(word(node, tag), node.name) for tag in ("parent", "child"))
    place = pose(*(values(node, tag, 3, (0.0, 0.0, 0.0)) for tag in ("position", "rotation")))
    axis = values(node, "axis", 3, Y_AXIS)
    yield Closure(word(node, "joint", default=f"{parent}-{child}"), "hinge", parent, child, place, 2, axis)


def injected_joint(node: Node, names: Names, model: pin.Model) -> Closure:
    """The closure of a ``<gazebo><joint>``."""
    name = node.get("name") or "joint"
    node.name = f"gazebo/joint {name!r}"
    kind = kind_of(node.get("type"))
    if kind not in _SDF_KINDS:
        raise node.error(f"type {node.get('type')[:40]!r} is not one of revolute, prismatic, ball, universal, fixed")
    parent, child = (names.link(word(node, tag), node.name) for tag in ("parent", "child"))
    if parent == child:
        raise node.error(f"parent and child are the same link {parent!r}")
    x, y, z, roll, pitch, yaw = values(node, "pose", 6, (0.0,) * 6)
    place = pose((x, y, z), (roll, pitch, yaw))
    axes = [_axis(node.child(tag), place, child, model) for tag in ("axis", "axis2")]
    fields = dict(zip(("axis", "axis2"), axes, strict=True)) if kind in WITH_AXIS else {}
    if kind != "universal":
        fields.pop("axis2", None)
    for axis in (node.child(tag) for tag in ("axis", "axis2")):
        warn_without_effect(axis, "dynamics")
    end = 2 if child != GROUND else 1
    return Closure(name, kind, parent, child, place, end, **fields)


def _axis(node, place, child, model):
    """The axis in the frame of the joint, for URDF's q = 0."""
    axis = np.array(values(node, "xyz", 3, Z_AXIS))
    if not axis.any():
        raise node.error("the axis is the zero vector")
    expressed = node.child("xyz").get("expressed_in")
    in_model = node.child("use_parent_model_frame").text().lower() in ("1", "true") or expressed == "__model__"
    if in_model and child != GROUND:
        data = workspace(model)
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        axis = place.rotation.T @ data.oMf[model.getFrameId(child, pin.FrameType.BODY)].rotation.T @ axis
    return tuple(axis.tolist())
