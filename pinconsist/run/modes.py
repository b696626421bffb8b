"""The modes of contacts: which elements are open, closed, stick or slide, and what happens where that changes.

===========  ================================  =======================================  ==========================
mode         rows                              direction of the force                   ends where this falls to 0
===========  ================================  =======================================  ==========================
``open``     none                              none                                     g
``closed``   g = 0                             n                                        λ_n
``stick``    g = 0, x_t = where it stuck       n and the tangents T                     λ_n; μ_s λ_n - \\|λ_t\\|
``slip``     g = 0                             n - μ_k Tᵀd with the direction d         λ_n; d·(T v)
===========  ================================  =======================================  ==========================

Dry friction of a joint has no gap: it sticks while \\|λ\\| is below its limit, and slides with a constant force.

At an end of a mode the velocities are settled first (:meth:`Modes._struck`), if some gap would close: by impulses, of a
complementarity problem of the velocities after it. What then approaches or leaves more slowly than can be resolved
rests. The same problem of the accelerations decides which contacts stay closed, and which stick
(:meth:`Modes._decided`). Where rows depend on each other, single multipliers mean nothing: then the mode ends where
this problem has another result.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engine import required
from ..engine.complementarity import Grip, Push, solve
from ..engine.norms import EPS, largest
from ..engine.systems import compiled_system
from ..errors import InputError, PinconsistError
from ..mechanism.mode_system import CLOSED, OPEN, SLIP, STICK, Mode, ModeSystem, dependent_gaps, first_rows
from .contact_results import ContactImpact, all_rows

TOUCHING = 1e-9  # gap at a start that counts as closed; deeper ones are errors
SAME_GAP = 1e-10  # gap, relative to positions, of what takes part in an impact of others
NOISE = 1e-13  # of a gap, relative to positions
LIFTS = 4  # Newton steps by which gaps are closed
LIFTED = 1e-11  # violation of a gap, relative to positions, that is removed where it closes
APPROACH = 1e-11  # rate of a gap, relative to velocities, that is none
SLIDES = 1e-10  # speed of sliding, relative to velocities, that is none, in a plane
TIE = 1e-7  # of the largest force: at the end of a mode a smaller one is zero
STICKS = 1e-9  # of the largest acceleration: a smaller one of sliding is none
FLIGHT = 1e3  # roundings of the position: the height of flights that are not resolved
LIKELY = 10.0  # tolerances: an error of velocities that runs have
SLOWEST = 1e-7  # m/s: of slower sliding in three dimensions rounding decides the direction
UNSOLVED = 1e-6  # residual of a complementarity problem that has no solution
GAIN = 1e-9  # kinetic energy, relative, that an impact may gain by rounding
LOADS, LOADED = 40, 1e-13  # times that the loads of pins are found again, and their relative change that is none
AT_ONCE = 30  # changes of mode at one time after which a run ends


class Period(NamedTuple):
    """The time from which a table of modes holds, and its system."""

    t: float
    system: ModeSystem


class Modes:
    """The modes of a run of a mechanism with contacts.

    Parameters
    ----------
    base : MechanismSystem
        The loops and forces.
    rtol, atol : float
        Of the velocities: what is slower than this allows after an impact rests.

    Attributes
    ----------
    system : ModeSystem
        The equations of the present mode.
    periods : list of Period
        All modes so far.
    impacts : list of ContactImpact
    """

    def __init__(self, base, rtol, atol):
        self._rtol, self._atol = rtol, atol
        self.elements = base.mechanism.contact_elements
        self.firsts = first_rows(self.elements)
        self.periods: list[Period] = []
        self.impacts: list[ContactImpact] = []
        self.every = all_rows(self.elements, base.model, base.workspace)
        self._stand_on(base)
        self._levels: list[float] = [0.0] * len(self.elements)
        self._speeds = np.zeros(len(self.elements))  # the largest of approach so far
        self._fastest = 0.0  # the largest rate of all rows so far
        self._at_once, self._last = 0, -np.inf
        self._told: list[str] = []

    @property
    def system(self) -> ModeSystem:
        return self.periods[-1].system

    def _stand_on(self, base):
        """Take the equations of the loops."""
        self.base = base
        self._loops = compiled_system(base)
        self._known: dict[tuple, ModeSystem] = {}
        self.hinges = {i: each.hinge(base) for i, each in enumerate(self.elements) if not each.pushes}

    def begin(self, t, p, v):
        """Choose the modes at a start; returns p and v, which an impact may change."""
        gap = self._rows(t, p, v).gap
        for i, element in enumerate(self.elements):
            if element.pushes and gap[i] < -TOUCHING:
                raise InputError(
                    f"the {element.record.kind} {element.name!r} is violated by {-gap[i]:.3g} at the start t = {t:.6g}"
                    ": take another q0, at which it is open or closed"
                )
        touching = {i for i, element in enumerate(self.elements) if element.pushes and gap[i] <= TOUCHING}
        return self._entered(t, p, v, touching, set(), [Mode()] * len(self.elements))

    def change(self, t, p, v, fired=(), beyond=None):
        """The modes after the events `fired`, pairs (element, what fell to zero), or after a jump of forces.

        Returns p and v. Where the accelerations of redundant rows call for other modes, these are those of a state
        `beyond`, (t, p, v), since at the event itself both fit.
        """
        modes, hits = self.system.modes, {i for i, what in fired if what == "gap"}
        self._require_progress(t, fired)
        near = SAME_GAP * (1.0 + largest(p))
        gap = self._rows(t, p, v).gap
        closed = {
            i
            for i, element in enumerate(self.elements)
            if element.pushes and (modes[i].kind != OPEN or i in hits or gap[i] <= near)
        }
        if beyond is not None and fired == [(None, "agree")]:
            kept, _ = self._decided(self._rows(*beyond), closed & self._closed_gaps(), set(), modes)
            self._enter(t, p, self._rows(t, p, v), kept)
            return p, v
        return self._entered(t, p, v, closed, set(fired), modes)

    def _closed_gaps(self):
        return {i for i, mode in enumerate(self.system.modes) if mode.kind != OPEN and self.elements[i].pushes}

    def _require_progress(self, t, fired):
        if abs(t - self._last) > 1e-12 * max(1.0, abs(t)):
            self._at_once, self._last, self._told = 0, t, []
        self._at_once += 1
        self._told += [self.elements[i].name for i, _ in fired if i is not None]
        if self._at_once > AT_ONCE:
            names = ", ".join(repr(name) for name in dict.fromkeys(self._told))
            raise PinconsistError(
                f"the contacts {names or 'of this mechanism'} change between the same modes at t = {t:.6g} without "
                "end; a smaller rtol or other coefficients of friction often help"
            )

    def _entered(self, t, p, v, closed, fired, before):
        state = self._rows(t, p, v)
        p = self._touching(state, closed)
        if p is not state.p:
            state = self._rows(t, p, v)
            before = [self._moved(state, i, mode) for i, mode in enumerate(before)]
        v, closed = self._struck(state, closed, {i for i, what in fired if what == "gap"}, before)
        if v is not state.v:
            state = self._rows(t, p, v)
            before = [mode if self._at_rest(state, i) else Mode() for i, mode in enumerate(before)]
        stopped = self._stopped(state, closed, before)
        if stopped is not None:
            v, state = stopped, self._rows(t, p, stopped)
        modes, v = self._decided(state, closed, fired, before)
        held = [mode.kind == STICK and before[i].kind != STICK for i, mode in enumerate(modes)]
        if any(held) and any(mode.kind == SLIP for mode in modes):
            modes, v = self._with_the_held(state, v, modes, closed, fired)
        self._enter(t, p, state, modes)
        return p, v

    def _stopped(self, state, closed, before):
        """The velocity without sliding that is too slow to have a direction, where friction holds it; None if nowhere.

        As points of a body that turns cannot all rest, this comes before the accelerations decide.
        """
        held = [row for i, mode in enumerate(before) if mode.kind == STICK for row in self._tangents(i)]
        normals = [self.firsts[i] for i in closed]
        slow = [
            i
            for i in sorted(closed)
            if self.elements[i].tangents == 2 and self.elements[i].static and before[i].kind != STICK
            and 0.0 < np.linalg.norm(state.rates[self._tangents(i)]) <= self.still
        ]  # fmt: skip
        while slow:
            moved = state.pushed(state.v, [*normals, *held, *(row for i in slow for row in self._tangents(i))])
            if moved is None:
                return None
            modes = self._anew(self._rows(state.t, state.p, moved), closed)
            kept = [i for i in slow if modes is not None and modes[i].kind == STICK]
            if len(kept) == len(slow):
                return moved
            slow = kept
        return None

    def _tangents(self, i):
        """The rows of the tangents of an element."""
        return list(range(self.firsts[i] + self.elements[i].pushes, self.firsts[i + 1]))

    def _with_the_held(self, state, v, modes, closed, fired):
        """The modes again, without the velocities of what now sticks: the rest may have come to rest with it."""
        rows = [self.firsts[i] for i in closed]
        for i, mode in enumerate(modes):
            if mode.kind == STICK:
                rows += range(self.firsts[i] + self.elements[i].pushes, self.firsts[i + 1])
        moved = state.pushed(v, rows)
        if moved is None:
            return modes, v
        again = [mode if mode.kind == STICK else Mode() for mode in modes]
        return self._decided(self._rows(state.t, state.p, moved), closed, fired, again)

    def _enter(self, t, p, state, modes):
        key = tuple(modes)
        system = self._known.get(key)
        kept = system is not None and system.base is self.base
        if not kept or system.redundant or _weak(system, state.J):
            system = ModeSystem(self.base, self.elements, self.every, modes, state.J, self.still)
            self._known[key] = system
        noise = NOISE * (1.0 + largest(p))
        for i in range(len(self.elements)):  # what leaves softly must not hit by rounding
            near = modes[i].kind == OPEN and state.gap[i] <= TOUCHING
            soft = near and state.rates[self.firsts[i]] <= self._resting_speed(i, state)
            self._levels[i] = min(state.gap[i], 0.0) - noise * soft if near else 0.0
        self.periods.append(Period(t, system))

    def rebased(self, t, base) -> ModeSystem:
        """The present mode with other rows of the loops."""
        self._stand_on(base)
        system = self.system
        self.periods.append(Period(t, system.with_base(base)))
        return self.system

    # What happens at an instant

    def _moved(self, state, i, mode):
        """The mode of an element at another position: what sticks does so there."""
        if mode.kind != STICK:
            return mode
        own = slice(self.firsts[i] + self.elements[i].pushes, self.firsts[i + 1])
        return mode._replace(at=tuple(state.phi[own].tolist()))

    def _touching(self, state, closed):
        """The position with gaps closed that are closed but for the accuracy of the time of an event.

        To lift what bounces by roundings would give it energy.
        """
        noise = LIFTED * (1.0 + largest(state.p))
        p = state.p
        for _ in range(LIFTS):
            rows = [self.firsts[i] for i in sorted(closed) if noise < abs(state.gap[i]) and state.gap[i] <= TOUCHING]
            if not rows:
                break
            A = state.R[rows] @ state.responses[:, rows]
            impulses = np.linalg.lstsq(A, state.phi[rows], rcond=1e-10)[0]
            p = self.base.integrate(p, -state.responses[:, rows] @ impulses)
            state = self._rows(state.t, p, state.v)
        return p

    def _rows(self, t, p, v) -> _Instant:
        state = _Instant(self, t, p, v)
        self._fastest = max(self._fastest, largest(state.rates))
        return state

    @property
    def still(self) -> float:
        """The speed of sliding in three dimensions that is none: the tolerances allow it as an error."""
        return max(LIKELY * (self._atol + self._rtol * self._fastest), SLOWEST)

    def _resting_speed(self, i, state) -> float:
        """The rate of a gap below which it rests after an impact."""
        acceleration = abs(state.acceleration(self.firsts[i]))
        unresolved = np.sqrt(2.0 * max(acceleration, 1.0) * FLIGHT * EPS * (1.0 + largest(state.p)))
        return max(self._atol + self._rtol * self._speeds[i], unresolved)

    def _struck(self, state, closed, hits, before):
        """The velocity after an impact, if some closed gap would close further, and what is closed then.

        A gap of `hits` that opens slowly is not about to close, but its flight is too short to be resolved.
        """
        v, rates = state.v, state.rates
        bound = APPROACH * (1.0 + largest(v))
        approaching = {i for i in closed if rates[self.firsts[i]] < -bound}
        if approaching:
            for i in approaching:
                self._speeds[i] = max(self._speeds[i], -rates[self.firsts[i]])
            v = self._impact(state, sorted(closed))
            rates = state.R @ v
        if approaching or hits:
            slow = [
                i
                for i in sorted(closed)
                if rates[self.firsts[i]] <= self._resting_speed(i, state)
                and (rates[self.firsts[i]] > 0.0 or self._is_slow(i, state))
            ]
            held = [j for j, mode in enumerate(before) if mode.kind == STICK and not self.elements[j].pushes]
            if not all(self._is_slow(i, state) for i in approaching):
                held = []  # an impact that counts
            rested = self._rested(state, v, slow, held, closed)
            if rested is not None:
                v, rates = rested, state.R @ rested
        bound = APPROACH * (1.0 + largest(v))
        return v, {i for i in closed if abs(rates[self.firsts[i]]) <= bound}

    def _at_rest(self, state, i) -> bool:
        """Whether the tangents of an element are at rest."""
        slip = state.rates[self.firsts[i] + self.elements[i].pushes : self.firsts[i + 1]]
        return largest(slip) <= SLIDES * (1.0 + largest(state.v))

    def _is_slow(self, i, state) -> bool:
        """Whether a gap closes so slowly that it does not bounce."""
        return -self._resting_speed(i, state) <= state.rates[self.firsts[i]] <= 0.0

    def _rested(self, state, v, slow, held, closed):
        """The velocity without slow rates of those elements that their accelerations then hold; None if there are none.

        The friction of the joints `held`, which stuck before, is not overcome by impacts that are not resolved.
        """
        while slow:
            moved, kept = self._tried(state, v, slow, held, closed)
            if len(kept) == len(slow):
                return moved
            slow = kept
        return None

    def _tried(self, state, v, slow, held, closed):
        """The velocity without these rates, and those of them that the accelerations then hold."""
        rows = [self.firsts[i] for i in slow] + [self.firsts[j] for j in held]
        for i in slow:
            first, element = self.firsts[i], self.elements[i]
            tangents = range(first + 1, first + element.size)
            if np.linalg.norm((state.R @ v)[list(tangents)]) <= self._resting_speed(i, state):
                rows += tangents
        moved = state.pushed(v, rows)
        if moved is None:
            return None, []
        after = self._rows(state.t, state.p, moved)
        bound = APPROACH * (1.0 + largest(moved))
        still_closed = {i for i in closed if abs(after.rates[self.firsts[i]]) <= bound}
        modes = self._anew(after, still_closed)
        return moved, [i for i in slow if modes is not None and i in still_closed and modes[i].kind != OPEN]

    def _impact(self, state, closed):
        """The velocity after an impact of these elements by Newton's law; it is recorded."""
        rows, blocks, e, at = [], [], [], {}
        for i in closed:
            element, first = self.elements[i], self.firsts[i]
            normal = len(rows)
            at[i] = normal
            rows.append(first)
            blocks.append(Push(normal))
            e.append(0.0 if self._is_slow(i, state) else element.restitution)
            if element.tangents and element.static:
                blocks.append(Grip(normal + 1, element.tangents, friction=element.kinetic, of=normal))
                rows += range(first + 1, first + element.size)
                e += [0.0] * element.tangents
        R, response = state.R[rows], state.responses[:, rows]
        A, u, factors = R @ response, state.rates[rows], np.array(e)
        self._require_response(state, closed, at, A, u)
        kinetic = state.kinetic(state.v)
        dependent = state.depend(rows)
        for _ in range(60):
            b = u + factors * np.minimum(u, 0.0) * np.isin(np.arange(len(u)), list(at.values()))
            impulses, _, left = solve(A, b, blocks, dependent)
            v = state.v + response @ impulses
            lost = kinetic - state.kinetic(v)
            gained = lost < -GAIN * max(kinetic, state.kinetic(state.v - v))
            if not factors.any() or not (gained or left > UNSOLVED):
                break
            factors = 0.5 * factors if factors.max() > 1e-6 else 0.0 * factors
        if left > UNSOLVED:
            names = ", ".join(repr(self.elements[i].name) for i in closed)
            raise PinconsistError(
                f"the impact of {names} at t = {state.t:.6g} has no solution by Newton's and Coulomb's laws"
            )
        self._record(state, closed, at, impulses, u, lost, False)
        return v

    def _require_response(self, state, closed, at, A, u):
        for i in closed:
            k = at[i]
            free = state.free_response(self.firsts[i])
            if u[k] < 0.0 and not A[k, k] > 1e-10 * free:
                raise PinconsistError(
                    f"the {self.elements[i].record.kind} {self.elements[i].name!r} is reached at t = {state.t:.6g}; "
                    "no impulse can change its velocity, because loops or drives determine it; let a servo with limits "
                    "move the joint instead of a drive"
                )

    def _record(self, state, closed, at, impulses, u, lost, jam):
        found, speeds = {}, {}
        for i in closed:
            element, k = self.elements[i], at[i]
            if (of := impulses[k : k + 1 + (element.tangents if element.static else 0)]).any():
                found[element.name] = of.copy() if len(of) > 1 else float(of[0])
                speeds[element.name] = float(-u[k])
        self.impacts.append(ContactImpact(float(state.t), found, speeds, float(lost), jam))

    def _decided(self, state, closed, fired, before):
        """The modes by the accelerations, and the velocity, which a jam changes."""
        modes = self._by_accelerations(state, closed, fired, before)
        return self._jammed(state, closed) if modes is None else (modes, state.v)

    def _anew(self, state, closed):
        """The modes that the accelerations call for, whatever they were before; None if there is no solution."""
        return self._by_accelerations(state, closed, set(), [Mode()] * len(self.elements))

    def _by_accelerations(self, state, closed, fired, before):
        """The modes that the accelerations call for; None if there is no solution."""
        problem = _Accelerations(self, state, closed, fired, before)
        kinetic = {i for i, what in fired if what == "cone"}
        for _ in range(len(self.elements) + 1):
            z, u, left = problem.solve(kinetic)
            if left > UNSOLVED:
                return None
            modes = problem.modes(z, u)
            slips = {i for i, mode in enumerate(modes) if mode.kind == SLIP and i in problem.sticking}
            if slips <= kinetic or not any(self.elements[i].kinetic < self.elements[i].static for i in slips - kinetic):
                break
            kinetic |= slips
        return modes

    def _jammed(self, state, closed):
        """The modes where no accelerations fit the laws: an impulse stops the sliding at once (Painlevé)."""
        names = ", ".join(repr(self.elements[i].name) for i in sorted(closed))
        rows, at = [], {}
        for i in sorted(closed):
            at[i] = len(rows)
            rows += range(self.firsts[i], self.firsts[i + 1])
        A = state.R[rows] @ state.responses[:, rows]
        impulses = -np.linalg.lstsq(A, state.rates[rows], rcond=1e-12)[0]
        v = state.v + state.responses[:, rows] @ impulses
        fits = largest(impulses) > 0.0
        for i in sorted(closed):
            own = impulses[at[i] : at[i] + self.elements[i].size]
            fits = fits and np.linalg.norm(own[1:]) <= self.elements[i].static * own[0] * (1.0 + 1e-9) + 1e-15
        if not fits:
            raise PinconsistError(
                f"the contacts {names} have no solution at t = {state.t:.6g}: rigid bodies with so much friction jam"
            )
        self._record(
            state, sorted(closed), at, impulses, state.rates[rows], state.kinetic(state.v) - state.kinetic(v), True
        )
        modes = self._anew(self._rows(state.t, state.p, v), closed)
        if modes is None:
            raise PinconsistError(f"the contacts {names} have no solution at t = {state.t:.6g}, nor after a jam")
        return modes, v

    def agree(self, t, p, v) -> bool:
        """Whether accelerations at a state call for the present modes: where dependent rows do not obey their laws."""
        modes, state = self.system.modes, self._rows(t, p, v)
        problem = _Accelerations(self, state, self._closed_gaps(), set(), modes)
        z, u, left = problem.solve({i for i, mode in enumerate(modes) if mode.kind == SLIP})
        if left > UNSOLVED:
            return False
        found = problem.modes(z, u)
        return all(one.kind == other.kind for one, other in zip(found, modes, strict=True))

    # Where the present mode ends

    def watch(self):
        """The functions that end the present mode, what each is, pairs (element, ``gap``, …), and what they call."""
        watched, system, what, agree = required().ContactWatch(self.every), self.system, [], self.agree
        if system.redundant:
            watched.add_laws(system.laws(), system.spread, agree)
            what.append((None, "agree"))
        for i, (element, mode) in enumerate(zip(self.elements, system.modes, strict=True)):
            first, used = int(self.firsts[i]), system.used.get(i, {})
            if mode.kind == OPEN:
                if element.pushes:
                    watched.add_gap(first, self._levels[i])
                    what.append((i, "gap"))
                continue
            if element.pushes and 0 in used and not system.redundant:
                watched.add_push(used[0])
                what.append((i, "push"))
            if mode.kind == STICK and not system.redundant:
                beside = [place for row, place in used.items() if row >= element.pushes]
                load = ([used[0]], np.ones((1, 1))) if element.pushes else system.hinges[i][1:]
                watched.add_cone(*load, beside, element.static)
                what.append((i, "cone"))
            if mode.kind == SLIP:
                watched.add_speed(first + element.pushes, np.array(mode.direction), self.still)
                what.append((i, "speed"))
        return watched, what, agree


