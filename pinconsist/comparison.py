"""Exact against numerically consistent initial values: the tables of Arévalo (2008), for any system and order."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .dae import consistency, start
from .dae.control import FixedStep
from .dae.index1 import Index1
from .dae.integrate import Method, integrate
from .dae.start import integrate_index1
from .errors import InputError, PinconsistError
from .mechanism.assembly import assemble
from .mechanism.checks import finite_array
from .mechanism.mechanism import Mechanism
from .mechanism.rows import LoopRows
from .reference import reference_problem
from .simulation import system_of

FORCES = {"m": "N", "rad": "N·m"}  # of the multipliers of rows


@dataclass(frozen=True)
class Run:
    """Multiplier errors for one step size, in the largest component, at each time.

    Attributes
    ----------
    h, order : float, int
        Step, s, and BDF order k.
    t, exact, consistent, every_step : ndarray, shape (n,)
        Times, and |λ_n - λ(t_n)| from exact values, from consistent ones, with every step corrected. For order k the
        first k rows are the exact start; the first BDF step is row k.
    lam : ndarray, shape (n, nc)
        λ(t_n).
    unit : str
        Of the largest multiplier at the first step of the method; empty for a general problem.
    v_given, v_consistent : ndarray, shape (nv,)
        The initial velocity as given, and the numerically consistent one.
    """

    h: float
    order: int
    t: np.ndarray
    exact: np.ndarray
    consistent: np.ndarray
    every_step: np.ndarray
    lam: np.ndarray
    unit: str
    v_given: np.ndarray
    v_consistent: np.ndarray

    @property
    def wrong(self) -> str:
        """How wrong the first multipliers from exact values are: ``128 % wrong``."""
        return f"{self._share(self.exact)} wrong"

    @property
    def verdict(self) -> str:
        """One sentence: how wrong the first multipliers are, and how large they should be."""
        size = f"{np.abs(self.lam[self.order]).max():.3g} {self.unit}".rstrip()
        return (
            f"h = {self.h:g} s: at the first step the multipliers (components of loop forces) from exact values are "
            f"{self.wrong}, from consistent values {self._share(self.consistent)}; the largest true one is {size}"
        )

    def _share(self, errors) -> str:
        """The error at the first step of the method, in the largest multiplier there."""
        error, size = errors[self.order], np.abs(self.lam[self.order]).max()
        if not size:
            return f"{error:.2g}"
        share = 100 * error / size
        return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"


@dataclass(frozen=True)
class Comparison:
    """Runs for several step sizes.

    Attributes
    ----------
    name : str
    order : int
    runs : tuple of Run
    """

    name: str
    order: int
    runs: tuple[Run, ...]

    def __str__(self):
        lines = [f"{self.name}, BDF of order {self.order}: error of the multipliers"]
        lines += [run.verdict for run in self.runs]
        for run in self.runs:
            lines.append(f"h = {run.h:g} s\n{'t [s]':>10} {'exact':>12} {'consistent':>12} {'every step':>12}")
            rows = zip(run.t[1:], run.exact[1:], run.consistent[1:], run.every_step[1:], strict=True)
            lines += [f"{t:10.6g} {a:12.4e} {b:12.4e} {c:12.4e}" for t, a, b, c in rows]
        return "\n".join(lines)


def compare(subject, steps, *, order=1, count=6, q0=None, v0=None) -> Comparison:
    """Errors of the first multipliers from exact and from numerically consistent initial values.

    Parameters
    ----------
    subject : str or Mechanism
        ``"problem51"``, ``"problem52"``, or a mechanism, whose reference is scipy's DOP853 at 1e-13 on the index-1
        equations.
    steps : sequence of float
        Step sizes, s.
    order : int
        BDF order k, 1 to 6.
    count : int
        BDF steps to take.
    q0, v0 : mapping or array, optional
        Start of a mechanism, as in :func:`pinconsist.simulate`.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        Arguments that cannot be used; a system without constraints, which has no multipliers.
    AssemblyError
        The loops of a mechanism cannot be closed.
    PinconsistError
        A run or the reference fails.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), section 5.
    """
    steps = np.atleast_1d(finite_array(steps, "steps"))
    if steps.size == 0 or (steps <= 0).any():
        raise InputError(f"steps must be positive numbers of seconds, got {steps}")
    if not 1 <= order <= 6 or count < 1:
        raise InputError(f"order must be 1 to 6 and count at least 1, got {order} and {count}")
    name, system, t0, p0, v0, exact = _subject(subject, q0, v0)
    return Comparison(name, order, tuple(_run(system, t0, p0, v0, exact, float(h), order, count) for h in steps))


def _subject(subject, q0, v0):
    """(name, system, t0, p0, v0, λ at times) of what is compared."""
    if isinstance(subject, Mechanism):
        assembly = assemble(subject, q0, v0)
        origin = 0.0, assembly.q, assembly.v
        system = system_of(subject, *origin)

        def multipliers(times):
            rows = integrate_index1(Index1(system), *origin, times, 1e-13, 1e-13)
            return np.array([system.full_multipliers(p, lam) for _, p, _, lam in rows])

        return subject.name, system, *origin, multipliers
    if q0 is not None or v0 is not None:
        raise InputError(f"{subject} has its own initial values; q0 and v0 are for mechanisms")
    problem = reference_problem(subject)
    origin = problem.t0, problem.p0, problem.v0
    exact = problem.exact
    return (
        problem.name,
        system_of(problem.system, *origin),
        *origin,
        lambda times: np.array([exact(t)[2] for t in times]),
    )


def _run(system, t0, p0, v0, exact, h, k, count):
    if system.nc == 0:
        raise InputError("there are no loops, so there are no multipliers to compare")
    times = t0 + h * np.arange(k + count)
    truth = exact(times)
    errors = []
    for mode in consistency.MODES:
        trajectory = integrate(system, (t0, times[-1]), p0, v0, Method(k, mode, FixedStep(), h))
        if trajectory.status < 0:
            raise PinconsistError(f"consistency={mode!r}, h = {h:g}: {trajectory.message}")
        errors.append(np.max(np.abs(trajectory.lam - truth), axis=1))
    states = start.equidistant_history(Index1(system), t0, p0, v0, h, k)
    base, Z = start.fill_table(system, states)
    mechanism = getattr(system, "mechanism", None)
    units = [] if mechanism is None else [FORCES.get(unit, "") for unit in LoopRows.of(mechanism).units]
    unit = units[np.argmax(np.abs(truth[k]))] if units else ""
    return Run(
        h, k, times, *errors, truth, unit, v0, consistency.consistent_velocities(system, h, k, base, Z, states)[0]
    )
