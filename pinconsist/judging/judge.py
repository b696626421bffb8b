"""`referee`: the same motion in several simulators, against a reference certified by two methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.index1 import Index1
from ..errors import InputError, MissingExtraError, warn
from ..files import as_path, written_whole
from ..formats.mjcf import solver_settings
from ..mechanism.assembly import Assembly, assemble
from ..mechanism.checks import names as checked_names
from ..mechanism.checks import number
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.rigid import tilted_hinges
from ..mechanism.system import MechanismSystem
from ..run.options import span_of
from .contestants import CONTESTANTS, FailedError, Rows, Setting, Task
from .log import aligned, read_log
from .mjcf import NotTranslatedError
from .motion import following, without_drives
from .reference import Measure, even_times, reference_of, rms

BELOW = 0.01  # relative error of forces that is asked for
BLOWN_UP = 100.0  # relative error of forces: no motion that is worth a number
UNEVEN = 1e-6  # relative difference of the times between rows
BUDGET = 10.0  # s of processor time that one run may take


@dataclass(frozen=True)
class Judged:
    """One run of one simulator with one setting, against the reference.

    Attributes
    ----------
    tool, setting : str
        The simulator and its settings.
    paste : str
        The setting as text to paste into a file or program.
    step : float or None
        Its time step, s.
    time : float
        CPU time of its steps per second of motion, s/s; including forces and commands that are evaluated outside the
        simulator, if there are any.
    joints_turn, joints_slide : float
        Largest error of a joint, rad, and m. ``joint`` is the name of the joint with the largest error.
    energy : float
        Largest error of the energy, relative to the change of the kinetic energy.
    force : float
        Root mean square error of the forces of all loops after the first step, relative to the root mean square of the
        forces. It has two parts, which add as vectors: ``force_here``, of the simulator's forces relative to the exact
        ones at its own states, and ``force_drift``, of these relative to those of the reference motion.
    force_peak : float
        Error of the largest force of a loop, relative.
    gap, tilt : float
        Largest opening of a loop, m, and tilt, rad.
    loops : dict[str, float]
        ``force`` of each loop.
    failed : str
        Why it did not reach the end; the numbers are NaN then.
    """

    tool: str
    setting: str
    paste: str
    step: float | None
    time: float = np.nan
    joints_turn: float = np.nan
    joints_slide: float = np.nan
    joint: str = ""
    energy: float = np.nan
    force: float = np.nan
    force_here: float = np.nan
    force_drift: float = np.nan
    force_peak: float = np.nan
    gap: float = np.nan
    tilt: float = np.nan
    loops: dict = field(default_factory=dict)
    failed: str = ""
    _rows: Any = field(default=None, repr=False, compare=False)


@dataclass(frozen=True, eq=False, repr=False)
class Judgement:
    """The result of :func:`referee`. ``print(judgement)`` shows it as a table.

    Attributes
    ----------
    mechanism : Mechanism
        The scene, with the forces and commands of the run.
    t : ndarray, shape (n,)
        The times at which errors are measured, s.
    reference : Solution
        The reference motion at these times.
    agreement : (float, float)
        Difference between Radau IIA, at rtol 1e-10, and BDF, at 3e-10: in joints, rad or m, and in forces, relative.
        NaN if BDF failed.
    rows : tuple of Judged
        All runs, in the order of the simulators and from coarse to fine.
    cheapest : dict[str, Judged or None]
        For each simulator, the fastest run whose force error is at most `below`; None if there is none.
    not_judged : dict[str, str]
        Simulators that could not be judged, and why.
    left_out : tuple of str
        Loops whose forces are not determined by the equations of motion.
    below : float
        The requested relative force error.
    notes : tuple of str
        Quantities of a log that were derived, assumed or left out.
    """

    mechanism: Mechanism
    t: np.ndarray
    reference: Any
    agreement: tuple[float, float]
    rows: tuple[Judged, ...]
    cheapest: dict
    not_judged: dict
    left_out: tuple[str, ...]
    below: float
    notes: tuple[str, ...] = ()

    def __str__(self):
        from .report import text_of

        return text_of(self)

    __repr__ = __str__

    def of(self, tool: str) -> list[Judged]:
        """The runs of the simulator named `tool`, as in ``Judged.tool``."""
        return [row for row in self.rows if row.tool == tool]

    def to_csv(self, file) -> Path:
        """Write all runs to a CSV `file`, atomically, and return its path. Raises OSError if that fails."""
        from .report import csv_of

        with written_whole(file) as stream:
            stream.write(csv_of(self).encode())
        return Path(file)

    def to_html(self, file, *, run: Judged | None = None, speed: float = 1.0) -> Path:
        """Write a page to `file` that overlays the reference motion and that of another run, and return its path.

        `run` is one of ``rows``; by default the first one of another simulator that moved. `speed` is as in
        :func:`export_html`. Raises InputError if there is no other run, OSError if writing fails.
        """
        from .report import write_page_of

        return write_page_of(self, file, run, speed)


def referee(
    mech, t_span=None, q0=None, v0=None, *, forces=(), control=None, motion=None, log=None,
    mjcf=None, tools: Sequence[str] | None = None, below: float = BELOW, budget: float = BUDGET,
) -> Judgement:  # fmt: skip
    """Measure the errors of robotics simulators in the motion and the loop forces, for one motion of one mechanism.

    The same bodies, loops and forces are simulated in MuJoCo (``pip install 'pinconsist[mujoco]'``), from its defaults
    to its stiffest loops; in Pinocchio's ``constraintDynamics`` with Baumgarte stabilisation; and in this package. Each
    run is compared with a reference by Radau IIA at rtol 1e-10, with which BDF must agree. Contacts and joint limits
    are inactive in all runs.

    Parameters
    ----------
    mech : Mechanism
    t_span : (float, float), optional
        Start and end, s. Default: 0 and the mechanism's ``duration``.
    q0, v0 : mapping or array, optional
        As in :func:`simulate`.
    forces, control
        As in :func:`simulate`. Forces without an element in a simulator are evaluated here before each of its steps and
        held.
    motion : mapping, optional
        Joint → a function of time, such as a :class:`Motion`, or a table (times, values), which the joint is to follow:
        by the torques of the exact dynamics, and a PD law of 10 Hz. All simulators use the same law. The joints of
        drives follow their curves in the same way, because no other simulator here moves a joint exactly.
    log : path, optional
        A CSV file with the motion of another simulator, or of a robot, to be judged: see :mod:`pinconsist.judging.log`.
        The reference motion starts from its first row, with its commands and torques, at its times. `t_span`, `q0`,
        `v0` and `motion` are not used with it.
    mjcf : path, optional
        The MJCF file of the mechanism: MuJoCo is then also judged with the solver settings of this file.
    tools : sequence of {"mujoco", "pinocchio", "pinconsist"}, optional
        The simulators. Default: all that are installed; none with a log.
    below : float
        The relative force error for which the cheapest setting is searched for.
    budget : float
        CPU time allowed for one run, s; finer settings are left out.

    Returns
    -------
    Judgement

    Raises
    ------
    InputError
        Invalid arguments; a motion on which no two methods agree.
    MissingExtraError
        A simulator in `tools` is not installed.
    """
    mech = with_added_forces(mech, forces, "referee")
    if mech.contacts:
        warn(f"{mech.name}: the referee leaves out its contacts, in all runs")
        mech = mech.with_contacts()
    mech = mech if control is None else mech.with_control(control)
    if not mech.loops:
        raise InputError(f"{mech.name} has no loops, so that there are no loop forces to judge")
    if not isinstance(motion, Mapping | None):
        raise InputError(f"motion must map joints to curves, got {motion!r}")
    mjcf = None if mjcf is None else as_path(mjcf)
    below, budget = number(below, "below", above=0.0), number(budget, "budget", above=0.0)
    if log is not None:
        given = {"t_span": t_span, "q0": q0, "v0": v0, "motion": motion}
        if used := [name for name, value in given.items() if value is not None]:
            raise InputError(f"{used[0]}: the start, the times and the motion are those of the log")
        return _of_log(mech, log, _tools(tools or ()), below, budget, mjcf)
    span = (0.0, mech.duration) if t_span is None else span_of(t_span)
    if not span[1] > span[0]:
        raise InputError(f"t_span must be a start and a later end, s, got {t_span!r}")
    mech, motion = without_drives(mech, motion)
    assembly = assemble(mech, q0, v0, t=span[0])
    if motion:
        mech, assembly = following(mech, motion, span, assembly)
    reference = reference_of(mech, even_times(span), assembly.q, assembly.v)
    measure = Measure(mech, reference)
    rows, not_judged = _by_tools(_tools(tools), measure, assembly, below, budget, tools is not None, mjcf)
    return _judgement(measure, rows, not_judged, below)


def _judgement(measure, rows, not_judged, below, notes=()) -> Judgement:
    reference = measure.reference
    return Judgement(
        measure.mechanism, reference.t, reference.sol, reference.agreement, tuple(rows), _cheapest(rows, below),
        not_judged, measure.left_out, below, tuple(notes),
    )  # fmt: skip


def _of_log(mech, file, tools, below, budget, mjcf) -> Judgement:
    """The judgement of a log, and of simulators that make the same motion."""
    log = read_log(mech, file)
    mech, start = log.mechanism, (log.t[0], log.q[0], log.v[0])
    system = MechanismSystem(mech, assemble(mech, log.q[0], t=log.t[0]).q, log.t[0])
    q0, v0 = Index1(system).projected(*start)
    reference = reference_of(mech, log.t, q0, v0)
    measure, kept = Measure(mech, reference), slice(len(reference.t))
    exact, closed = measure.at_states(log.t[kept], log.q[kept], log.v[kept])
    exact = measure.forces(log.t[kept], closed, np.nan_to_num(exact))
    forces, notes = {}, list(log.notes)
    for name, values in log.forces.items():
        if name in measure.loops:
            k = measure.loops.index(name)
            forces[name], note = aligned(mech, name, values[kept], exact[:, 3 * k : 3 * k + 3], closed)
            notes += [note] * bool(note)
    rows = Rows(log.t[kept], log.q[kept], log.v[kept], None, 0.0, forces)
    judged = Judged("log", Path(file).name, "", None, **errors_of(rows, measure) | {"time": np.nan}, _rows=rows)
    even = np.ptp(np.diff(log.t)) <= UNEVEN * log.t[-1] / len(log.t)
    if tools and not even:
        raise InputError("tools: simulators of fixed steps need a log with even times")
    found, not_judged = _by_tools(tools, measure, Assembly(q0, v0, {}, 0, 0, 0, 0.0, 0, ()), below, budget, True, mjcf)
    judgement = _judgement(measure, [judged, *found], not_judged, below, notes)
    judgement.cheapest.pop("log")
    return judgement


def _by_tools(tools, measure, start, below, budget, needed, mjcf) -> tuple[list[Judged], dict[str, str]]:
    """The runs of simulators, and why others could not be judged."""
    mech, times = measure.mechanism, measure.reference.t
    of_file = None if mjcf is None or "mujoco" not in tools else solver_settings(mjcf)
    task = Task(mech, start.q, start.v, times, tilted_hinges(mech, start.q, float(times[0])), of_file)
    rows, not_judged = [], {}
    for name in tools:
        try:
            contestant = CONTESTANTS[name](task)
        except (NotTranslatedError, InputError) as error:
            not_judged[name] = str(error)
            continue
        except MissingExtraError as error:
            if needed:
                raise
            not_judged[name] = str(error)
            continue
        rows += _judged(contestant, measure, below, budget)
    return rows, not_judged


def _tools(tools) -> list[str]:
    names = (
        list(CONTESTANTS) if tools is None else [tools] if isinstance(tools, str) else [*checked_names(tools, "tools")]
    )
    for name in names:
        if name not in CONTESTANTS:
            raise InputError(f"tools: unknown simulator {name!r}; choose from {', '.join(CONTESTANTS)}")
    return names


def _judged(contestant, measure: Measure, below, budget) -> list[Judged]:
    """The runs of a simulator: each list of settings from coarse to fine, until one is good enough or too slow."""
    found = []
    for ladder in contestant.ladders():
        rate = None  # s of processor time times step of the last run
        for setting in ladder:
            if rate and setting.step and rate / setting.step > budget:
                break
            judged = judge(contestant, setting, measure)
            found.append(judged)
            if not judged.failed:
                length = float(np.ptp(measure.reference.t))
                rate = judged.time * length * setting.step if setting.step else None
                if judged.force <= below and len(ladder) > 1:
                    break
    return found


def judge(contestant, setting: Setting, measure: Measure) -> Judged:
    """Run a simulator with one setting, and measure its errors."""
    about = {"tool": contestant.name, "setting": setting.label, "paste": setting.paste, "step": setting.step}
    try:
        rows = contestant.run(setting)
    except FailedError as error:
        return Judged(**about, failed=str(error))
    errors = errors_of(rows, measure)
    if not errors["force"] <= BLOWN_UP:
        return Judged(**about, failed=f"the simulation became unstable: its forces are {errors['force']:.0e} times off")
    return Judged(**about, **errors, _rows=rows)


def errors_of(rows: Rows, measure: Measure) -> dict:
    """The errors of rows whose times are among those of the reference; fields of ``Judged``."""
    stride = max(1, round((rows.t[1] - rows.t[0]) / (measure.reference.t[1] - measure.reference.t[0])))
    here = slice(None, stride * len(rows.t), stride)
    exact_loads, closed = measure.at_states(rows.t, rows.q, rows.v)
    exact = np.full_like(measure.true[here], np.nan)
    if (known := np.isfinite(exact_loads).all(axis=1)).any():
        exact[known] = measure.forces(rows.t[known], closed[known], exact_loads[known])
    turn, slide, joint = measure.joints(here, rows.q)
    gap, tilt = measure.gaps(rows.t, rows.q)
    found = {
        "time": rows.seconds / float(rows.t[-1] - rows.t[0]),
        "joints_turn": turn, "joints_slide": slide, "joint": joint, "gap": gap, "tilt": tilt,
        "energy": measure.energy_error(here, rows.t, rows.q, rows.v),
    }  # fmt: skip
    return found | _force_errors(_own_forces(rows, closed, measure), exact, measure.true[here], measure)


def _force_errors(own, exact, true, measure) -> dict:
    """The errors of forces (n, 3 k); without the first row, before any step, at which soft loops have no force yet."""
    exact, true = exact[1:], true[1:]
    if own is None:
        return {"force_drift": rms(exact - true) / measure.size}
    own = own[1:]
    there = np.isfinite(own).all(axis=0)  # a log may have some loops only
    own, exact, true = own[:, there], exact[:, there], true[:, there]
    size = rms(measure.true[1:, there]) or 1.0
    peaks = [_peaks(each) for each in (own, true)]
    per_loop = {
        name: rms((own - true)[:, part]) / (rms(true[:, part]) or 1.0) for name, part in _parts(measure, there).items()
    }
    return {
        "force": rms(own - true) / size, "force_here": rms(own - exact) / size, "force_drift": rms(exact - true) / size,
        "force_peak": float(abs(peaks[0] - peaks[1]) / (peaks[1] or 1.0)), "loops": per_loop,
    }  # fmt: skip


def _own_forces(rows: Rows, closed, measure: Measure):
    """The forces of a simulator, side by side; NaN for loops that a log does not have, None if it has none."""
    if rows.loads is not None:
        return measure.forces(rows.t, closed, rows.loads)
    if not rows.forces.keys() & set(measure.loops):
        return None
    nothing = np.full((len(rows.t), 3), np.nan)
    return np.hstack([rows.forces.get(name, nothing) for name in measure.loops])


def _parts(measure, there) -> dict[str, slice]:
    """The columns of each loop among those that are there."""
    names = [name for k, name in enumerate(measure.loops) if there[3 * k]]
    return {name: slice(3 * k, 3 * k + 3) for k, name in enumerate(names)}


def _peaks(forces) -> float:
    parts = forces.reshape(len(forces), -1, 3) if forces.shape[1] % 3 == 0 else forces[:, :, None]
    return float(np.linalg.norm(parts, axis=2).max())


def _cheapest(rows, below) -> dict:
    found: dict[str, Judged | None] = {}
    for row in rows:
        best = found.setdefault(row.tool, None)
        if row.force <= below and (best is None or row.time < best.time):
            found[row.tool] = row
    return found
