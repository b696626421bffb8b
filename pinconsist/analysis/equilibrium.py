"""Equilibrium: the configuration at rest under all forces, its multipliers, and its stability."""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import pinocchio as pin

from ..errors import EquilibriumError, SingularSystemError
from ..mechanism.assembly import assemble
from ..mechanism.checks import flag, number, require_no_contacts
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.names import joints_in
from ..mechanism.reactions import HasReactions
from ..mechanism.system import MechanismSystem
from .variations import (
    NEUTRAL,
    Derivatives,
    Locked,
    TangentSpace,
    Varied,
    by_position,
    closed_near,
    of_state,
    step_sizes,
)

MAX_ITERATIONS = 200
MAX_NUDGES = 20
FLOOR = 1e-14  # relative to the balanced forces: rounding
BALANCED = 1e-9  # relative to the balanced forces: accepted residual if rounding prevents a smaller one
LONGEST_STEP = 0.5  # rad, or lengths of the mechanism: longest step
DISPLACEMENT = 0.05  # rad, or lengths: displacement from an unstable equilibrium


@dataclass(frozen=True, eq=False)
class Equilibrium(Locked, HasReactions):
    """A configuration in which all forces balance.

    Attributes
    ----------
    mechanism : Mechanism
        The mechanism, with all forces that act.
    t : float
        Time, s.
    q : ndarray, shape (nq,)
        Closed configuration.
    lam : ndarray, shape (nc,)
        Multipliers of all rows, those of smallest norm if rows are redundant; signs, frames and units:
        :mod:`pinconsist.mechanism.loops`.
    residual : float
        Largest entry of |g - τ - Jᵀλ|, N·m or N.
    stiffness : ndarray, shape (mobility,)
        Eigenvalues, ascending, of the symmetric part of the stiffness on the admissible displacements, normalised in
        joint coordinates, N·m/rad (or N/m). Values that cannot be distinguished from zero are zero.
    neutral : tuple of str
        Joints of the displacements with zero stiffness.
    iterations : int
        Number of Newton steps.
    """

    mechanism: Mechanism = field(repr=False)
    t: float
    q: np.ndarray
    lam: np.ndarray
    residual: float
    stiffness: np.ndarray
    neutral: tuple[str, ...]
    iterations: int

    @property
    def stable(self) -> bool:
        """Whether every small admissible displacement is resisted: all entries of `stiffness` are positive.

        If forces have no potential (follower forces, a servo of one joint on another), this excludes divergence but not
        flutter; see :meth:`Linearization.modes`.
        """
        return bool((self.stiffness > 0).all())

    def derivatives(self, parameters, theta=None) -> Derivatives:
        """Differentiate the equilibrium with respect to parameters of the mechanism.

        Parameters
        ----------
        parameters : sequence of str or callable
            Names of parameters, see :meth:`Mechanism.with_parameters`; or ``build(theta) -> Mechanism``.
        theta : array, optional
            With `build`: the values of the parameters.

        Returns
        -------
        Derivatives
            Of ``"q"``, (nv, P), as tangent vectors, and of ``"lam"``, (nc, P); the last index is the parameter.

        Raises
        ------
        InputError
            Unknown names; a parameter that makes redundant loops contradict each other.
        SingularSystemError
            Some motion has zero stiffness.
        """
        varied, rest = Varied(self.mechanism, parameters, theta), np.zeros(self.mechanism.nv)
        dq, _, _, dlam = of_state(varied, self.t, self.q, rest, rest, self.lam)
        return Derivatives(varied.names, {"q": dq, "lam": dlam})

    def __str__(self):
        if not len(self.stiffness):
            return f"rigid, forces balance to {self.residual:.1e}"
        least = self.stiffness[0]
        kind = "stable" if least > 0 else "neutral" if least == 0 else "unstable"
        unheld = f", nothing resists {', '.join(self.neutral)}" if self.neutral else ""
        return f"{kind} equilibrium, smallest stiffness {least:.6g}{unheld}; forces balance to {self.residual:.1e}"


