"""A user-defined constraint Φ(t, q) = 0, with or without its Jacobian."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .breakpoints import depends_on_time, knots_of, time_function
from .checks import name, number, put, put_checked, require_functions, returned
from .joint_constraints import Rows
from .lie import integrate
from .motion import TIME_STEP, UNLIMITED, check_rate, check_slope, first, in_time

REACH = 10.0  # times `step`: step of the second difference along the motion
CHECKED_OVER = (1.0, 1e-2, 1e-4, 1e-6)  # fractions of the steps with which user-defined derivatives are checked


@dataclass(frozen=True, eq=False)
class Constraint:
    """A user-defined constraint Φ(t, q) = 0, passed with the loops of a mechanism.

    Its multipliers λ give the generalised forces Jᵀλ; their unit is N·m where Φ is an angle in rad, N where it is a
    length in m. Scale Φ to one of these: loops count as closed at |Φ| < 1e-10.

    Parameters
    ----------
    name : str
    function : callable
        ``function(t, q) -> array (size,)``, smooth, for every configuration q (nq,) that assembly may try; called with
        read-only arrays.
    size : int
        Number of rows.
    jacobian : callable, optional
        ``jacobian(t, q) -> array (size, nv)``, ∂Φ/∂q in the tangent space of q, one column per velocity. Default:
        sixth-order differences, six calls of `function` for each of the nv columns, accurate to about 1e-12 of Φ's
        terms; the multipliers have the same error. BDF then keeps tolerances down to about 4e-10, Radau somewhat lower.
    rate : callable, optional
        ``rate(t, q) -> array (size,)``, ∂Φ/∂t. Default: sixth-order differences over 1 ms, or less if Φ
        is faster, accurate to about 1e-12.
    moving : bool, optional
        Whether Φ depends on t. If not, its time derivatives are not computed. Default: True, unless `function` is a
        Python function that does not use its argument t.
    rows : sequence of str, optional
        Names of the rows for reports. Default "0", "1", ….
    knots : sequence of float
        Times, s, at which Φ or one of its first two time derivatives jumps, as for :class:`Drive`.
    step : float
        Step of the difference quotients, rad or m: about a thousandth of the length over which Φ varies.
    unilateral : bool
        Whether its rows can only push towards larger Φ, λ ≥ 0, as a cam pushes its follower. They are enforced as
        equalities nevertheless; :meth:`Solution.check` names the time from which they pull.

    Raises
    ------
    InputError
        Invalid arguments; at the start of a run, a Jacobian or rate that is not that of `function`; during a run, wrong
        shapes and numbers that are not finite.
    UserFunctionError
        One of the functions raised an exception.
    """

    name: str
    function: Callable
    size: int
    jacobian: Callable | None = None
    rate: Callable | None = None
    moving: bool = None  # type: ignore[assignment]  # a bool after __post_init__
    rows: tuple[str, ...] = None  # type: ignore[assignment]  # a tuple after __post_init__
    step: float = 1e-3
    unilateral: bool = False
    knots: Sequence[float] = ()

    kind: ClassVar[str] = "constraint"

    def __post_init__(self):
        who = f"constraint {self.name!r}"
        put_checked(self, who, name, "name")
        require_functions(self, who, "(t, q)", "function", optional=("jacobian", "rate"))
        if isinstance(self.size, bool) or not isinstance(self.size, int | np.integer) or self.size < 1:
            raise InputError(f"{who}: size must be a positive whole number, got {self.size!r}")
        if self.moving is None:
            put(self, moving=self.rate is not None or depends_on_time(self.function))
        if self.rate is not None and not self.moving:
            raise InputError(f"{who}: it has a rate, which contradicts moving=False")
        number(self.step, f"{who}: step", above=0.0)
        put(self, knots=knots_of(self.knots, f"{who}: knots"))
        rows = tuple(map(str, range(self.size))) if self.rows is None else self.rows
        if isinstance(rows, str) or len(rows := tuple(rows)) != self.size or not all(isinstance(r, str) for r in rows):
            raise InputError(f"{who}: rows needs {self.size} names, got {self.rows!r}")
        put(self, rows=rows)


class ConstraintRows(Rows):
    """The rows of a user-defined constraint on a model."""

    def __init__(self, model: pin.Model, constraint: Constraint):
        self.model, self.loop = model, constraint
        self.moving, self.steady = constraint.moving, not constraint.moving
        self.turns = (True,) * constraint.size  # Φ is not scaled
        self.difference_step = np.inf if constraint.jacobian is not None else constraint.step
        self._units = np.eye(model.nv)

    def evaluate(self, q, t):
        t = self.breakpoints.inside(t)
        return self._phi(t, q), self._jacobian(t, q)

    def functions_of_time(self, q, v):
        if not self.moving:
            return []
        return [time_function(self.loop.function, lambda t: self._phi(t, q), 2, self.loop.knots)]

    def rate(self, t, q):
        if not self.moving:
            return super().rate(t, q)
        t = self.breakpoints.inside(t)
        if self.loop.rate is not None:
            return self._call("rate", t, q)
        return in_time(lambda s: self._phi(t + s, q), 1, TIME_STEP, *self.breakpoints.reach(t))

    def acceleration_bias(self, t, q, v):
        if not self.moving and (self._phi(t + TIME_STEP, q) != self._phi(t, q)).any():
            raise InputError(f"constraint {self.loop.name!r} has moving=False, but Φ changes with time at t = {t:.6g}")
        fastest = np.max(np.abs(v), initial=0.0)
        step = min(TIME_STEP if self.moving else np.inf, REACH * self.loop.step / fastest if fastest else np.inf)
        if step == np.inf:
            return np.zeros(self.loop.size)
        t = self.breakpoints.inside(t)
        reach = self.breakpoints.reach(t) if self.moving else (UNLIMITED, True)

        def place(s):
            return integrate(self.model, q, s * v)

        if self.loop.jacobian is not None and (self.loop.rate is not None or not self.moving):
            return in_time(lambda s: self._jacobian(t + s, x := place(s)) @ v + self.rate(t + s, x), 1, step, *reach)
        return in_time(lambda s: self._phi(t + s, place(s)), 2, step, *reach)

    def check_derivatives(self, t, q) -> None:
        who = f"constraint {self.loop.name!r}:"
        if self.loop.jacobian is not None:
            J, steps = self._jacobian(t, q), [self.loop.step * share for share in CHECKED_OVER]
            for i, unit in enumerate(self._units):
                what, along = f"{who} column {i} of its jacobian", self._along(t, q, unit)
                check_slope(what, "function", J[:, i], along, steps, np.abs(J).max(axis=1))
        if self.loop.rate is not None:
            steps = [TIME_STEP * share for share in CHECKED_OVER]
            check_rate(f"{who} its rate", "function", lambda t: self._phi(t, q), lambda t: self.rate(t, q), t, steps)

    def _along(self, t, q, unit):
        return lambda s: self._phi(t, integrate(self.model, q, s * unit))

    def _phi(self, t, q):
        return self._call("function", t, q)

    def _jacobian(self, t, q):
        if self.loop.jacobian is not None:
            return self._call("jacobian", t, q, (self.model.nv,))
        return np.column_stack([first(self._along(t, q, unit), self.loop.step) for unit in self._units])

    def _call(self, field, t, q, columns=()):
        what, shape = f"constraint {self.loop.name!r}: its {field}", (self.loop.size, *columns)
        hint = ", one column for each joint velocity" if columns else ""
        value = np.array(returned(getattr(self.loop, field), what, shape, t, q, hint=hint))
        if not np.isfinite(value).all():
            raise InputError(
                f"{what} returned a number that is not finite at t = {t:.6g}, "
                f"q = {np.array2string(q, precision=4, threshold=12)}; it must be defined for every q that assembly or "
                "Newton's iteration may try"
            )
        return value
