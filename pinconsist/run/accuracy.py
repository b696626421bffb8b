"""How accurate a run is: residuals of its rows in all equations, and its error, estimated from a finer run."""

import os
import time
from dataclasses import dataclass
from math import ceil
from typing import Any

import numpy as np

from ..engine import constant, required
from ..engine.index1 import Index1
from ..engine.norms import largest
from ..engine.systems import blank_system, with_all_rows
from ..errors import PinconsistError
from ..mechanism.energy import alone, integrals, total_power
from ..mechanism.forces.held import sided
from ..mechanism.names import velocity_names, velocity_units
from ..mechanism.pulses import brief_times
from ..mechanism.rows import Workspace
from ..mechanism.system import MechanismSystem
from .contact_results import ContactHistory, EquationsInModes, measured_in_modes, too_slow
from .control import ErrorControl
from .integrate import integrate
from .options import Options, looking
from .output import Output
from .steppers import stepper_for

LOOKS = 1000  # least number of force evaluations in the finer run: five in a pulse of a two-hundredth of the span
SHORTER = 0.3  # longest steps of the finer run, relative to those of a run: it evaluates forces at other times
FINER = 0.1  # of the tolerance
FINER_OF_RADAU = 1e-4  # the same: its forced ends cost digits that long steps keep, and save none of its time
LEAST_RTOL = 1e-12  # of Radau
ENDS = 100  # steps of Radau between rows that are compared
FINER_TIME = 3.0  # s of processor time that the finer run may take if it was not requested
MOST_STEPS = 20  # of the finer run, per step of the run: order 1 takes ten; more are due to noise
AMPLIFIED = 100.0  # tolerances: a larger error is worth a warning
OFF = 0.01  # of velocities, forces and energies
ROUNDING = 1e-10  # of the forces that act: loop forces that are all smaller are rounding
A_THREAD = 200  # rows that justify one more thread, and its pin.Data, which has several arrays of nv³ numbers
THREADS = 4  # at most


@dataclass(frozen=True)
class GlobalError:
    """The difference between a run and a finer one, the largest over its rows.

    The finer run has a tenth of the tolerance (Radau: a ten-thousandth), or half of the fixed step.

    Attributes
    ----------
    q, v : float
        Error of the positions, rad or m, and of the velocities.
    force : float
        Error of Jᵀλ (G λ), relative to its largest value in the run, or to 1e-10 of the other forces if that is larger.
    q_at, v_at, force_at : str
        Where each of them is largest: coordinate and time. `force_at` is empty if nothing is constrained.
    tolerances : float or None
        The largest error of q and v divided by the tolerance, which is rtol times the largest value of the coordinate
        plus atol; None for fixed steps.
    units : tuple of str
        Units of `q` and `v`; empty for a general problem.
    """

    q: float
    v: float
    force: float
    q_at: str
    v_at: str
    force_at: str
    tolerances: float | None
    units: tuple[str, str] = ("", "")

    @property
    def amplified(self) -> bool:
        """Whether the error is so many tolerances that the motion must amplify disturbances."""
        return not (self.tolerances or 0.0) <= AMPLIFIED

    def __str__(self):
        looks = self.amplified
        lines = [
            figure("error of q", self.q, self.units[0], looks, self.q_at),
            figure("error of v", self.v, self.units[1], looks, self.v_at),
        ]
        if self.force_at:
            about = f"of the largest, {self.force_at}"
            lines.append(figure("error of forces", self.force, "", looks or not self.force <= OFF, about))
        if self.tolerances is not None:
            digits = ".3g" if self.tolerances < 1000 else ".0f"
            lines.append(figure("  in tolerances", self.tolerances, "", looks, "at most", digits))
        return "\n".join(lines)


def above(value: float, bar: float) -> bool:
    """Whether a figure is a concern: NaN is."""
    return not value <= bar