def equilibrium(mechanism, q0=None, *, forces=(), t: float = 0.0, stable: bool = True) -> Equilibrium:
    """Find a closed configuration in which g(q) = τ(t, q, 0) + Jᵀλ.

    Newton's method on the configurations that the loops allow: each step is taken in their tangent space with the
    stiffness of forces, weight and constraint forces, and the loops are closed again. With ``stable`` it is a descent:
    the sign of negative curvature is reversed, steps that require external work are halved, and an unstable equilibrium
    is left. The mass matrix is not used, so that massless links are allowed.

    Parameters
    ----------
    mechanism : Mechanism
        All of its forces act, evaluated at rest; dry friction, which is smoothed, vanishes there. Drives hold their
        joints at the values of time `t`.
    q0 : mapping or array, optional
        Initial configuration, as in :func:`assemble`. Default: the mechanism's guess.
    forces : sequence
        Additional forces, as in :func:`simulate`.
    t : float
        Time at which forces and drives are evaluated, s.
    stable : bool
        False: return the equilibrium that Newton's method finds from `q0`, stable or not.

    Returns
    -------
    Equilibrium

    Raises
    ------
    EquilibriumError
        None was found; the message gives the unbalanced forces and their joints, and the error carries the
        configuration.
    AssemblyError
        The loops cannot be closed.
    SingularSystemError
        The equilibrium is at a singular configuration, where the forces in the loops are not determined.
    InputError
        Invalid arguments.
    """
    mechanism = with_added_forces(mechanism, forces, "equilibrium")
    require_no_contacts(mechanism, "equilibrium")
    t, stable = number(t, "t"), flag(stable, "stable")
    start = assemble(mechanism, q0, t=t).q
    system = MechanismSystem(mechanism, start, t)
    place, iterations, nudges = _Place(system, t, start), 0, 0
    while True:
        following = None if place.is_balanced(FLOOR) else place.following(downhill=stable)
        if place.is_settled(following):
            nudged = place.nudged() if stable and nudges < MAX_NUDGES else None
            if nudged is None:
                break
            place, nudges = nudged, nudges + 1
        elif following is None:
            why = "no step descends further" if stable else "Newton's method is stuck; try stable=True or another q0"
            raise _not_found(place, why)
        elif iterations == MAX_ITERATIONS:
            raise _not_found(place, f"not converged after {MAX_ITERATIONS} steps")
        else:
            place, iterations = following, iterations + 1
    rank = system.nv - place.Z.shape[1]
    if rank < system.rows.nc and system.rank_nearby(place.q, place.Z) > rank:
        raise SingularSystemError(
            f"{mechanism.name}: the forces balance at a singular configuration, where the motion branches and the "
            "forces in the loops are not determined. Change a length slightly, or look for another equilibrium",
            names=tuple(loop.name for loop in mechanism.loops),
        )
    return place.result(iterations)


