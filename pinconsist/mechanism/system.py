"""Mechanism → Index3System, with its private workspace.

The system integrates the *kept* rows of the loops. Rows that are identically zero or depend on others are dropped, so
that the KKT matrix is regular; :meth:`full_multipliers` restores the multipliers of all rows, at minimum norm.
"""

from functools import cached_property, partial

import numpy as np
import pinocchio as pin

from ..engine.problem import Index3System
from ..engine.systems import choice_of_rows, compiled_system
from ..errors import InputError, PinconsistError
from .assembly import velocity_on_constraints
from .breakpoints import Breakpoints
from .checks import read_only
from .closing import LoopSolver
from .forces import bound_forces
from .forces.force import BoundLaw, Differentiated, UserForce
from .forces.held import BoundHeld
from .forces.piecewise import BoundPiecewise
from .lie import difference, integrate, structure_constants
from .mechanism import Mechanism
from .names import velocity_names
from .rows import KeptRows, mass_matrix

DROPPED_GAP = 1e-6  # gap of a dropped row, relative to the mechanism's size, that shows that it was needed
VELOCITY_CHANGES = np.array([1e-8, 1e-6, 1e-4, 1e-3])  # relative to the largest velocity: over them jumps are sought
JUMP = 1e-3  # smallest jump, relative to the force
SIMULTANEOUS = 1e-9  # relative difference of times below which changes count as simultaneous
RANK_DISTANCE = 1e-3  # rad and m: from a position with dependent rows to those at which the rank is compared


