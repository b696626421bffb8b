"""First variations of a mechanism's equations at a state, for statics and linearisation.

A variation δq is in the tangent space of the configurations, like a velocity. The variations that the loops allow are
δq = Z y, where the y are the variations of a few joints themselves: Z has a unit row for each of them.

Derivatives by parameters: let F(x, θ) = 0 be the equations that were solved (loops, balance of forces, rates of the
loops). At their solution, F_x dx + F_θ = 0 is solved without iteration; F_θ is computed by differences at the fixed
state.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin
from scipy.linalg import qr, solve_triangular

from ..errors import InputError, SingularSystemError
from ..mechanism.axes import SMOOTH, rnea_derivatives
from ..mechanism.checks import finite_array
from ..mechanism.closing import check_closing, newton
from ..mechanism.motion import AHEAD, difference_step, first
from ..mechanism.parameters import parameter
from ..mechanism.rank import independent_rows
from ..mechanism.system import MechanismSystem

NEUTRAL = 1e-10  # relative to the stiffness: smaller values cannot be distinguished from zero
NARROW = 1e-4  # step of differences of forces, which may vary over short distances: errors near 1e-11
MOTOR_WEIGHT = 10.0  # preference for motorised joints as coordinates
EQUAL = 1e-6  # joints whose shares in the free motions differ by less are equally good coordinates


class TangentSpace:
    """The variations that the loops allow at a configuration.

    J (nc, nv) has all rows of the loops, and `kept` are the indices of independent ones. The columns of Z (nv, n) are a
    basis of its null space, with unit rows at the `coordinates`, the entries of δq that are the y. P (nv, nc) is a
    right inverse of J that does not change the coordinates: J P r = r in the range of J, P[coordinates] = 0.
    """

    def __init__(self, system, q, t: float = 0.0):
        self.J = system.loop_rows(q, t)[1]
        kept = self.kept = independent_rows(self.J, system.rows.turns)
        nv, rank = system.nv, len(kept)
        Q, R = qr(self.J[kept].T) if rank else (np.eye(nv), np.zeros((nv, 0)))
        free, P = Q[:, rank:], np.zeros((nv, len(self.J)))
        P[:, kept] = Q[:, :rank] @ solve_triangular(R[:rank], np.eye(rank), trans="T")
        self.coordinates = _coordinates(system.mechanism, free)
        self.Z = np.linalg.solve(free[self.coordinates].T, free.T).T
        self.Z[self.coordinates] = np.eye(nv - rank)
        self.P = P - self.Z @ P[self.coordinates]

    def multipliers(self, load) -> np.ndarray:
        """λ of smallest norm, shape (nc,), for which Jᵀλ is the part of `load` (nv,) that the loops can carry."""
        rank = len(self.J.T) - self.Z.shape[1]
        U, s, Vt = np.linalg.svd(self.J, full_matrices=False)
        return U[:, :rank] @ (Vt[:rank] @ load / s[:rank])


def _coordinates(mechanism, free):
    """The joint velocities that describe the free ones best, motorised ones first."""
    if not free.size:
        return np.zeros(0, dtype=int)
    weights = np.linspace(1.0, 1.0 - EQUAL, len(free))  # prefers the first of equal ones, independent of rounding
    for joint in mechanism.actuated:
        weights[mechanism.columns(joint)] = MOTOR_WEIGHT
    pivots = qr(free.T * weights, mode="r", pivoting=True)[1]
    return np.sort(pivots[: free.shape[1]])


class Locked:
    """Base of results with read-only arrays."""

    def __post_init__(self):
        for value in vars(self).values():
            for array in value.values() if isinstance(value, dict) else (value,):
                if isinstance(array, np.ndarray):
                    array.setflags(write=False)


def step_sizes(system, q) -> np.ndarray:
    """The change of each coordinate that counts as one radian, shape (nv,): 1 for rotations, else the model's size."""
    model, loops = system.model, system.mechanism.anchored_loops
    arms = [place.translation for place in model.jointPlacements] + [inertia.lever for inertia in model.inertias]
    arms += [place.translation for loop in loops for place in (loop.placement1, loop.placement2)]
    length = max(float(np.linalg.norm(arm)) for arm in arms) or 1.0
    columns = pin.computeJointJacobians(model, model.createData(), q).reshape(6, -1)
    return np.where(np.linalg.norm(columns[3:], axis=0) > 1e-9, 1.0, length)


