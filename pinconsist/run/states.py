"""The states of a run at any times, as accurate as its rows, with the loops closed to rounding."""

import numpy as np

from ..engine.charts import chart_matrix, chart_rate_gradient
from ..engine.index1 import Index1
from ..engine.norms import largest
from ..errors import InputError, PinconsistError, warn
from ..mechanism.checks import finite_array
from ..mechanism.forces.held import jump_offset
from .accuracy import Equations, equations_of
from .integrate import integrate
from .options import Options
from .output import Output
from .steppers import stepper_for

REPEAT_DISTANCE = 0.1  # of the way of a step: if its repetition ends farther from its end, it is another motion


def states_at(solution, times, mechanism=None):
    """(q, v, λ) of a solution at times of shape (n,), in any order, from its first to its last one.

    At the time of a row they are that row, the later of two. Between rows, a solution that was made by ``at()`` asks
    the run from which it comes. Else the continuous solution is evaluated if there is one, or steps of BDF are
    interpolated, and longer ones repeated, see :class:`Steps`; then the loops are closed, velocities projected onto
    them, and multipliers computed from the equations of motion.
    """
    times = _checked(solution, times)
    sign = 1.0 if solution.t[-1] >= solution.t[0] else -1.0
    rows = np.searchsorted(sign * solution.t, sign * times, side="right") - 1
    q, v, lam = (part[rows] for part in (solution.q, solution.v, solution.lam))
    between = np.flatnonzero(solution.t[rows] != times)
    between = between[np.argsort(sign * times[between], kind="stable")]
    if not len(between):
        return q, v, lam
    if solution._run is not None:
        for part, of_run in zip((q, v, lam), states_at(solution._run, times[between], mechanism), strict=True):
            part[between] = of_run
        return q, v, lam
    equations = equations_of(mechanism, solution) if mechanism is not None else Index1(solution.system)
    for k, *near in zip(between, *_near(solution, times[between], rows[between], mechanism), strict=True):
        index1 = equations.at(times[k], *near) if mechanism is not None else equations
        q[k], v[k] = index1.projected(times[k], *near)
        lam[k] = index1.system.full_multipliers(q[k], index1.acceleration(times[k], q[k], v[k])[1], v=v[k])
    return q, v, lam


def _checked(solution, times):
    """The times as an array; InputError for times outside of the solution."""
    times = finite_array(times, "t")
    if times.ndim != 1:
        raise InputError(f"states need a row of times, s, got an array of shape {times.shape}")
    if not len(solution.t):
        raise InputError("the solution has no rows")
    low, high = sorted((float(solution.t[0]), float(solution.t[-1])))
    if (outside := times[(times < low) | (times > high)]).size:
        raise InputError(f"the solution covers t = {low:g} to {high:g} s, not {outside[0]:g} s")
    return times


def _near(solution, times, rows, mechanism):
    """q and v at times in the order of the run, each in the step after one of the rows, before loops are closed."""
    if solution.sol is not None:
        return solution.sol(times)[:2]
    steps = Steps(solution, mechanism)
    parts = [steps.inside(row, times[rows == row]) for row in np.unique(rows)]
    return tuple(map(np.concatenate, zip(*parts, strict=True)))


