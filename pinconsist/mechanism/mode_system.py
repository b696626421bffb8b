"""The equations of a mechanism in one mode of its contacts: with the rows of what is closed or sticks."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engine.complementarity import contact_laws
from .system import MechanismSystem

OPEN, CLOSED, STICK, SLIP = "open", "closed", "stick", "slip"
DEPENDENT = 1e-6  # remainder of a row, relative to its length, below which it depends on those before it
EQUAL = 1e-6  # relative difference of remainders that are as large
APART = 1e-9  # part of a gap in a dependence of unit length below which it has none
NO_ROW = 1e-9  # length of a row, relative to the longest, that is rounding


class Mode(NamedTuple):
    """What one element does: ``open``, ``closed`` (it rests, without friction), ``stick`` or ``slip``.

    `at` is where it sticks, along its tangents; `direction` that of sliding, a unit vector.
    """

    kind: str = OPEN
    at: tuple[float, ...] = ()
    direction: tuple[float, ...] = ()


def first_rows(elements) -> np.ndarray:
    """Where the rows of each element begin among those of all, and their number after them."""
    return np.concatenate(([0], np.cumsum([each.size for each in elements]))).astype(int)


class Shared(NamedTuple):
    """Gaps whose rows depend on each other, as those of four legs: r combinations of their rows are constraints.

    `members` are the k elements, `shares` (k, r) their parts in each multiplier, from `place` on. The forces are those
    of smallest norm: of supports that yield equally.
    """

    members: tuple[int, ...]
    shares: np.ndarray
    place: int


class ModeSystem(MechanismSystem):
    """The system of `base`, which has the loops and forces, with the rows of `elements` in their `modes`.

    `every` is a compiled system with all rows of the elements. `J` has the kept rows of the loops and then the rows of
    all elements, at the position at which the mode begins, by which independent ones are kept: first the gaps, which
    share their forces if they depend on each other, then tangents, then the friction of joints. ``redundant`` says
    whether some depend on others; ``used`` has for each element the kept ones of its rows and their places among the
    multipliers, ``shared`` the rest of the gaps. Contacts that slide more slowly than `still` keep their direction.
    """

    def __init__(self, base: MechanismSystem, elements, every, modes, J, still: float):
        vars(self).update(vars(base))
        vars(self).pop("compiled", None)  # those have other rows
        self._base, self.elements, self.every, self.modes = base, elements, every, tuple(modes)
        self._start, self.still = J, still
        self.firsts = first_rows(elements)
        chosen, groups, self.redundant = _independent(J[: base.nc], self._wanted(), J[base.nc :])
        self.used: dict[int, dict[int, int]] = {}
        place = base.nc
        for i, mode in enumerate(self.modes):
            rows = [row - self.firsts[i] for row in chosen if self.firsts[i] <= row < self.firsts[i + 1]]
            if rows and mode.kind != OPEN:
                self.used[i] = {row: place + k for k, row in enumerate(rows)}
                place += len(rows)
        self.shared: list[Shared] = []
        for rows, shares in groups:
            members = tuple(int(np.searchsorted(self.firsts, row, side="right")) - 1 for row in rows)
            self.shared.append(Shared(members, shares, place))
            place += shares.shape[1]
        self.nc = place
        self.spread = self._spread()
        self.hinges = {i: each.hinge(base) for i, each in enumerate(self.elements) if not each.pushes}

    def _spread(self) -> np.ndarray:
        """The matrix (rows of all elements, nc) that makes forces of the multipliers, except those of sliding."""
        spread = np.zeros((int(self.firsts[-1]), self.nc))
        for members, shares, place in self.shared:
            spread[self.firsts[list(members)], place : place + shares.shape[1]] = shares
        for i, rows in self.used.items():
            for row, place in rows.items():
                spread[self.firsts[i] + row, place] = 1.0
        return spread

    @property
    def base(self) -> MechanismSystem:
        return self._base

    def _wanted(self) -> list[list[int]]:
        """The rows of elements in classes, those of the first class first."""
        gaps, tangents, of_joints = [], [], []
        for i, (element, mode) in enumerate(zip(self.elements, self.modes, strict=True)):
            first = self.firsts[i]
            if mode.kind != OPEN and element.pushes:
                gaps.append(first)
            if mode.kind == STICK:
                rows = range(first + element.pushes, first + element.size)
                (tangents if element.pushes else of_joints).extend(rows)
        return [gaps, tangents, of_joints]

    def with_base(self, base) -> ModeSystem:
        """The same mode with other rows of the loops."""
        return ModeSystem(base, self.elements, self.every, self.modes, self._start, self.still)

    def aimed(self, q, v) -> ModeSystem:
        """The same mode, in which contacts slide in the directions of a velocity."""
        modes = [
            mode._replace(direction=tuple(self.directions(i, q, v, mode.direction)))
            if mode.kind == SLIP and self.elements[i].tangents == 2
            else mode
            for i, mode in enumerate(self.modes)
        ]
        return ModeSystem(self.base, self.elements, self.every, modes, self._start, self.still)

    def hand_over(self, compiled):
        self.kept_rows.hand_over(compiled)
        self._slide_joints(compiled, of_loops=True)
        for i, rows in self.used.items():
            element, mode = self.elements[i], self.modes[i]
            if mode.kind == SLIP:
                element.add_sliding(compiled, mode.direction, self.still)
            else:
                element.add(compiled, tuple(rows), mode.at or None)
        for members, shares, _ in self.shared:
            for i in members:
                if self.modes[i].kind == SLIP:
                    self.elements[i].add_sliding(compiled, self.modes[i].direction, self.still)
                else:
                    self.elements[i].add(compiled, (0,))
            compiled.combine(shares.T)
        self.hand_over_forces(compiled)

    def hand_over_forces(self, compiled):
        super().hand_over_forces(compiled)
        self._slide_joints(compiled, of_loops=False)

    def _slide_joints(self, compiled, of_loops):
        """Add the friction of joints, or of pins of loops, that slide."""
        for i, hinge in self.hinges.items():
            if self.modes[i].kind == SLIP and self.elements[i].of_loop == of_loops:
                self.elements[i].slide(compiled, self.modes[i].direction[0], hinge)

    @property
    def n_multipliers(self):
        return self.rows.nc + int(self.firsts[-1])

    def full_multipliers(self, q, lam, complete=None, v=None):
        """λ of all rows of the loops, then of all elements, 0 where they are open, from those in use; also stacks.

        The friction of contacts that slide is that of their velocity `v`.
        """
        of_loops = lam[..., : self.base.nc].copy()
        own = lam @ self.spread.T
        for i, (element, mode) in enumerate(zip(self.elements, self.modes, strict=True)):
            if mode.kind == SLIP:
                first = self.firsts[i]
                self._slide(own[..., first : self.firsts[i + 1]], i, element, mode, q, v, lam)
        if self.redundant:
            self._share(q, of_loops, own)
        loops = self.base.full_multipliers(q, of_loops, complete)
        return np.concatenate((loops, own), axis=-1)

    def _share(self, q, of_loops, own):
        """Distribute the forces among rows that depend on each other: of smallest norm or, where these break a law,
        so that each obeys its law.

        Rows may depend on each other by the loops, which then carry what the others do not: only the part of the forces
        that the loops cannot carry is given.
        """
        laws = self.laws()
        held = np.repeat([mode.kind in (CLOSED, STICK) for mode in self.modes], np.diff(self.firsts))
        states = [(q, of_loops, own)] if own.ndim == 1 else zip(q, of_loops, own, strict=True)
        for position, loops, forces in states:
            R, J = self.every.rows(position)[1], self.base.compiled.rows(position)[1]
            carried = np.linalg.qr(J.T)[0]
            given = R - (R @ carried) @ carried.T
            shares = forces.copy()
            shares[held] = np.linalg.lstsq(given[held].T, forces[held] @ given[held], rcond=1e-10)[0]
            if not laws.obey(shares):
                shares = laws.shared(given, forces)
            if len(J):
                loops += np.linalg.lstsq(J.T, (forces - shares) @ R, rcond=None)[0]
            forces[:] = shares

    def laws(self):
        """The laws of the elements, in the engine: what rests or sticks shares forces, what slides keeps its own.

        The limit of a pin is not known there: that its forces obey is found by its accelerations.
        """
        return contact_laws(
            [
                (
                    int(first), element.pushes, element.tangents, 0.0 if element.of_loop else element.static,
                    mode.kind in (CLOSED, STICK), mode.kind == STICK,
                )
                for first, element, mode in zip(self.firsts, self.elements, self.modes, strict=False)
            ]
        )  # fmt: skip

    def _slide(self, own, i, element, mode, q, v, lam):
        """Fill in the tangential forces of an element that slides."""
        if not element.pushes:
            own[..., 0] = -element.kinetic * self.hinges[i].load(lam) * mode.direction[0]
            return
        direction = np.broadcast_to(mode.direction, (*own.shape[:-1], len(mode.direction)))
        if element.tangents == 2 and v is not None:
            direction = self.directions(i, q, v, direction)
        own[..., 1:] = -element.kinetic * own[..., :1] * direction

    def directions(self, i, q, v, otherwise):
        """The directions in which the element slides, of one row or a stack of rows in order of time.

        Where it is too slow to have one, that of the row before, or `otherwise` of the first.
        """
        first, found = self.firsts[i] + 1, np.array(otherwise, float)
        rows = [(q, v)] if np.ndim(v) == 1 else list(zip(q, v, strict=True))
        last = np.reshape(found, (-1, 2))[0]
        for k, (position, velocity) in enumerate(rows):
            slip = self.every.evaluate(0.0, position, velocity, np.zeros(self.nv))[3][first : first + 2]
            if (speed := float(np.linalg.norm(slip))) > self.still:
                last = slip / speed
            found[(k,) if found.ndim > 1 else ...] = last
        return found

    def reselected(self, q):
        fresh = self.base.reselected(q)
        return None if fresh is None else self.with_base(fresh)

    def opened(self, times, positions, gaps=None):
        return self.base.opened(times, positions, gaps)

    def describe_row(self, row):
        for i, rows in self.used.items():
            for own, place in rows.items():
                if place == row:
                    return f"contact {self.elements[i].name!r} row {self.elements[i].labels[own]}"
        for members, shares, place in self.shared:
            if 0 <= row - place < shares.shape[1]:
                return f"contacts {', '.join(repr(self.elements[i].name) for i in members)} rows n"
        return super().describe_row(row)


def _independent(loops, classes, J):
    """The independent rows of J, (n, nv), the gaps that depend on each other, and whether some rows are not used.

    The gaps are the first of the classes; see :func:`dependent_gaps`. `loops` are rows that are kept in any case. Of
    the other classes the row with the largest remainder comes first; where several are as large, the first of them.
    """
    lengths = np.linalg.norm(J, axis=1) if len(J) else np.zeros(0)
    longest = lengths.max(initial=0.0)
    gaps = classes[0]
    groups = [([gaps[k] for k in members], shares) for members, shares in dependent_gaps(loops, J[gaps])]
    dependent = bool(groups)
    kept = [row for row in gaps if not any(row in rows for rows, _ in groups)]
    basis = np.linalg.qr(np.vstack((loops, J[kept], *(shares.T @ J[rows] for rows, shares in groups))).T)[0]
    for rows in classes[1:]:
        left = {row: J[row] / lengths[row] for row in rows if lengths[row] > NO_ROW * longest}
        dependent |= len(left) < len(rows)
        while left:
            for row in left:
                for _ in range(2):
                    left[row] = left[row] - basis @ (basis.T @ left[row])
            sizes = {row: float(np.linalg.norm(rest)) for row, rest in left.items()}
            most = max(sizes.values())
            if most < DEPENDENT:
                dependent = True
                break
            row = next(row for row, size in sizes.items() if size >= (1.0 - EQUAL) * most)
            kept.append(row)
            basis = np.column_stack((basis, left.pop(row) / sizes[row]))
    return sorted(kept), groups, dependent


def dependent_gaps(loops, N) -> list[tuple[list[int], np.ndarray]]:
    """The rows of gaps N, (k, nv), that depend on each other and on `loops`: groups, each with its shares (k, r).

    The r columns span the rates that the gaps of the group can have, and so the forces of smallest norm.
    """
    if not len(N):
        return []
    basis = np.linalg.qr(loops.T)[0] if len(loops) else np.zeros((N.shape[1], 0))
    rest = N
    for _ in range(2):
        rest = rest - (rest @ basis) @ basis.T
    lengths = np.linalg.norm(N, axis=1)
    lengths = np.maximum(lengths, NO_ROW * max(lengths.max(), 1e-300))
    U, sizes, _ = np.linalg.svd(rest / lengths[:, None])
    rank = int(np.sum(sizes >= DEPENDENT))
    if rank == len(N):
        return []
    none = np.linalg.qr(U[:, rank:] / lengths[:, None])[0]
    projector = none @ none.T
    together = np.abs(projector) > APART
    groups, left = [], [i for i in range(len(N)) if together[i, i]]
    while left:
        members, found = [], [left[0]]
        while found:
            i = found.pop()
            left.remove(i)
            members.append(i)
            found += [j for j in left if together[i, j] and j not in found]
        members.sort()
        own, vectors = np.linalg.eigh(np.eye(len(members)) - projector[np.ix_(members, members)])
        groups.append((members, vectors[:, own > 0.5]))
    return groups
