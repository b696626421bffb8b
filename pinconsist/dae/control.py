"""Control of step and order: a fixed step, or an error controller on positions and velocities.

The multipliers are never in the error test: once every step is corrected they have the order of the velocities, and a
test on them would only react to their rounding floor.
"""

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ..errors import InputError
from . import bdf, tuning
from .norms import EPS, largest, weighted_norm
from .rounding import rounding_weights
from .tuning import (
    ACCURACY,
    AFTER_FAILURE,
    LONGEST,
    MAX_FACTOR,
    MIN_FACTOR,
    NEARLY,
    NEWTON_FACTOR,
    NOISE,
    PROBING,
    SAFETY,
    STIRRED,
    SURE,
)


@dataclass
class FixedStep:
    """The same step and order throughout; Newton iterates down to rounding; no step is rejected."""

    reasons: dict = field(default_factory=dict)

    def fit(self, system):
        """Nothing to prepare."""

    def weights(self, system, predicted, p, h):
        return rounding_weights(system, predicted)

    def error(self, system, d, k, weight) -> float:
        return 0.0

    def after_failure(self, h):
        return None

    def next_step(self, system, Z, k, h, error, weight):
        return h, k

    def reached(self, system, y, p):
        """Nothing to update."""

    def restart(self):
        """Nothing to forget."""


