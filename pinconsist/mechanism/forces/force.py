"""The interface of forces: protocol, records, records bound to a model; joint torques and user-defined laws."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from ...engine.systems import blank_system
from ...errors import InputError
from ..breakpoints import (
    NONE,
    Breakpoints,
    TimeCurve,
    TimeFunction,
    depends_on_time,
    time_function,
    with_own_state,
)
from ..checks import amounts, called, columns, function_name, put, real_array, require_functions, returned, spread
from ..motion import Motion, slope
from .points import points_of

MOST_NAMED = 3  # joints in a label
NARROW = 2e-6  # rad, m or of a velocity: step of differences of fourth order, for transitions of 1e-4 and wider


class Force(Protocol):
    """A generalised force τ on the joints, shape (nv,), N·m (or N).

    A force that depends on the model has a method ``bind(model)`` instead, which returns such an object. It may also
    have a ``label``, its name in reports, and a method ``stored(q, v) -> (energy, rate)``, J and W, if it stores
    elastic energy.
    """

    def torque(self, t: float, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        """τ at a state."""

    def derivatives(self, t: float, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(∂τ/∂q, ∂τ/∂v), each (nv, nv) in the tangent space, or None where it is zero or small."""


class ForceRecord:
    """A force in plain numbers that refers to joints and frames by name; it is not bound to a model."""

    _kind: ClassVar[str]
    _acts_on: ClassVar[str]  # the field with the joints or frames
    _law: ClassVar[Any]  # (record, model) → BoundForce

    @property
    def label(self) -> str:
        """The name of the force in energy reports and messages: "damping crank, rocker", without joints if many."""
        where = getattr(self, self._acts_on) or ()
        names = [where] if isinstance(where, str) else list(where)
        named = 0 < len(names) <= MOST_NAMED and isinstance(names[0], str)  # otherwise one number for each velocity
        return f"{self._kind} {', '.join(names)}" if named else self._kind

    def bind(self, model) -> Any:
        """The force on one `model`, an object with ``torque(t, q, v)`` and ``derivatives(t, q, v)``; systems call it.

        Raises InputError for a joint or frame that the model does not have, or has several times, and for numbers that
        do not fit its velocities.
        """
        return self._law(self, model)


class BoundForce(ABC):
    """A record bound to a model; by default it depends on time only, and the engine calls it.

    It is `smooth` if it never bends or jumps within a step; otherwise Radau evaluates it also between its stages.
    `by_time` says that it bends or jumps only as its functions of time do. If it `stores` elastic energy, it has
    ``stored(q, v) -> (energy, rate)``, J and W. If it `changes` at times of its own, it has ``start(t, backwards)``,
    ``next_change(t)`` and ``change(t, q, v)`` as a system. `widths` are those of a system, see :class:`Index3System`.
    `breakpoints` are those of the system.
    """

    smooth = by_time = stores = changes = False
    widths: np.ndarray | None = None
    breakpoints: Breakpoints = NONE

    @abstractmethod
    def torque(self, t, q, v): ...

    def derivatives(self, t, q, v):
        return None, None

    def loads(self, t, q, v) -> list[tuple]:
        """(joint, point, force, moment) on each body on which it acts, in world axes; none if it acts on joints."""
        return []

    def element(self, t, q, v) -> dict[str, Any]:
        """Its ``force``, ``moment``, ``length`` and ``speed``, those that it has: see :class:`ElementForce`."""
        return {}

    def set_breakpoints(self, breakpoints) -> None:
        self.breakpoints = breakpoints

    def functions_of_time(self, q, v) -> list[TimeFunction]:
        """The functions of time; those of a law f(t, q, v) are at this state."""
        return []

    def hand_over(self, compiled) -> None:
        """Add this law to the compiled system."""
        compiled.add_python_force(self)


class CompiledForce(BoundForce):
    """A record whose law is in the engine: ``hand_over`` adds its numbers and its `curves`, functions of time."""

    def __init__(self, model):
        self._model = model
        self._points = points_of(model)
        self.curves: list[TimeCurve] = []

    def set_breakpoints(self, breakpoints) -> None:
        for curve in self.curves:
            curve.breakpoints = breakpoints

    def functions_of_time(self, q, v):
        return [time_function(curve.function, curve.value) for curve in self.curves]

    @abstractmethod
    def hand_over(self, compiled) -> None: ...

    @cached_property
    def _alone(self):
        """A compiled system with this force only."""
        alone = blank_system(self._model, self._points)
        self.hand_over(alone)
        return alone

    def torque(self, t, q, v):
        return self._alone.torque(t, q, v)

    def derivatives(self, t, q, v):
        return self._alone.torque_derivatives(t, q, v)

    def loads(self, t, q, v):
        return self._alone.loads(t, q, v)

    def _along(self, t, q, v):
        """Force, length and speed of an element that has a length."""
        return dict(zip(("force", "length", "speed"), self._alone.along(t, q, v), strict=True))


