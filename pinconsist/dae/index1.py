"""The equations of index 1: accelerations, projections onto the constraints, and scipy's DOP853 on them.

A multistep run starts with them, and references and events use them. :class:`Index1` collects what a run needs; the
compiled method has its own, with the same interface.
"""

import numpy as np
from scipy.integrate import DOP853

from ..errors import AssemblyError, PinconsistError, SingularSystemError
from .charts import chart_matrix, chart_point, table_row
from .kkt import columns, kkt_at
from .newton import culprits
from .norms import EPS, largest
from .rounding import rounding_gap
from .tuning import CLOSED, CLOSINGS


class NotFiniteError(PinconsistError):
    """The equations of motion have a number that is not finite."""


def not_finite_message(system, t, p, v) -> str:
    """The message about accelerations that are not finite; it names the forces that are not."""
    whose = culprits(system, t, p, v)
    return (
        f"the equations of motion are not finite at t = {t:.6g}{whose}: a force or a user's function returns NaN or "
        "infinity"
    )


def not_closed_message(gap) -> str:
    """The message about a position that cannot be projected onto the constraint."""
    return f"the position could not be projected onto the constraint: |Φ| = {gap:.3g} remains"


def integration_failed_message(t, cause) -> str:
    """The message about a one-step method that fails."""
    return f"the index-1 equations could not be integrated from t = {t:.6g}: {cause}"


def solve_acceleration(system, t, p, v):
    """(a, λ), shapes (nv,) and (nc,): acceleration and multiplier of the differential equation itself at a state.

    Solves [[M, -G], [W, 0]] [a; λ] = [-f₀; -γ]; M alone may be singular (massless links).
    """
    kkt, f0, _, _ = kkt_at(system, t, p, v)
    rhs = -np.concatenate((f0, system.acceleration_bias(t, p, v)))
    if not np.isfinite(rhs).all():
        raise NotFiniteError(not_finite_message(system, t, p, v))
    x = kkt.solve(rhs)
    return x[: system.nv], x[system.nv :]


def velocity_shift(system, t, p, v, rho):
    """M⁻¹ G S⁻¹ ρ, shape (nv,): the smallest velocity, in the mass metric, that has the residual ρ."""
    return kkt_at(system, t, p, v)[0].solve(np.concatenate((np.zeros(system.nv), rho)))[: system.nv]


def project_velocity(system, t, p, v):
    """`v` projected onto the hidden constraint W v + Φ_t = 0 in the mass metric, shape (nv,)."""
    if not system.nc:
        return v
    for _ in range(2):  # the second pass removes the remainder if U is not linear in v
        v = v - velocity_shift(system, t, p, v, system.constraint(t, p, system.rate(t, p, v))[1])
    return v


def moved_by(system, t, p, v, change):
    """∂U/∂v `change`, shape (nx,): the tangent vector by which a vector of velocities moves the position."""
    small = 1e-4 * (1.0 + largest(v)) / max(largest(change), 1e-300)  # not so small that v rounds it away
    return (system.rate(t, p, v) - system.rate(t, p, v - small * change)) / small


def settled(system, t, p, v):
    """(p, v), near both constraints, projected onto them, and λ there, by one factorisation."""
    if not system.nc:
        return p, v, np.zeros(0)
    kkt, zero = kkt_at(system, t, p, v)[0], np.zeros(system.nv)
    phi = system.constraint(t, p, system.rate(t, p, v))[0]
    shift = kkt.solve(np.concatenate((zero, phi)))[: system.nv]
    p = system.integrate(p, -moved_by(system, t, p, v, shift))
    rho = system.constraint(t, p, system.rate(t, p, v))[1]
    v = v - kkt.solve(np.concatenate((zero, rho)))[: system.nv]
    f0 = system.evaluate(t, p, v, zero)[0]
    return p, v, kkt.solve(-np.concatenate((f0, system.acceleration_bias(t, p, v))))[system.nv :]


def projected(system, kkt, G, t, p, v):
    """(p, v) after a step, on both constraints by the matrix at its end; (None, None) if there are none."""
    with _overflow_allowed():
        for _ in range(CLOSINGS):
            phi, rho = system.constraint(t, p, system.rate(t, p, v))
            shift, change = kkt.solve(columns(system.nv, system.nc, (0.0, phi), (0.0, rho)))[: system.nv].T
            p, v = system.integrate(p, -moved_by(system, t, p, v, shift)), v - change
            if not np.isfinite(p).all():
                return None, None
            if largest(phi) <= CLOSED * (1.0 + largest(p)):
                return p, v
    gap = largest(system.constraint(t, p, v)[0])
    return (p, v) if gap <= rounding_gap(p, G) else (None, None)


