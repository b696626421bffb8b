"""The options of a run, and the method that they mean."""

import logging
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..engine import constant
from ..engine.bdf import MAX_ORDER
from ..engine.consistency import MODES, check_mode
from ..engine.norms import EPS
from ..engine.radau_table import STAGES
from ..engine.rounding import shortest_step
from ..errors import InputError, warn
from ..mechanism.checks import finite_array
from .control import ErrorControl, FixedStep
from .integrate import Method

log = logging.getLogger(__name__)

MAX_ADAPTIVE_ORDER = 5  # of BDF
METHODS = ("Radau", "BDF", "ImplicitEuler")

# With more, a step of Radau, whose equations have all stages, costs more than the steps of BDF that it replaces.
MOST_FREEDOMS_OF_RADAU = 32


def span_of(t_span):
    """(start, end) as two numbers, or InputError."""
    span = finite_array(t_span, "t_span")
    if span.shape != (2,):
        raise InputError(f"t_span needs two numbers (start, end), got {t_span!r}")
    return float(span[0]), float(span[1])


@dataclass(frozen=True)
class Options:
    """The options of a run that concern its method, as :func:`pinconsist.simulate` has them.

    Raises
    ------
    InputError
        A value that no run can have.
    """

    method: str | None = None
    step: float | None = None
    order: int | None = None
    rtol: Any = 1e-6
    atol: Any = 1e-8
    consistency: str = "every-step"
    first_step: float | None = None
    max_step: float = np.inf
    max_steps: int | None = None

    def __post_init__(self):
        self._require_choice("method", None, *METHODS)
        self._require_choice("consistency", *MODES)
        check_mode(self.consistency, self.step is not None)
        most = self.max_steps
        if most is not None and (not isinstance(most, int | np.integer) or most < 1):
            raise InputError(f"max_steps must be a positive whole number, got {most!r}")

    def _require_choice(self, what, *choices) -> None:
        value = getattr(self, what)
        if not ((isinstance(value, str) or value is None) and value in choices):
            names = ", ".join(repr(choice) for choice in choices if choice is not None)
            raise InputError(f"unknown {what} {value!r}; choose from {names}")

    def chosen(self, freedoms) -> str:
        """The name of the method, for a system of so many degrees of freedom."""
        if self.method is not None:
            return self.method
        if self.consistency != "every-step":
            return "BDF"
        plain = self.step is None and self.order is None
        return "BDF" if plain and freedoms > MOST_FREEDOMS_OF_RADAU else "Radau"

    def for_span(self, span, freedoms=0) -> Method:
        """The method of a run over `span`, (start, end) in s, of a system with so many degrees of freedom."""
        name = self.chosen(freedoms)
        stages = None
        if name == "Radau":
            stages = self._stages()  # 0 where the method chooses them
            order = 2 * int(stages or constant("MOST_STAGES")) - 1
        elif name == "BDF":
            order = self._order()
        else:
            order = 1
        most = None if self.max_steps is None else int(self.max_steps)
        if self.step is not None:
            step = self._fixed_step(span)
            return Method(order, self.consistency, FixedStep(), step, max_steps=most, stages=stages)
        first = None if self.first_step is None else positive_time(self.first_step, "first_step")
        control = self._error_control(order, stages)
        return Method(order, self.consistency, control, None, first, most, stages=stages)

    def _order(self) -> int:
        highest = MAX_ORDER if self.step is not None else MAX_ADAPTIVE_ORDER
        order = self.order
        if order is None:
            return MAX_ADAPTIVE_ORDER
        if isinstance(order, bool) or not isinstance(order, int | np.integer) or not 1 <= order <= highest:
            raise InputError(f"order must be a whole number from 1 to {highest}, got {order!r}")
        return int(order)

    def _stages(self) -> int:
        """The stages of Radau IIA; 0 if the method chooses them together with the step size."""
        if self.consistency != "every-step":
            raise InputError(
                f"consistency={self.consistency!r} is a mode of BDF, whose steps depend on earlier ones. A step of "
                "Radau depends only on (q, v), and its end is projected: omit consistency. To see the effect of exact "
                "values on a method that does not correct them, use method='ImplicitEuler'"
            )
        orders = {2 * s - 1: s for s in STAGES}
        order = self.order
        if order is None:
            return 0 if self.step is None else int(constant("FIRST_STAGES"))
        if isinstance(order, bool) or not isinstance(order, int | float | np.number) or order not in orders:
            choices = ", ".join(map(str, orders))
            raise InputError(f"order must be one of {choices} with Radau, got {order!r}; method='BDF' has 1 to 6")
        return orders[int(order)]

    def _fixed_step(self, span) -> float:
        step = positive_time(self.step, "step")
        if step < shortest_step(*span):
            raise InputError(f"step = {step:g} s is too small to differ from zero at t = {max(map(abs, span)):g} s")
        steps = abs(span[1] - span[0]) / step
        if self.max_steps is None and steps > constant("ENDLESS"):
            raise InputError(f"step = {step:g} s makes {steps:.1g} steps until t = {span[1]:g} s; set max_steps to try")
        return step

    def _error_control(self, order, stages) -> ErrorControl:
        unlimited = isinstance(self.max_step, float | np.floating) and self.max_step == np.inf
        max_step = np.inf if unlimited else positive_time(self.max_step, "max_step")
        rtol = _pair(self.rtol, "rtol")
        atol = _pair(self.atol, "atol")
        control = ErrorControl(rtol, atol, order, max_step, self.consistency == "every-step", stages)
        asked = control.asked[0]
        if asked < 1e-13:
            raise InputError(f"rtol = {self.rtol!r} is below 1e-13, which double precision cannot reach")
        if max(max(part.ravel().tolist()) for part in rtol) >= 1.0:
            raise InputError(
                f"rtol = {self.rtol!r} allows errors as large as the solution; choose less than 1, such as 1e-3"
            )
        if asked < control.best:
            better = "" if order >= MAX_ADAPTIVE_ORDER else f"; order 5 gives {ErrorControl((), (), 5, 1.0).best:.1g}"
            log.warning(
                "rtol = %g: order %d gives about %.1g in double precision%s", asked, order, control.best, better
            )
        return control


