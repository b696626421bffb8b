"""Discrete-time linearisation of Radau IIA steps with respect to the state at their start and the held inputs.

The derivatives are those of the accepted steps, propagated by the same C++ code as those of runs; inputs are torques
and commands that are constant over the steps, so that their effect on the equations is known.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from ..engine.index1 import Index1
from ..errors import InputError, PinconsistError
from ..mechanism.checks import frame_of
from ..mechanism.forces import Actuator
from ..mechanism.forces.actuators import BoundHeldActuator
from ..mechanism.forces.held import BoundSampled
from ..mechanism.names import velocity_names
from ..mechanism.rank import null_space
from .known import Pull, unit_torque
from .propagator import Propagator

CLEARLY, ROUNDING = 0.1, 1e-9  # of unit motions: least speed of a coordinate that others do not determine
SLANTED = 1e4  # mean condition of the other coordinates beyond which coordinates are chosen anew
APART = 1e-4  # of a unit change of the state: differences of the multipliers of redundant rows
COMMAND_STEP = 1e-3  # relative step of differences by a command, in which actuators are linear between their limits


@dataclass(frozen=True, eq=False, repr=False)
class StepLinearization:
    """The linearisation of a step with respect to the state before it and the held inputs: δx₁ = A δx₀ + B δu.

    x = (ξ, v): tangent coordinates of the configuration, and velocities, 2 nv numbers. Initial states that violate the
    constraints are projected onto them by the step: A includes the derivative of the projection. ``A, B =
    linearization``.

    Attributes
    ----------
    inputs : tuple of str
        The m inputs: actuators (their commands) and velocities, ``crank`` or ``ball[0]`` (their torques).
    t, q, v : float, ndarray, ndarray
        The state after the step.
    """

    inputs: tuple[str, ...]
    t: float
    q: np.ndarray
    v: np.ndarray
    _made_by: Any = field(repr=False, default=None)
    _start: tuple = field(repr=False, default=())
    _steps: tuple = field(repr=False, default=())

    @cached_property
    def _whole(self):
        return self._made_by.through(self._steps, np.eye(2 * self._system.nv))

    @property
    def A(self) -> np.ndarray:
        """∂x₁/∂x₀, (2 nv, 2 nv)."""
        return self._whole[0]

    @property
    def B(self) -> np.ndarray:
        """∂x₁/∂u, (2 nv, m)."""
        return self._whole[1]

    def __iter__(self):
        yield self.A
        yield self.B

    def __repr__(self):
        return f"StepLinearization to t = {self.t:.6g}: {2 * self._system.nv} states, inputs {', '.join(self.inputs)}"

    @property
    def _system(self):
        return self._made_by.system

    @cached_property
    def _of_multipliers(self) -> np.ndarray:
        return self._made_by.multipliers(self.t, self.q, self.v, np.hstack((self.A, self.B)).T.copy()).T

    @property
    def lam_x(self) -> np.ndarray:
        """∂λ₁/∂x₀, (nc, 2 nv), for the multipliers after the step."""
        return self._of_multipliers[:, : len(self.A)]

    @property
    def lam_u(self) -> np.ndarray:
        """∂λ₁/∂u, (nc, m), for the multipliers after the step."""
        return self._of_multipliers[:, len(self.A) :]

    @cached_property
    def _basis(self):
        """Indices of the coordinates, and all states by those of the coordinates at the start, (2 nv, 2 d)."""
        return self._made_by.basis(*self._start)

    @property
    def _columns(self) -> np.ndarray:
        return self._basis[0]

    @property
    def _extended(self) -> np.ndarray:
        return self._basis[1]

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """Independent velocities, one for each degree of freedom; those of motors come first."""
        names = velocity_names(self._system.model)
        return tuple(names[column] for column in self._columns)

    @property
    def _rows(self) -> np.ndarray:
        return np.concatenate((self._columns, self._system.nv + self._columns))

    @cached_property
    def _small(self):
        if "_whole" in vars(self):
            return self.A @ self._extended, self.B
        return self._made_by.through(self._steps, self._extended)

    @property
    def A_reduced(self) -> np.ndarray:
        """∂y₁/∂y₀ for the independent coordinates and their velocities, (2 d, 2 d); faster than :attr:`A`."""
        return self._small[0][self._rows]

    @property
    def B_reduced(self) -> np.ndarray:
        """∂y₁/∂u for the independent coordinates and their velocities, (2 d, m)."""
        return self._small[1][self._rows]

    def frame(self, frame: str) -> tuple[np.ndarray, np.ndarray]:
        """The derivatives of the pose of a `frame` after the step with respect to x₀ and u, (6, 2 nv) and (6, m).

        The rows are displacement, m, and rotation, rad, in world axes. Raises InputError for an unknown frame.
        """
        system, nv = self._system, self._system.nv
        model, data = system.model, system.model.createData()
        name = frame_of(model, frame, system.mechanism.name).name
        J = pin.computeFrameJacobian(model, data, self.q, model.getFrameId(name), pin.LOCAL_WORLD_ALIGNED)
        return J @ self.A[:nv], J @ self.B[:nv]


def _independent(Z, order) -> np.ndarray:
    """The first d columns in an order whose velocities determine motions Z (nv, d); clearly independent ones first."""
    found, left = [], Z.copy()
    for least in (CLEARLY, 0.0):
        for column in order:
            row = left[column]
            if len(found) < Z.shape[1] and column not in found and row @ row > max(least, ROUNDING) ** 2:
                left = left - np.outer(left @ row, row) / (row @ row)
                found.append(column)
    return np.sort(np.array(found, int))


def _inverse(B):
    try:
        return np.linalg.inv(B)
    except np.linalg.LinAlgError:
        return None


class Inputs:
    """Torques and commands that are held, as the parameters of a Propagator, after columns for the states."""

    beside: ClassVar[dict] = {}

    def __init__(self, system, names=None, t=0.0, states=0):
        model, mechanism = system.model, system.mechanism
        actuators = {force.name: force for force in mechanism.forces if isinstance(force, Actuator)}
        self.names = _checked(mechanism, actuators, names)
        self.workspace = model, model.createData()
        self._states, places = states, {name: i for i, name in enumerate(velocity_names(model))}
        self.known = []
        for k, name in enumerate(self.names):
            if name in actuators:
                parts = _by_command(actuators[name], system, t)
            else:
                parts = [(1.0, unit_torque(model.nv, places[name]))]
            self.known.append((self._states + k, parts))

    def __len__(self):
        return self._states + len(self.names)


def _checked(mechanism, actuators, names) -> tuple[str, ...]:
    """The names of the inputs: actuators, and velocities; a joint is all of its velocities."""
    velocities = velocity_names(mechanism.model)
    if names is None:
        own = [joint for joint in mechanism.actuated if not any(joint in each.arms for each in actuators.values())]
        names = [*actuators, *own] or velocities
    found = []
    for name in [names] if isinstance(names, str) else names:
        if name in actuators or name in velocities:
            found.append(name)
        elif name in mechanism.joints:
            found += velocities[mechanism.columns(name)]
        else:
            known = ", ".join([*actuators, *mechanism.joints])
            raise InputError(f"inputs: no actuator or joint {name!r}; they are {known}")
    return tuple(dict.fromkeys(found))


def _by_command(actuator, system, t):
    """The derivative of an actuator's force by its command, which may be at a limit."""
    held = next(
        each for each in system.held_forces if isinstance(each, BoundHeldActuator) and each.name == actuator.name
    )
    at = held.command(t)
    step = COMMAND_STEP * (1.0 + abs(at))
    own = {each.name: getattr(actuator, each.name) for each in fields(Actuator)}
    sides = []
    for sign in (1.0, -1.0):
        bound = Actuator(**own | {"control": at + sign * step}).bind(system.model)
        bound.set_breakpoints(system.breakpoints)
        sides.append((sign / (2.0 * step), Pull(bound)))
    return sides


