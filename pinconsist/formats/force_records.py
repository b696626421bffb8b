"""The records under ``forces`` in a loop file.

Each has ``kind`` and the fields of the record of :mod:`pinconsist.mechanism.forces` that it stands for::

    forces:
      - {kind: damping, coefficients: {crank: 0.1, ball: [0.1, 0.1, 0.2]}}
      - {kind: friction, coefficients: {crank: 0.5}, width: 0.01}
      - {kind: spring, joint: crank, stiffness: 20.0, rest: 0.3}
      - {kind: spring-damper, frame1: tip, stiffness: 500.0, length: 0.4, damping: 2.0, xyz2: [0, 0, 1]}
      - {kind: torque, torques: {crank: 2.0, rocker: {amplitude: 3.0, frequency: 0.5}}}
      - {kind: servo, joint: crank, target: {start: 0.1, speed: 2.0}, stiffness: 100.0, damping: 5.0}
      - {kind: wrench, frame: tip, force: [0, 0, -10], axes: world}

Where code takes a number or a function of time, a file takes a number or the fields of a
:class:`~pinconsist.mechanism.constraints.motion.Motion`.
"""

from __future__ import annotations

from ..errors import FormatError
from ..mechanism.forces import JointDamping, JointFriction, JointSpring, JointTorque, Servo, SpringDamper, Wrench
from .reading import shown
from .records import mapping, record_of

KINDS = {
    "damping": JointDamping,
    "friction": JointFriction,
    "spring": JointSpring,
    "spring-damper": SpringDamper,
    "torque": JointTorque,
    "servo": Servo,
    "wrench": Wrench,
}


def force_record(number: int, entry):
    """The force of the record that stands at place `number`, counted from 1; FormatError where it is none."""
    entry = dict(mapping(entry, force_element(number), "kind, joint, stiffness"))
    kind = entry.pop("kind", None)
    if kind is None:
        raise FormatError("'kind' is missing", element=force_element(number))
    if kind not in tuple(KINDS):
        reason = f"unknown kind {shown(kind)}; known are {', '.join(KINDS)}"
        raise FormatError(reason, element=force_element(number))
    return record_of(KINDS[kind], entry, f"force {number} ({kind})")


def force_element(number: int, force=None) -> str:
    """By what name messages speak of the force at place `number`."""
    kinds = [kind for kind, make in KINDS.items() if isinstance(force, make)]
    return f"force {number} ({kinds[0]})" if kinds else f"force {number}"
