"""The general Hessenberg index-3 form, built from callables."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy

import numpy as np

from ..errors import InputError, UserFunctionError
from .norms import largest
from .problem import Index3System


class HessenbergProblem(Index3System):
    """The general index-3 form (4.1) of Arévalo (2008): p' = U, v' = F + G Λ, 0 = R, with R_p U_v G nonsingular.

    Its methods are called by the integrator, on the copy with known sizes that :meth:`at` returns; M is the identity,
    and positions are vectors.

    Parameters
    ----------
    U, F : callable
        ``U(t, p, v) -> (np,)`` and ``F(t, p, v) -> (nv,)``.
    G : callable
        ``G(t, p, v) -> (nv, nc)``.
    R : callable
        ``R(t, p) -> (nc,)``.
    R_p, R_t : callable, optional
        ``R_p(t, p) -> (nc, np)``, ``R_t(t, p) -> (nc,)``. Without them, fourth-order central differences, accurate to
        about 1e-12 of the problem's scale; the multipliers inherit this error. ``R_p`` without ``R_t`` means that R_t
        is approximated by finite differences: pass ``R_t`` for a constraint that depends on time.
    U_p, U_v : callable, optional
        ``(np, np)`` and ``(np, nv)``; forward differences if missing (they only affect Newton's convergence).

    Raises
    ------
    InputError
        Something is not callable; at the start of a run, shapes do not fit, numbers are not finite, or ``R_p`` is not
        the derivative of ``R``.
    UserFunctionError
        During a run, one of the functions raised an exception.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), eq. (4.1).
    """

    vector_like = True

    def __init__(
        self,
        U: Callable,
        F: Callable,
        G: Callable,
        R: Callable,
        *,
        R_p: Callable | None = None,
        R_t: Callable | None = None,
        U_p: Callable | None = None,
        U_v: Callable | None = None,
    ):
        given = {"U": U, "F": F, "G": G, "R": R, "R_p": R_p, "R_t": R_t, "U_p": U_p, "U_v": U_v}
        for name, function in given.items():
            if not (callable(function) or (function is None and "_" in name)):
                raise InputError(f"HessenbergProblem: {name} must be callable, got {type(function).__name__}")
        self._given = {name: function for name, function in given.items() if function is not None}
        self.npos = self.nx = self.nv = self.nc = 0

    def at(self, t, p, v) -> HessenbergProblem:
        """A copy with ``npos``, ``nx``, ``nv`` and ``nc``, from one evaluation at `t`, `p` (np,), `v` (nv,).

        Every run begins with this call. It checks what the functions return: InputError for shapes that do not fit each
        other, numbers that are not finite, and an ``R_p`` that is not the derivative of ``R``; UserFunctionError if a
        function raises.
        """
        if np.ndim(p) != 1 or np.ndim(v) != 1:
            raise InputError(f"HessenbergProblem: p0 and v0 need shapes (n,), got {np.shape(p)} and {np.shape(v)}")
        sized = copy(self)
        sized.npos = sized.nx = nx = len(p)
        sized.nv = nv = len(v)
        sized.nc = nc = len(np.atleast_1d(_called("R", self._given["R"], t, p)))
        shapes = {"U": (nx,), "F": (nv,), "G": (nv, nc), "R": (nc,)}
        shapes |= {"R_p": (nc, nx), "R_t": (nc,), "U_p": (nx, nx), "U_v": (nx, nv)}
        for name, shape in shapes.items():
            function = self._given.get(name)
            setattr(sized, "_" + name, function and _checked(name, function, shape))
            if function is not None:
                state = (p,) if name[0] == "R" else (p, v)
                value = getattr(sized, "_" + name)(t, *state)
                if not np.isfinite(value).all():
                    raise InputError(f"HessenbergProblem: {name} is not finite at t = {t:g}")
        if "R_p" in self._given:
            sized._compare_derivative(t, p)
        return sized

    def _compare_derivative(self, t, p):
        """R_p along a direction in which every coordinate moves, against the difference quotient of R."""
        direction = np.cos(np.arange(1.0, self.nx + 1.0))
        given, expected = self._R_p(t, p) @ direction, _along(self._R, t, p, 0.0, direction)
        scale = largest(self._R_p(t, p)) + largest(expected)
        if largest(given - expected) > 1e-4 * scale:
            row = int(np.argmax(np.abs(given - expected)))
            raise InputError(
                f"HessenbergProblem: R_p is not the derivative of R at t = {t:g}: in a test direction its row "
                f"{row} gives {given[row]:.6g}, differences of R {expected[row]:.6g}. Omit R_p to use differences"
            )

    def rate(self, t, p, v):
        return self._U(t, p, v)

    def position(self, t, base, psi, c, v):
        p = psi + c * self.rate(t, base, v)
        scale = 1.0 + largest(p)
        for _ in range(20):  # one pass if U does not depend on p
            gap = psi + c * self.rate(t, p, v) - p
            if largest(gap) <= 4e-16 * scale:
                break
            p = p + np.linalg.solve(np.eye(self.nx) - c * self._jacobian_U_p(t, p, v), gap)
        return p, p

    def evaluate(self, t, p, v, a):
        phi, rho = self.constraint(t, p, self.rate(t, p, v))
        return a - self._F(t, p, v), phi, self._G(t, p, v), rho

    def linearize(self, t, p, v, a, lam, c, A):
        E = np.linalg.inv(np.eye(self.nx) - c * self._jacobian_U_p(t, p, v))
        U_v = E @ self._jacobian_U_v(t, p, v)

        def force(p, v):
            return self._F(t, p, v) + self._G(t, p, v) @ lam

        A[:] = np.eye(self.nv)
        if c:
            A -= c * _columns(lambda x: force(p, x), v) + c**2 * _columns(lambda x: force(x, v), p) @ U_v
        return self._jacobian_R_p(t, p) @ U_v

    def matrices(self, t, p, v, a):
        U_v = self._jacobian_U_v(t, p, v)
        F_v, F_p = _columns(lambda x: self._F(t, p, x), v), _columns(lambda x: self._F(t, x, v), p)
        return np.eye(self.nv), -F_v, -F_p @ U_v

    def velocity_jacobian(self, t, p, v, G):
        return self._jacobian_R_p(t, p) @ self._jacobian_U_v(t, p, v)

    def constraint(self, t, p, rate):
        return self._R(t, p), self._hidden(t, p, rate)

    def _hidden(self, t, p, rate):
        if self._R_p is None:
            return _along(self._R, t, p, 1.0, rate)
        R_t = self._R_t(t, p) if self._R_t is not None else _along(self._R, t, p, 1.0, np.zeros_like(p))
        return self._R_p(t, p) @ rate + R_t

    def acceleration_bias(self, t, p, v):
        U = self.rate(t, p, v)
        if self._R_p is not None:
            return _along(lambda t, p: self._hidden(t, p, self.rate(t, p, v)), t, p, 1.0, U)
        return _second_along(self._R, t, p, U, _along(lambda t, p: self.rate(t, p, v), t, p, 1.0, U))

    sharp = may_act_later = True  # for all that is known of F

    def sharp_force(self, t, p, v):
        return self._F(t, p, v)

    def describe_row(self, row):
        return f"row {row} of R"

    def _jacobian_R_p(self, t, p):
        if self._R_p is not None:
            return self._R_p(t, p)
        return np.column_stack([_along(self._R, t, p, 0.0, unit) for unit in np.eye(self.nx)])

    def _jacobian_U_p(self, t, p, v):
        return self._U_p(t, p, v) if self._U_p is not None else _columns(lambda x: self._U(t, x, v), p)

    def _jacobian_U_v(self, t, p, v):
        return self._U_v(t, p, v) if self._U_v is not None else _columns(lambda x: self._U(t, p, x), v)


def _called(name, function, t, *state):
    """The return value of the user's function; its exceptions become UserFunctionError."""
    try:
        return function(t, *state)
    except Exception as error:
        raise UserFunctionError(f"{name} of the problem", t, error) from error


