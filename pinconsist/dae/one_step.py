"""An explicit one-step method on the index-1 equations, by which a multistep run begins: scipy's DOP853."""

from __future__ import annotations

import numpy as np
from scipy.integrate import DOP853

from ..errors import PinconsistError, SingularSystemError
from . import bdf
from .acceleration import NotFiniteError, not_finite, singular, solve_acceleration

FAILED = "the index-1 equations could not be integrated from t = {:.6g}: {}"


class OneStep:
    """A run of DOP853 on [ξ | v] in the chart at `base`.

    Parameters
    ----------
    system : Index3System
    base : ndarray
        Chart centre.
    t0, p0, v0 : float, ndarray, ndarray
        Start.
    t_end : float
        No step goes further, s.
    rtol, atol : float
        Tolerances of the local error.
    max_step : float
        Largest step, s.
    dense : bool
        Keep the interpolants, for :meth:`sample`.

    Attributes
    ----------
    t, y : float, ndarray
        Time and [ξ | v] reached.
    step_size : float
        The last step, s, positive.
    finished : bool
        `t_end` is reached.
    evaluations : int
        Of the right-hand side; interpolants take three a step.
    """

    def __init__(self, system, base, t0, p0, v0, t_end, rtol, atol, max_step=np.inf, dense=False):
        self._f, y0 = RightHandSide(system, base), chart_state(system, base, p0, v0)
        self._pieces, self._dense, self.step_size = [], dense, 0.0
        with _far_tries():
            self._solver = DOP853(self._f, t0, y0, t_end, rtol=rtol, atol=atol, max_step=max_step)

    t = property(lambda self: self._solver.t)
    y = property(lambda self: self._solver.y)
    finished = property(lambda self: self._solver.status == "finished")
    evaluations = property(lambda self: self._solver.nfev)

    def step(self) -> None:
        """One step; raises PinconsistError where the method fails, SingularSystemError where the equations are."""
        solver = self._solver
        with _far_tries():
            reason = solver.step()
        if solver.status == "failed":
            cause = self._f.not_finite
            raise PinconsistError(FAILED.format(solver.t, cause or reason)) from cause
        self.step_size = abs(solver.step_size)
        if self._dense:
            self._pieces.append(solver.dense_output())

    def sample(self, times):
        """[ξ | v] at `times` inside the steps made, shape (len(times), nx+nv), in their order away from the start."""
        ends = np.array([piece.t for piece in self._pieces])
        direction = self._solver.direction
        holders = np.minimum(np.searchsorted(direction * ends, direction * times), len(ends) - 1)
        return np.concatenate([self._pieces[i](times[holders == i]).T for i in np.unique(holders)])


class CompiledOneStep:
    """The same by the twin of a system."""

    def __init__(self, system, base, t0, p0, v0, t_end, rtol, atol, max_step=np.inf, dense=False):
        self._system, y0 = system, chart_state(system, base, p0, v0)
        self._run = system.twin.one_step(base, t0, y0, t_end, rtol, atol, max_step, dense)
        self.sample = self._run.sample

    t = property(lambda self: self._run.t)
    y = property(lambda self: self._run.y)
    step_size = property(lambda self: self._run.step_size)
    finished = property(lambda self: self._run.finished)
    evaluations = property(lambda self: self._run.evaluations)

    def step(self) -> None:
        """One step, as of :class:`OneStep`."""
        run = self._run
        reason = run.step()
        if reason == "singular":
            raise SingularSystemError(singular(run.culprit[0]))
        if reason:
            cause = NotFiniteError(not_finite(self._system, *run.culprit)) if run.culprit else None
            raise PinconsistError(FAILED.format(run.t, cause or reason)) from cause


def one_step(system, *arguments, **options) -> OneStep | CompiledOneStep:
    """A :class:`OneStep`, compiled where the system has a twin."""
    kind = OneStep if getattr(system, "twin", None) is None else CompiledOneStep
    return kind(system, *arguments, **options)


class RightHandSide:
    """f(t, [ξ | v]) of the index-1 equations in the chart at `base`, for scipy.

    Attributes
    ----------
    not_finite : NotFiniteError or None
        What evaluations have run into since the last one that came to something.
    """

    def __init__(self, system, base):
        self.system, self.base, self.not_finite = system, base, None

    def __call__(self, t, y):
        system, base = self.system, self.base
        p = y[: system.nx] if system.vector_like else system.integrate(base, y[: system.nx])
        v = y[system.nx :]
        try:
            a, _ = solve_acceleration(system, t, p, v)
        except NotFiniteError as error:  # a step far too long for a stiff force: scipy takes a shorter one
            if np.isfinite(y).all():  # the stages after it are only led on from there
                self.not_finite = error
            return np.full(len(y), np.nan)
        self.not_finite = None
        return np.concatenate((system.chart_rate(base, p, system.rate(t, p, v)), a))


def chart_state(system, base, p, v):
    """[ξ | v] of a state."""
    return bdf.table_row(system, base, p, v, np.zeros(0))


def _far_tries():
    """A first try of a step may go so far that numbers overflow; a shorter one then follows."""
    return np.errstate(over="ignore", invalid="ignore")
