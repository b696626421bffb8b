"""Numerically consistent values: the paper, its generalisation to any order, and the correction of every step.

Every BDF-k solution carries a hidden velocity residual

    ρ_n = W v_n + Φ_t = -hᵏ/(k+1) · Φ_p p⁽ᵏ⁺¹⁾ + O(hᵏ⁺¹)        (constant step)

while exact data has ρ = 0. At every change (the start, a new step size, a new order) the multiplier is wrong by
S⁻¹ Σ_i d_i ρ_{n-i} = O(hᵏ⁻¹), with S = W M⁻¹ G and d_i the derivative weights of the formula. There are three modes:

* :class:`Exact`: take the values as they are and accept that;
* :class:`Initial`: give the starting velocities the residual of the formula (Arévalo's numerically consistent values);
* :class:`EveryStep`: remove ρ from every solution, v -= M⁻¹ G S⁻¹ ρ, λ -= d₀ S⁻¹ ρ, by one more back-substitution with
  the factorised matrix of the step.
"""

import numpy as np

from ..errors import InputError, SingularSystemError
from . import bdf
from .charts import table_row
from .index1 import velocity_shift
from .kkt import columns
from .newton import Newton
from .norms import largest
from .rounding import rounding_weights
from .tuning import CLOSED, CLOSINGS


class Exact:
    """Raw BDF from exact values: the first multipliers, and those after each change of step or order, are wrong."""

    name = "exact"

    def check(self, fixed_step: bool) -> None:
        """Raise InputError if the mode does not suit the step size control."""

    def start(self, system, h, k, base, Z, states) -> None:
        """Change the table Z of the starting `states` (t, p, v, λ), oldest first, in place."""

    def correct(self, system, step) -> None:
        """Change the solution of a step, an :class:`~pinconsist.dae.newton.Attempt`, in place."""


class Initial(Exact):
    """The paper's method: only the starting velocities are made numerically consistent."""

    name = "initial"

    def check(self, fixed_step):
        if not fixed_step:
            raise InputError(
                "consistency='initial' is for a fixed step (give step=): every change of step size undoes it. "
                "Variable steps need consistency='every-step'"
            )

    def start(self, system, h, k, base, Z, states):
        velocities = np.array(consistent_velocities(system, h, k, base, Z, states)[::-1])
        Z[: len(states), system.nx : system.nx + system.nv] = bdf.differences(len(states) - 1) @ velocities


class EveryStep(Exact):
    """Loops are closed and ρ is removed after every step: multipliers have full order throughout."""

    name = "every-step"

    def correct(self, system, step):
        """Φ corrects the position, ρ velocity and multipliers; the dynamics are not evaluated again.

        Repeated while a gap above rounding remains, as the matrix is that of the prediction.
        """
        nv, raw = system.nv, step.v
        for _ in range(CLOSINGS):
            phi, rho = system.constraint(step.t, step.p, system.rate(step.t, step.p, step.v))
            closing, hidden = step.kkt.solve(columns(nv, system.nc, (0.0, phi), (0.0, rho))).T
            raw = raw - closing[:nv] / step.c
            step.p, step.xi = system.position(step.t, step.base, step.psi_x, step.c, raw)
            step.v, step.lam = step.v - hidden[:nv], step.lam - hidden[nv:]
            if largest(phi) * step.rate <= CLOSED * (1.0 + largest(step.p)):
                break


MODES = {mode.name: mode for mode in (Exact(), Initial(), EveryStep())}


def consistent_velocities(system, h, k, base, Z, states):
    """The numerically consistent velocities of a history: the paper's for k = 1, its generalisation otherwise."""
    if k == 1:
        t0, p0, v0, _ = states[0]
        return [consistent_initial_velocity(system, t0, p0, v0, h)]
    return consistent_history(system, h, k, base, Z, states)


def consistent_initial_velocity(system, t0, p0, v0, h):
    """The paper's numerically consistent initial velocity for implicit Euler.

    One trial step gives p₁, v₁; then v₀ := v(0) - B₁ (v₁ - v(0)), B₁ = M₁⁻¹ G₁ S₁⁻¹ W₁, which equals
    v(0) - h M₁⁻¹ G₁ δλ with δλ = S₁⁻¹ W₁ (f₁ + G₁ λ₁). In the general form R_p (U₁ - U(0)) takes the place of
    W₁ (v₁ - v(0)), which covers U_t as the paper has it, and U_p. (C. Arévalo, ETNA 34 (2008), sections 3 and 4.)
    """
    k = 1
    Z = np.zeros((k + 3, system.nx + system.nv + system.nc))
    Z[0] = table_row(system, p0, p0, v0, np.zeros(system.nc))
    step = trial_step(system, t0, h, k, p0, Z)
    U0, U1 = system.rate(t0, p0, v0), system.rate(step.t, step.p, step.v)
    change = system.constraint(step.t, step.p, U1)[1] - system.constraint(step.t, step.p, U0)[1]
    return v0 - velocity_shift(system, step.t, step.p, step.v, change)


def trial_step(system, t, h, k, base, Z):
    """One uncorrected BDF-k step from a table, iterated to rounding; raises SingularSystemError if Newton fails."""
    base, predicted, psi = bdf.predict(system, k, base, Z)
    weights = rounding_weights(system, predicted)
    step = Newton().attempt(system, t + h, base, psi, predicted, h / bdf.alpha(k), *weights)
    if step.failure:
        raise SingularSystemError(f"the trial step from t = {t:.6g} with h = {h:.3g} failed: {step.failure}")
    return step


def consistent_history(system, h, k, base, Z, states):
    """Give a history of exact states the hidden residual of BDF-k: v_j += M_j⁻¹ G_j S_j⁻¹ ρ_trial.

    `states` are (t, p, v, λ), oldest first; returns the changed velocities. For k = 1 this is the paper's value up to
    O(h²).
    """
    step = trial_step(system, states[-1][0], h, k, base, Z.copy())
    rho = system.constraint(step.t, step.p, system.rate(step.t, step.p, step.v))[1]
    return [v + velocity_shift(system, t, p, v, rho) for t, p, v, _ in states]
