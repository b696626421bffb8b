"""Forces of redundant loops: which are not unique, who shares them, and how compliances distribute them.

If rows of the loops depend on each other, multipliers n with Jᵀn = 0 can be added to λ: the loops and the joints of the
tree then press against each other, and nothing moves. Rigid bodies do not determine such a self-stress. Joints that
give way a little do: with a compliance c of each, the energy Σ c |wrench|² / 2 is smallest.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import near, number
from .loops import Loop
from .rank import Ranking
from .wrenches import several_wrenches

JOINT, LOOP = "joint", "loop"
Member = tuple[str, str]  # JOINT or LOOP, and its name
DEPENDENCE_ROWS = 5  # rows of a run at which dependences are searched for
STRESS_ROUNDING = 1e-6  # smallest part of a unit self-stress, and of the largest force, that is not rounding
DETERMINED = 1e-12  # of the largest: smallest energy of a self-stress that compliances determine
WAYS = tuple(f"{what} {axis}" for what in ("force", "moment") for axis in "xyz")


def sampled(n: int) -> list[int]:
    """Rows of a run of `n` rows at which dependences of its loops are searched for."""
    return list(dict.fromkeys(k * (n - 1) // (DEPENDENCE_ROWS - 1) for k in range(DEPENDENCE_ROWS))) if n else []


@dataclass(frozen=True, eq=False)
class SelfStress:
    """The self-stresses of a mechanism in one configuration, as columns.

    ``multipliers`` (nc, k) are those of unit size, with rows in m scaled by ``size``, m. ``members`` maps each loop and
    joint to its wrenches (6, k): force and moment on body 2 at anchor 2, or on the child at the joint, in world axes;
    drives, couplings and user-defined constraints to their multipliers. ``poses`` has the points of the others, with
    the axes of anchor 1 or of the joint, and ``bodies`` the joints of the two bodies, first that on which they act.
    """

    multipliers: np.ndarray
    members: dict[Member, np.ndarray]
    poses: dict[Member, pin.SE3]
    bodies: dict[Member, tuple[int, int]]
    size: float

    def through(self, basis) -> "SelfStress":
        """The self-stresses that are combinations of these: the columns of `basis`, (k, m)."""
        members = {member: found @ basis for member, found in self.members.items()}
        return SelfStress(self.multipliers @ basis, members, self.poses, self.bodies, self.size)

    def parts(self, member: Member, axes: str) -> np.ndarray:
        """How much each component of a member's wrench takes part, (6,), or (rows,) of a loop without anchors."""
        found = self.members[member]
        if member in self.poses:
            found = self._scaled(found, self.poses[member].rotation if axes != "world" else np.eye(3))
        return np.linalg.norm(found, axis=1)

    def parts_of_sum(self, members, member: Member, axes: str) -> np.ndarray:
        """The same for the sum of several members on the body of one, about its point, (6,)."""
        pose, (body, _) = self.poses[member], self.bodies[member]
        total = np.zeros((2, 3, self.multipliers.shape[1]))
        for each in members:
            force, moment = self.members[each].reshape(2, 3, -1)
            sign = 1.0 if self.bodies[each][0] == body else -1.0
            total += sign * np.array(
                (force, moment + pin.skew(self.poses[each].translation - pose.translation) @ force)
            )
        turn = pose.rotation if axes != "world" else np.eye(3)
        return np.linalg.norm(self._scaled(total.reshape(6, -1), turn), axis=1)

    def parallel(self, member: Member) -> tuple[Member, ...]:
        """The members that join the same two bodies as one, itself included."""
        bodies = sorted(self.bodies.get(member, ()))
        return tuple(each for each in self.bodies if sorted(self.bodies[each]) == bodies)

    def loaded(self, wrenches: dict[Member, np.ndarray]) -> np.ndarray:
        """Orthonormal basis (k, m) of the self-stresses along which `wrenches`, (6,) of each member, have a part.

        The others are zero by symmetry, for instance across the plane of a planar mechanism.
        """
        halves = []
        for member, wrench in wrenches.items():
            mine = self.members[member]
            if member not in self.poses:
                halves += [(mine[i : i + 1], wrench[i : i + 1]) for i in range(len(mine))]
                continue
            halves += [(self.size * mine[:3], self.size * wrench[:3]), (mine[3:], wrench[3:])]
        largest = max((np.linalg.norm(wrench) for _, wrench in halves), default=0.0)
        along = np.array([mine.T @ wrench for mine, wrench in halves])
        _, sizes, ways = np.linalg.svd(along)
        return ways[: np.count_nonzero(sizes > STRESS_ROUNDING * largest)].T if largest else np.zeros((len(ways), 0))

    def partners(self, member: Member) -> tuple[Member, ...]:
        """The other members with which one shares these self-stresses, directly or by others."""
        scaled = [self._scaled(found) if each in self.poses else found for each, found in self.members.items()]
        basis, weights, _ = np.linalg.svd(np.vstack(scaled), full_matrices=False)
        basis = basis[:, weights > STRESS_ROUNDING * weights.max(initial=0.0)]
        blocks = dict(zip(self.members, np.split(basis, np.cumsum([len(part) for part in scaled])[:-1]), strict=True))
        found, waiting = [member], [member]
        while waiting:
            mine = blocks[waiting.pop()]
            fresh = [
                each for each in blocks if each not in found and np.abs(mine @ blocks[each].T).max() > STRESS_ROUNDING
            ]
            found += fresh
            waiting += fresh
        return tuple(each for each in found if each != member)

    def _scaled(self, wrenches, turn=None):
        """Forces times the size of the mechanism, and moments, in other axes."""
        force, moment = wrenches[:3], wrenches[3:]
        if turn is not None:
            force, moment = turn.T @ force, turn.T @ moment
        return np.vstack((self.size * force, moment))