class Steps:
    """The states inside the steps of a solution.

    A step of BDF of a mechanism is interpolated from the positions, velocities and accelerations at its ends by
    polynomials of degree 5: their error is of a higher order than that of the step. A step of Radau is too long for
    that. It is made once more from its first row, as are the steps between rows of ``t_eval``, and the result is bent
    to the next row, from which it differs by no more than the error of the run.
    """

    def __init__(self, solution, mechanism):
        self._solution, self._are_steps, self._mechanism = solution, bool(len(solution.h)), mechanism
        self._interpolates = mechanism is not None and self._are_steps and solution.method.get("method") != "Radau"
        if mechanism is not None:
            self._equations = equations_of(mechanism, solution)
            again = equations_of if self._are_steps else Equations  # other rows may have changes of modes between them
            self._repeated = again(mechanism, solution)  # a run changes held torques

    def inside(self, row, times):
        """q and v at times between a row and the next one."""
        sol = self._solution
        if abs(sol.t[row + 1] - sol.t[row]) <= jump_offset(sol.t[row]):  # a step that ends where another ended, rounded
            return np.repeat(sol.q[row : row + 1], len(times), axis=0), np.repeat(
                sol.v[row : row + 1], len(times), axis=0
            )
        if self._interpolates:
            return self._interpolated(row, times)
        try:
            return self._again(row, times)
        except PinconsistError as error:
            if self._mechanism is None:
                raise
            t = self._solution.t
            warn(f"between t = {t[row]:.6g} and {t[row + 1]:.6g} s states are interpolated from rows only: {error}")
            return self._interpolated(row, times)

    def _interpolated(self, row, times):
        """By Hermite's polynomials in the chart at the row."""
        sol = self._solution
        (t0, t1), (q0, q1), (v0, v1) = (part[row : row + 2] for part in (sol.t, sol.q, sol.v))
        inner = np.sign(t1 - t0) * jump_offset(t0)
        a0 = self._equations.at(t0, q0, v0).acceleration(t0 + inner, q0, v0)[0]
        index1 = self._equations.at(t1, q1, v1)
        a1, system = index1.acceleration(t1 - inner, q1, v1)[0], index1.system
        end = system.difference(q0, q1)
        rate, bent = v1, a1
        if not system.vector_like:
            T = chart_matrix(system, end)
            rate = T @ v1
            bent = T @ a1 + chart_rate_gradient(system, end, v1) @ rate
        xi, rates = quintic(times - t0, t1 - t0, (v0, a0), (end, rate, bent))
        if system.vector_like:
            return q0 + xi, rates
        q = np.array([system.integrate(q0, each) for each in xi])
        return q, np.array([np.linalg.solve(chart_matrix(system, x), r) for x, r in zip(xi, rates, strict=True)])

    def _again(self, row, times):
        """By the same step once more."""
        sol = self._solution
        (t0, t1), (q0, q1), (v0, v1) = (part[row : row + 2] for part in (sol.t, sol.q, sol.v))
        system = sol.system if self._mechanism is None else self._repeated.at(t0, q0, v0).system.aimed(q0, v0)
        method = self._method(row, t0, t1)
        output = Output(t_eval=np.append(times, t1), events=() if self._are_steps else sol._events)
        run = integrate(system, (t0, t1), q0, v0, method, output, stepper_for(system, method))
        if len(run.t) <= len(times):
            raise PinconsistError(run.message)
        way, off = system.difference(q0, q1), system.difference(run.p[-1], q1)
        if largest(off) > REPEAT_DISTANCE * max(largest(way), largest((t1 - t0) * v0), 1e-6):
            raise PinconsistError("an event, or a force that the solution does not have, acted there")
        share = (times - t0) / (t1 - t0)
        share = (share**2 * (3.0 - 2.0 * share))[:, None]
        q = np.array([system.integrate(*state) for state in zip(run.p[:-1], share * off, strict=True)])
        return q, run.v[:-1] + share * (v1 - run.v[-1])

    def _method(self, row, t0, t1):
        about, h = self._solution.method, abs(t1 - t0)
        rtol, atol = (
            tuple(about[key]) if key in about else default for key, default in (("rtol", 1e-6), ("atol", 1e-8))
        )
        step = order = first = None
        if self._are_steps and about.get("method") == "Radau" and self._solution.order[row] > 0:
            order = int(self._solution.order[row])
            step, first = (h, None) if about["step"] is not None else (None, h)
        consistency = "every-step"
        return Options("Radau", step, order, rtol, atol, consistency, first).for_span((t0, t1))


def quintic(t, h, start, end):
    """x and x' of the polynomial of degree 5 with x(0) = 0 at times `t` (n,) of a step `h`, shapes (n, k).

    `start` has x' and x'' at 0, and `end` x, x' and x'' at `h`.
    """
    (v0, a0), (x1, v1, a1) = start, end
    b = np.array([x1 - h * v0 - h**2 / 2 * a0, h * (v1 - v0 - h * a0), h**2 * (a1 - a0)])
    c = np.array([[10.0, -4.0, 0.5], [-15.0, 7.0, -1.0], [6.0, -3.0, 0.5]]) @ b  # of θ³, θ⁴ and θ⁵
    s = (t / h)[:, None]
    x = h * s * v0 + h**2 / 2 * s**2 * a0 + s**3 * (c[0] + s * (c[1] + s * c[2]))
    return x, v0 + h * s * a0 + s**2 / h * (3.0 * c[0] + s * (4.0 * c[1] + 5.0 * s * c[2]))
