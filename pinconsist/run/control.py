"""Control of the step: a fixed step, or the accuracy that is asked of a run.

The multipliers are never in the error test: once every step is corrected they have the order of the velocities, and a
test on them would only react to their rounding floor.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..engine import constant
from ..engine.norms import EPS
from ..errors import InputError

LONGEST_OF_BDF = 0.05  # part of the span that a step of BDF covers at most if functions of time act, as at rest
LONGEST_STAGES = 0.1  # the same of Radau, which evaluates them within the step
BEST_OF_STAGES = 1e-12  # smallest tolerance that Radau can meet in double precision


@dataclass(frozen=True)
class Switches:
    """Features that exist only for speed, as in ``tuning.hpp``; `python -m benchmarks ablate` switches each off."""

    iteration_forecast: bool = True
    jacobian_reuse: bool = True
    kept_derivatives: bool = True
    few_derivatives: bool = True
    lanes: bool = True
    row_derivatives: bool = True
    kept_matrix: bool = True


@dataclass
class FixedStep:
    """The same step and order throughout; Newton iterates down to rounding; no step is rejected."""

    reasons: dict = field(default_factory=dict)

    def fit(self, system) -> None:
        """Nothing to prepare."""


@dataclass
class ErrorControl:
    """Step, and order or stages, from the errors of positions and velocities.

    Parameters
    ----------
    rtol, atol : tuple
        The accuracy of the run, relative to the largest value of each coordinate and absolute: (position part, velocity
        part), each a scalar or an array.
    max_order : int
        Of BDF, 1 to 5.
    max_step : float
        Largest |h|, s.
    noise : bool
        False if errors of raw BDF at a change of step must not count as rounding.
    stages : int, optional
        Of Radau IIA; 0 if the method chooses them. Default: BDF.
    """

    rtol: tuple
    atol: tuple
    max_order: int
    max_step: float
    noise: bool = True
    stages: int | None = None
    reasons: dict = field(default_factory=lambda: {"error": 0, "newton": 0})
    wanted: tuple = field(init=False, repr=False, compare=False)  # rtol, atol of the columns, set by `fit`

    def fit(self, system) -> None:
        """Tolerances for the columns [ξ | v] of a system."""
        self.wanted = self._columns(system, "rtol"), self._columns(system, "atol")

    @cached_property
    def asked(self) -> tuple[float, float]:
        """The smallest rtol and atol of the run."""
        rtol, atol = (min(min(part.ravel().tolist()) for part in parts) for parts in (self.rtol, self.atol))
        return rtol, atol

    @property
    def best(self) -> float:
        """The smallest tolerance that can be met in double precision."""
        if self.stages is not None:
            return BEST_OF_STAGES
        return self.rounding ** (self.max_order / (self.max_order + 1)) / constant("ACCURACY")

    @property
    def rounding(self) -> float:
        """Smallest tolerance of a step of BDF: rounding, eps/h in velocities, is below τ if τ > eps^((k+1)/(k+2))."""
        return 3.0 * EPS ** ((self.max_order + 1) / (self.max_order + 2))

    @property
    def longest(self) -> float:
        """The part of the span that a step covers at most if functions of time act."""
        return LONGEST_OF_BDF if self.stages is None else LONGEST_STAGES

    def _columns(self, system, name) -> np.ndarray:
        sizes, columns = (system.nx, system.nv), np.empty(system.nx + system.nv)
        try:
            columns[: system.nx], columns[system.nx :] = getattr(self, name)
        except ValueError:
            shapes = [np.shape(part) for part in getattr(self, name)]
            raise InputError(
                f"{name} for q and v: needs scalars, {sizes} numbers, or a tuple of the two; got shapes {shapes}"
            ) from None
        return columns
