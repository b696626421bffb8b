"""Who decides about step and order: a fixed step, or an error controller on positions and velocities.

The multipliers are never in the error test: they follow with the order of the velocities once every step is
corrected, and a test on them would only react to their rounding floor.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from . import bdf
from .newton import rounding_weights

NEWTON_FACTOR = 3e-3  # of the error test; keeps loop gaps down for 3 % more residuals
SAFETY = 0.9
MIN_FACTOR, MAX_FACTOR = 0.2, 10.0


@dataclass
class FixedStep:
    """The same step and order throughout; Newton down to rounding; nothing is rejected."""

    ndf: bool = False
    corrections: int = 2

    def weights(self, system, predicted, p):
        return rounding_weights(system, predicted)

    def error(self, system, d, k, weights) -> float:
        return 0.0

    def after_failure(self, h, failure):
        return None

    def next_step(self, system, Z, k, h, error, weights, iterations):
        return h, k


@dataclass
class ErrorControl:
    """Step and order from the local errors of ∇ᵏ, ∇ᵏ⁺¹, ∇ᵏ⁺², as in Shampine and Reichelt's codes.

    Parameters
    ----------
    rtol, atol : tuple
        (position part, velocity part), each a scalar or an array.
    max_order : int
        1 to 5.
    max_step : float
        Largest |h|, s.
    """

    rtol: tuple
    atol: tuple
    max_order: int
    max_step: float
    ndf: bool = True
    corrections: int = 1
    equal_steps: int = 0
    reasons: dict = field(default_factory=lambda: {"error": 0, "newton": 0})

    def weights(self, system, predicted, p):
        """Reciprocal tolerances of position and velocity, and Newton's stopping size."""
        nx, nv = system.nx, system.nv
        weight_x = 1.0 / (self.atol[0] + self.rtol[0] * system.position_scale(p))
        weight_v = 1.0 / (self.atol[1] + self.rtol[1] * np.abs(predicted[nx : nx + nv]))
        return weight_x, weight_v, NEWTON_FACTOR

    def error(self, system, d, k, weights) -> float:
        """Local error of order k over its tolerance: the larger root mean square of the two parts."""
        return abs(bdf.error_constant(k, self.ndf)) * self._norm(system, d, weights)

    def error_of(self, system, rows, k) -> float:
        """The same from k+2 equidistant rows [ξ | v], oldest first."""
        d = (bdf.differences(k + 1) @ rows[::-1])[k + 1]
        p = rows[0][: system.nx]
        weight_x = 1.0 / (self.atol[0] + self.rtol[0] * (np.abs(p) if system.vector_like else 1.0))
        weight_v = 1.0 / (self.atol[1] + self.rtol[1] * np.abs(rows[:, system.nx :]).max(axis=0))
        return self.error(system, d, k, (np.broadcast_to(weight_x, p.shape), weight_v))

    def after_failure(self, h, failure):
        self.equal_steps = 0
        self.reasons["newton"] += 1
        return 0.25 * h

    def after_rejection(self, h, k, error):
        self.equal_steps = 0
        self.reasons["error"] += 1
        return h * max(MIN_FACTOR, SAFETY * error ** (-1.0 / (k + 1)))

    def next_step(self, system, Z, k, h, error, weights, iterations):
        """(h, k) of the next step, from the table at the accepted one."""
        self.equal_steps += 1
        if self.equal_steps <= k:
            return h, k
        errors = {k: error}
        if k > 1:
            errors[k - 1] = self.error(system, Z[k], k - 1, weights)
        if k < self.max_order:
            errors[k + 1] = self.error(system, Z[k + 2], k + 1, weights)
        factors = {order: max(value, 1e-10) ** (-1.0 / (order + 1)) for order, value in errors.items()}
        best = max(factors, key=lambda order: (factors[order], -order))
        factor = min(MAX_FACTOR, SAFETY * factors[best])
        if best == k and 1.0 <= factor < 1.1:
            return h, k
        limit = self.max_step / abs(h)
        self.equal_steps = 0
        return h * min(max(factor, MIN_FACTOR), limit), best

    def _norm(self, system, d, weights):
        nx, nv = system.nx, system.nv
        x, v = d[:nx] * weights[0], d[nx : nx + nv] * weights[1]
        return float(np.sqrt(max(x @ x / max(nx, 1), v @ v / max(nv, 1))))
