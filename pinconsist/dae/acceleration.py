"""The index-1 equations: acceleration and multipliers of the differential equation itself at a state."""

from __future__ import annotations

import numpy as np

from ..errors import PinconsistError, SingularSystemError
from .newton import KKT, culprits


def singular(t) -> str:
    """What a message says of a singular position."""
    return f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])"


def not_finite(system, t, p, v) -> str:
    """What a message says of accelerations that are not finite; it names the forces that are not."""
    whose = culprits(system, t, p, v)
    return (
        f"the equations of motion are not finite at t = {t:.6g}{whose}: a force or a user's function returns NaN or "
        "infinity"
    )


class NotFiniteError(PinconsistError):
    """The equations of motion have a number that is not finite."""


def solve_acceleration(system, t, p, v):
    """The index-1 equations: acceleration and multiplier of the differential equation itself at a state.

    Solves [[M, -G], [W, 0]] [a; λ] = [-f₀; -γ]; M alone may be singular (massless links).

    Returns
    -------
    a : ndarray, shape (nv,)
    lam : ndarray, shape (nc,)
    """
    if (twin := getattr(system, "twin", None)) is not None:
        solution = twin.acceleration(t, p, v)
        if solution is None:
            raise SingularSystemError(singular(t))
        a, lam, finite = solution
        if not finite:
            raise NotFiniteError(not_finite(system, t, p, v))
        return a, lam
    f0, _, G, _ = system.evaluate(t, p, v, np.zeros(system.nv))
    kkt = KKT(system.nv, system.nc)
    W = system.linearize(t, p, v, np.zeros(system.nv), np.zeros(system.nc), 0.0, kkt.A)
    rhs = -np.concatenate((f0, system.acceleration_bias(t, p, v)))
    if not np.isfinite(rhs).all():
        raise NotFiniteError(not_finite(system, t, p, v))
    x = kkt.solve_new(G, W, 1.0, rhs)
    if x is None:
        raise SingularSystemError(singular(t))
    return x[: system.nv], x[system.nv :]