def figure(name: str, value: float, unit: str, looks: bool, about: str = "", digits: str = ".2e") -> str:
    """One line of a certificate; `looks` if the user should check it."""
    return f"{name:<20}{value:9{digits}} {unit:<6} {'look' if looks else 'ok':<4}  {about}".rstrip()


class NotEstimatedError(Exception):
    """There is no estimate of the error of a run, and why."""


@dataclass(frozen=True)
class FinerRun:
    """States of a finer run, at `rows` of a solution and at even times between them.

    `at` are the places of the rows among the times `t`; `apart` says which rows lie between an event of one run and the
    same event of the other.
    """

    system: Any
    rows: np.ndarray
    at: np.ndarray
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    apart: np.ndarray
    contacts: Any = None  # its ContactHistory


def finer_run(solution, mechanism=None, patience=np.inf) -> FinerRun:
    """The finer run of a solution; NotEstimatedError if it fails or takes longer than `patience` (s)."""
    if not solution.success:
        raise NotEstimatedError("the run ended early")
    if len(solution.t) < 2 or "order" not in solution.method:
        raise NotEstimatedError("there is no run to compare with" if len(solution.t) > 1 else "there is only one row")
    if not all(np.isfinite(part).all() for part in (solution.q, solution.v)):
        raise NotEstimatedError("numbers of the rows are not finite")
    ours = solution.t_events if solution._events else [times for times in solution.t_events if len(times)]
    if len(ours) > len(solution._events):
        raise NotEstimatedError("the functions of its events are not in files and copies")
    if mechanism := mechanism or solution.mechanism:
        system = MechanismSystem(mechanism, solution.q[0], solution.t[0])
        brief = brief_times(system, solution.t, solution.q, solution.v, LOOKS)
    else:
        system, brief = solution.system, np.zeros(0)
    method = _method(solution, system, len(brief) > 0)
    exact = method.name == "Radau"  # between steps its velocities are of a lower order
    rows = _rows(solution, ENDS if exact else len(solution.t))
    t, start = solution.t[rows], (solution.q[rows[0]], solution.v[rows[0]])
    if not len(solution.h):  # rows that were interpolated
        start = Index1(system).state(t[0], *start)[1:3]
    middles = 0.5 * (t[1:] + t[:-1]) if exact else []  # with the steps of the other run errors would be alike
    asked = _with(np.linspace(t[0], t[-1], _steps(method.name) + 1), np.sort(np.concatenate((t, middles))))
    asked = _with(brief, asked) if len(brief) else asked
    asked = asked if t[-1] >= t[0] else asked[::-1]
    run = _finer(system, method, asked, exact, start, solution._events, patience)
    times = [np.array([row[0] for row in found]) for found in run.events]
    at = np.searchsorted(asked, t) if t[-1] >= t[0] else len(asked) - 1 - np.searchsorted(asked[::-1], t)
    contacts = ContactHistory.of(run)
    return FinerRun(system, rows, at, asked, run.p, run.v, run.lam, _apart(ours, times, t), contacts)


