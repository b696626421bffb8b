"""Step and stages of Radau IIA, chosen from the error estimate and from the convergence of Newton's iteration."""

from dataclasses import dataclass, field

from . import tuning
from .control import ErrorControl


@dataclass
class RadauControl(ErrorControl):
    """The step from the error estimate, by Gustafsson's prediction; the stages from Newton's convergence.

    Parameters
    ----------
    stages : int
        Fixed number of stages; 0: chosen during the run, as in Hairer and Wanner's RADAU.

    Attributes
    ----------
    s : int
        Stages of the next step.
    """

    stages: int = 0
    s: int = field(default=0, init=False)
    _last: tuple | None = field(default=None, init=False, repr=False, compare=False)  # h and error of the last step
    _calm: int = field(default=0, init=False, repr=False, compare=False)  # steps since stages changed or a failure
    _failures: int = field(default=0, init=False, repr=False, compare=False)  # failures until CALM such steps

    best, longest = 1e-12, tuning.LONGEST_STAGES

    def __post_init__(self):
        self.s = self.stages or tuning.FIRST_STAGES

    def use(self, s) -> None:
        """Continue with `s` stages, with the tolerance of a step that belongs to them."""
        self.s, self._calm, self._failures, self._last = s, 0, 0, None
        self._hold_steps()

    def step_tolerance(self, tol):
        """The tolerance τ of the estimate with which a run is as accurate as `tol`.

        The estimate falls like hᵉ, e = :func:`exponent`, the error of the run like h²ˢ⁻¹.
        """
        return _tolerance(tol, self.s)

    def of_stages(self, s) -> tuple[float, float]:
        """:attr:`newton_factor` and :attr:`slack` of `s` stages."""
        slack = _tolerance(tol := max(self.asked), s) / tol
        return min(tuning.STAGE_NEWTON_FACTOR[s], tuning.STAGE_LEFT / slack), slack

    @property
    def newton_factor(self) -> float:
        """Newton's tolerance as a fraction of τ: its errors add up, and do not fall with the order."""
        return self.of_stages(self.s)[0]

    @property
    def slack(self) -> float:
        """The tolerance of the estimate divided by that of the run."""
        return self.of_stages(self.s)[1]

    @property
    def worth_most(self) -> bool:
        """Whether the tolerance is tight enough for the largest number of stages."""
        return self.asked[0] <= tuning.MOST_STAGES_BELOW

    def chosen_after_step(self, rate, cut) -> int:
        """Stages after an accepted step in which Newton contracted by `rate`: more if it was fast for some steps.

        A step that is `cut`, as by the samples of a controller, would gain nothing from more stages.
        """
        self._calm += 1
        if self._calm < tuning.CALM or cut:
            return self.s
        self._failures = 0
        more = tuning.FIRST_STAGES if self.s < tuning.FIRST_STAGES else tuning.MOST_STAGES
        worth = self.s < tuning.FIRST_STAGES or self.worth_most
        return more if self.stages == 0 and worth and rate <= tuning.QUICK else self.s

    def chosen_after_failure(self) -> int:
        """Stages after Newton failed or a step shrank by MIN_FACTOR: fewer if that also happened shortly before."""
        self._calm, self._failures = 0, self._failures + 1
        fewer = tuning.FIRST_STAGES if self.s > tuning.FIRST_STAGES else tuning.FEWEST_STAGES
        return fewer if self.stages == 0 and self._failures >= 2 else self.s

    def restart(self) -> None:
        """Forget the last step."""
        self._last = None

    def after_failure(self, h):
        """The step after Newton failed."""
        self.reasons["newton"] += 1
        self._last = None
        return tuning.STAGE_AFTER_FAILURE * h

    def after_rejection(self, s, h, error):
        """The step for the next attempt."""
        self.reasons["error"] += 1
        return h * max(tuning.MIN_FACTOR, tuning.STAGE_SAFETY * error ** (-1.0 / exponent(s)))

    def next_step(self, s, h, error):
        """The step after an accepted one."""
        error = max(error, 1e-10)
        factor = error ** (-1.0 / exponent(s))
        if self._last is not None:
            h_old, error_old = self._last
            factor *= min(1.0, abs(h / h_old) * (error_old / error) ** (1.0 / exponent(s)))
        growth = tuning.MAX_FACTOR if self._last is None else tuning.STAGE_GROWTH
        self._last = h, max(error, 1e-2)
        factor = min(growth, max(tuning.MIN_FACTOR, tuning.STAGE_SAFETY * factor))
        return h * min(factor, self.max_step / abs(h))


def _tolerance(tol, s):
    return (tuning.STAGE_ACCURACY * tol) ** (exponent(s) / (2 * s - 1))


def exponent(s) -> int:
    """The power of h by which the error estimate with s stages falls."""
    return s + 2 if s >= 3 else s + 1