@dataclass
class ErrorControl:
    """Step and order from the local errors of ∇ᵏ, ∇ᵏ⁺¹, ∇ᵏ⁺², as in Shampine and Reichelt's codes.

    Parameters
    ----------
    rtol, atol : tuple
        The accuracy of the run, relative to the largest value of each coordinate and absolute: (position part, velocity
        part), each a scalar or an array. A single step has the tolerance :meth:`step_tolerance`.
    max_order : int
        1 to 5.
    max_step : float
        Largest |h|, s.
    """

    rtol: tuple
    atol: tuple
    max_order: int
    max_step: float
    noise: bool = True  # False if errors of raw BDF at a change of step must not count as rounding
    equal_steps: int = 0
    noisy_steps: int = 0  # with errors that were rounding, since a longer step was last tried
    reasons: dict = field(default_factory=lambda: {"error": 0, "newton": 0})
    wanted: tuple = field(init=False, repr=False, compare=False)  # rtol, atol of the columns, set by `fit`
    _rtol: np.ndarray = field(init=False, repr=False, compare=False)  # of a step, for the columns
    _atol: np.ndarray = field(init=False, repr=False, compare=False)
    sizes: np.ndarray = field(init=False, repr=False, compare=False)  # largest values of the columns so far

    longest = LONGEST

    def fit(self, system) -> None:
        """Tolerances for the columns [ξ | v] of a system."""
        self.wanted = self._columns(system, "rtol"), self._columns(system, "atol")
        self.sizes = np.zeros(system.nx + system.nv)
        self._hold_steps()

    def _hold_steps(self):
        """Tolerances of a step from those of the run."""
        rtol, atol = self.wanted
        tol = np.maximum(rtol, atol)
        share = self.step_tolerance(tol) / tol
        self._rtol, self._atol = share * rtol, share * atol

    def step_tolerance(self, tol):
        """The tolerance τ of one step's error with which a run is as accurate as `tol`.

        Steps of size h ~ τ^(1/(k+1)) with an error of τ each sum up to τ/h ~ τ^(k/(k+1)), k being the highest order.
        """
        k = self.max_order
        return np.maximum((ACCURACY * np.asarray(tol)) ** ((k + 1) / k), self._rounding)

    def apart(self, rows, others) -> float:
        """The largest difference of rows [ξ | v], divided by the accuracy of the run."""
        rtol, atol = (np.maximum(wanted, self.best) for wanted in self.wanted)
        return float((np.abs(rows - others) / (atol + rtol * np.abs(rows).max(axis=0))).max())

    @cached_property
    def asked(self) -> tuple[float, float]:
        """The smallest rtol and atol of the run."""
        rtol, atol = (min(min(part.ravel().tolist()) for part in parts) for parts in (self.rtol, self.atol))
        return rtol, atol

    @property
    def best(self) -> float:
        """The smallest tolerance that can be met in double precision."""
        return self._rounding ** (self.max_order / (self.max_order + 1)) / ACCURACY

    @property
    def _rounding(self) -> float:
        """Rounding in one step: eps/h in the velocities, which is below τ if τ > eps^((k+1)/(k+2))."""
        return 3.0 * EPS ** ((self.max_order + 1) / (self.max_order + 2))

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

    @property
    def _sums_up(self) -> np.ndarray:
        """The sum of the errors of all steps, in tolerances of one step; see :meth:`step_tolerance`."""
        return np.maximum(self._rtol, self._atol) ** (-1.0 / (self.max_order + 1))

    @property
    def spread(self) -> tuple[np.ndarray, np.ndarray]:
        """rtol and atol of a step, of the columns [ξ | v]."""
        return self._rtol, self._atol

    @property
    def tightest(self) -> tuple[float, float]:
        """The smallest rtol and atol of a step."""
        return float(self._rtol.min()), float(self._atol.min())

    def weights(self, system, predicted, p, h):
        """Reciprocal tolerances of [ξ | v], and Newton's stopping size. Rounding of the positions is tolerated.

        It appears in the velocities as eps/h, limited to the sum of the errors of all steps, and as eps |v| divided by
        the step of the difference quotients that replace W.
        """
        size = np.maximum(self.sizes, self._magnitudes(system, predicted, p))
        allowed, noise = self._rtol * size + self._atol, EPS * (1.0 + largest(p)) if self.noise else 0.0
        allowed[: system.nx] += NOISE * noise
        allowed[system.nx :] += np.minimum(STIRRED * noise / abs(h), (self._sums_up * allowed)[system.nx :])
        v = predicted[system.nx :][: system.nv]
        allowed[system.nx :] += SURE * noise * largest(v) / system.difference_step
        if system.widths is not None:  # forces change over a width: it has to be resolved
            narrow = np.abs(v) < tuning.COARSE * system.widths
            allowed[system.nx :][narrow] = np.minimum(allowed[system.nx :], system.widths)[narrow]
        return 1.0 / allowed, NEWTON_FACTOR

    def reached(self, system, y, p):
        """Update the sizes of the columns at an accepted state."""
        self.sizes = np.maximum(self.sizes, self._magnitudes(system, y, p))

    @staticmethod
    def _magnitudes(system, y, p):
        size = np.abs(y[: system.nx + system.nv])
        if not system.vector_like:
            size[: system.nx] = system.position_scale(p)
        return size

    def error(self, system, d, k, weight) -> float:
        """Local error of order k divided by its tolerance, from d = ∇ᵏ⁺¹y or its substitute."""
        return bdf.error_constant(k) * weighted_norm(d, weight, system.nv)

    def error_of(self, system, rows, k) -> float:
        """Local error from k+2 equidistant rows [ξ | v], oldest first."""
        weight = 1.0 / (self._atol + self._rtol * np.abs(rows).max(axis=0))
        return self.error(system, (bdf.differences(k + 1) @ rows[::-1])[k + 1], k, weight)

    def after_failure(self, h):
        self.equal_steps = 0
        self.reasons["newton"] += 1
        return AFTER_FAILURE * h

    def after_rejection(self, system, Z, d, k, h, error, weight):
        """(h, k) for the next try; a lower order if noise or a jump has spoilt the higher differences."""
        self.equal_steps = 0
        self.reasons["error"] += 1
        factor = error ** (-1.0 / (k + 1))
        if k > 1:
            lower = self.error(system, Z[k] + d, k - 1, weight) ** (-1.0 / k)
            if lower > factor:
                factor, k = lower, k - 1
        return h * min(1.0, max(MIN_FACTOR, SAFETY * factor)), k

    def after_rounding(self, h, tried) -> float:
        """The step after one whose error was rounding: as long as the one `tried` before, sometimes twice as long."""
        self.restart()
        self.noisy_steps += 1
        length = max(abs(h), tried)
        if self.noisy_steps > PROBING:
            self.noisy_steps, length = 0, min(2.0 * length, max(length, self.max_step))
        return float(np.copysign(length, h))

    def restart(self) -> None:
        """Forget the number of steps of equal size."""
        self.equal_steps = 0

    def next_step(self, system, Z, k, h, error, weight):
        """(h, k) of the next step, from the table at the accepted one."""
        self.equal_steps += 1
        if self.equal_steps <= k:
            return h, k
        errors = {k: error}
        if k > 1:
            errors[k - 1] = self.error(system, Z[k], k - 1, weight)
        if k < self.max_order:
            errors[k + 1] = self.error(system, Z[k + 2], k + 1, weight)
        factors = {order: max(value, 1e-10) ** (-1.0 / (order + 1)) for order, value in errors.items()}
        best = max(factors, key=lambda order: (factors[order], -order))
        if k > 2 and factors[k - 1] > NEARLY * factors[best]:
            best = k - 1
        factor = min(MAX_FACTOR, SAFETY * factors[best])
        if best == k and 1.0 <= factor < 1.1:
            return h, k
        limit = self.max_step / abs(h)
        self.equal_steps = 0
        return h * min(max(factor, MIN_FACTOR), limit), best
