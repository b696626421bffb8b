"""The options of a run: checks of the arguments, and the method for the integration loop of dae."""

import logging
from dataclasses import replace

import numpy as np

from .dae import integrate as dae
from .dae.consistency import MODES, check_mode
from .dae.control import ErrorControl, FixedStep
from .dae.norms import EPS
from .dae.rounding import shortest_step
from .dae.tuning import ENDLESS, FIRST_STAGES, MAX_ADAPTIVE_ORDER, MAX_ORDER, MOST_STAGES, STAGES, SURE
from .errors import InputError, warn
from .mechanism.checks import finite_array

log = logging.getLogger(__name__)

METHODS = ("BDF", "Radau", "ImplicitEuler")


def span_of(t_span):
    """(start, end) as two numbers, or InputError."""
    span = finite_array(t_span, "t_span")
    if span.shape != (2,):
        raise InputError(f"t_span needs two numbers (start, end), got {t_span!r}")
    return float(span[0]), float(span[1])


def method_of(span, method, step, max_order, rtol, atol, consistency, first_step, max_step, max_steps) -> dae.Method:
    """The method that the arguments of :func:`pinconsist.simulate` ask for, or InputError."""
    choices = (("method", method, METHODS), ("consistency", consistency, MODES))
    for what, chosen, known in choices:
        if not (isinstance(chosen, str) and chosen in known):
            raise InputError(f"unknown {what} {chosen!r}; choose from {', '.join(map(repr, known))}")
    stages = _stages(max_order, step, consistency) if method == "Radau" else None
    check_mode(consistency, step is not None)
    if stages is not None:  # 0 where the method chooses them
        order = 2 * (stages or MOST_STAGES) - 1
    else:
        order = 1 if method == "ImplicitEuler" else _order(max_order, step)
    if max_steps is not None and (not isinstance(max_steps, int | np.integer) or max_steps < 1):
        raise InputError(f"max_steps must be a positive whole number, got {max_steps!r}")
    max_steps = None if max_steps is None else int(max_steps)
    if step is not None:
        step = positive_time(step, "step")
        if step < shortest_step(*span):
            raise InputError(f"step = {step:g} s is too small to differ from zero at t = {max(map(abs, span)):g} s")
        if max_steps is None and (steps := abs(span[1] - span[0]) / step) > ENDLESS:
            raise InputError(f"step = {step:g} s makes {steps:.1g} steps until t = {span[1]:g} s; set max_steps to try")
        return dae.Method(order, consistency, FixedStep(), step, max_steps=max_steps, stages=stages)
    first_step = None if first_step is None else positive_time(first_step, "first_step")
    unlimited = isinstance(max_step, float | np.floating) and max_step == np.inf
    max_step = np.inf if unlimited else positive_time(max_step, "max_step")
    tolerances = _pair(rtol, "rtol"), _pair(atol, "atol")
    control = ErrorControl(*tolerances, order, max_step, consistency == "every-step", stages)
    asked = control.asked[0]
    if asked < 1e-13:
        raise InputError(f"rtol = {rtol!r} is below 1e-13, which double precision cannot reach")
    if max(max(part.ravel().tolist()) for part in control.rtol) >= 1.0:
        raise InputError(f"rtol = {rtol!r} allows errors as large as the solution; choose less than 1, such as 1e-3")
    if asked < control.best:
        better = "" if order >= MAX_ADAPTIVE_ORDER else f"; order 5 gives {ErrorControl((), (), 5, 1.0).best:.1g}"
        log.warning("rtol = %g: order %d gives about %.1g in double precision%s", asked, order, control.best, better)
    return dae.Method(order, consistency, control, None, first_step, max_steps, stages=stages)


def without_backend(backend) -> None:
    """Warn of an argument that has no effect any more."""
    if backend is not None:
        warn("backend= has no effect any more: all runs are made by the compiled method. Leave it out")


def warn_of_differences(system, method) -> None:
    """Log the accuracy that BDF can reach if the Jacobian of a constraint is made of difference quotients."""
    best = 10.0 * SURE * EPS / system.difference_step
    if method.step is None and method.stages is None and method.control.asked[0] < best:
        why = "rtol = %g: constraints without a jacobian give about %.0g; pass one, or use method='Radau'"
        log.warning(why, method.control.asked[0], best)


def _order(max_order, step) -> int:
    highest = MAX_ORDER if step is not None else MAX_ADAPTIVE_ORDER
    if max_order is None:
        return MAX_ADAPTIVE_ORDER
    if isinstance(max_order, bool) or not isinstance(max_order, int | np.integer) or not 1 <= max_order <= highest:
        raise InputError(f"max_order must be a whole number from 1 to {highest}, got {max_order!r}")
    return int(max_order)


def _stages(max_order, step, consistency) -> int:
    """The stages of Radau IIA; 0 if the method chooses them together with the step size."""
    if consistency != "every-step":
        raise InputError(
            f"consistency={consistency!r} is a mode of BDF, whose steps depend on earlier ones. A step of Radau "
            "depends only on (q, v), and its end is projected: omit consistency. To see the effect of exact values on "
            "a method that does not correct them, use method='ImplicitEuler'"
        )
    orders = {2 * s - 1: s for s in STAGES}
    if max_order is None:
        return 0 if step is None else FIRST_STAGES
    if isinstance(max_order, bool) or not isinstance(max_order, int | float | np.number) or max_order not in orders:
        raise InputError(f"max_order of Radau must be one of {', '.join(map(str, orders))}, got {max_order!r}")
    return orders[int(max_order)]


def looking(method, system, span) -> dae.Method:
    """The method with steps that do not leap over what acts for a while only, where laws of the state may do so."""
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
