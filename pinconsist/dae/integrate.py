"""The one loop: predict, solve, correct, test, accept, record."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from . import bdf, consistency, start
from .newton import Newton
from .stepsize import ErrorControl, FixedStep

log = logging.getLogger(__name__)

SUCCESS, STOPPED, FAILED = 0, 1, -1


@dataclass
class Trajectory:
    """What an integration reached. Rows are times.

    Attributes
    ----------
    t, p, v, lam : ndarray
        (n,), (n, npos), (n, nv), (n, nc).
    success : bool
        True if the end of the span was reached.
    status : int
        0 end reached, 1 stopped by a callback, -1 failed.
    message : str
        One sentence (or more) for a person.
    nfev, njev, nlu : int
        Residual evaluations, Newton matrices, factorisations.
    rejected : dict
        Number of rejected attempts by reason.
    h, order : ndarray, shape (n-1,)
        Step and order by which each row was reached (order 0: from the one-step start).
    """

    t: np.ndarray
    p: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    success: bool
    status: int
    message: str
    nfev: int = 0
    njev: int = 0
    nlu: int = 0
    rejected: dict = field(default_factory=dict)
    h: np.ndarray = field(default_factory=lambda: np.zeros(0))
    order: np.ndarray = field(default_factory=lambda: np.zeros(0, int))


@dataclass
class Method:
    """The method of one run: order, formula, consistency and who controls the step."""

    order: int
    consistency: str
    control: FixedStep | ErrorControl
    step: float | None
    first_step: float | None = None
    max_steps: int | None = None

    def describe(self) -> dict:
        """The method in plain numbers and words, for the record."""
        about = {"max_order": self.order, "consistency": self.consistency, "step": self.step}
        if isinstance(self.control, ErrorControl):
            about["rtol"] = [np.asarray(part).tolist() for part in self.control.rtol]
            about["atol"] = [np.asarray(part).tolist() for part in self.control.atol]
        return about


class Recorder:
    """Rows of the solution as they are accepted."""

    def __init__(self, callback):
        self.rows, self.steps, self.callback = [], [], callback

    def add(self, t, p, v, lam, h=0.0, k=0) -> bool:
        """Record a row; True if the callback asks to stop."""
        self.rows.append((t, p, v, lam))
        if len(self.rows) > 1:
            self.steps.append((h, k))
        return self.callback is not None and bool(self.callback(t, p, v, lam))


def integrate(system, t_span, p0, v0, method: Method, callback=None) -> Trajectory:
    """Integrate an index-3 system from (p0, v0), taken as they stand.

    Parameters
    ----------
    system : Index3System
    t_span : (float, float)
        Start and end, s; backwards if the end is earlier.
    p0, v0 : ndarray
        Initial position and velocity.
    method : Method
    callback : callable, optional
        ``callback(t, p, v, lam)`` after every accepted step; a true value stops the run.

    Returns
    -------
    Trajectory
        ``success`` is False, with what was reached, where the method fails.
    """
    t0, t1 = t_span
    recorder = Recorder(callback)
    newton = Newton(system, corrections=method.control.corrections if method.consistency == "every-step" else 0)
    outcome = FAILED, ""
    try:
        p, v, lam = p0, v0, start.solve_acceleration(system, t0, p0, v0)[1]
        if t0 == t1:
            recorder.add(t0, p, v, lam)
            outcome = SUCCESS, "the interval has length zero"
        else:
            outcome = _march(system, t0, t1, p0, v0, method, newton, recorder)
    except KeyboardInterrupt:
        outcome = STOPPED, "interrupted; the solution holds what was reached"
    return _trajectory(system, recorder, newton, method, outcome)


def _march(system, t0, t1, p0, v0, method, newton, recorder):
    control, k = method.control, method.order
    fixed = isinstance(control, FixedStep)
    if fixed:
        steps = max(1, int(np.ceil(abs(t1 - t0) / abs(method.step) - 1e-9)))
        h = (t1 - t0) / steps
        states = start.equidistant_history(system, t0, p0, v0, h, min(k, steps + 1))
    else:
        h, states = start.adaptive_history(system, t0, p0, v0, t1, k, control, method.first_step)
    for row in states:
        if recorder.add(*row, h, 0):
            return STOPPED, f"stopped by the callback at t = {row[0]:.6g}"
    base, Z = start.fill_table(system, states, k)
    if method.consistency == "initial":
        _make_consistent(system, h, k, base, Z, states)
    table = np.zeros((bdf.MAX_ORDER + 3, Z.shape[1]))
    table[: len(Z)] = Z
    Z, t, taken = table, states[-1][0], len(states) - 1
    ndf = control.ndf
    while t != t1:
        if fixed:
            t_next = t0 + (taken + 1) * h if taken + 1 < steps else t1
        else:
            if (t1 - t) / h < 1.0 + 1e-9:
                Z[: k + 1] = bdf.rescale(k, (t1 - t) / h) @ Z[: k + 1]
                h, t_next = t1 - t, t1
                control.equal_steps = 0
            else:
                t_next = t + h
        centre, predicted, psi = bdf.predict(system, k, base, Z, ndf)
        base = centre
        weights = control.weights(system, predicted, centre)
        step = newton.attempt(t_next, centre, psi, predicted, h / bdf.alpha(k, ndf), *weights)
        if step.failure:
            smaller = control.after_failure(h, step.failure)
            if smaller is None or abs(smaller) < 16 * np.spacing(abs(t)):
                return FAILED, f"{step.failure} at t = {t:.6g} with step {h:.3g}"
            Z[: k + 1] = bdf.rescale(k, smaller / h) @ Z[: k + 1]
            h = smaller
            continue
        d = step.y - predicted
        error = control.error(system, d, k, weights)
        if error > 1.0:
            smaller = control.after_rejection(h, k, error)
            if abs(smaller) < 16 * np.spacing(abs(t)):
                return FAILED, f"the step size fell to {smaller:.3g} at t = {t:.6g}"
            Z[: k + 1] = bdf.rescale(k, smaller / h) @ Z[: k + 1]
            h = smaller
            continue
        Z[k + 2] = d
        Z[: k + 3] = bdf.advance(k) @ Z[: k + 3]
        t, taken = t_next, taken + 1
        nx, nv = system.nx, system.nv
        if recorder.add(t, step.p, step.y[nx : nx + nv], step.y[nx + nv :], h, k) and t != t1:
            return STOPPED, f"stopped by the callback at t = {t:.6g}"
        if method.max_steps is not None and taken >= method.max_steps and t != t1:
            return FAILED, f"max_steps = {method.max_steps} reached at t = {t:.6g}"
        new_h, new_k = control.next_step(system, Z, k, h, error, weights, step.iterations)
        if new_h != h:
            Z[: new_k + 1] = bdf.rescale(new_k, new_h / h) @ Z[: new_k + 1]
        h, k = new_h, new_k
    return SUCCESS, "the end of the interval was reached"


def _make_consistent(system, h, k, base, Z, states):
    """Replace the velocities of the table by numerically consistent ones."""
    t0, p0, v0, _ = states[0]
    if k == 1:
        velocities = [consistency.consistent_initial_velocity(system, t0, p0, v0, h)]
    else:
        velocities = consistency.consistent_history(system, h, k, base, Z, states)
    D = bdf.differences(len(states) - 1)
    Z[: len(states), system.nx : system.nx + system.nv] = D @ np.array(velocities[::-1])


def _trajectory(system, recorder, newton, method, outcome):
    status, message = outcome
    t, p, v, lam = (np.array(column) for column in zip(*recorder.rows, strict=True))
    steps = np.array(recorder.steps).reshape(-1, 2)
    return Trajectory(
        t, p, v, lam, status == SUCCESS, status, message, newton.nfev, newton.njev, newton.nlu,
        dict(getattr(method.control, "reasons", {})), steps[:, 0], steps[:, 1].astype(int),
    )  # fmt: skip