class _Place:
    """A closed configuration and the forces there; ``push`` = Zᵀ(g - τ) are the unbalanced forces.

    Z is an orthonormal basis of the displacements that the loops allow, in units of `sizes`.
    """

    def __init__(self, system, t, q):
        self.system, self.t, self.q = system, t, q
        self.sizes = step_sizes(system, q)
        space, rest = TangentSpace(system, q, t), np.zeros(system.nv)
        self.Z = self.sizes[:, None] * np.linalg.qr(space.Z / self.sizes[:, None])[0]
        weight, applied = pin.rnea(system.model, system.data, q, rest, rest), system.torque(t, q, rest)
        self.load = weight - applied
        self.lam = space.multipliers(self.load)
        self.residual = float(np.max(np.abs(self.load - space.J.T @ self.lam)))
        self.push = self.Z.T @ self.load
        terms = self.sizes * (np.abs(weight) + np.abs(applied) + np.abs(space.J).T @ np.abs(self.lam))
        mass = sum(inertia.mass for inertia in system.model.inertias)
        self.scale = np.max(terms) + self.sizes.max() * mass * np.linalg.norm(system.model.gravity.linear)

    def is_balanced(self, tolerance) -> bool:
        return bool((np.abs(self.push) <= tolerance * self.scale).all())

    def is_settled(self, following) -> bool:
        """Whether the forces balance up to rounding, so that the step to `following` does not improve the balance."""
        stuck = following is None or np.linalg.norm(following.push) > 0.5 * np.linalg.norm(self.push)
        return self.is_balanced(FLOOR) or (self.is_balanced(BALANCED) and stuck)

    @cached_property
    def stiffness(self):
        """The stiffness in the basis Z, shape (n, n); symmetric in equilibrium if the forces have a potential."""
        rest = np.zeros(self.system.nv)
        return self.Z.T @ by_position(self.system, self.t, self.q, rest, rest, self.lam, self.Z)

    @cached_property
    def spectrum(self):
        """Eigenvalues and vectors of the symmetric part of the stiffness, and the bound below which they are zero."""
        K = self.stiffness
        return *np.linalg.eigh((K + K.T) / 2), NEUTRAL * (np.max(np.abs(K), initial=0.0) + self.scale)

    def nudged(self):
        """A place displaced slightly in the most unstable direction; None if every displacement is resisted."""
        values, vectors, noise = self.spectrum
        if not (values < -noise).any():
            return None
        dq = self.Z @ vectors[:, 0]
        return self._moved(DISPLACEMENT * dq / np.max(np.abs(dq) / self.sizes)) or self

    def following(self, downhill: bool):
        """The next place of the descent, or of Newton's method, with the step halved until it improves; or None."""
        values, vectors, noise = self.spectrum
        steep = np.linalg.norm(self.push)
        if not downhill:
            y = -np.linalg.lstsq(self.stiffness, self.push, rcond=1e-12)[0]
        elif (values > noise).all():
            y = -np.linalg.solve(self.stiffness, self.push)
        else:
            y = -vectors @ (vectors.T @ self.push / np.maximum(np.abs(values), max(noise, steep / LONGEST_STEP)))
        dq = self.Z @ y
        dq *= min(1.0, LONGEST_STEP / max(np.max(np.abs(dq) / self.sizes), 1e-300))
        for share in 0.5 ** np.arange(40):
            new = self._moved(share * dq)
            if new is None:
                continue
            if not downhill and np.linalg.norm(new.push) <= (1 - 1e-4 * share) * steep:
                return new
            work = (self.load + new.load) @ self.system.difference(self.q, new.q) / 2  # work that must be supplied
            if downhill and (work <= 1e-4 * share * (self.load @ dq) or np.linalg.norm(new.push) <= 0.5 * steep):
                return new
        return None

    def _moved(self, dq):
        q = closed_near(self.system, self.t, self.system.integrate(self.q, dq))
        return None if q is None else _Place(self.system, self.t, q)

    def result(self, iterations) -> Equilibrium:
        values, vectors, noise = self.spectrum
        idle = np.abs(values) <= noise
        neutral = joints_in(self.system.mechanism, self.Z @ vectors[:, idle]) if idle.any() else ()
        mechanism, values = self.system.mechanism, np.where(idle, 0.0, values)
        return Equilibrium(mechanism, self.t, self.q, self.lam, self.residual, values, neutral, iterations)


def _not_found(place, why) -> EquilibriumError:
    mechanism = place.system.mechanism
    values, vectors, noise = place.spectrum
    unheld = vectors.T @ place.push * (values <= noise)
    size = float(np.linalg.norm(place.push))
    runs_away = np.linalg.norm(unheld) > 0.5 * size
    names = joints_in(mechanism, place.Z @ (vectors @ unheld if runs_away else place.push))
    cause = "nothing resists this motion: lock the joint, or add a spring" if runs_away else "start closer to it"
    return EquilibriumError(
        f"{mechanism.name}: no equilibrium found, {why}; {size:.3g} N·m (or N) remain unbalanced at "
        f"{', '.join(names)}. {cause}",
        q=place.q, residual=size, names=names,
    )  # fmt: skip
