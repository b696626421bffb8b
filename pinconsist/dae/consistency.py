"""Numerically consistent values: the paper, its generalisation to any order, and projections onto the constraints.

Every BDF-k solution carries a hidden velocity residual

    ρ_n = W v_n + Φ_t = -hᵏ/(k+1) · Φ_p p⁽ᵏ⁺¹⁾ + O(hᵏ⁺¹)        (constant step)

while exact data has ρ = 0. At every change (the start, a new step size, a new order) the multiplier is wrong by
S⁻¹ Σ_i d_i ρ_{n-i} = O(hᵏ⁻¹), with S = W M⁻¹ G and d_i the derivative weights of the formula. There are three ways:

* ``exact``: take the values as they are and accept that;
* ``initial``: give the starting velocities the residual of the formula (Arévalo's numerically consistent values);
* ``every-step``: take ρ out of every solution, v -= M⁻¹ G S⁻¹ ρ, λ -= d₀ S⁻¹ ρ, by one more back-substitution
  (done in :mod:`pinconsist.dae.newton`, where the factorised matrix is).
"""

from __future__ import annotations

import numpy as np

from ..errors import AssemblyError, SingularSystemError
from . import bdf
from .acceleration import singular
from .newton import KKT, Newton
from .sizes import EPS, largest

MODES = ("exact", "initial", "every-step")
GAP = 1e-13  # gap of closed loops, relative to positions and W


def kkt_at(system, t, p, v) -> KKT:
    """[[M, -G], [W, 0]], factorised, at a state."""
    zero_v, zero_c = np.zeros(system.nv), np.zeros(system.nc)
    _, _, G, _ = system.evaluate(t, p, v, zero_v)
    kkt = KKT(system.nv, system.nc)
    W = system.linearize(t, p, v, zero_v, zero_c, 0.0, kkt.A)
    if kkt.solve_new(G, W, 1.0, np.zeros(system.nv + system.nc)) is None:
        raise SingularSystemError(singular(t))
    return kkt


def rounding_gap(p, W) -> float:
    """The gap that rounding leaves in closed loops, from the position and from W or G."""
    return GAP * (1.0 + largest(p)) * (1.0 + largest(W))


def not_closed(gap) -> str:
    """What a message says of a position that stays off the constraint."""
    return f"the position could not be put on the constraint: |Φ| = {gap:.3g} remains"


def velocity_shift(system, t, p, v, rho):
    """M⁻¹ G S⁻¹ ρ, shape (nv,): the smallest velocity, in the mass metric, that carries the residual ρ."""
    return kkt_at(system, t, p, v).solve(np.concatenate((np.zeros(system.nv), rho)), 1.0)[: system.nv]


def project_velocity(system, t, p, v):
    """`v` put on the hidden constraint W v + Φ_t = 0 in the mass metric, shape (nv,)."""
    if not system.nc:
        return v
    for _ in range(2):  # the second turn takes out what is left where U is not linear in v
        v = v - velocity_shift(system, t, p, v, system.constraint(t, p, system.rate(t, p, v))[1])
    return v


def project_position(system, t, p, v):
    """`p`, near the manifold, put on Φ(t, p) = 0 in the mass metric.

    Raises
    ------
    AssemblyError
        Φ does not fall to rounding within 20 iterations.
    """
    if not system.nc:
        return p
    last = np.inf
    for _ in range(20):
        _, phi, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
        size = largest(phi)
        if size <= EPS or (size <= rounding_gap(p, G) and size >= 0.5 * last):
            return p
        step = velocity_shift(system, t, p, v, phi)
        small = 1e-4 * (1.0 + largest(v)) / largest(step)  # not so small that v rounds it away
        move = (system.rate(t, p, v) - system.rate(t, p, v - small * step)) / small
        p, last = system.integrate(p, -move), size
    raise AssemblyError(not_closed(last))


def consistent_initial_velocity(system, t0, p0, v0, h):
    """The paper's numerically consistent initial velocity for implicit Euler.

    One trial step gives p₁, v₁; then v₀ := v(0) - B₁ (v₁ - v(0)), B₁ = M₁⁻¹ G₁ S₁⁻¹ W₁, which equals
    v(0) - h M₁⁻¹ G₁ δλ with δλ = S₁⁻¹ W₁ (f₁ + G₁ λ₁). In the general form R_p (U₁ - U(0)) takes the place of
    W₁ (v₁ - v(0)), which covers U_t as the paper has it, and U_p.

    Parameters
    ----------
    system : Index3System
    t0 : float
        Start, s.
    p0, v0 : ndarray
        Exact (consistent) values.
    h : float
        The step that will be taken, s.

    Returns
    -------
    ndarray, shape (nv,)
        The changed velocity: O(h) away from `v0`.

    References
    ----------
    C. Arévalo, ETNA 34 (2008), sections 3 and 4.
    """
    k = 1
    Z = np.zeros((k + 3, system.nx + system.nv + system.nc))
    Z[0] = bdf.table_row(system, p0, p0, v0, np.zeros(system.nc))
    step = trial_step(system, t0, h, k, p0, Z)
    v1 = step.y[system.nx : system.nx + system.nv]
    t1, p1 = t0 + h, step.p
    U0, U1 = system.rate(t0, p0, v0), system.rate(t1, p1, v1)
    change = system.constraint(t1, p1, U1)[1] - system.constraint(t1, p1, U0)[1]
    return v0 - velocity_shift(system, t1, p1, v1, change)


def trial_step(system, t, h, k, base, Z):
    """One uncorrected BDF-k step from a table, to rounding; raises where Newton fails."""
    newton = Newton(system, correct=False)
    step = bdf.formula_step(newton, t, h, k, base, Z)[0]
    if step.failure:
        raise SingularSystemError(f"the trial step from t = {t:.6g} with h = {h:.3g} failed: {step.failure}")
    return step


def consistent_history(system, h, k, base, Z, states):
    """Give a history of exact states the hidden residual of BDF-k: v_j += M_j⁻¹ G_j S_j⁻¹ ρ_trial.

    `states` are (t, p, v, λ), oldest first; returns the changed velocities. For k = 1 this is the paper's value up to
    O(h²).
    """
    newest = states[-1]
    trial = trial_step(system, newest[0], h, k, base, Z.copy())
    t1 = newest[0] + h
    v1 = trial.y[system.nx : system.nx + system.nv]
    rho = system.constraint(t1, trial.p, system.rate(t1, trial.p, v1))[1]
    return [v + velocity_shift(system, t, p, v, rho) for t, p, v, _ in states]


def velocity_rounding(system, t, p, v) -> float:
    """Velocity that eps in v and in Φ brings about: positions move by eps/σ, W turns with them, v by eps/σ² |v|.

    0 where loops gape: more than rounding is wrong there.
    """
    nv, nc = system.nv, system.nc
    size, reach = EPS * largest(v), 1.0 + largest(p)
    if not nc:
        return size
    _, phi, G, _ = system.evaluate(t, p, v, np.zeros(nv))
    if largest(phi) > rounding_gap(p, G):
        return 0.0
    try:
        kkt = kkt_at(system, t, p, v)
    except SingularSystemError:
        return np.inf
    inverse = kkt.solve(np.vstack((np.zeros((nv, nc)), np.eye(nc))), 1.0)[:nv]
    s, turn = (np.abs(matrix).sum(axis=1).max() for matrix in (inverse, kkt.W))
    return size * (1.0 + reach * s**2 * turn)
