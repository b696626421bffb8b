"""Numerically consistent values: the paper, its generalisation to any order, and the correction of every step.

Every BDF-k solution carries a hidden residual

    ρ_n = W v_n + Φ_t = -hᵏ/(k+1) Φ_p p⁽ᵏ⁺¹⁾ + O(hᵏ⁺¹)

while exact data has ρ = 0. Where ρ jumps, at the start, the multiplier is wrong by S⁻¹ Σ_i d_i ρ_{n-i} = O(hᵏ⁻¹), with
S = W M⁻¹ G and d_i the weights of the derivative. There are three modes:

* ``exact``: take the values as they are, and accept that;
* ``initial``: give the starting velocities the residual of the formula (Arévalo's numerically consistent values);
* ``every-step``: remove ρ from every solution, v -= M⁻¹ G S⁻¹ ρ, λ -= d₀/h S⁻¹ ρ, by one more substitution with the
  factorised matrix of the step.

References
----------
C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), sections 3 and 4.
"""

from dataclasses import replace

import numpy as np

from ..errors import InputError
from .index1 import acceleration, finite, hidden_residual, index3_system, velocity_shift
from .step import State, bdf_step, solved

MODES = ("exact", "initial", "every-step")


def corrected(system, step: State) -> State:
    """The solution of a step without its hidden residual.

    The increments belong to the right-hand side (0, ρ):  K [δv; δλ] = [0; ρ], so that W δv = ρ and c δλ ≈ S⁻¹ ρ.
    """
    rho = hidden_residual(system, step.t, step.p, step.v)
    dv, dlam = solved(step.factors, np.zeros(system.nv), rho)
    return replace(step, v=step.v - dv, lam=step.lam - dlam)


def consistent_history(system, history, h: float, k: int) -> list[State]:
    """The history, newest first, with numerically consistent velocities: for k = 1 the paper's."""
    if k > 1:
        return general_history(system, history, h, k)
    start = history[0]
    return [replace(start, v=consistent_initial_velocity(system, start.t, start.p, start.v, h))]


def general_history(system, history, h: float, k: int) -> list[State]:
    """The history with the hidden residual of BDF-k, that of one trial step: v_j += M_j⁻¹ G_j S_j⁻¹ ρ_trial.

    For k = 1 this is the paper's value up to O(h²).
    """
    trial = bdf_step(system, history, h, k)
    rho = hidden_residual(system, trial.t, trial.p, trial.v)
    return [replace(each, v=each.v + velocity_shift(system, each.t, each.p, each.v, rho)) for each in history]


def consistent_initial_velocity(system, t0, p0, v0, step) -> np.ndarray:
    """The paper's numerically consistent initial velocity for implicit Euler with this step.

    One trial step gives p₁, v₁; then v₀ := v(0) - B₁ (v₁ - v(0)) with B₁ = M₁⁻¹ G₁ (W₁ M₁⁻¹ G₁)⁻¹ W₁, a change of
    O(step), after which the first multiplier is right to O(step) instead of O(1). In the general form R_p (U₁ - U(0))
    takes the place of W₁ (v₁ - v(0)); it contains the paper's U_t, and U_p.

    Parameters
    ----------
    system, t0 : Mechanism or HessenbergProblem or Index3System, float
        System, and start time, s.
    p0, v0 : array
        Exact (consistent) initial values.
    step : float
        The step that will be taken, s; negative backwards.

    Returns
    -------
    ndarray, shape (nv,)

    Raises
    ------
    InputError
        Wrong sizes, NaN, or something that cannot be integrated.
    PinconsistError
        The trial step fails, or the equations of motion are singular.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), sections 3 and 4.
    """
    p0 = finite(p0, "p0")
    v0 = finite(v0, "v0")
    if not (np.isfinite(step) and step):
        raise InputError(f"step must be a number of seconds other than zero, got {step!r}")
    system = index3_system(system, t0, p0, v0)
    trial = bdf_step(system, [State(t0, p0, v0, acceleration(system, t0, p0, v0)[1])], step, 1)
    U0 = system.rate(t0, p0, v0)
    U1 = system.rate(trial.t, trial.p, trial.v)
    residual0 = np.array(system.constraint(trial.t, trial.p, U0)[1])
    residual1 = np.array(system.constraint(trial.t, trial.p, U1)[1])
    return v0 - velocity_shift(system, trial.t, trial.p, trial.v, residual1 - residual0)
