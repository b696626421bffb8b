"""Numerically consistent values: the paper, its generalisation to any order, and the correction of every step.

Every BDF-k solution carries a hidden velocity residual

    ρ_n = W v_n + Φ_t = -hᵏ/(k+1) · Φ_p p⁽ᵏ⁺¹⁾ + O(hᵏ⁺¹)        (constant step)

while exact data has ρ = 0. At every change (the start, a new step size, a new order) the multiplier is wrong by
S⁻¹ Σ_i d_i ρ_{n-i} = O(hᵏ⁻¹), with S = W M⁻¹ G and d_i the derivative weights of the formula. There are three modes:

* ``"exact"``: take the values as they are and accept that;
* ``"initial"``: give the starting velocities the residual of the formula (Arévalo's numerically consistent values);
* ``"every-step"``: remove ρ from every solution, v -= M⁻¹ G S⁻¹ ρ, λ -= d₀ S⁻¹ ρ, by one more back-substitution with
  the factorised matrix of the step.
"""

from ..errors import InputError

MODES = ("exact", "initial", "every-step")


def check_mode(consistency: str, fixed_step: bool) -> None:
    """Raise InputError if a mode does not suit the step size control."""
    if consistency == "initial" and not fixed_step:
        raise InputError(
            "consistency='initial' is for a fixed step (give step=): every change of step size undoes it. "
            "Variable steps need consistency='every-step'"
        )


def consistent_velocities(index1, states, h, trial):
    """The numerically consistent velocities of a history of exact states (t, p, v, λ), oldest first.

    `trial` is (t, p, v) at the end of an uncorrected step of size h from there, whose residual is ρ₁. For one state,
    which is the paper's case, v₀ := v(0) - B₁ (v₁ - v(0)), B₁ = M₁⁻¹ G₁ S₁⁻¹ W₁; in the general form R_p (U₁ - U(0))
    takes the place of W₁ (v₁ - v(0)), which covers U_t as the paper has it, and U_p. (C. Arévalo, ETNA 34 (2008),
    sections 3 and 4.) For more states, each has the residual of the step: v_j += M_j⁻¹ G_j S_j⁻¹ ρ₁.
    """
    system = index1.system
    t1, p1, v1 = trial
    U1 = system.rate(t1, p1, v1)
    rho = system.constraint(t1, p1, U1)[1]
    if len(states) == 1:
        t0, p0, v0, _ = states[0]
        rho0 = system.constraint(t1, p1, system.rate(t0, p0, v0))[1]
        return [v0 - index1.velocity_shift(t1, p1, v1, rho - rho0)]
    return [v + index1.velocity_shift(t, p, v, rho) for t, p, v, _ in states]