def global_error(solution, finer: FinerRun, apart=False) -> GlobalError:
    """The error of a solution; `apart` is a mask of more rows that are not compared."""
    system, rows = finer.system, finer.rows
    t, q, v, lam = (part[rows] for part in (solution.t, solution.q, solution.v, solution.lam))
    other = finer.q[finer.at], finer.v[finer.at], finer.lam[finer.at]
    error_q = np.abs([system.difference(a, b) for a, b in zip(q, other[0], strict=True)])
    error_v = np.abs(v - other[1])
    contacts = solution.contacts
    ours = loop_forces(system, t, q, v, lam, contacts)
    # multipliers between the steps of the finer run are those of its polynomials, which nothing controls
    sides = sided(solution.t, system.jumps_at(solution.t[-1], solution.q[-1], solution.v[-1]))[rows]
    error_force = np.abs(ours - exact_forces(system, (sides, *other), finer.contacts))
    if contacts is not None:  # where a contact has closed or turned in one run and not yet in the other
        error_force[[contacts.laws(time) != finer.contacts.laws(time) for time in t]] = 0.0
        error_force[too_slow(system.mechanism, contacts, t, q, v)] = 0.0
    for error in (error_q, error_v, error_force):
        error[finer.apart | apart] = 0.0
    others = largest(system.evaluate(t[0], q[0], v[0], np.zeros(system.nv))[0])
    names, units = _coordinates(system)
    of_q, of_v = (units[_worst(error)[1]] for error in (error_q, error_v))
    return GlobalError(
        largest(error_q), largest(error_v), largest(error_force) / (max(largest(ours), ROUNDING * others) or 1.0),
        _where(error_q, names, t), _where(error_v, names, t), _where(error_force, names, t) if lam.size else "",
        _in_tolerances(solution.method, system, q, v, error_q, error_v), (of_q, of_v and f"{of_v}/s"),
    )  # fmt: skip


def _steps(name) -> int:
    """The least number of steps of a finer run; Radau evaluates forces at its stages."""
    return LOOKS // int(constant("FEWEST_STAGES")) if name == "Radau" else LOOKS


def _method(solution, system, by_radau):
    """The method of the finer run; `by_radau` if its steps have to end at given times."""
    about = solution.method
    name, order, step = about.get("method", "BDF"), about["order"], about["step"]
    rtol, atol = (about.get(key, (tol, tol)) for key, tol in (("rtol", 1e-6), ("atol", 1e-8)))
    if by_radau:
        name, order, step = "Radau", None, None
    span = float(solution.t[0]), float(solution.t[-1])
    length = abs(span[1] - span[0])
    if step is not None:
        step /= max(2, ceil(step * _steps(name) / length - 1e-9))
    else:
        shares = [FINER] * len(rtol)
        if name == "Radau":
            shares = [np.clip(LEAST_RTOL / np.maximum(part, LEAST_RTOL), FINER_OF_RADAU, FINER**2) for part in rtol]
        rtol, atol = (tuple(map(np.multiply, shares, parts)) for parts in (rtol, atol))
        if name == "BDF":
            control = ErrorControl(rtol, atol, order, np.inf)
            name = "Radau" if control.asked[0] < control.best else name  # less rounding
        rtol = tuple(np.maximum(part, LEAST_RTOL) for part in rtol) if name == "Radau" else rtol
    order = None if name == "Radau" and step is None else order
    most = MOST_STEPS * (solution.nsteps + LOOKS)
    longest = min(SHORTER * about.get("max_step", np.inf), length / _steps(name))
    options = Options(name, step, order, rtol, atol, about["consistency"], None, longest, most)
    return looking(options.for_span(span), system, span)


def _rows(solution, most):
    """The rows that are compared: both rows at an event that changed the state are left out.

    Where only forces jumped, the row after the jump is compared. The run begins after the changes at its start, and
    ends before those at its end.
    """
    t, states = solution.t, np.hstack((solution.q, solution.v))
    jumps = np.flatnonzero(np.diff(t) == 0.0)
    moved = (states[jumps] != states[jumps + 1]).any(axis=1)
    rows = np.setdiff1d(np.arange(len(t)), (*jumps, *jumps[moved] + 1))
    if not len(rows) or t[rows[0]] != t[0]:
        rows = np.append(np.count_nonzero(t == t[0]) - 1, rows)
    if t[rows[-1]] != t[-1]:
        rows = np.append(rows, len(t) - np.count_nonzero(t == t[-1]))
    return rows[np.unique(np.linspace(0, len(rows) - 1, min(most, len(rows))).astype(int))]


def _with(even, needed):
    """The times `needed`, in order, and those of the `even` ones that are not next to them."""
    after = np.clip(np.searchsorted(needed, even), 1, len(needed) - 1)
    apart = np.minimum(np.abs(even - needed[after - 1]), np.abs(even - needed[after]))
    return np.unique(np.concatenate((needed, even[apart > 0.1 * np.abs(even[1] - even[0])])))


