"""What acts during a motion and can be drawn: the loops' forces and moments, the torques of drives and motors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..mechanism.constraints.loop import Loop
from ..mechanism.forces import JointTorque, Servo
from ..mechanism.mechanism import Mechanism
from ..mechanism.reactions import Reaction, reaction
from .motion import Run, anchors, in_world

FORCE, MOMENT = "force", "moment"
MOTORS = (JointTorque, Servo)
NOTHING = 1e-9  # of the largest: below it a moment is rounding, as of a hinge's tilts in a planar loop


@dataclass(frozen=True, eq=False)
class Action:
    """A force, N, or a moment, N·m, over the frames."""

    name: str
    kind: str  # FORCE or MOMENT
    points: np.ndarray  # (m, 3), m, where it acts
    vectors: np.ndarray  # (m, 3), world axes
    on_joint: bool = False  # of a drive or motor; else of a loop

    @property
    def sizes(self) -> np.ndarray:
        """Its size at every frame, shape (m,)."""
        return np.linalg.norm(self.vectors, axis=1)


def motors(mech: Mechanism) -> list:
    """The forces of a mechanism that are servos or joint torques; to know what they do, velocities are needed."""
    return [force for force in mech.forces if isinstance(force, MOTORS)]


def actions(run: Run, poses: np.ndarray, size: float, without=frozenset()) -> list[Action]:
    """All that can be drawn.

    A loop acts on its body 2, or on its body 1 where the other is the ground; drives and motors act on their joints,
    of which those with one degree of freedom are told. Couplings are left out: theirs is a share of two joints.

    Parameters
    ----------
    run : Run
        With multipliers, at the frames' times.
    poses : ndarray, shape (m, njoints, 7)
        World poses of the joints.
    size : float
        Size of the scene, m, by which moments are told from rounding.
    without : collection of str
        Loops that are left out, as their forces are not determined.
    """
    out = []
    for loop in (each for each in run.mech.loops if each.name not in without):
        found = reaction(run.mech, loop.name, run.t, run.q, run.lam)
        if isinstance(loop, Loop):
            out += _of_loop(run, poses, loop, found)
        elif loop.kind == "drive":
            out += _at_joints(run, poses, loop.name, found.joint_forces)
    if acting := motors(run.mech):
        bound = [force.bind(run.mech.model) for force in acting]
        states = zip(run.t, run.q, run.v, strict=True)
        torques = np.array([sum(each.torque(*state) for each in bound) for state in states])
        out += _at_joints(run, poses, "motor", torques)
    largest = max((each.sizes.max() / (size if each.kind == MOMENT else 1.0) for each in out), default=0.0)
    return [each for each in out if each.kind == FORCE or each.sizes.max() > NOTHING * largest * size]


def _of_loop(run: Run, poses: np.ndarray, loop: Loop, found: Reaction) -> list[Action]:
    joint, place = anchors(run.mech.model, loop)[1]
    points = in_world(poses[:, joint], [place.translation])[:, 0]
    sign = 1.0 if joint else -1.0
    force, moment = Action(loop.name, FORCE, points, sign * found.force), sign * found.moment
    return [force, Action(f"{loop.name} moment", MOMENT, points, moment)] if moment.any() else [force]


def _at_joints(run: Run, poses: np.ndarray, name: str, torques: np.ndarray) -> list[Action]:
    """Torques, shape (m, nv), on joints that turn, forces on those that slide; of one degree of freedom each."""
    model, data, out = run.mech.model, run.mech.model.createData(), []
    for joint, of in enumerate(run.mech.joints, start=1):
        torque = torques[:, model.idx_vs[joint]]
        if model.nvs[joint] != 1 or not torque.any():
            continue
        slides, turns = np.reshape(data.joints[joint].S, (2, 3))
        kind, axis = (MOMENT, turns) if turns.any() else (FORCE, slides)
        along = in_world(poses[:, joint], [axis])[:, 0] - poses[:, joint, :3]
        out.append(Action(f"{name} {of}", kind, poses[:, joint, :3], torque[:, None] * along, on_joint=True))
    return out