class MechanismSystem(Index3System):
    """The equations M v' + nle = τ + Jᵀλ, Φ(q) = 0 of a mechanism.

    ``kept`` has the indices of the rows in use; they are chosen at the closed configuration `q` and the time `t`,
    ``chosen_at``, or they are those of another system, `like`, of a mechanism with other numbers. ``dropped_are_zero``
    is True if the others vanish everywhere, as out-of-plane rows do. The rows and the workspace of a `solver` that has
    assembled the mechanism at time `t` are reused.
    """

    def __init__(self, mechanism: Mechanism, q, t: float = 0.0, solver: LoopSolver | None = None, like=None):
        self.mechanism, self.model, self.chosen_at = mechanism, mechanism.model, t
        solver = solver or LoopSolver(mechanism, t)
        self.workspace, self.rows = solver.workspace, solver.loop_rows
        self.vector_like = self.model.nq == self.model.nv  # otherwise some joint is in SO(2), SO(3), SE(2) or SE(3)
        self.npos, self.nx, self.nv = self.model.nq, self.model.nv, self.model.nv
        chosen = like or solver.ranking(q)
        self.kept, self.scales = chosen.kept, chosen.scales
        self.nc = len(self.kept)
        self.kept_rows = KeptRows(self.rows, self.kept)
        self.difference_step = self.kept_rows.difference_step
        if like is None:
            dropped = sorted(set(range(self.rows.nc)).difference(self.kept.tolist()))
            self.dropped_are_zero = not dropped or self._zero_everywhere(tuple(dropped), q)
        else:
            self.dropped_are_zero = like.dropped_are_zero
        forces = bound_forces(self.model, mechanism.forces)
        breakpoints = self.rows.breakpoints if self.rows.moving else Breakpoints()
        breakpoints.add(forces.values())
        self._take(forces, breakpoints)
        self.moving, self._solver = self.rows.moving, None
        self.steps_from: tuple | None = None  # the start of a run that is over, on whose steps the forces act

    @property
    def data(self) -> pin.Data:
        """Pinocchio's data, which runs in C++ do not need."""
        return self.workspace.data

    @cached_property
    def compiled(self):
        """These equations in C++."""
        return compiled_system(self)

    @property
    def _structure(self):
        known = self.rows.structure
        if not known:
            known.append(structure_constants(self.model))
        return known[0]

    def _take(self, forces, breakpoints):
        vars(self).pop("compiled", None)
        self.forces, self.held_forces = forces, [each for each in forces.values() if isinstance(each, BoundHeld)]
        self.breakpoints = breakpoints
        self.changing = [each for each in forces.values() if each.changes]
        self.changing += [breakpoints] * bool(breakpoints)
        self.changes = bool(self.changing)
        narrow = [each.widths for each in forces.values() if each.widths is not None]
        self.widths = np.min(narrow, axis=0) if narrow else None
        self._sharp = [each for each in forces.values() if not each.smooth]
        self.sharp = bool(self._sharp)
        # Friction depends on v alone, and what functions of time do is known.
        self.may_act_later = any(each.widths is None and not each.by_time for each in self._sharp)

    def with_velocities(self, t, p, v, named):
        solver = self._solver = self._solver or LoopSolver(self.mechanism, t)
        solver.t = t
        solver.loop_rows.continue_in(self.breakpoints)
        return velocity_on_constraints(solver, p, named, self.kept, v)

    def describe_velocity(self, i):
        return velocity_names(self.model)[i]

    @property
    def held(self) -> dict[str, np.ndarray]:
        """The tables of sampled forces, by their labels; see :attr:`Solution.held`."""
        return {label: force.held for label, force in self.forces.items() if isinstance(force, BoundHeld)}

    def start(self, t, p, v, backwards, like=None):
        for force in self.changing:
            force.start(t, backwards)
        if like is not None:
            for mine, theirs in zip(self.held_forces, like.held_forces, strict=True):
                mine.follow(theirs, t)
        self.change(t, p, v)

    def on_steps(self, run: "MechanismSystem", t, backwards) -> None:
        """Let the forces that change act as in a `run` from `t` that is over, for evaluations in any order."""
        mine, theirs = ([each for each in system.changing if each is not system.breakpoints] for system in (self, run))
        if [type(each) for each in mine] != [type(each) for each in theirs]:
            raise InputError(f"{self.mechanism.name}: the forces that change at known times are not those of the run")
        for each, other in zip(mine, theirs, strict=True):
            each.on_steps(other, t, backwards)
        self.steps_from = t, backwards

    def times_of_changes(self, low, high) -> list[float]:
        """The times at which forces jump, in order; break points of functions of time are not among them."""
        found = [each.times_between(low, high) for each in self.changing if each is not self.breakpoints]
        return sorted(t for times in found for t in times)

    def next_change(self, t, t_end):
        times = [force.next_change(t) for force in self.changing]
        if len(times) > 1:
            near = (1.0 + SIMULTANEOUS) * min([abs(time - t) for time in times])
            times = [max([time for time in times if abs(time - t) <= near], key=lambda time: abs(time - t))]
        return times[0] if times and (1.0 + SIMULTANEOUS) * abs(times[0] - t) < abs(t_end - t) else t_end

    def change(self, t, p, v):
        changed = [each.change(t, p, v) for each in self.changing]
        return any(changed) if any(each is not None for each in changed) else None

    def look_ahead(self, t, t_end, p, v, every):
        self.breakpoints.look_ahead(t, t_end, read_only(p), read_only(v), every)

    def jumps_at(self, t, p, v):
        return len(self.changing) > bool(self.breakpoints) or self.breakpoints.jump_at(t, read_only(p), read_only(v))

    def integrate(self, p, xi):
        return integrate(self.model, p, xi)

    def difference(self, p0, p1):
        return difference(self.model, p0, p1)

    def rate(self, t, p, v):
        return v

    def bracket(self, xi):
        return np.tensordot(xi, self._structure, 1)

    def position(self, t, base, psi, c, v):
        xi = psi + c * v
        return (xi, xi) if self.vector_like else (self.integrate(base, xi), xi)

    def evaluate(self, t, p, v, a):
        f, phi, J, rho = self.compiled.evaluate(t, p, v, a)
        return f, phi, J.T, rho

    def linearize(self, t, p, v, a, lam, c, A):
        A[:] = self.compiled.linearize(t, p, v, a, c)
        return self.compiled.G_transposed

    def force_gradient(self, t, p, v, lam):
        """∂(Jᵀλ)/∂q, shape (nv, nv); by forward differences where rows are user-defined."""
        known = self.compiled.row_gradients(t, p, v, lam)
        if known is not None:
            return known[0]
        step = 1e-7
        at = self.compiled.rows(p, t)[1].T @ lam
        near = [self.compiled.rows(self.integrate(p, step * e), t)[1].T @ lam for e in np.eye(self.nv)]
        return np.column_stack([(each - at) / step for each in near])

    def constraint(self, t, p, rate):
        return self.compiled.constraint(t, p, rate)

    def acceleration_bias(self, t, p, v):
        return self.compiled.dynamics(t, p, v)[3]

    def position_scale(self, p):
        return np.abs(p) if self.vector_like else np.ones(self.nx)

    def describe_row(self, row):
        loop, name = self.rows.labels[self.kept[row]]
        return f"loop {loop!r} row {name}"

    def torque(self, t, q, v):
        """τ of all forces, shape (nv,)."""
        return sum((force.torque(t, q, v) for force in self.forces.values()), np.zeros(self.nv))

    def differentiate_forces(self) -> None:
        """Complete the derivatives of user-defined forces by differences, as derivatives of runs need them all."""
        moves = partial(integrate, self.model)  # not a method: forces do not hold their system
        for label, force in self.forces.items():
            if isinstance(force, BoundLaw | UserForce):
                self.forces[label] = Differentiated(force, moves)
            elif isinstance(force, BoundPiecewise):
                force.differentiate(moves)
        vars(self).pop("compiled", None)

    def sharp_force(self, t, p, v):
        return sum((force.torque(t, p, v) for force in self._sharp), np.zeros(self.nv))

    def hand_over(self, compiled) -> None:
        """Add the rows and forces to a compiled system."""
        self.kept_rows.hand_over(compiled)
        self.hand_over_forces(compiled)

    def hand_over_forces(self, compiled) -> dict[str, int]:
        """Add the forces to a compiled system; returns the number there of each that is one force, by its label."""
        found = {}
        for label, force in self.forces.items():
            before = compiled.number_of_forces
            force.hand_over(compiled)
            if compiled.number_of_forces == before + 1:
                found[label] = before
        return found

    def take_held(self, other: "MechanismSystem") -> None:
        """Take over the held torques and commands of another system of the same mechanism, as objects."""
        held = {label: force for label, force in other.forces.items() if isinstance(force, BoundHeld)}
        self._take(self.forces | held, self.breakpoints)

    def all_rows(self) -> KeptRows:
        """All rows of the loops, including dropped ones."""
        return KeptRows(self.rows, np.arange(self.rows.nc))

    def not_finite(self, t, q, v) -> tuple[str, ...]:
        """Labels of the forces whose torque or derivatives are not finite although the state is."""
        if not np.isfinite(np.concatenate((q, v))).all():
            return ()
        parts = {label: (f.torque(t, q, v), *f.derivatives(t, q, v)) for label, f in self.forces.items()}
        known = {label: [part for part in found if part is not None] for label, found in parts.items()}
        return tuple(label for label, found in known.items() if not all(np.isfinite(part).all() for part in found))

    def weights(self, q, v):
        """Gravity, Coriolis and centrifugal forces, shape (nv,)."""
        return pin.rnea(self.model, self.data, q, v, np.zeros(self.nv))

    def jumps(self, t, q, v) -> tuple[str, ...]:
        """Labels of the forces that are discontinuous at velocities near `v`, such as relays."""
        return tuple(label for label, force in self.forces.items() if _jumps(lambda v, f=force: f.torque(t, q, v), v))

    def mass_matrix(self, q):
        """M(q), shape (nv, nv)."""
        return mass_matrix(self.model, q, self.workspace)

    def loop_rows(self, q, t: float | None = None):
        """Φ and J of all rows at `q`, including dropped ones; by default at the time at which the rows were chosen.

        J depends on time only in user-defined constraints; Φ also in drives.
        """
        return self.rows.at(q, self.chosen_at if t is None else t)

    @property
    def n_multipliers(self):
        return self.rows.nc

    def aimed(self, q, v):
        """The system in which contacts slide in the directions of a velocity."""
        return self

    def full_multipliers(self, q, lam, complete=None, v=None):
        """λ of all rows, shape (nc,): the vector of smallest norm with the same joint forces Jᵀλ; also for many states.

        Rows whose J depends on time keep their λ.
        """
        if self.nc == self.rows.nc:
            return lam
        full = np.zeros((*lam.shape[:-1], self.rows.nc))
        full[..., self.kept] = lam
        steady = np.flatnonzero(self.rows.steady)
        if self.dropped_are_zero or not steady.size:
            return full
        if lam.ndim > 1:
            if complete is not None:
                return complete(self.chosen_at, q, full, steady)
            return np.array([self.full_multipliers(*row) for row in zip(q, lam, strict=True)])
        J = self.loop_rows(q)[1][steady]
        full[steady] = np.linalg.lstsq(J.T, J.T @ full[steady], rcond=1e-10)[0]
        return full

    def reselected(self, q):
        """The same system with other rows kept, if the current ones have become a poor choice at `q`; else None."""
        if self.dropped_are_zero:
            return None
        if not choice_of_rows(self, self.rows.compiled).poor(q):
            return None
        fresh = MechanismSystem(self.mechanism, q, self.chosen_at)
        fresh.rows.continue_in(self.breakpoints)
        fresh._take(self.forces, self.breakpoints)  # sampled forces keep their state
        return fresh if fresh.nc == self.nc and (fresh.kept != self.kept).any() else None

    def rank_nearby(self, q, free) -> int:
        """The highest rank of the loops at three closed positions near `q`, along the columns of `free`; else 0."""
        if not free.size:
            return 0
        solver, rng, highest = LoopSolver(self.mechanism, self.chosen_at), np.random.default_rng(0), 0
        for _ in range(3):
            motion = free @ rng.standard_normal(free.shape[1])
            nearby, _ = solver.close(integrate(self.model, q, RANK_DISTANCE * motion / np.linalg.norm(motion)))
            highest = max(highest, len(solver.kept(nearby)))
        return highest

    def opened(self, times, configurations, gaps=None):
        """(index, gap, row) of the first configuration in which a dropped row is open, or None.

        This happens if the kept rows lose rank during the run, or the start was a singular configuration.
        """
        if self.dropped_are_zero:
            return None
        suspects = range(len(times))
        if gaps is not None:
            suspects = np.flatnonzero((np.abs(gaps(times, configurations)) / self.scales).max(axis=1) > DROPPED_GAP)
        for i in suspects:
            phi = np.abs(self.loop_rows(configurations[i], times[i])[0]) / self.scales
            if phi.max() > DROPPED_GAP + 100 * phi[self.kept].max(initial=0.0):  # interpolation opens all rows alike
                return int(i), float((phi * self.scales).max()), self.rows.labels[int(np.argmax(phi))]
        return None

    def _zero_everywhere(self, rows, q) -> bool:
        """Whether these rows of J vanish at three random configurations."""
        if (known := self.rows.vanishing.get(rows)) is not None:
            return known
        rng = np.random.default_rng(0)
        places = [integrate(self.model, q, rng.uniform(-1, 1, self.nv)) for _ in range(3)]
        try:
            found = not any(np.abs(self.loop_rows(place)[1][list(rows)]).max(initial=0.0) > 1e-13 for place in places)
        except PinconsistError:  # a user-defined constraint need not be defined there
            return False
        if self.rows.steady.all():
            self.rows.vanishing[rows] = found
        return found


def _jumps(function, v) -> bool:
    """Whether a function changes over an eighth of a small velocity difference as much as over all of it."""
    for way in np.multiply.outer(VELOCITY_CHANGES * (1.0 + np.abs(v).max()), np.eye(len(v))).reshape(-1, len(v)):
        far, near = (function(v + part * way) - function(v - part * way) for part in (1.0, 0.125))
        if 10.0 * np.abs(far - near).max() < np.abs(far).max() > JUMP * np.abs(function(v)).max():
            return True
    return False