def _weak(system, J) -> bool:
    """Whether the kept rows of a known system are nearly dependent here."""
    rows = [*range(system.base.nc)]
    rows += [system.base.nc + int(system.firsts[i]) + row for i, used in system.used.items() for row in used]
    if not rows:
        return False
    sizes = np.linalg.svd(J[rows] / np.linalg.norm(J[rows], axis=1)[:, None], compute_uv=False)
    return len(rows) > J.shape[1] or sizes[-1] < 1e-6


class _Instant:
    """The equations at one state: rows of all elements, and the responses of the velocities to their forces."""

    def __init__(self, modes: Modes, t, p, v):
        self.t, self.p, self.v, self._modes = t, p, v, modes
        self.M, self.f, self.J_loops, self.bias_loops = modes._loops.dynamics(t, p, v)
        _, phi, self.R, rates = modes.every.evaluate(t, p, v, np.zeros(len(v)))
        self.bias = modes.every.dynamics(t, p, v)[3]
        self.rates, self.phi = rates, phi
        self.gap = np.array([phi[first] for first in modes.firsts[:-1]])
        self.J = np.vstack((self.J_loops, self.R))
        n, m = self.M.shape[0], len(self.J_loops)
        self._kkt = np.block([[self.M, -self.J_loops.T], [self.J_loops, np.zeros((m, m))]])
        right = np.zeros((n + m, 1 + len(self.R)))
        right[:, 0] = -np.concatenate((self.f, self.bias_loops))
        right[:n, 1:] = self.R.T
        try:
            found = np.linalg.solve(self._kkt, right)
        except np.linalg.LinAlgError:
            found = np.linalg.lstsq(self._kkt, right, rcond=None)[0]
        self.free, self.responses = found[:n, 0], found[:n, 1:]
        self._of_loops = found[n:]

    def multipliers(self, forces):
        """Those of the loops, under the forces of all rows."""
        return self._of_loops[:, 0] + self._of_loops[:, 1:] @ forces

    def response(self, force):
        """The accelerations that follow a force (nv,) or several (nv, k)."""
        right = np.zeros((len(self._kkt), force.shape[1] if force.ndim > 1 else 1))
        right[: len(self.v)] = force.reshape(len(self.v), -1)
        found = np.linalg.lstsq(self._kkt, right, rcond=None)[0][: len(self.v)]
        return found if force.ndim > 1 else found[:, 0]

    def free_response(self, row) -> float:
        """The response of a row without the loops."""
        return float(self.R[row] @ np.linalg.lstsq(self.M, self.R[row], rcond=1e-13)[0])

    def depend(self, rows) -> bool:
        """Whether these rows depend on each other."""
        return len(rows) > 1 and bool(dependent_gaps(self.J_loops, self.R[rows]))

    def pushed(self, v, rows):
        """The velocity nearest to `v` in the metric of M at which these rows have no rate; None if there is none."""
        A = self.R[rows] @ self.responses[:, rows]
        moved = v - self.responses[:, rows] @ np.linalg.lstsq(A, self.R[rows] @ v, rcond=1e-12)[0]
        return moved if largest(self.R[rows] @ moved) <= APPROACH * (1.0 + largest(v)) else None

    def kinetic(self, v) -> float:
        return 0.5 * float(v @ self.M @ v)

    def size_of_force(self, row) -> float:
        """The size of the force along a row that could balance the other forces."""
        n = np.abs(self.R[row])
        return float(n @ np.abs(self.f)) / max(float(n @ n), 1e-300)

    def acceleration(self, row) -> float:
        """That of a row without forces of contacts."""
        return float(self.R[row] @ self.free + self.bias[row])


