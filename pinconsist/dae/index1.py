"""The equations of index 1: accelerations, and projections onto the constraints.

Starts and events use them. :class:`Index1` collects what a run needs; the compiled one has the same interface.
"""

import numpy as np

from ..errors import AssemblyError, PinconsistError
from .failure import culprits
from .kkt import kkt_at
from .norms import EPS, largest
from .rounding import rounding_gap


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
