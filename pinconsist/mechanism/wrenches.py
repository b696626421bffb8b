"""Forces and moments on bodies: of loops, of forces, and those that each joint of the tree transmits."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .forces import bound_forces
from .loops import Loop
from .rows import KeptRows, LoopRows

WRENCH_ROUNDING = 1e-9  # of the largest wrench: smaller ones are rounding


class Load(NamedTuple):
    """A force, N, and a moment about its point, N·m, on the body of a joint; (n, 3) each, in world axes."""

    loop: str  # that exerts it; empty for a force
    joint: int
    point: np.ndarray
    force: np.ndarray
    moment: np.ndarray


def loop_wrenches(rows, closure, t, q, lam, axes, workspace):
    """[force, moment] on body 2, zero without anchors, and Jᵀλ of one loop at several states."""
    compiled = workspace.compiled()
    own = rows.slices[closure.loop.name]
    KeptRows(rows, range(own.start, own.stop)).hand_over(compiled)
    joint_forces = compiled.residuals(t, q, np.zeros((len(t), rows.model.nv)), lam)[2]
    if not isinstance(closure.loop, Loop):
        return np.zeros((len(t), 6)), joint_forces
    return compiled.wrenches(t, q, lam, *closure.ends(), axes == "world"), joint_forces


def several_wrenches(rows, closure, t, q, lam, workspace):
    """[force, moment] on body 2 at anchor 2, (n, 6), in world axes, of n multipliers (n, rows) in one state."""
    n = len(lam)
    return loop_wrenches(rows, closure, np.full(n, t), np.tile(q, (n, 1)), lam, "world", workspace)[0]


class Transmission:
    """The wrenches that the joints of a tree transmit at n states, with accelerations `a`, (n, nv), and λ, (n, nc).

    The wrench of a joint balances the bodies beyond it: their inertial forces and weights, the loops between them and
    the others, and the forces that act on bodies. All other forces, and user-defined constraints, are taken for torques
    of joints; they are then the part of the wrench along the free axes of the joint (less the torque that accelerates
    its rotor).
    """

    def __init__(self, mechanism, t, q, v, a, lam, workspace):
        self.model, n = mechanism.model, len(t)
        self._inertial = np.empty((n, self.model.njoints, 6))  # in the axes of each joint
        self.places = np.empty((n, self.model.njoints, 3))
        self.turns = np.empty((n, self.model.njoints, 3, 3))
        self._move(q, v, a, workspace.data)
        self._loads = [*self._of_loops(mechanism, t, q, lam, workspace), *_of_forces(mechanism, t, q, v)]
        if lam.shape[1] > mechanism.nc:
            self._loads += self._of_contacts(mechanism, lam[:, mechanism.nc :])

    def wrench(self, joint: int) -> np.ndarray:
        """[force, moment] on the child of a joint from its parent, at the joint, (n, 6), in world axes."""
        wrench = np.einsum("nij,nkj->nki", self.turns[:, joint], self._inertial[:, joint].reshape(-1, 2, 3))
        beyond, here = set(self.model.subtrees[joint]), self.places[:, joint]
        for load in self._loads:
            if load.joint in beyond:
                wrench[:, 0] -= load.force
                wrench[:, 1] -= load.moment + np.cross(load.point - here, load.force)
        return wrench.reshape(-1, 6)

    def wrenches(self) -> dict[str, np.ndarray]:
        """:meth:`wrench` of each joint by its name, without those that transmit nothing but rounding, as free ones."""
        found = {self.model.names[joint]: self.wrench(joint) for joint in range(1, self.model.njoints)}
        largest = max((np.abs(wrench).max(initial=0.0) for wrench in found.values()), default=0.0)
        return {
            name: wrench
            for name, wrench in found.items()
            if np.abs(wrench).max(initial=0.0) > WRENCH_ROUNDING * largest
        }

    def resultant(self, members, body: int, point) -> np.ndarray:
        """[force, moment about `point` (n, 3)] of some loops and joints together on a body, (n, 6), in world axes."""
        total = np.zeros((len(point), 2, 3))

        def add(sign, at, force, moment):
            total[:, 0] += sign * force
            total[:, 1] += sign * (moment + np.cross(at - point, force))

        for load in self._loads:
            if ("loop", load.loop) in members and load.joint == body:
                add(1.0, load.point, load.force, load.moment)
        for joint in range(1, self.model.njoints):
            if ("joint", self.model.names[joint]) in members and body in (joint, self.model.parents[joint]):
                wrench = self.wrench(joint)
                add(1.0 if joint == body else -1.0, self.places[:, joint], wrench[:, :3], wrench[:, 3:])
        return total.reshape(-1, 6)

    def anchor(self, closure) -> np.ndarray:
        """Anchor 2 of a loop, (n, 3), m, in world axes."""
        return self.places[:, closure.joint2] + self.turns[:, closure.joint2] @ closure.place2.translation

    def _move(self, q, v, a, data):
        every = range(self.model.njoints)
        for i in range(len(q)):
            pin.rnea(self.model, data, q[i], v[i], a[i])
            pin.updateGlobalPlacements(self.model, data)
            for joint in every:
                pose = data.oMi[joint]
                self._inertial[i, joint] = data.f[joint].vector
                self.places[i, joint] = pose.translation
                self.turns[i, joint] = pose.rotation

    def _of_contacts(self, mechanism, lam) -> list[Load]:
        loads, first = [], 0
        for element in mechanism.contact_elements:
            own, first = lam[:, first : first + element.size], first + element.size
            if not element.of_joint:
                joint1, place1, joint2, place2 = element.ends
                x1, x2 = self._at(joint1, place1), self._at(joint2, place2)
                force = element.force(own, x1, x2, self.turns[:, joint1])
                moment = element.moment(own, self.turns[:, joint1])
                loads.append(Load("", joint2, x2, force, moment))
                loads.append(Load("", joint1, x2, -force, -moment))
        return loads

    def _at(self, joint, place):
        """A point of a body, (n, 3), in world axes."""
        return self.places[:, joint] + self.turns[:, joint] @ place[:3, 3]

    def _of_loops(self, mechanism, t, q, lam, workspace):
        rows, loads = LoopRows.of(mechanism), []
        for closure in rows.closures:
            if isinstance(closure.loop, Loop):
                its = lam[:, rows.slices[closure.loop.name]]
                wrenches, _ = loop_wrenches(rows, closure, t, q, its, "world", workspace)
                force, moment = wrenches[:, :3], wrenches[:, 3:]
                point = self.anchor(closure)
                name = closure.loop.name
                loads.append(Load(name, closure.joint2, point, force, moment))
                loads.append(Load(name, closure.joint1, point, -force, -moment))
        return loads


def _of_forces(mechanism, t, q, v) -> list[Load]:
    """The loads of forces that act on points of bodies."""
    loads = []
    for force in bound_forces(mechanism.model, mechanism.forces).values():
        if not (len(t) and force.loads(t[0], q[0], v[0])):
            continue
        states = [force.loads(*state) for state in zip(t, q, v, strict=True)]
        for ends in zip(*states, strict=True):
            joints, *parts = zip(*ends, strict=True)
            loads.append(Load("", joints[0], *(np.array(part) for part in parts)))
    return loads