def self_stress(rows, workspace, t, q) -> SelfStress | None:
    """The self-stresses of the `rows` of all loops at a state; None if the rows are independent."""
    J = rows.at(q, t)[1]
    ranking = Ranking(J, rows.turns)
    if len(ranking.kept) == len(J):
        return None
    shares = np.linalg.svd(J / ranking.scales[:, None])[0][:, len(ranking.kept) :]
    multipliers = shares / ranking.scales[:, None]
    size = float(ranking.scales.max(where=~rows.turns, initial=0.0)) or 1.0
    members, poses, bodies = wrenches_of(rows, workspace, t, q, multipliers)
    return SelfStress(multipliers, members, poses, bodies, size)


def wrenches_of(rows, workspace, t, q, multipliers) -> tuple[dict, dict, dict]:
    """What columns of multipliers exert on each loop and, in equilibrium, on each joint: see :class:`SelfStress`."""
    model = rows.model
    data = workspace.data
    members: dict[Member, np.ndarray] = {}
    poses: dict[Member, pin.SE3] = {}
    bodies: dict[Member, tuple[int, int]] = {}
    pin.forwardKinematics(model, data, q)
    on_bodies = np.zeros((model.njoints, 2, 3, multipliers.shape[1]))  # about the origin
    for closure in rows.closures:
        loop, its = closure.loop, multipliers[rows.slices[closure.loop.name]]
        members[LOOP, loop.name] = its
        if isinstance(loop, Loop):
            force, moment = several_wrenches(rows, closure, t, q, its.T, workspace).T.reshape(2, 3, -1)
            members[LOOP, loop.name] = np.vstack((force, moment))
            point = data.oMi[closure.joint2].act(closure.place2.translation)
            poses[LOOP, loop.name] = pin.SE3(data.oMi[closure.joint1].rotation @ closure.place1.rotation, point)
            bodies[LOOP, loop.name] = closure.joint2, closure.joint1
            about_origin = np.array((force, moment + pin.skew(point) @ force))
            on_bodies[closure.joint2] += about_origin
            on_bodies[closure.joint1] -= about_origin
    for joint in range(model.njoints - 1, 0, -1):
        on_bodies[model.parents[joint]] += on_bodies[joint]
        force, about_origin = -on_bodies[joint]
        pose, member = data.oMi[joint], (JOINT, model.names[joint])
        members[member] = np.vstack((force, about_origin - pin.skew(pose.translation) @ force))
        poses[member] = pose.copy()
        bodies[member] = joint, model.parents[joint]
    return members, poses, bodies


def over_samples(rows, workspace, t, q) -> dict[int, SelfStress]:
    """The self-stresses at a few rows of a run; empty if its loops are independent at one of them.

    While a singular configuration is passed, there are more of them; such rows are left out.
    """
    found = {}
    for i in sampled(len(t)):
        stress = self_stress(rows, workspace, t[i], q[i])
        if stress is None:
            return {}
        found[i] = stress
    fewest = min((each.multipliers.shape[1] for each in found.values()), default=0)
    return {i: each for i, each in found.items() if each.multipliers.shape[1] == fewest}


def compliances(mechanism, values) -> dict[Member, np.ndarray]:
    """Compliances from user input, by member: (6,) of a joint or a loop with anchors, (rows,) of the others."""
    if not isinstance(values, Mapping) or not values:
        raise InputError(f"compliance= needs a mapping of loops and joints to compliances, got {values!r}")
    loops, found = {loop.name: loop for loop in mechanism.loops}, {}
    for name, value in values.items():
        if name not in loops and name not in mechanism.joints:
            known = (*loops, *mechanism.joints)
            raise InputError(f"{mechanism.name}: compliance= of {name!r}, which is no loop or joint{near(name, known)}")
        who, loop = f"the compliance of {name!r}", loops.get(name)
        pair = np.ndim(value) == 1 and len(value) == 2
        if loop is not None and not isinstance(loop, Loop):
            found[LOOP, name] = np.full(len(loop.rows), number(value, who, least=0.0))
            continue
        force, moment = (number(each, who, least=0.0) for each in (value if pair else (value, 0.0)))
        found[LOOP if loop is not None else JOINT, name] = np.repeat((force, moment), 3)
    return found


def relaxed(stress: SelfStress, wrenches, compliance) -> tuple[np.ndarray, np.ndarray]:
    """(β, R): what compliances add of each self-stress, (k,), and basis (k, m) of those that they do not determine.

    The energy Σ c |wrench + members β|² / 2 is smallest; undetermined self-stresses remain as they are.
    """
    k = stress.multipliers.shape[1]
    energy, load = np.zeros((k, k)), np.zeros(k)
    for member, c in compliance.items():
        weighted = stress.members[member].T * c
        energy += weighted @ stress.members[member]
        load += weighted @ wrenches[member]
    sizes, ways = np.linalg.eigh(energy)
    soft = sizes > DETERMINED * sizes.max(initial=0.0)
    return -ways[:, soft] @ ((ways[:, soft].T @ load) / sizes[soft]), ways[:, ~soft]
