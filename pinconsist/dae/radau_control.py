"""Step and stages of Radau IIA: what follows from the error estimate and from how Newton went."""

from __future__ import annotations

from dataclasses import dataclass, field

from .control import ErrorControl
from .tuning import MAX_FACTOR, MIN_FACTOR, SMOOTH, STAGE_AFTER_FAILURE, STAGE_GROWTH, STAGE_SAFETY


@dataclass
class RadauControl(ErrorControl):
    """The step from the error estimate, and Gustafsson's prediction of the next one; ``stages`` None: chosen."""

    stages: int | None = None
    _last: tuple | None = field(default=None, init=False, repr=False, compare=False)  # h and error of the last step

    best = 1e-13

    def step_tolerance(self, tol):
        return tol

    def restart(self) -> None:
        """Forget the last step."""
        self._last = None

    def after_failure(self, h):
        """The step after Newton failed."""
        self.reasons["newton"] += 1
        self._last = None
        return STAGE_AFTER_FAILURE * h

    def after_rejection(self, s, h, error):
        """The step with which to try again."""
        self.reasons["error"] += 1
        return h * max(MIN_FACTOR, STAGE_SAFETY * error ** (-1.0 / exponent(s)))

    def next_step(self, s, h, error):
        """The step after an accepted one."""
        error = max(error, 1e-10)
        factor = error ** (-1.0 / exponent(s))
        if self._last is not None:
            h_old, error_old = self._last
            factor *= min(1.0, abs(h / h_old) * (error_old / error) ** (1.0 / exponent(s)))
        growth = MAX_FACTOR if self._last is None or error < SMOOTH else STAGE_GROWTH
        self._last = h, max(error, 1e-2)
        factor = min(growth, max(MIN_FACTOR, STAGE_SAFETY * factor))
        return h * min(factor, self.max_step / abs(h))


def exponent(s) -> int:
    """The power of h by which the error estimate with s stages falls."""
    return s + 2 if s >= 3 else s + 1
