"""What a system must provide to be integrated."""

from abc import ABC, abstractmethod
from typing import Any

import numpy as np

from ..errors import InputError


class Index3System(ABC):
    """An index-3 system p' = U(t,p,v), M(t,p) v' + f₀(t,p,v) = G λ, 0 = Φ(t,p).

    Positions may live on a manifold: they are stored in ``npos`` numbers and moved by tangent vectors of ``nx``.
    Velocities have ``nv`` numbers, multipliers ``nc``. With ``W = Φ_p U_v`` the matrix ``W M⁻¹ G`` must be nonsingular.
    A rigid-body system has ``U = v``, ``f₀ = nle - τ``, ``G = Jᵀ``, ``W = J``.

    To all methods ``t`` is the time, s; ``p``, ``p0``, ``p1`` and ``base`` are positions, shape (npos,), the last one
    the centre of a chart ξ ↦ base ⊕ ξ; ``xi`` and ``psi`` tangent vectors, ``rate`` a tangent velocity, (nx,); ``v`` a
    velocity and ``a`` its derivative, (nv,); ``lam`` multipliers, (nc,); ``c`` the step times the coefficient by which
    a BDF formula weighs the new derivative, s. All arrays hold floats; only ``A`` is changed.

    Methods with a body are defaults; those for positions belong to a vector space.

    Attributes
    ----------
    npos, nx, nv, nc : int
        Sizes, as above.
    vector_like : bool
        True where ``integrate`` is addition; the method then skips all charts.
    moving : bool
        The constraint may depend on time.
    changes : bool
        Forces or constraints may jump or bend at times that are known before, see :meth:`next_change`.
    difference_step : float
        Step of the difference quotients that replace ``W``; their rounding error is divided by it. inf if ``W`` is
        exact.
    dropped_are_zero : bool
        False if constraint rows were left out that may become independent of the others during a run.
    widths : ndarray or None
        For each velocity, the width of the narrow range about zero over which forces change quickly, as friction does;
        inf if there is none.
    sharp : bool
        Whether there are forces that may bend or jump within a step, as friction does: :meth:`sharp_force`.
    mechanism, model : Mechanism, pin.Model, or None
        Those of a rigid-body system, which the engine evaluates itself; other systems are called back.
    may_act_later : bool
        Whether forces or constraints may begin to act after a time of rest, at times that :meth:`look_ahead` does not
        find.
    """

    npos: int
    nx: int
    nv: int
    nc: int
    vector_like: bool = True
    changes: bool = False
    difference_step: float = np.inf
    dropped_are_zero: bool = True
    moving: bool = True
    widths: np.ndarray | None = None
    sharp: bool = False
    may_act_later: bool = True
    mechanism: Any = None
    model: Any = None

    @property
    def base(self) -> "Index3System":
        """The equations without contacts, of which these may be one mode."""
        return self

    @property
    def held(self) -> dict[str, np.ndarray]:
        """The tables of torques that are held, by the labels of their forces."""
        return {}

    def integrate(self, p, xi):
        """p ⊕ ξ, shape (npos,): the position reached from `p` by the tangent vector `xi`."""
        return p + xi

    def difference(self, p0, p1):
        """ξ with `p0` ⊕ ξ = `p1`, shape (nx,)."""
        return p1 - p0

    @abstractmethod
    def rate(self, t, p, v):
        """U at (`t`, `p`, `v`), shape (nx,): the tangent velocity of the position."""

    def bracket(self, xi):
        """The matrix ad ξ of the Lie bracket [`xi`, ·] of positions, shape (nx, nx); 0 for a vector space."""
        return np.zeros((self.nx, self.nx))

    @abstractmethod
    def position(self, t, base, psi, c, v):
        """(p, ξ) with p = `base` ⊕ ξ and ξ = `psi` + `c` U(t, p, v): the position that a BDF step gives to `v` at `t`.

        Shapes (npos,) and (nx,).
        """

    @abstractmethod
    def evaluate(self, t, p, v, a):
        """(f, Φ, G, ρ) at (`t`, `p`, `v`): f = M `a` + f₀, the constraint, force directions, the hidden residual.

        Shapes (nv,), (nc,), (nv, nc), (nc,). The caller may change the arrays, which are valid until the next call.
        """

    @abstractmethod
    def linearize(self, t, p, v, a, lam, c, A):
        """Fill a Newton step's matrices, at the point (`t`, `p`, `v`, `a`) that was evaluated last.

        Parameters
        ----------
        t, p, v, a
            That point.
        lam : ndarray, shape (nc,)
            Multipliers, for systems whose `A` includes the derivative of G λ; for others see :meth:`force_gradient`.
        c : float
            Change of the position per velocity, s; with 0 only M is computed.
        A : ndarray, shape (nv, nv)
            Set to M + c ∂f/∂v + c² ∂f/∂p.

        Returns
        -------
        ndarray, shape (nc, nv)
            W.
        """

    def matrices(self, t, p, v, a):
        """(M, ∂f/∂v, ∂f/∂p) at (`t`, `p`, `v`, `a`), each (nv, nv), the last in velocity columns.

        The parts of :meth:`linearize`, without that of G λ. The caller may change the arrays.
        """
        M, plus, minus = (np.empty((self.nv, self.nv)) for _ in range(3))
        for c, A in ((0.0, M), (1.0, plus), (-1.0, minus)):
            self.linearize(t, p, v, a, np.zeros(self.nc), c, A)
        return M, 0.5 * (plus - minus), 0.5 * (plus + minus) - M

    def velocity_jacobian(self, t, p, v, G):
        """The matrix W at (`t`, `p`, `v`), shape (nc, nv), where `G` is known; Gᵀ, as for rigid bodies."""
        return G.T

    def force_gradient(self, t, p, v, lam):
        """∂(G `lam`)/∂ξ at (`t`, `p`, `v`), (nv, nv) in velocity columns, where :meth:`linearize` leaves it out.

        Otherwise the number 0.
        """
        return 0.0

    @abstractmethod
    def constraint(self, t, p, rate):
        """(Φ, ρ) at (`t`, `p`), each (nc,): the constraint, and the hidden one ρ = Φ_p U + Φ_t with U = `rate`."""

    @abstractmethod
    def acceleration_bias(self, t, p, v):
        """γ at (`t`, `p`, `v`), shape (nc,), with dρ/dt = W v' + γ."""

    def position_scale(self, p):
        """The size of each tangent coordinate at `p`, shape (nx,), by which a relative tolerance is multiplied."""
        return np.abs(p)

    def describe_row(self, row: int) -> str:
        """The name of constraint row `row`, counted from 0, in messages."""
        return f"constraint row {row}"

    @property
    def n_multipliers(self) -> int:
        """Number of multipliers as the user sees them, including those of rows that were left out."""
        return self.nc

    def full_multipliers(self, p, lam, complete=None, v=None):
        """The multipliers as the user sees them, (n_multipliers,), from `lam` of this system at `p`; also stacks.

        `complete`, if given, is a compiled function that does this for many rows; `v` are the velocities.
        """
        return lam

    def reselected(self, p):
        """The same system with other rows of its constraints, if those kept are a poor choice at `p`; else None."""
        return None

    def opened(self, times, positions, gaps=None):
        """(index, gap, (loop, row)) of the first of `positions` at `times` that violates a row left out; else None.

        `gaps`, if given, is a compiled function that evaluates all rows at many positions.
        """
        return None

    def with_velocities(self, t, p, v, named):
        """The velocity nearest to `v` at (`t`, `p`) in which the joints of `named`, name → value, have these values.

        It is on the constraints; distance is measured in the mass metric. Raises InputError if there are no joints.
        """
        raise InputError("a general problem has no joints: return v, or (p, v), not a mapping")

    def describe_velocity(self, i: int) -> str:
        """The name of component `i` of v, counted from 0, in messages."""
        return f"v[{i}]"

    def look_ahead(self, t, t_end, p, v, every) -> None:  # noqa: B027  # by default nothing is known ahead
        """Find the times between `t` and `t_end` at which a run that starts at (`p`, `v`) has to end steps.

        If not `every`, only those at which functions that are known otherwise jump or bend.
        """

    def start(self, t, p, v, backwards) -> None:  # noqa: B027
        """Set the forces that jump at known times to their values at the start (`t`, `p`, `v`) of a run.

        `backwards` says that the run goes back in time.
        """

    def next_change(self, t, t_end):
        """The first time after `t` at which forces or constraints change their character, or `t_end`.

        Steps end there.
        """
        return t_end

    def change(self, t, p, v) -> bool | None:
        """Whether forces jumped: those due at `t` are evaluated at (`t`, `p`, `v`), and act from then on.

        None if nothing is due, or all is smooth, so that a multistep method need not start again.
        """
        return None

    def jumps_at(self, t, p, v) -> bool:
        """Whether forces or constraints may jump at the end `t` of a run, in the state (`p`, `v`)."""
        return self.changes

    def sharp_force(self, t, p, v):
        """The forces at (`t`, `p`, `v`) that may bend or jump within a step, shape (nv,); called if :attr:`sharp`."""
        return np.zeros(self.nv)

    def jumps(self, t, p, v) -> tuple[str, ...]:
        """The names of forces that jump at (`t`, `p`) at velocities near `v`, where the system knows them."""
        return ()

    def not_finite(self, t, p, v) -> tuple[str, ...]:
        """The names of user-defined functions that are not finite at (`t`, `p`, `v`), where the system knows them."""
        return ()