class _Accelerations:
    """The complementarity problem of the accelerations at an instant.

    ``sticking`` are the elements whose tangents are at rest: these may stick. Those that slide have a fixed direction.
    """

    def __init__(self, modes: Modes, state: _Instant, closed, fired, before):
        self._modes, self._state, self._fired, self._before = modes, state, fired, before
        ended = {i for i, what in fired if what == "speed"}
        flat = SLIDES * (1.0 + largest(state.v))
        self.sliding: dict[int, np.ndarray] = {}
        self.sticking, self._closed = set(), sorted(closed)
        for i, element in enumerate(modes.elements):
            if not element.tangents or not element.static or (element.pushes and i not in closed):
                continue
            first = modes.firsts[i] + element.pushes
            slip = state.rates[first : modes.firsts[i + 1]]
            speed = float(np.linalg.norm(slip))
            # where the direction has turned by a right angle, sliding has not ended
            slides = speed > SLOWEST if element.tangents == 2 else speed > flat and i not in ended
            if before[i].kind != STICK and slides:
                self.sliding[i] = slip / speed
            else:
                self.sticking.add(i)

    def solve(self, kinetic):
        """(z, u, residual); elements of `kinetic` have their kinetic friction.

        The loads of pins, which limit their friction, depend on the solution.
        """
        pins = [i for i in self._modes.hinges if self._modes.elements[i].of_loop]
        self.loads = dict.fromkeys(self._modes.hinges, 1.0)
        if not pins:
            return self._solved(kinetic)
        loads = self._loads_of(pins, np.zeros(len(self._state.R)))
        for _ in range(LOADS):
            self.loads |= dict(zip(pins, loads.tolist(), strict=True))
            found = self._solved(kinetic)
            before, loads = loads, self._loads_of(pins, self._forces(found[0]))
            if largest(loads - before) <= LOADED * largest(loads):
                break
        self.loads |= dict(zip(pins, loads.tolist(), strict=True))
        return found

    def _loads_of(self, pins, forces) -> np.ndarray:
        """The loads of pins under the forces of all rows."""
        lam = self._state.multipliers(forces)
        return np.array([float(self._modes.hinges[i].load(lam)) for i in pins])

    def _forces(self, z):
        """The forces of all rows."""
        modes, forces = self._modes, np.zeros(len(self._state.R))
        for i, element in enumerate(modes.elements):
            first = modes.firsts[i]
            if i in self.normal:
                forces[first] = z[self.normal[i]]
            if i in self.tangent:
                forces[first + element.pushes : modes.firsts[i + 1]] = z[list(self.tangent[i])]
            elif i in self.sliding:
                push = forces[first] if element.pushes else self.loads[i]
                forces[first + element.pushes : modes.firsts[i + 1]] = -element.kinetic * push * self.sliding[i]
        return forces

    def _solved(self, kinetic):
        modes, state = self._modes, self._state
        rows, columns, blocks, force = [], [], [], np.zeros(len(state.v))
        self.normal, self.tangent = {}, {}
        for i in self._closed:
            element, first = modes.elements[i], modes.firsts[i]
            self.normal[i] = len(rows)
            blocks.append(Push(len(rows)))
            rows.append(first)
            column = state.responses[:, first]
            if i in self.sliding:
                T = state.responses[:, first + 1 : modes.firsts[i + 1]]
                column = column - element.kinetic * (T @ self.sliding[i])
            columns.append(column)
            if i in self.sticking:
                self.tangent[i] = range(len(rows), len(rows) + element.tangents)
                friction = element.kinetic if i in kinetic else element.static
                blocks.append(Grip(len(rows), element.tangents, friction=friction, of=self.normal[i]))
                rows += range(first + 1, modes.firsts[i + 1])
                columns += list(state.responses[:, first + 1 : modes.firsts[i + 1]].T)
        for i, element in enumerate(modes.elements):
            if element.pushes or not element.static:
                continue
            first = modes.firsts[i]
            if i in self.sliding:
                force -= element.kinetic * self.loads[i] * self.sliding[i][0] * state.R[first]
                continue
            self.tangent[i] = range(len(rows), len(rows) + 1)
            limit = self.loads[i] * (element.kinetic if i in kinetic else element.static)
            blocks.append(Grip(len(rows), 1, limit=limit))
            rows.append(first)
            columns.append(state.responses[:, first])
        if not rows:
            return np.zeros(0), np.zeros(0), 0.0
        free = state.free + (state.response(force) if force.any() else 0.0)
        b = state.R[rows] @ free + state.bias[rows]
        A = state.R[rows] @ np.column_stack(columns)
        self._scale = largest(b)
        return solve(A, b, blocks, state.depend(rows))

    def modes(self, z, u):
        """The modes of a solution."""
        modes, result = self._modes, [Mode()] * len(self._modes.elements)
        most = largest(z[list(self.normal.values())]) if self.normal else 0.0
        for i, element in enumerate(modes.elements):
            if element.pushes:
                if i not in self.normal:
                    continue
                push = z[self.normal[i]]
                bar = TIE * max(most, self._state.size_of_force(modes.firsts[i])) if (i, "push") in self._fired else 0.0
                if push <= max(bar, 1e-12 * most):
                    continue
            if not element.tangents or not element.static:
                result[i] = Mode(CLOSED) if element.pushes else Mode()
            elif i in self.sliding:
                result[i] = Mode(SLIP, direction=tuple(self.sliding[i].tolist()))
            else:
                result[i] = self._of_tangents(i, element, z, u)
        return result

    def _of_tangents(self, i, element, z, u):
        """Whether an element whose tangents are at rest sticks, or begins to slide and in which direction."""
        own = list(self.tangent[i])
        moves, force = u[own], z[own]
        speed = float(np.linalg.norm(moves))
        if speed > STICKS * self._scale:
            return Mode(SLIP, direction=tuple((moves / speed).tolist()))
        load = z[self.normal[i]] if element.pushes else self.loads[i]
        size, limit = float(np.linalg.norm(force)), element.kinetic * load
        if (i, "cone") in self._fired and size >= (1.0 - TIE) * limit > 0.0:
            return Mode(SLIP, direction=tuple((-force / size).tolist()))
        if self._before[i].kind == STICK:
            return self._before[i]
        first = self._modes.firsts[i] + element.pushes
        return Mode(STICK, at=tuple(self._stuck_at(i, first)))

    def _stuck_at(self, i, first):
        return self._state.phi[first : self._modes.firsts[i + 1]].tolist()