def _checked(name, function, shape):
    """The user's function, with its values copied and checked at every call."""

    def checked(t, *state):
        value = _called(name, function, t, *state)
        try:
            array = np.array(value)
        except ValueError:  # rows of different lengths
            array = np.array(None)
        if array.dtype.kind not in "fiub":
            raise InputError(f"HessenbergProblem: {name} returned {value!r}, needs real numbers (t = {t:g})")
        if array.shape != shape:
            raise InputError(f"HessenbergProblem: {name} returned shape {array.shape}, needs {shape} (t = {t:g})")
        return array.astype(float, copy=False)

    return checked


def _columns(function, x):
    """Forward-difference Jacobian: enough for a Newton matrix."""
    at = function(x)
    jacobian = np.empty((len(at), len(x)))
    for i in range(len(x)):
        moved = x.copy()
        moved[i] += 1.5e-8 * (1.0 + abs(x[i]))
        jacobian[:, i] = (function(moved) - at) / (moved[i] - x[i])
    return jacobian


def _along(function, t, p, dt, dp):
    """Derivative of function(t + ε dt, p + ε dp) at ε = 0 by fourth-order central differences."""
    e = 1e-3 * (1.0 + largest(p)) / (1.0 + abs(dt) + largest(dp))
    at = [function(t + s * e * dt, p + s * e * dp) for s in (-2, -1, 1, 2)]
    return (at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * e)


def _second_along(function, t, p, dp, ddp):
    """Second derivative of function(t + ε, p + ε dp + ε²/2 ddp) at ε = 0, sixth-order central differences."""
    e = 2e-2 * (1.0 + largest(p)) / (2.0 + largest(dp))
    weights = {-3: 2.0, -2: -27.0, -1: 270.0, 0: -490.0, 1: 270.0, 2: -27.0, 3: 2.0}
    total = sum(w * function(t + s * e, p + s * e * dp + 0.5 * (s * e) ** 2 * ddp) for s, w in weights.items())
    return total / (180.0 * e**2)