def project_position(system, t, p, v):
    """`p`, near the manifold, projected onto Φ(t, p) = 0 in the mass metric; AssemblyError after 20 iterations."""
    if not system.nc:
        return p
    last = np.inf
    for _ in range(20):
        _, phi, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
        size = largest(phi)
        if size <= EPS or (size <= rounding_gap(p, G) and size >= 0.5 * last):
            return p
        step = velocity_shift(system, t, p, v, phi)
        p, last = system.integrate(p, -moved_by(system, t, p, v, step)), size
    raise AssemblyError(not_closed_message(last))


class Index1:
    """The index-1 equations of a system, as far as a run needs them."""

    def __init__(self, system):
        self.system = system

    def acceleration(self, t, p, v):
        """See :func:`solve_acceleration`."""
        return solve_acceleration(self.system, t, p, v)

    def projected(self, t, p, v):
        """(p, v) projected onto the constraints."""
        p = project_position(self.system, t, p, v)
        return p, project_velocity(self.system, t, p, v)

    def state(self, t, p, v):
        """(t, p, v, λ) with p and v projected onto the constraints and λ of the differential equation."""
        p, v = self.projected(t, p, v)
        return t, p, v, self.acceleration(t, p, v)[1]

    def one_step(self, *arguments, **options):
        """A run of the one-step method, see :class:`OneStep`."""
        return OneStep(self.system, *arguments, **options)


class OneStep:
    """A run of DOP853 from (t0, p0, v0) towards `t_end` on [ξ | v] in the chart at `base`.

    `t` and `y` are the time and state reached, `step_size` is the last step, `evaluations` counts those of the
    right-hand side; with `dense` the interpolants are kept, for :meth:`sample`.
    """

    def __init__(self, system, base, t0, p0, v0, t_end, rtol, atol, max_step=np.inf, dense=False):
        self._f, y0 = RightHandSide(system, base), chart_state(system, base, p0, v0)
        self._pieces, self._dense, self.step_size = [], dense, 0.0
        with _overflow_allowed():
            self._solver = DOP853(self._f, t0, y0, t_end, rtol=rtol, atol=atol, max_step=max_step)

    t = property(lambda self: self._solver.t)
    y = property(lambda self: self._solver.y)
    finished = property(lambda self: self._solver.status == "finished")
    evaluations = property(lambda self: self._solver.nfev)

    def step(self) -> None:
        """One step; raises PinconsistError if the method fails, SingularSystemError if the equations are singular."""
        solver = self._solver
        with _overflow_allowed():
            reason = solver.step()
        if solver.status == "failed":
            cause = self._f.failure
            if isinstance(cause, SingularSystemError):
                raise cause
            raise PinconsistError(integration_failed_message(solver.t, cause or reason)) from cause
        self.step_size = abs(solver.step_size)
        if self._dense:
            self._pieces.append(solver.dense_output())

    def sample(self, times):
        """[ξ | v] at `times` inside the steps made, shape (len(times), nx+nv), in their order away from the start."""
        ends = np.array([piece.t for piece in self._pieces])
        direction = self._solver.direction
        holders = np.minimum(np.searchsorted(direction * ends, direction * times), len(ends) - 1)
        return np.concatenate([self._pieces[i](times[holders == i]).T for i in np.unique(holders)])


class RightHandSide:
    """f(t, [ξ | v]) of the index-1 equations in the chart at `base`, for scipy.

    `failure` is the error of the evaluations since the last successful one, or None.
    """

    def __init__(self, system, base):
        self.system, self.base, self.failure, self._started = system, base, None, False

    def __call__(self, t, y):
        system, base = self.system, self.base
        p, v = chart_point(system, base, y[: system.nx]), y[system.nx :]
        try:
            a, _ = solve_acceleration(system, t, p, v)
        except (NotFiniteError, SingularSystemError) as error:
            if not self._started:
                raise
            if np.isfinite(y).all():  # if not, an earlier stage failed
                self.failure = error
            return np.full(len(y), np.nan)  # a step far too long for a stiff force: scipy then tries a shorter one
        self.failure, self._started = None, True
        rate = system.rate(t, p, v)
        return np.concatenate((rate if system.vector_like else chart_matrix(system, y[: system.nx]) @ rate, a))


def chart_state(system, base, p, v):
    """[ξ | v] of a state."""
    return table_row(system, base, p, v, np.zeros(0))


def _overflow_allowed():
    """Numbers may overflow in a step that is too long; a shorter one then follows."""
    return np.errstate(over="ignore", invalid="ignore")