class Discrete:
    """Linearises steps of one system under inputs that are held from the time `t` on."""

    def __init__(self, system, names=None, t=0.0):
        for label, force in system.forces.items():
            if isinstance(force, BoundSampled):
                raise InputError(
                    f"the torque of {label!r} depends on the states at which it was sampled, which a linearisation "
                    "does not see: apply the law in your own loop, by control= of step()"
                )
        self.system = system
        system.differentiate_forces()
        self._index1, self._columns, self._about = Index1(system), None, (names, t)
        self.inputs = Inputs(system, *self._about)
        self._solver, self._propagators = Propagator(self._index1, []), {}

    def along(self, start, rows, orders, again) -> StepLinearization:
        """The linearisation of the steps from `start`, (t, q, v), to `rows` of them, with their orders.

        ``again(start, t)`` makes the steps once more and returns them as a list of Step; it is called where Newton's
        iteration does not converge from the states alone.
        """
        states = [start, *rows]
        t, q, v = (np.array(column, float) for column in zip(*states, strict=True))
        accelerations = np.array([self._index1.acceleration(*state)[0] for state in states])
        stages = (np.array(orders, np.int64) + 1) // 2
        try:
            made, end, velocity = self._solver.solved(t, q, v, stages, accelerations)
        except PinconsistError:
            steps = again(start, float(t[-1]))
            t = np.array([start[0], *(step.end for step in steps)])
            made, end, velocity = self._solver.taken(steps)
        return StepLinearization(self.inputs.names, float(t[-1]), end, velocity, self, start, (made, t[1:]))

    def of_steps(self, start, made, end) -> StepLinearization:
        """The linearisation of the steps that a run has made from `start`, as StageSteps, to `end`, (t, q, v)."""
        t, q, v = end
        return StepLinearization(self.inputs.names, t, q, v, self, start, (made, made.t))

    def through(self, steps, states):
        """The ends of steps by their starts along directions `states` (2 nv, n), and by the inputs."""
        n = states.shape[1]
        S = np.zeros((n + len(self.inputs), 2 * self.system.nv))
        S[:n] = states.T
        S = self._with(n).through(*steps, S)
        return S[:n].T.copy(), S[n:].T.copy()

    def _with(self, n):
        """The propagator of n directions of the state and of the inputs."""
        if n not in self._propagators:
            self._propagators[n] = Propagator(self._index1, Inputs(self.system, *self._about, n))
        return self._propagators[n]

    def basis(self, t, q, v):
        """The coordinates, motors first as far as they are independent, and (2 nv, 2 d): all states by theirs.

        The velocities of the others depend on the coordinates as well: J v + Φ_t = 0 holds where these change.
        """
        nv, compiled = self.system.nv, self._index1.compiled
        J = compiled.dynamics(t, q, v)[2]
        columns, others, inverse = self._chosen(J)
        d = len(columns)
        Z = np.zeros((nv, d))
        Z[columns, np.arange(d)] = 1.0
        Z[others] = -inverse @ J[:, columns]
        known = compiled.row_gradients(t, q, v, np.zeros(len(J)))
        bend = self._bend(t, q, v, J, Z) if known is None else known[1] @ Z
        extended = np.zeros((2 * nv, 2 * d))
        extended[:nv, :d] = extended[nv:, d:] = Z
        extended[nv + others, :d] = -inverse @ bend
        return columns, extended

    def _bend(self, t, q, v, J, Z):
        """∂ρ/∂q Z, (nc, d), from J̇ v: the symmetric part of the second derivative of Φ, and half a Lie bracket."""
        system, dynamics = self.system, self._index1.compiled.dynamics
        bend = np.empty((len(J), Z.shape[1]))
        for k, z in enumerate(Z.T):
            bend[:, k] = 0.25 * (dynamics(t, q, v + z)[3] - dynamics(t, q, v - z)[3])
            if not system.vector_like:
                bend[:, k] += 0.5 * J @ (system.bracket(z) @ v)
        return bend

    def _chosen(self, J):
        """The columns of the coordinates, the last ones if they still do, the others, and the inverse of these in J."""
        if self._columns is not None:
            B = J[:, self._columns[1]]
            inverse = _inverse(B)
            if inverse is not None and np.vdot(inverse, inverse) * np.vdot(B, B) <= (SLANTED * len(B)) ** 2:
                return *self._columns, inverse
        mechanism, nv = self.system.mechanism, self.system.nv
        own = [range(nv)[mechanism.columns(joint)] for joint in mechanism.actuated]
        order = dict.fromkeys([*(column for columns in own for column in columns), *range(nv)])
        columns = _independent(null_space(J), list(order))
        others = np.delete(np.arange(nv), columns)
        self._columns = columns, others
        return columns, others, np.linalg.pinv(J[:, others])

    def multipliers(self, t, q, v, S):
        """The derivatives of all multipliers at a state, (n, nc), from those of the state, (n, 2 nv)."""
        system = self.system
        _, found = self._with(2 * system.nv).multipliers(np.array([t]), q[None], v[None], S[None])
        kept, lam = found[0], self._index1.acceleration(t, q, v)[1]
        if system.nc == system.n_multipliers or system.dropped_are_zero:
            return system.full_multipliers(np.tile(q, (len(S), 1)), kept)
        sides = [
            [system.full_multipliers(system.integrate(q, sign * APART * row[: system.nv]), lam + sign * APART * of_lam)
             for row, of_lam in zip(S, kept, strict=True)]
            for sign in (1.0, -1.0)
        ]  # fmt: skip
        return (np.array(sides[0]) - np.array(sides[1])) / (2.0 * APART)
