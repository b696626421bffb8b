"""The equations of index 1, by scipy: accelerations, projections, starting values, and reference solutions.

The constraint differentiated twice is linear in the acceleration, W v' + γ = 0, and with the equations of motion

    [ M  -G ] [ v' ]     [ f₀ ]
    [ W   0 ] [ λ  ] = - [ γ  ]

gives acceleration and multipliers of the differential equation itself. DOP853 integrates them; Φ and its derivative are
then satisfied by projection in the metric of M.
"""

from functools import partial
from typing import NamedTuple

import numpy as np
from scipy.integrate import solve_ivp

from ..engine.charts import chart_matrix, chart_point
from ..engine.hessenberg import HessenbergProblem
from ..engine.problem import Index3System
from ..errors import AssemblyError, InputError, PinconsistError
from .step import State, factorised, kkt_matrix, solved

PROJECTIONS = 20  # iterations of a projection, at most
GAP_LEFT = 1e-15  # gap relative to the position that is rounding
MAX_CHART_STEP = 1.0  # rad, or m: the most that a position moves in one chart
CHOICES = 100  # times in a reference solution at which the choice of constraint rows is checked


class Reference(NamedTuple):
    """Rows of a reference solution: t (n,), q (n, nq), v (n, nv), lam (n, nc)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray


def index3_system(system, t0, p0, v0) -> Index3System:
    """The Index3System of a problem at its start: of a HessenbergProblem, a Mechanism, or the system itself."""
    if isinstance(system, HessenbergProblem):
        return system.at(t0, p0, v0)
    if isinstance(system, Index3System):
        return system
    from ..run.simulation import system_of  # needs Pinocchio

    return system_of(system, t0, p0, v0)


def kkt_at(system, t, p, v):
    """(factors of K with A = M and c = 1, f₀) at a state."""
    at_rest = np.zeros(system.nv)
    f0, _, G, _ = (np.array(part) for part in system.evaluate(t, p, v, at_rest))
    M = np.empty((system.nv, system.nv))
    W = np.array(system.linearize(t, p, v, at_rest, np.zeros(system.nc), 0.0, M))
    return factorised(kkt_matrix(M, G, W), t), f0


def acceleration(system, t, p, v):
    """(v', λ) of the differential equation at a state, shapes (nv,) and (nc,)."""
    factors, f0 = kkt_at(system, t, p, v)
    return solved(factors, -f0, -system.acceleration_bias(t, p, v))


def velocity_shift(system, t, p, v, rho):
    """M⁻¹ G S⁻¹ ρ, shape (nv,): the smallest velocity, in the metric of M, that has the hidden residual ρ."""
    return solved(kkt_at(system, t, p, v)[0], np.zeros(system.nv), rho)[0]


def hidden_residual(system, t, p, v):
    """ρ = Φ_p U + Φ_t at a state, shape (nc,)."""
    return np.array(system.constraint(t, p, system.rate(t, p, v))[1])


def projected(system, t, p, v) -> State:
    """The state near (p, v) that satisfies the constraint and its derivative, with λ of the differential equation."""
    for _ in range(PROJECTIONS if system.nc else 0):
        phi = system.constraint(t, p, system.rate(t, p, v))[0]
        shift = velocity_shift(system, t, p, v, phi)
        p = system.integrate(p, system.rate(t, p, v - shift) - system.rate(t, p, v))
        if np.abs(phi).max() <= GAP_LEFT * (1.0 + np.abs(p).max()):
            break
    gap = np.abs(system.constraint(t, p, system.rate(t, p, v))[0]).max(initial=0.0)
    if gap > 1e-10 * (1.0 + np.abs(p).max()):
        raise AssemblyError(f"the position could not be projected onto the constraint: |Φ| = {gap:.3g} remains")
    for _ in range(2 if system.nc else 0):  # the second removes what remains if U is not linear in v
        v = v - velocity_shift(system, t, p, v, hidden_residual(system, t, p, v))
    return State(t, p, v, acceleration(system, t, p, v)[1])


def right_hand_side(system, base, accelerations):
    """f(t, [ξ | v]) of the index-1 equations in the chart at `base`, for scipy; ``accelerations(t, p, v)``: (v', λ)."""
    turning = np.zeros(0, int)
    if not system.vector_like:
        turning = np.flatnonzero(system.bracket(np.arange(1.0, 1.0 + system.nx)).any(axis=0))

    def f(t, y):
        xi = y[: system.nx]
        v = y[system.nx :]
        p = chart_point(system, base, xi)
        rate = np.array(system.rate(t, p, v))
        if len(turning):
            rate[turning] = chart_matrix(system, xi, turning) @ rate[turning]
        return np.concatenate((rate, accelerations(t, p, v)[0]))

    return f


def states_at(system, t0, p0, v0, times, rtol=1e-13, atol=1e-14) -> list[State]:
    """The states at `times`, monotone from `t0` on, by DOP853 on the index-1 equations, each projected."""
    now = State(t0, p0, v0, acceleration(system, t0, p0, v0)[1])
    states = []
    for target in times:
        while now.t != target:
            now = _advance(system, now, target, rtol, atol)
        states.append(now)
    return states


def _advance(system, now, target, rtol, atol) -> State:
    """The state at `target`, or as far towards it as one chart reaches."""
    if not system.vector_like:
        speed = np.abs(system.rate(now.t, now.p, now.v)).max(initial=0.0)
        parts = int(np.ceil(speed * abs(target - now.t) / MAX_CHART_STEP)) or 1
        target = target if parts == 1 else now.t + (target - now.t) / parts
    xi = now.p if system.vector_like else np.zeros(system.nx)
    f = right_hand_side(system, now.p, partial(acceleration, system))
    run = solve_ivp(
        f, (now.t, target), np.concatenate((xi, now.v)), method="DOP853", rtol=max(rtol, 2.3e-14), atol=atol
    )
    if run.status < 0:
        raise PinconsistError(f"the index-1 equations could not be integrated from t = {now.t:.6g}: {run.message}")
    y = run.y[:, -1]
    return projected(system, target, chart_point(system, now.p, y[: system.nx]), y[system.nx :])


def reference_solution(system, t0, p0, v0, times, *, rtol=1e-13, atol=1e-13) -> Reference:
    """Solve the index-1 equations by scipy's DOP853, with a projection at each of the times.

    The equations are those of :func:`pinconsist.simulate`; no step of its methods is used.

    Parameters
    ----------
    system : Mechanism or HessenbergProblem or Index3System
    t0 : float
        Start, s.
    p0, v0 : array
        Consistent initial values, for instance ``sol.q[0], sol.v[0]``.
    times : array
        Times of the rows, starting from `t0`, monotone.
    rtol, atol : float
        scipy's tolerances.

    Returns
    -------
    Reference
        With the multipliers of all rows of a mechanism, as ``sol.lam`` has them.

    Raises
    ------
    InputError
        Wrong sizes, NaN, or something that cannot be integrated.
    PinconsistError
        scipy's integrator fails, or redundant rows of the loops become inconsistent.
    """
    p0 = finite(p0, "p0")
    v0 = finite(v0, "v0")
    times = np.atleast_1d(finite(times, "times"))
    system = index3_system(system, t0, p0, v0)
    longest = abs(times[-1] - t0) / CHOICES if len(times) else 0.0
    rows = []
    t, p, v = t0, p0, v0
    for target in times:
        parts = 1
        if longest and not system.dropped_are_zero:  # other rows are used if those in use become a poor choice
            parts = max(1, int(np.ceil(abs(target - t) / longest)))
        for stop in np.linspace(t, target, parts + 1)[1:]:
            (state,) = states_at(system, t, p, v, [stop], rtol, atol)
            t, p, v = state.t, state.p, state.v
            opened = system.opened([t], [p])
            if opened:
                raise PinconsistError(f"no reference: the loops are open by {opened[1]:.1e} at t = {t:.6g}")
            lam = system.full_multipliers(p, state.lam)
            system = system.reselected(p) or system
        rows.append((t, p, v, lam))
    return Reference(*(np.array(column) for column in zip(*rows, strict=True)))


def finite(value, what) -> np.ndarray:
    """An array of finite real numbers, or InputError."""
    try:
        array = np.asarray(value, float)
    except (TypeError, ValueError):
        raise InputError(f"{what} must be numbers, got {value!r}") from None
    if not np.isfinite(array).all():
        raise InputError(f"{what} must be finite numbers, got {value!r}")
    return array.copy()
