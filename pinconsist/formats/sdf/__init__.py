"""SDF files (sdformat.org), read without libsdformat, which the pip builds of Pinocchio do not have.

The specification is that of versions 1.4 to 1.12. What a file says is carried over as follows:

* ``<joint>`` elements make a net of links, of which a tree is taken; the joints that are left over close loops
  (:mod:`.net` says which, and how). The poses of a file describe it closed, at q = 0.
* A link without ``<inertial>`` has 1 kg and 1 kg·m², as the specification has it.
* A model that no joint ties to the world floats in SDF. Here it is fixed where it is unless
  ``load(..., free_flyer=True)`` lets it float, as with URDF files. ``<static>`` models never move.
* The name of the only model of a file is left out; else links, joints and frames are ``model::name``. Before version
  1.7 a link and a joint may have one name: the joint is then ``name_joint``.
* Damping and friction of a ball joint act about all its axes. Position limits are kept in the model and do not act.
* Joint controllers of Gazebo act (:mod:`.actuators`). Contacts, sensors, other plugins and lights are left out. What
  would change the motion and cannot be carried over is refused: ``<include>``, kinematic links, inertias from shapes,
  fluid added mass, gravity on some links only.
* A screw is one joint of Pinocchio's (helical), a universal joint two hinges ``name_axis``, ``name_axis2`` with a
  massless body between them: Pinocchio's own universal joint has wrong ``computeRNEADerivatives``.
"""

import logging
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np

from ...mechanism.forces import JointSpring
from ..reading import RobotFile, closing, parsed, read_bytes, refuse
from ..urdf import checked
from .actuators import actuators
from .document import Document
from .joints import read_joints
from .model import build
from .net import Net, couplings
from .shapes import in_urdf, inertias, weightless

_log = logging.getLogger(__name__)


def read(path: Path, name: str, folders, *, free_flyer=False, ignore=()) -> RobotFile:
    """What an SDF file says; links and `<frame>` elements become frames of the model, a free-flyer ``root_joint``."""
    raw = parsed(content := read_bytes(path))
    holders = [each for tag in ("world", "model", "joint", "axis", "axis2") for each in raw.iter(tag)]
    found = [
        each for holder in holders for each in closing(holder, ("mimic", "gearbox_ratio", "gearbox_reference_body"))
    ]
    refuse(found, ignore, raw, content, "write it as a <joint> or <mimic> of SDF")
    document = Document(raw)
    joints = read_joints(document)
    robot = checked(in_urdf(document, [Path(folder).resolve() for folder in folders]), name)
    net = Net(document, joints)
    if len(net.roots) > 1:
        _log.warning("%s: no joints tie %s together or to the world", path, ", ".join(map(repr, net.roots)))
    model, guess = build(document, net, inertias(document, robot), name, free_flyer)
    if weightless(document):
        model.gravity.linear = np.zeros(3)
    motions = [motion for joint in net.joints for motion in zip(joint.parts, joint.axes, strict=False)]
    springs = [JointSpring(part, axis.stiffness, axis.reference) for part, axis in motions if axis.stiffness]
    guess |= {part: axis.initial for part, axis in motions if axis.initial and model.existJointName(part)}
    shapes, loops = tostring(robot, encoding="unicode"), tuple(net.loops(document))
    acting = actuators(document, joints, model)
    return RobotFile(
        model, shapes, loops, tuple(couplings(joints)), forces=(*springs, *acting), guess=guess,
        actuated=tuple(dict.fromkeys(force.joint for force in acting)),
    )  # fmt: skip