class StoringForce(CompiledForce):
    """A record whose law is in the engine, and that stores elastic energy."""

    stores = True

    def stored(self, q, v) -> tuple[float, float]:
        return self._alone.stored(q, v)


class _BoundTorque(CompiledForce):
    by_time = True

    def __init__(self, record, model):
        super().__init__(model)
        constant, functions = record.torques, {}
        if isinstance(constant, Mapping):
            functions = {joint: torque for joint, torque in constant.items() if callable(torque)}
            constant = {joint: torque for joint, torque in constant.items() if joint not in functions}
        self._constant = spread(model, constant, "JointTorque")
        self._motions: list[tuple[Motion, int]] = []  # with their columns
        self._columns: list[tuple[int, int]] = []  # the first column, and the number, of each curve
        for joint, function in functions.items():
            here = columns(model, joint, "JointTorque")
            size = here.stop - here.start
            if type(function) is Motion and size == 1:
                self._motions.append((function, here.start))
            else:
                shape = (size,) if size > 1 else ()
                self.curves.append(TimeCurve(function, f"the torque of joint {joint!r}", shape))
                self._columns.append((here.start, size))
        self.smooth = not self.curves

    @property
    def constant(self):
        """τ, shape (nv,), or None if some of it depends on time."""
        return None if self.curves or self._motions else self._constant

    def hand_over(self, compiled) -> None:
        compiled.add_constant(self._constant)
        for motion, column in self._motions:
            compiled.add_torque_curve(column, motion.numbers)
        for curve, (column, size) in zip(self.curves, self._columns, strict=True):
            if size == 1:
                compiled.add_torque_curve(column, curve)
            else:
                compiled.add_time_torque(column, size, curve)


@dataclass(frozen=True)
class JointTorque(ForceRecord):
    """Torques at joints, constant or as functions of time.

    Parameters
    ----------
    torques : mapping or sequence of nv numbers
        Joint name → torque, N·m (or N): a number, one number for each velocity of the joint, or a function of time that
        returns either, for instance a :class:`Motion`. Or constant torques for all nv joint velocities.

    Raises
    ------
    InputError
        Invalid numbers; on a model, unknown joints and wrong sizes; during a run, an invalid return value of a
        function.
    UserFunctionError
        A function raised an exception.
    """

    torques: Mapping[str, float | tuple | Callable] | tuple[float, ...]

    _kind, _acts_on, _law = "torque", "torques", _BoundTorque

    def __post_init__(self):
        put(self, torques=amounts(self.torques, "JointTorque", functions=True))