def without_backend(backend) -> None:
    """Warn of an argument that no longer has an effect."""
    if backend is not None:
        warn("backend= is deprecated and has no effect: all runs use the compiled method. Omit it")


def warn_of_differences(system, method) -> None:
    """Log the accuracy that BDF can reach if the Jacobian of a constraint is made of difference quotients."""
    best = 10.0 * constant("SURE") * EPS / system.difference_step
    if method.step is None and method.stages is None and method.control.asked[0] < best:
        why = "rtol = %g: constraints without a jacobian give about %.0g; pass one, or use method='Radau'"
        log.warning(why, method.control.asked[0], best)


def looking(method, system, span) -> Method:
    """The method with its largest step limited so that short pulses are seen, where laws of the state may have them."""
    if method.step is not None or method.control.max_step < np.inf or not system.may_act_later:
        return method
    longest = method.control.longest * max(abs(span[1] - span[0]), shortest_step(*span))
    return replace(method, control=replace(method.control, max_step=longest))


def positive_time(value, what) -> float:
    """A positive number of seconds, or InputError."""
    value, given = finite_array(value, what), value
    if value.shape != () or not value > 0 or isinstance(given, bool):
        raise InputError(f"{what} must be a positive number of seconds, got {given!s}")
    return float(value)


def _pair(value, what) -> tuple:
    """(position part, velocity part) of a tolerance."""
    given = value if isinstance(value, tuple) and len(value) == 2 else (value,)
    parts = tuple(finite_array(part, what) for part in given)
    if any(part.ndim > 1 or part.size == 0 or min(part.ravel().tolist()) <= 0.0 for part in parts):
        raise InputError(f"{what} must be a positive number, or (for q, for v), got {value!r}")
    return parts if len(parts) == 2 else 2 * parts
