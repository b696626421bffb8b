"""Derivatives of statics, of driven motions and of small motions with respect to parameters of the mechanism.

The equations that were solved are F(x, θ) = 0: loops, balance, rates of the loops. F_x dx + F_θ = 0 is solved at their
solution, without iteration; F_θ comes from differences at the fixed state.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ..errors import InputError, SingularSystemError
from ..mechanism.checks import finite_array
from ..mechanism.motion import AHEAD, first
from ..mechanism.parameters import check_closing, difference_step, parameter
from ..mechanism.system import MechanismSystem
from .variations import TangentSpace, along_places, bias, by_position, by_velocity, rates_of_loops

NEUTRAL = 1e-10  # of the stiffness: what cannot be distinguished from zero


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives with respect to parameters, which are the last index.

    Attributes
    ----------
    names : tuple of str
        Of the parameters.
    values : dict[str, ndarray]
        Of what, by the name that it has in the result: ``q`` as tangent vectors, ``lam``, ``torques.NAME``, …
    """

    names: tuple[str, ...]
    values: dict[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]


class Varied:
    """A mechanism and its parameters: names of them, or ``build(theta)`` and theta."""

    def __init__(self, mechanism, parameters, theta=None):
        self.mechanism = mechanism
        if callable(parameters):
            self._build: Callable | None = parameters
            self.theta = np.atleast_1d(finite_array(theta, "theta"))
            self.names = tuple(f"theta[{i}]" for i in range(len(self.theta)))
            return
        if isinstance(parameters, str) or not all(isinstance(name, str) for name in parameters):
            raise InputError(f"derivatives needs names of parameters, or build and theta, got {parameters!r}")
        self._build, self.names = None, tuple(parameters)
        self._parameters = [parameter(mechanism, name) for name in self.names]
        self.theta = np.array([each.value for each in self._parameters])

    def rate(self, i, function):
        """The derivative of ``function(mechanism, change of the parameter)`` with respect to a parameter."""
        step = difference_step(self.theta[i])

        def at(change):
            value = self.theta[i] + change
            if self._build is None:
                return function(self._parameters[i].put(self.mechanism, value), change)
            return function(self._build(np.where(np.arange(len(self.theta)) == i, value, self.theta)), change)

        try:
            return first(at, step)
        except InputError:  # at a bound
            return sum(weight * at(m * step) for m, weight in AHEAD.items()) / step


def of_state(varied, t, q, v, a, lam, still=True):
    """(dq, dv, da, dλ) by each parameter at a state that loops determine, and balance where it is `still`."""
    system = MechanismSystem(varied.mechanism, q, t)
    space, nv, every = TangentSpace(system, q, t), system.nv, np.eye(system.nv)

    def residuals(system):
        phi, J = system.loop_rows(q, t)
        r = pin.rnea(system.model, system.data, q, v, a) - system.torque(t, q, v) - J.T @ lam
        return r, phi, J @ v + system.rows.time_rate(t, q), J @ a + bias(system, t, q, v)

    def beside(mechanism, _):
        return np.concatenate(residuals(MechanismSystem(mechanism, q, t, kept=system.kept)))

    rates = np.array([varied.rate(i, beside) for i in range(len(varied.names))])
    r, phi, rho, gamma = np.split(rates.T, np.cumsum([nv, system.rows.nc, system.rows.nc]))
    K = by_position(system, t, q, v, a, lam, every)
    dq = -space.P @ phi
    for columns in zip(varied.names, (space.J @ dq + phi).T, phi.T, strict=True):
        check_closing(*columns)
    if still and space.Z.size:
        stiffness = space.Z.T @ K @ space.Z
        sizes = np.linalg.svd(stiffness, compute_uv=False)
        if sizes[-1] <= NEUTRAL * max(sizes[0], np.abs(K).max()):
            raise SingularSystemError(
                f"{varied.mechanism.name}: nothing resists some motion at this equilibrium, so that it has no "
                "derivative. Add a spring, or lock the joint"
            )
        dq = dq - space.Z @ np.linalg.solve(stiffness, space.Z.T @ (K @ dq + r))

    dv = da = np.zeros_like(dq)
    if not still:
        hidden, closing, by_v = rates_of_loops(system, t, q, v, a, every)
        dv = -space.P @ (rho + hidden @ dq)
        da = -space.P @ (gamma + closing @ dq + by_v @ dv)
    load = K @ dq + by_velocity(system, t, q, v, a) @ dv + system.mass_matrix(q) @ da + r
    dlam = np.column_stack([space.multipliers(column) for column in load.T])
    if len(space.kept) < system.rows.nc:
        dlam = dlam + _of_redundant(varied, system, space, t, q, lam, dq)
    return dq, dv, da, dlam


def _of_redundant(varied, system, space, t, q, lam, dq):
    """What turns the range of J, in which λ of smallest norm is: (1 - Π) dJ J⁺ λ."""
    J, z = space.J, np.linalg.lstsq(space.J, lam, rcond=1e-10)[0]

    def turned(mechanism, _):
        return MechanismSystem(mechanism, q, t, kept=system.kept).loop_rows(q, t)[1] @ z

    change = along_places(lambda x: system.loop_rows(x, t)[1] @ z, system, q, np.eye(system.nv)) @ dq
    change = change + np.column_stack([varied.rate(i, turned) for i in range(len(varied.names))])
    return change - J @ np.linalg.lstsq(J, change, rcond=1e-10)[0]