@dataclass(frozen=True, eq=False)
class Torque:
    """A user-defined law τ = f(t, q, v).

    Parameters
    ----------
    function : callable
        ``f(t, q, v) -> array (nv,)``; called with read-only arrays.
    gradient : callable, optional
        ``g(t, q, v) -> (∂τ/∂q, ∂τ/∂v)`` in the tangent space; either may be None. Without it ∂τ/∂v is computed by
        finite differences, and ∂τ/∂q is omitted from Newton's matrix (never from the residual).

    Raises
    ------
    InputError
        During a run: wrong shapes, complex numbers.
    UserFunctionError
        A function raised an exception.
    """

    function: Callable
    gradient: Callable | None = None

    def __post_init__(self):
        require_functions(self, "Torque", "(t, q, v)", "function", optional=("gradient",))

    @property
    def label(self) -> str:
        """The name of the force in energy reports and messages."""
        return f"torque {function_name(self.function)}"

    def torque(self, t, q, v) -> np.ndarray:
        """τ at time `t`, configuration `q` (nq,) and velocity `v` (nv,): the return value of the function, N·m or N.

        Returns an array (nv,). Raises InputError for another shape or numbers that are not real, and UserFunctionError
        if the function raises.
        """
        what = f"the torque function {function_name(self.function)}"
        return returned(self.function, what, v.shape, t, q, v)

    def derivatives(self, t, q, v) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(∂τ/∂q, ∂τ/∂v) at `t`, `q`, `v`, each (nv, nv) in the tangent space, or None: what ``gradient`` returns.

        Without a ``gradient``, ∂τ/∂q is None and ∂τ/∂v is computed by forward differences. Raises the errors of
        :meth:`torque`, and InputError for numbers that are not finite.
        """
        if self.gradient is not None:
            return _gradient(self.gradient, f"the gradient {function_name(self.gradient)}", t, q, v)
        at = self.torque(t, q, v)
        columns = np.empty((len(v), len(v)))
        for i, step in enumerate(1e-7 * (1.0 + np.abs(v))):
            moved = v.copy()
            moved[i] += step
            with np.errstate(invalid="ignore"):  # infinite torques are reported by the caller
                columns[:, i] = (self.torque(t, q, moved) - at) / step
        return None, columns


class UserForce(BoundForce):
    """A user-defined force object, whose return values are checked."""

    returns_derivatives = True

    def __init__(self, force, label):
        self._force, self._label = force, label
        if hasattr(force, "stored"):
            self.stores, self.stored = True, force.stored

    def torque(self, t, q, v):
        t = self.breakpoints.inside(t)
        return returned(self._force.torque, f"the torque of {self._label!r}", v.shape, t, q, v)

    def derivatives(self, t, q, v):
        t = self.breakpoints.inside(t)
        return _gradient(self._force.derivatives, f"the derivatives of {self._label!r}", t, q, v)

    def functions_of_time(self, q, v):
        return _of_law(self._force.torque, self._label, q, v)


class BoundLaw(BoundForce):
    """A user-defined law in a system."""

    def __init__(self, force):
        self._force, self.returns_derivatives = force, force.gradient is not None

    def torque(self, t, q, v):
        return self._force.torque(self.breakpoints.inside(t), q, v)

    def derivatives(self, t, q, v):
        return self._force.derivatives(self.breakpoints.inside(t), q, v)

    def functions_of_time(self, q, v):
        return _of_law(self._force.function, self._force.label, q, v)


def _of_law(function, label, q, v):
    """A law f(t, q, v) as a function of time alone, if it depends on time."""
    own = None

    def value(t):
        nonlocal own
        own = own or with_own_state(function)
        return returned(own, f"the torque of {label!r}", v.shape, t, q, v)

    return [TimeFunction(value)] if depends_on_time(function) else []


class Differentiated(BoundForce):
    """A user-defined force with all of its derivatives: those that it does not return are differences.

    Newton's iteration converges without them, but derivatives of runs are wrong. `integrate` moves configurations.
    """

    def __init__(self, force, integrate):
        self._force, self._integrate = force, integrate

    def torque(self, t, q, v):
        return self._force.torque(t, q, v)

    def derivatives(self, t, q, v):
        by_q, by_v = self._force.derivatives(t, q, v) if self._force.returns_derivatives else (None, None)
        if by_q is None:
            by_q = self._columns(lambda e: self.torque(t, self._integrate(q, e), v), np.full(len(v), NARROW))
        if by_v is None:
            by_v = self._columns(lambda e: self.torque(t, q, v + e), NARROW * (1.0 + np.abs(v)))
        return by_q, by_v

    @staticmethod
    def _columns(function, steps):
        units = np.eye(len(steps))
        return np.column_stack([slope(lambda s, e=e: function(s * e), h) for e, h in zip(units, steps, strict=True)])


def as_force(force) -> Any:
    """A force from user input: a Force, joint torques by name or as an array, or a callable f(t, q, v)."""
    if isinstance(force, type):
        raise InputError(f"a force must be an object, not the class {force.__name__}: pass {force.__name__}(…)")
    if hasattr(force, "bind") or (hasattr(force, "torque") and hasattr(force, "derivatives")):
        return force
    if isinstance(force, Mapping):
        return JointTorque(force)
    if callable(force):
        return Torque(force)
    if isinstance(force, str | bytes) or np.ndim(force) != 1:
        raise InputError(
            "a force must be a Force, a mapping joint → torque, an array of joint torques or a callable f(t, q, v), "
            f"got {force!r}"
        )
    return JointTorque(force)


def label_of(force) -> str:
    """The name of a force of any kind in reports."""
    return getattr(force, "label", "") or type(force).__name__


def bound_force(model, force, label):
    """A force of any kind, bound to a model."""
    force = force.bind(model) if hasattr(force, "bind") else force
    if isinstance(force, Torque):
        return BoundLaw(force)
    return force if isinstance(force, BoundForce) else UserForce(force, label)


def _gradient(function, what, t, q, v):
    parts, shape = called(function, what, t, q, v), (len(v), len(v))
    wanted = f"at t = {t:.6g}; it must return two matrices of shape {shape}, (∂τ/∂q, ∂τ/∂v), or None for either"
    if not (isinstance(parts, tuple | list) and len(parts) == 2):
        raise InputError(f"{what} returned {parts!r} {wanted}")
    found = tuple(None if part is None else real_array(part, what, shape, t) for part in parts)
    if not all(part is None or np.isfinite(part).all() for part in found):
        raise InputError(f"{what} returned a number that is not finite {wanted}")
    return found


def unused(wanted: str, taken) -> str:
    """`wanted`, or "wanted 2", "wanted 3", … if it is taken."""
    found, count = wanted, 1
    while found in taken:
        count += 1
        found = f"{wanted} {count}"
    return found