def along(function, directions, steps=SMOOTH) -> np.ndarray:
    """d function(ε z)/dε at ε = 0 for each column z of `directions`, as columns; `steps` (nv,) are difference steps."""
    columns = [first(lambda s, z=z: function(s * z), 1.0 / np.max(np.abs(z) / steps)) for z in directions.T]
    return np.column_stack(columns) if columns else np.zeros((len(function(np.zeros(len(directions)))), 0))


def along_places(function, system, q, Z, step=SMOOTH) -> np.ndarray:
    """d function(q ⊕ Z y)/dy at y = 0; `step` is the difference step in units of :func:`step_sizes`."""
    return along(lambda dq: function(system.integrate(q, dq)), Z, step * step_sizes(system, q))


def by_position(system, t, q, v, a, lam, Z) -> np.ndarray:
    """∂(M a + nle - τ - Jᵀλ)/∂q Z at constant λ, shape (nv, n): stiffness, including the geometric one of Jᵀλ."""
    model, data = system.model, system.model.createData()
    carried = rnea_derivatives(model, data, q, v, a)[0] @ Z
    loads = along_places(lambda x: system.loop_rows(x, t)[1].T @ lam, system, q, Z)
    return carried - along_places(lambda x: system.torque(t, x, v), system, q, Z, NARROW) - loads


def by_velocity(system, t, q, v, a) -> np.ndarray:
    """∂(M a + nle - τ)/∂v, shape (nv, nv): gyroscopic and damping terms."""
    model, data = system.model, system.model.createData()
    widths, every = step_sizes(system, q) + np.abs(v), np.eye(system.nv)
    forces = along(lambda dv: system.torque(t, q, v + dv), every, NARROW * widths)
    return rnea_derivatives(model, data, q, v, a)[1] - forces


def rates_of_loops(system, t, q, v, a, Z):
    """∂(J v + Φ_t)/∂q Z and ∂(J a + γ)/∂q Z, each (nc, n), and ∂γ/∂v, (nc, nv): terms from the curvature of loops."""

    def rates(x):
        J = system.loop_rows(x, t)[1]
        return np.concatenate((J @ v + system.rows.time_rate(t, x), J @ a + system.rows.acceleration_bias(t, x, v)))

    widths = np.maximum(np.abs(v), step_sizes(system, q))  # γ is quadratic in v: exact for any step
    by_v = along(lambda dv: system.rows.acceleration_bias(t, q, v + dv), np.eye(system.nv), widths)
    return *np.split(along_places(rates, system, q, Z), 2), by_v


def closed_near(system, t, q):
    """The closed configuration that Newton's method reaches from a nearby `q`; None if it does not converge."""
    rows = partial(system.loop_rows, t=t)
    return newton(rows, system.model, system.rows.turns, q, step_sizes(system, q))


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives with respect to parameters, which are the last index.

    Attributes
    ----------
    names : tuple of str
        Names of the parameters.
    values : dict[str, ndarray]
        Derivatives by the name of the quantity in the result: ``q`` as tangent vectors, ``lam``, ``torques.NAME``, …
    """

    names: tuple[str, ...]
    values: dict[str, np.ndarray]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.values[name]


class Varied:
    """A mechanism and its parameters: their names, or ``build(theta)`` and theta."""

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
    """(dq, dv, da, dλ) by each parameter at a state that the loops determine, with the balance of forces if `still`."""
    system = MechanismSystem(varied.mechanism, q, t)
    space, nv, every = TangentSpace(system, q, t), system.nv, np.eye(system.nv)

    def residuals(system):
        phi, J = system.loop_rows(q, t)
        r = pin.rnea(system.model, system.data, q, v, a) - system.torque(t, q, v) - J.T @ lam
        return r, phi, J @ v + system.rows.time_rate(t, q), J @ a + system.rows.acceleration_bias(t, q, v)

    def beside(mechanism, _):
        return np.concatenate(residuals(MechanismSystem(mechanism, q, t, like=system)))

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
                f"{varied.mechanism.name}: nothing resists some motion at this equilibrium, so that the equilibrium "
                "has no derivative. Add a spring, or lock the joint"
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
    """The change of λ with the range of J, which contains the λ of smallest norm: (1 - Π) dJ J⁺ λ."""
    J, z = space.J, np.linalg.lstsq(space.J, lam, rcond=1e-10)[0]

    def turned(mechanism, _):
        return MechanismSystem(mechanism, q, t, like=system).loop_rows(q, t)[1] @ z

    change = along_places(lambda x: system.loop_rows(x, t)[1] @ z, system, q, np.eye(system.nv)) @ dq
    change = change + np.column_stack([varied.rate(i, turned) for i in range(len(varied.names))])
    return change - J @ np.linalg.lstsq(J, change, rcond=1e-10)[0]
