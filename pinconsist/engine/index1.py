"""The equations of index 1: accelerations, and projections onto the constraints, for starts, events and rows.

The constraint differentiated twice is linear in the acceleration, W a + γ = 0. With the equations of motion,

    [ M  -G ] [ a ]     [ f₀ ]
    [ W   0 ] [ λ ] = - [ γ  ]

gives acceleration and multiplier of the differential equation itself; M alone may be singular (massless links).
Projections are orthogonal in the metric of M. The computations are in ``engine/index1.hpp``.
"""

from functools import cached_property

from ..errors import AssemblyError, PinconsistError, SingularSystemError
from . import required
from .failure import culprits
from .systems import compiled_system


class NotFiniteError(PinconsistError):
    """The equations of motion have a number that is not finite."""


def singular_message(t) -> str:
    """The message about a singular configuration."""
    return f"the equations of motion are singular at t = {t:.6g} ([[M, -G], [W, 0]])"


class Index1:
    """The equations of index 1 of a system; `compiled` is the system in C++, if it is there already."""

    def __init__(self, system, compiled=None):
        self.system = system
        if compiled is not None:
            self.compiled = compiled

    @cached_property
    def compiled(self):
        """The system in C++."""
        return compiled_system(self.system)

    @cached_property
    def _projection(self):
        return required().Projection(self.compiled)

    def acceleration(self, t, p, v):
        """(a, λ), shapes (nv,) and (nc,); SingularSystemError or NotFiniteError if they do not exist."""
        solution = self._projection.acceleration(t, p, v)
        if solution is None:
            raise SingularSystemError(singular_message(t))
        a, lam, finite = solution
        if not finite:
            raise NotFiniteError(
                f"the equations of motion are not finite at t = {t:.6g}{culprits(self.system, t, p, v)}: a force or a "
                "user-defined function returns NaN or infinity"
            )
        return a, lam

    def projected(self, t, p, v):
        """(p, v) projected onto both constraints; AssemblyError if the position does not converge."""
        p, v, failure, gap = self._projection.project(t, p, v)
        if failure == "singular":
            raise SingularSystemError(singular_message(t))
        if failure:
            raise AssemblyError(f"the position could not be projected onto the constraint: |Φ| = {gap:.3g} remains")
        return p, v

    def velocity_shift(self, t, p, v, rho):
        """M⁻¹ G S⁻¹ ρ, shape (nv,): the smallest velocity, in the metric of M, that has the hidden residual ρ."""
        shift = self._projection.velocity_shift(t, p, v, rho)
        if shift is None:
            raise SingularSystemError(singular_message(t))
        return shift

    def state(self, t, p, v):
        """(t, p, v, λ) with p and v projected onto the constraints and λ of the differential equation."""
        p, v = self.projected(t, p, v)
        return t, p, v, self.acceleration(t, p, v)[1]
