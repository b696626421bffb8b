"""Small motions about a state, in independent coordinates."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import SingularSystemError
from ..mechanism.assembly import assemble
from ..mechanism.checks import number, require_no_contacts
from ..mechanism.lie import integrate
from ..mechanism.mechanism import with_added_forces
from ..mechanism.names import velocity_names
from ..mechanism.rank import MASSLESS, without_inertia
from ..mechanism.system import MechanismSystem
from .equilibrium import equilibrium
from .modes import Modes, modes
from .variations import (
    Derivatives,
    Locked,
    TangentSpace,
    Varied,
    by_position,
    by_velocity,
    of_state,
    rates_of_loops,
    step_sizes,
)


@dataclass(frozen=True, eq=False)
class Linearization(Locked):
    """The equations mass·y'' + damping·y' + stiffness·y = 0 of small variations y about a state.

    The y are the variations of as many joints as the loops leave free; all others follow: δq = Z y to first order.
    About a moving state the variations are expressed in the frame of this state (this matters for joints with rotations
    in space only), and the coefficients are those at time `t`: exponentials are solutions if they are constant.

    Attributes
    ----------
    t : float
        Time, s.
    q, v, a, lam : ndarray
        The state, its acceleration and its multipliers: shapes (nq,), (nv,), (nv,), (nc,). In an equilibrium v and a
        are zero.
    coordinates : tuple of str, length n
        Names of the joints of the variations y; ``ball[0]`` is the first velocity of a joint that has several.
    Z : ndarray, shape (nv, n)
        Joint velocities for unit y, as columns.
    mass, damping, stiffness : ndarray, shape (n, n)
        ZᵀMZ; damping and gyroscopic terms; stiffness of the forces, the weight, the constraint forces (geometric
        stiffness) and, about a moving state, of the curvature of the constraints. SI.
    """

    t: float
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    coordinates: tuple[str, ...]
    Z: np.ndarray
    mass: np.ndarray
    damping: np.ndarray
    stiffness: np.ndarray
    _sizes: np.ndarray = field(repr=False)
    _scale: float = field(repr=False)
    _about: tuple = field(repr=False)  # mechanism, q0, v0

    def __str__(self):
        matrices = {"mass": self.mass, "damping": self.damping, "stiffness": self.stiffness}
        lines = [f"at t = {self.t:g} s, mass·y'' + damping·y' + stiffness·y = 0 for y of {', '.join(self.coordinates)}"]
        for name, matrix in matrices.items():
            text = np.array2string(matrix, precision=6, suppress_small=True, prefix=f"{name:<10}", max_line_width=100)
            lines.append(f"{name:<10}{text}")
        return "\n".join(lines)

    @property
    def A(self) -> np.ndarray:
        """The matrix of the first-order form (y, y')' = A (y, y'), shape (2n, 2n).

        Raises
        ------
        SingularSystemError
            Some motions have no inertia; use :meth:`modes` then.
        """
        n = len(self.mass)
        scaled = self._sizes[:, None] * self.mass * self._sizes
        inertia = np.linalg.eigvalsh(scaled)
        if n and inertia[0] <= MASSLESS * inertia[-1]:
            raise SingularSystemError("motions that the loops allow have no inertia, so there is no state matrix A")
        below = -np.linalg.solve(self.mass, np.hstack((self.stiffness, self.damping)))
        return np.block([[np.zeros((n, n)), np.eye(n)], [below[:, :n], below[:, n:]]])

    def derivatives(self, parameters, theta=None) -> Derivatives:
        """Differentiate the matrices with respect to parameters of the mechanism.

        Parameters and errors as :meth:`Equilibrium.derivatives`: `parameters`, `theta`.

        Returns
        -------
        Derivatives
            Of ``"mass"``, ``"damping"`` and ``"stiffness"``, (n, n, P); the last index is the parameter. A computed
            equilibrium changes with the parameters; a prescribed state is assembled again.
        """
        mechanism, q0, v0 = self._about
        varied, dq = Varied(mechanism, parameters, theta), None
        if q0 is None and v0 is None:
            dq = of_state(varied, self.t, self.q, self.v, self.a, self.lam)[0]

        def matrices(i, beside, change):
            there = q0 if dq is None else integrate(mechanism.model, self.q, change * dq[:, i])
            found = linearize(beside, there, v0, t=self.t)
            return np.array([found.mass, found.damping, found.stiffness])

        rates = [varied.rate(i, lambda *side, i=i: matrices(i, *side)) for i in range(len(varied.names))]
        parts = np.stack(rates, axis=-1)
        return Derivatives(varied.names, dict(zip(("mass", "damping", "stiffness"), parts, strict=True)))

    def modes(self) -> Modes:
        """Compute natural frequencies, damping ratios and mode shapes; motions without inertia are condensed.

        Of these, motions without damping follow the others without delay; those with damping are of first order.

        Returns
        -------
        Modes
            The finite modes, the slowest first.

        Raises
        ------
        SingularSystemError
            A motion has neither inertia nor damping nor stiffness; the modes are not determined.
        """
        return modes(self)


def linearize(mechanism, q0=None, v0=None, *, forces=(), t: float = 0.0) -> Linearization:
    """Linearise a mechanism on its constraints.

    Parameters
    ----------
    mechanism : Mechanism
    q0 : mapping or array, optional
        Configuration, closed as by :func:`assemble`. Default: the equilibrium that :func:`equilibrium` finds.
    v0 : mapping or array, optional
        Velocity, projected onto the constraints as by :func:`assemble`. Default: rest, except for driven motion.
    forces : sequence
        Additional forces, as in :func:`simulate`.
    t : float
        Time at which forces and drives are evaluated, s.

    Returns
    -------
    Linearization

    Raises
    ------
    EquilibriumError
        No `q0` was given and no equilibrium was found.
    AssemblyError
        The loops cannot be closed, or do not allow `v0`.
    SingularSystemError
        A force acts on a motion without inertia: no acceleration balances it.
    InputError
        Invalid arguments.

    Notes
    -----
    The variations of Φ, of its rates J v + Φ_t and J a + γ, and of M a + nle - τ - Jᵀλ are formed. In δv and δa, the
    entries of the coordinates are y' and y'', the others follow from the rates. The projection by Zᵀ eliminates δλ, and
    the last variation is then exactly that of the equations of motion in minimal coordinates.
    """
    mechanism = with_added_forces(mechanism, forces, "linearize")
    require_no_contacts(mechanism, "linearize")
    t = number(t, "t")
    given = q0
    if q0 is None:
        q0 = equilibrium(mechanism, t=t).q
    state = assemble(mechanism, q0, v0, t=t)
    q, v = state.q, state.v
    system = MechanismSystem(mechanism, q, t)
    space, sizes = TangentSpace(system, q, t), step_sizes(system, q)
    Z, M = space.Z, system.mass_matrix(q)
    a, lam, scale = _acceleration(system, space, t, q, v, M)
    K = by_position(system, t, q, v, a, lam, Z)
    C = by_velocity(system, t, q, v, a)
    velocity, from_velocity, from_position = _follow(system, space, t, q, v, a)
    names = velocity_names(mechanism.model)
    return Linearization(
        t, q, v, a, lam,
        tuple(names[i] for i in space.coordinates), Z,
        mass=Z.T @ M @ Z,
        damping=Z.T @ (C @ Z + M @ from_velocity),
        stiffness=Z.T @ (K + C @ velocity + M @ from_position),
        _sizes=sizes[space.coordinates], _scale=scale, _about=(mechanism, given, v0),
    )  # fmt: skip


def _acceleration(system, space, t, q, v, M):
    """(a, λ, size of the forces) of the equations of motion; M may be singular."""
    Z = space.Z
    given = -space.P @ system.rows.acceleration_bias(t, q, v)
    push = pin.nonLinearEffects(system.model, system.data, q, v) - system.torque(t, q, v)
    inertia, motions = np.linalg.eigh(Z.T @ M @ Z)
    load = motions.T @ (Z.T @ (push + M @ given))
    scale = np.max(np.abs(Z).T @ (np.abs(push) + np.abs(M) @ np.abs(given)), initial=0.0)
    massless = inertia <= MASSLESS * inertia.max(initial=0.0)
    if (np.abs(load[massless]) > 1e-8 * scale).any():
        why = ", but forces act on them: linearisation is possible only at an equilibrium"
        raise without_inertia(system.mechanism, Z @ motions[:, massless], why)
    load[massless], inertia[massless] = 0.0, 1.0
    a = given - Z @ (motions @ (load / inertia))
    carried = M @ a + push
    return a, space.multipliers(carried), float(np.max(np.abs(carried), initial=0.0))


def _follow(system, space, t, q, v, a):
    """(V, A₁, A₀), each (nv, n), with δv = Z y' + V y and δa = Z y'' + A₁ y' + A₀ y.

    For rotations, tangent vectors at q ⊕ δq are expressed in another frame than those at q. With δv = δq' + T(v) δq,
    the coordinates of δv are y' + (T(v) δq)[coordinates].
    """
    Z, P = space.Z, space.P
    if not (v.any() or a.any()):
        return np.zeros_like(Z), np.zeros_like(Z), np.zeros_like(Z)

    def coordinates_of(vectors):
        return Z @ vectors[space.coordinates]

    turn_v, turn_a = _frame_turn(system, q, v), _frame_turn(system, q, a)
    hidden, by_q, by_v = rates_of_loops(system, t, q, v, a, Z)
    velocity = coordinates_of(turn_v @ Z) - P @ hidden
    from_velocity = coordinates_of(turn_v @ Z) - P @ (by_v @ Z)
    from_position = coordinates_of(turn_v @ (velocity - turn_v @ Z) + turn_a @ Z) - P @ (by_q + by_v @ velocity)
    return velocity, from_velocity, from_position


def _frame_turn(system, q, v):
    """T, (nv, nv): if q moves with v and δq is constant, q ⊕ δq has the velocity v + T δq in its own frame."""
    if system.vector_like:
        return np.zeros((system.nv, system.nv))
    return system.bracket(v)
