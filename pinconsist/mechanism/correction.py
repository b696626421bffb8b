"""Correction of rounded numbers: the smallest change that makes dependent loops consistent again.

A parallelogram with three cranks can move because one loop follows from the other. If a length is wrong by 1e-9 m, the
loops contradict each other, and the rows that should be dependent lock the mechanism. Such rows are found from the
singular values of J at closed configurations along a random walk, on which the loops may stay open by the error of the
numbers. Let N be the left singular vectors of the small singular values, the combinations of rows that should vanish,
and P = ∂Φ/∂p for the placements p of all joints and anchors. Then N Φ + N P δp = 0 at all these configurations makes
the rows dependent to second order. The solution δp of smallest norm is used, and the step is repeated until the loops
close to rounding.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from .closing import LoopSolver, newton, steady
from .description import digests
from .lie import difference, integrate
from .loops import anchor
from .rank import SIX_DIGITS, row_scales
from .rows import AnchoredRows
from .wrenches import several_wrenches

_WEAK = (30.0, 3.0)  # how many errors may add up in a row of J; both values are tried
_REACH = 0.4  # rad and m, distance between configurations of the walk
_ONWARD = 5.0  # weight of the last direction in a walk that should cover long distances
_LEAST, _MOST = 6, 40  # number of configurations
_SEARCHES, _FREEDOM = 8, 2  # searches for singular configurations, and the largest mobility for which they are made
_STEP = 1e-6  # of difference quotients of J
_VANISHES, _NEAR = 1e-9, 1e-2  # singular values, relative to the largest: zero; close to a singular configuration
_ITERATIONS = 8
_OVERSHOOT = 3.0  # times the precision: after a larger step the iteration is given up
_AGREE = 1e-12  # m or rad: gaps of consistent loops are smaller
_LEAP = 0.5  # rad or m
_found: dict[tuple, Any] = {}


class Correction(NamedTuple):
    """A mechanism with corrected numbers, and its mobility."""

    mechanism: Any
    mobility: int


def correction(mechanism, precision: float) -> Correction | None:
    """The smallest correction that makes rows dependent which errors of this size made independent, or None."""
    if not mechanism.anchored_loops:
        return None
    still = mechanism.with_loops(*steady(mechanism.loops))
    moving = [loop for loop in mechanism.loops if loop not in still.loops]
    for weak in _WEAK:
        walk = Walk(still, weak * precision)
        places = walk.contradictions()
        for branching in (True, False) if places else ():
            found = _corrected(walk, places, precision, branching)
            if found is not None and found.mechanism.corrected_by <= precision:
                loops = {loop.name: loop for loop in (*found.mechanism.loops, *moving)}
                whole = found.mechanism.with_loops(*(loops[loop.name] for loop in mechanism.loops))
                return Correction(whole, max(found.mobility - len(moving), 0))
    return None


def rounding_of(mechanism) -> Correction | None:
    """The correction, within 1e-6 or else 1e-5, with which a mechanism closes or can move, or None."""
    parts = digests(mechanism)
    key = parts["model"], parts["loops"], parts["guess"]
    if key not in _found:  # cached for the last mechanism: the search can take seconds, and any assembly may need it
        _found.clear()
        _found[key] = correction(mechanism, SIX_DIGITS) or correction(mechanism, 10 * SIX_DIGITS)
    return _found[key]


def hint(mechanism) -> str:
    """Advice about rounded numbers for the end of a message; empty if no correction helps."""
    found = rounding_of(mechanism)
    if found is None:
        return ""
    change = found.mechanism.corrected_by
    precision = f"{SIX_DIGITS if change <= SIX_DIGITS else 10 * SIX_DIGITS:.0e}"
    return (
        f"the numbers in the file are rounded: load(…, precision={precision}) "
        f"changes them by up to {change:.1e} m or rad; the loops are then consistent and the mobility is "
        f"{found.mobility}"
    )


def _corrected(walk, places, precision, branching) -> Correction | None:
    """The correction that is found from the first `places` of a walk, or None.

    With `branching`, positions where the mechanism branches are preserved.
    """
    mechanism, rank = walk.mechanism, walk.full
    parameters, dependent = 6 * (len(mechanism.joints) + 2 * len(mechanism.loops)), walk.solver.loop_rows.nc - rank
    if np.max(np.abs(_step([walk.equations(place, rank) for place in places]))) > _OVERSHOOT * precision:
        return None  # with more places, the change can only grow
    if branching and not 0 < rank + _FREEDOM >= mechanism.nv:
        return None
    places = places + walk.places(min(parameters // dependent, _MOST), places[-1])
    places = [place for place in places if walk.rank(place) == rank]
    starts = walk.places(_MOST, places[0], onward=_ONWARD)[:: _MOST // _SEARCHES] if branching else []
    singular = [walk.singular(place) for place in starts]
    singular = [place for place in singular if place is not None]
    if branching and not singular:
        return None
    result = mechanism
    for _ in range(_ITERATIONS):
        equations = [walk.equations(place, rank) for place in places]
        equations += [walk.equations(place, rank - 1) for place in singular]
        if max(np.max(np.abs(gaps), initial=0.0) for gaps, _ in equations) < 0.1 * _AGREE:
            break
        change = _step(equations)
        if np.max(np.abs(change)) > _OVERSHOOT * precision:
            return None
        result = _changed(result, np.where(np.abs(change) > 0.1 * _AGREE, change, 0.0).reshape(-1, 6))
        walk = Walk(result, walk.weak, rank)
        places = [new for place in places if (new := walk.settled(place)) is not None]
        singular = [new for place in singular if (new := walk.singular(place)) is not None]
        if not places:
            return None
    fresh = walk.places(_LEAST, places[0], seed=1)
    if not fresh or max(map(walk.solver.size, fresh)) > _AGREE or walk.has_excess_rank(fresh):
        return None
    result = replace(result, guess=places[0], corrected_by=_change(mechanism, result))
    return Correction(result, mechanism.nv - rank)


def _step(equations):
    """The smallest change that satisfies these equations to second order."""
    left, P = (np.concatenate(parts) for parts in zip(*equations, strict=True))
    return np.linalg.lstsq(P, -left, rcond=1e-6)[0]


class Walk:
    """Configurations with closed loops, except for rows that are independent by less than `weak`.

    `full` is the rank of the other rows wherever the mechanism does not branch.
    """

    def __init__(self, mechanism, weak, full=0):
        self.solver, self.weak, self.mechanism, self.full = LoopSolver(mechanism), weak, mechanism, full
        self.turns = self.solver.loop_rows.turns

    def split(self, q):
        """Φ, the scales of the rows, the SVD U, s, Vᵀ of the scaled J, and its rank."""
        phi, J = self.solver.rows(q)
        scales = row_scales(J, self.turns)
        U, s, Vt = np.linalg.svd(J / scales[:, None])
        return phi, scales, U, s, Vt, int(np.count_nonzero(s > self._least(scales) * s.max(initial=0.0)))

    def _least(self, scales):
        return self.weak / scales.min(initial=1.0)

    def rank(self, q) -> int:
        return self.split(q)[-1]

    def has_excess_rank(self, places) -> bool:
        """Whether the rank of all rows, with the current numbers, exceeds ``full``."""
        return any(len(self.solver.kept(place)) > self.full for place in places)

    def contradictions(self) -> list:
        """The first places, and sets ``full``; empty if the loops are consistent, or all rows should be independent."""
        places = self.places(_LEAST)
        if places:
            self.full = int(np.argmax(np.bincount([self.rank(place) for place in places])))  # the most frequent rank
        agree = not self.has_excess_rank(places) and max(map(self.solver.size, places), default=0.0) < _AGREE
        if agree or self.full == self.solver.loop_rows.nc:
            return []
        return [place for place in places if self.rank(place) == self.full]

    def settled(self, q, least=0.0):
        """The configuration near `q` in which all but weak combinations of rows are closed, or None.

        Singular values below `least`, relative to the largest, also count as weak.
        """
        J = self.solver.rows(q)[1]
        least = max(least, self._least(row_scales(J, self.turns)))
        return newton(self.solver.rows, self.solver.model, self.turns, q, _LEAP, tolerance=least)

    def places(self, count, start=None, seed=0, onward=0.0) -> list:
        """Up to `count` configurations along a random walk from `start`, by default the guess.

        `onward` is the weight of the last direction in the next one; with a large weight, the walk gets farther.
        """
        rng, found, model = np.random.default_rng(seed), [], self.solver.model
        at = self.settled(self.solver.descend(self.mechanism.guess if start is None else start, enough=self.weak)[0])
        ahead = np.zeros(model.nv)
        for _ in range(3 * count):
            if at is not None:
                found.append(at)
            if len(found) == count or not found:
                break
            *_, Vt, rank = self.split(found[-1])
            free = Vt[rank:].T
            if not free.size:
                break
            chosen, reach = rng.standard_normal(free.shape[1]), _REACH * rng.uniform(0.5, 1.0)
            motion = free @ (chosen + onward * free.T @ ahead / max(np.linalg.norm(ahead), 1e-300))
            near = integrate(model, found[-1], reach * motion / np.linalg.norm(motion))
            at = self.settled(self.solver.descend(near, enough=self.weak)[0])
            if at is not None and (self.solver.size(at) > self.weak or self.rank(at) < rank):  # open, or a branch
                at = None
            ahead = rng.standard_normal(model.nv) if at is None else difference(model, found[-1], at)
        return found

    def singular(self, q):
        """A position near `q` where the mechanism branches, as one more singular value of J vanishes; or None."""
        k, best = self.full - 1, None
        for _ in range(2 * _ITERATIONS):
            _, scales, U, s, Vt, rank = self.split(q)
            if rank < k:
                return None
            if rank == k and (best is None or s[k] < best[0]):
                best = s[k], q
            free, u, v = Vt[rank:], U[:, k] / scales, Vt[k]
            near = [integrate(self.solver.model, q, _STEP * z) for z in free]
            slope = np.array([u @ self.solver.rows(each)[1] @ v - s[k] for each in near]) / _STEP
            steep = slope @ slope
            if s[k] < _VANISHES * s[0] or not steep:
                break
            way = -s[k] * slope / steep
            way *= min(1.0, _REACH / np.linalg.norm(way))
            weak = 3.0 * s[k] / s[0]  # the combination of rows that vanishes there need not be closed
            q = self.settled(integrate(self.solver.model, q, way @ free), weak if weak < _NEAR else 0.0)
            if q is None:
                break
        return best and best[1]

    def equations(self, q, rank):
        """N Φ and N P at a configuration of this rank; P has six columns for each joint, then six for each anchor."""
        phi, scales, U, *_ = self.split(q)
        N = U[:, rank:].T
        return N @ (phi / scales), N @ (self._by_placement(q) / scales[:, None])

    def _by_placement(self, q):
        """∂Φ/∂p, (nc, 6(joints + 2 loops)); p are twists of the placements of joints and anchors in their own axes."""
        model, data, rows = self.solver.model, self.solver.data, self.solver.loop_rows
        pin.forwardKinematics(model, data, q)
        n = model.njoints - 1
        P = np.zeros((rows.nc, n + 2 * len(rows.loops), 6))
        joints = [data.oMi[model.parents[j]] * model.jointPlacements[j] for j in range(1, n + 1)]
        for number, closure in enumerate(rows.closures):
            if not isinstance(closure, AnchoredRows):
                continue
            pose1, pose2 = data.oMi[closure.joint1] * closure.place1, data.oMi[closure.joint2] * closure.place2
            unit = np.eye(len(closure.turns))
            A = several_wrenches(rows, closure, self.solver.t, q, unit, self.solver.workspace)  # ∂Φ/∂(twist), closed
            A[:, 3:] += np.cross(pose2.translation, A[:, :3])  # of the twist about the origin
            part = P[rows.slices[closure.loop.name]]
            for sign, joint in ((1.0, closure.joint2), (-1.0, closure.joint1)):
                for j in (j for j in model.supports[joint] if j):
                    part[:, j - 1] += sign * A @ joints[j - 1].action
            part[:, n + 2 * number], part[:, n + 2 * number + 1] = -A @ pose1.action, A @ pose2.action
        return P.reshape(rows.nc, -1)


def _changed(mechanism, twists):
    """The mechanism with joints and anchors displaced by these twists, in their own axes."""
    model, n = mechanism.model.copy(), len(mechanism.joints)
    for j in range(1, n + 1):
        model.jointPlacements[j] = model.jointPlacements[j] * pin.exp6(twists[j - 1])
    loops = []
    for loop, pair in zip(mechanism.loops, twists[n:].reshape(-1, 2, 6), strict=True):
        for end, twist in enumerate(pair, start=1):
            if twist.any():  # never for couplings and drives
                loop = replace(loop, **anchor(end, getattr(loop, f"placement{end}") * pin.exp6(twist)))
        loops.append(loop)
    return replace(mechanism, model=model, loops=tuple(loops))


def _change(mechanism, other) -> float:
    """The largest difference of the placements of joints and anchors, m or rad."""
    pairs = list(zip(mechanism.model.jointPlacements, other.model.jointPlacements, strict=True))
    loops = zip(mechanism.anchored_loops, other.anchored_loops, strict=True)
    for loop, new in loops:
        pairs += [(loop.placement1, new.placement1), (loop.placement2, new.placement2)]
    return max(float(np.abs(pin.log6(one.actInv(two)).vector).max()) for one, two in pairs)