def _finer(system, method, asked, exact, start, events, patience):
    """The trajectory with rows at these times; NotEstimatedError if the run does not reach the end."""
    due = time.thread_time() + patience  # of the processor: a verdict must not depend on the load

    def late():
        return time.thread_time() > due

    output = Output(t_eval=asked, exact=exact, events=events)
    try:
        run = integrate(system, (asked[0], asked[-1]), *start, method, output, stepper_for(system, method), late)
    except PinconsistError as error:
        raise NotEstimatedError(f"a finer run failed: {error}") from error
    if run.status < 0:
        raise NotEstimatedError(f"a finer run failed: {run.message}")
    if len(run.t) < len(asked):
        ended = f"a finer run takes more than {patience:g} s of processor time; check(error=True) waits for it"
        raise NotEstimatedError(ended if late() else f"a finer run ended early: {run.message}")
    return run


def _apart(ours, theirs, t):
    """Mask of the rows between an event of one run and the same event of the other.

    NotEstimatedError if they differ in number.
    """
    counts = [len(times) for times in ours], [len(times) for times in theirs]
    if counts[0] != counts[1]:
        number, (few, many) = next((i, pair) for i, pair in enumerate(zip(*counts, strict=True)) if pair[0] != pair[1])
        raise NotEstimatedError(f"event {number} occurs {few} times, and {many} times in a finer run")
    apart = np.zeros(len(t), bool)
    for low, high in zip(map(np.minimum, ours, theirs), map(np.maximum, ours, theirs), strict=True):
        for i, j in zip(low, high, strict=True):
            apart |= (t >= i) & (t <= j)
    return apart


def _coordinates(system):
    mechanism = system.mechanism
    if mechanism is None:
        return [f"coordinate {i}" for i in range(system.nv)], [""] * system.nv
    return velocity_names(mechanism.model), velocity_units(mechanism.model)


def _worst(error) -> tuple:
    """Row and column of the largest error."""
    return np.unravel_index(np.argmax(error), error.shape)


def _where(error, names, t) -> str:
    row, column = _worst(error)
    return f"{names[column]} at t = {t[row]:.6g} s"


def _in_tolerances(about, system, q, v, error_q, error_v):
    if about["step"] is not None:
        return None
    sizes = np.abs([system.position_scale(p) for p in q]).max(axis=0), np.abs(v).max(axis=0)
    allowed = (np.multiply(r, size) + a for r, a, size in zip(about["rtol"], about["atol"], sizes, strict=True))
    return max(largest(error / limit) for error, limit in zip((error_q, error_v), allowed, strict=True))


def exact_forces(system, states, contacts=None):
    """Jᵀλ (G λ) of the differential equation at rows `states`, (t, q, v, λ)."""
    return measured(system, states, _workspace(system), contacts)[3]


def _workspace(system):
    mechanism = system.mechanism
    return None if mechanism is None else Workspace(system.model, system.workspace)


def work_of(finer: FinerRun) -> tuple[np.ndarray, np.ndarray]:
    """The work of all forces and all constraints of a mechanism up to the rows of a finer run, J, shape (n,).

    With it comes by how much it changes, anywhere, if every second state is left out: a short pulse has few.
    """
    system, states, workspace = finer.system, (finer.t, finer.q, finer.v, finer.lam), _workspace(finer.system)
    *_, exact, energies, _ = measured(system, states, workspace)
    power = total_power(system.forces, *states[:3], workspace, energies) + (exact * finer.v).sum(axis=1)
    work = integrals(finer.t, power[:, None])[:, 0]
    fewer = integrals(finer.t[::2], power[::2, None])[:, 0]
    return work[finer.at], work[::2] - fewer


