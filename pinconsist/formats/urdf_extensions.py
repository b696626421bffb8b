"""Extensions of URDF by other programs: what acts here, and what is counted as without effect.

``<gazebo reference="JOINT">`` with ``springStiffness`` and ``springReference`` becomes a joint spring, and
``<gazebo reference="LINK">`` with ``turnGravityOff`` a force that carries the link's weight.
"""

from xml.etree.ElementTree import Element

from ..mechanism.forces import JointSpring, Wrench
from ..mechanism.loops import GROUND
from . import drake, gazebo
from .extensions import LOOP_TAGS
from .ignored import CONTACTS, Ignored
from .reading import Node, floats, require_known

ROBOT = (*drake.TAGS, *LOOP_TAGS, "link", "joint", "coupling", "material", "transmission", "gazebo", "mujoco", "sensor")
ROBOT += ("group", "frame", "drake:frame")
ROBOT += ("fixed_frame", "drake:proximity_properties", "drake:collision_filter_group", "ros2_control")
HARMLESS = ("visual", "sensor", "material", "origin", "self_collide", "selfCollide", "verbose", "hardwareInterface")
HARMLESS += ("preserveFixedJoint", "disableFixedJointLumping", "provideFeedback", "laserRetro")
_CONTACT = ("kp", "kd", "mu1", "mu2", "mu", "fdir1", "maxVel", "minDepth", "maxContacts", "collision", "slip1", "slip2")
_SPRING = ("springStiffness", "springReference", "implicitSpringDamper", "turnGravityOff", "gravity")
_MUJOCO = ("compiler", "size", "visual")


def count_extensions(robot: Element, ignored: Ignored) -> None:
    """Count what has no effect in the ``<gazebo>`` and ``<mujoco>`` elements of a parsed ``<robot>``."""
    for holder in robot.findall("gazebo"):
        for plugin in (each for each in holder.findall("plugin") if not gazebo.reads(each)):
            ignored.add_plugin(plugin)
        ignored.add(CONTACTS, sum(each.tag in _CONTACT for each in holder))
        ignored.add_unknown(holder, (*HARMLESS, *_CONTACT, *_SPRING, "plugin", "joint"), "gazebo")
    for holder in robot.findall("mujoco"):
        ignored.add_unknown(holder, (*_MUJOCO, "equality"), "mujoco")


def springs(robot: Element, model) -> tuple[JointSpring, ...]:
    """The springs of joints that ``<gazebo reference>`` gives them."""
    found = []
    for node, joint in _references(robot):
        stiffness = _number(node, "springStiffness")
        if stiffness:
            require_known(joint, list(model.names)[1:], f"there is no joint {joint!r} with this spring", node.name)
            found.append(JointSpring(joint, stiffness, _number(node, "springReference")))
    return tuple(found)


def weightless_links(robot: Element, model) -> tuple[Wrench, ...]:
    """For each link with ``turnGravityOff``, the force that carries its weight."""
    links, found = Node(robot).named("link"), []
    for node, name in _references(robot):
        off = node.child("turnGravityOff").text().lower() in ("true", "1")
        if not off and node.child("gravity").text().lower() not in ("false", "0"):
            continue
        require_known(name, links, f"there is no link {name!r} without gravity", node.name)
        inertial = links[name].child("inertial")
        mass = inertial.child("mass").number("value", 0.0)
        frame = model.getFrameId(name) if model.existFrame(name) else 0
        if mass and frame and model.frames[frame].parentJoint:
            force = tuple((-mass * model.gravity.linear).tolist())
            found.append(Wrench(name, force, xyz=inertial.child("origin").numbers("xyz", 3, (0.0, 0.0, 0.0))))
    return tuple(found)


def _references(robot):
    """(node, name) of the ``<gazebo>`` elements that refer to a link or joint."""
    for node in Node(robot).children("gazebo"):
        name = node.get("reference")
        node.name = f"gazebo {name!r}"
        if name and name != GROUND:
            yield node, name


def _number(node, tag) -> float:
    child = node.child(tag)
    return floats(child.text() or child.get("value"), 1, child.name)[0] if child else 0.0