def measured(system, states, workspace, contacts=None):
    """Φ, the hidden residual, Jᵀλ (G λ) and that of the differential equation at rows `states`, (t, q, v, λ).

    After these come the energies as :func:`~pinconsist.mechanism.energy.measure` returns them, or None, and the largest
    of the other acting forces. `contacts` is the ContactHistory of a run with contacts.
    """
    if contacts is not None:
        return measured_in_modes(system.mechanism, contacts, states)
    if workspace is not None and (found := _compiled(system, states, workspace)) is not None:
        return found
    rows, acting = [], 0.0  # also used if the equations have no solution: the error says why
    index1 = Index1(system)
    for t, p, v, lam in zip(*states, strict=True):
        exact = index1.acceleration(t, p, v)[1]
        f, gap, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
        hidden, weights, exact = system.constraint(t, p, system.rate(t, p, v))[1], f, G @ exact
        if workspace is not None:
            gap, J = system.loop_rows(p, t)
            hidden, weights, G = J @ v + system.rows.time_rate(t, p), system.weights(p, v), J.T
        rows.append((gap, hidden, G @ lam, exact))
        acting = max(acting, largest(f), largest(weights))
    return *(np.array(column) for column in zip(*rows, strict=True)), None, acting


def _compiled(system, states, workspace):
    """What :func:`measured` returns, computed in C++; None if the equations have no solution.

    The rows are divided between threads, each with its own system, if no Python function is called.
    """
    compiled = workspace.compiled()
    rows, systems = system.all_rows(), []

    def add(compiled):
        rows.hand_over(compiled)
        system.hand_over_forces(compiled)
        systems.append((compiled, alone(system.forces, workspace)))

    add(compiled)
    if not compiled.calls_python:
        for _ in range(min(THREADS, processors(), len(states[0]) // max(A_THREAD, system.nv**2 // 10)) - 1):
            add(blank_system(system.model))
    if (found := required().certified(systems, system.kept, *states)) is None:
        return None
    return found


def processors() -> int:
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class Equations:
    """The equations of motion of a mechanism along a solution, with independent rows of its loops at each state.

    Differences of functions of time do not reach across the times at which these jump or bend.
    """

    def __init__(self, mechanism, solution):
        self._mechanism, self._solution, self._index1 = mechanism, solution, None

    def at(self, t, q, v=None) -> Index1:
        """The equations near a state; they are the same for all velocities."""
        known, sol = self._index1, self._solution
        fresh = MechanismSystem(self._mechanism, q, t) if known is None else known.system.reselected(q)
        if known is None and fresh.breakpoints and len(sol.t):
            run = sol.system.breakpoints if isinstance(sol.system, MechanismSystem) else None
            fresh.breakpoints.look_over(sol.t[0], sol.t[-1], sol.q[0], sol.v[0], run)
        if fresh is not None:
            self._index1 = Index1(fresh)
        return self._index1


def equations_of(mechanism, solution):
    """The equations of motion along a solution, with ``at(t, q)``: :class:`Equations`, or those in modes."""
    contacts = solution.contacts
    return Equations(mechanism, solution) if contacts is None else EquationsInModes(mechanism, contacts)


def accelerations(mechanism, solution, t, q, v):
    """Accelerations of the equations of motion at several states of a solution, shape (n, nv)."""
    found, equations = np.empty(v.shape), equations_of(mechanism, solution)
    for row, *state in zip(found, t, q, v, strict=True):
        row[:] = equations.at(*state).acceleration(*state)[0]
    return found


def loop_forces(system, t, q, v, lam, contacts=None):
    """Jᵀλ (G λ) at each row, contacts included."""
    states = t, q, v, lam
    if contacts is not None:
        return measured_in_modes(system.mechanism, contacts, states)[2]
    if not isinstance(system, MechanismSystem):
        return np.array([system.evaluate(t, p, v, 0.0 * v)[2] @ lam for t, p, v, lam in zip(*states, strict=True)])
    return with_all_rows(system).residuals(*states)[2]
