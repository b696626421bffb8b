"""Joints outside of the position limits of their file, which do not act in a run."""

from dataclasses import dataclass
from math import inf, tau

import numpy as np

from .names import position_names

ROUNDING = 1e-9  # rad or m


@dataclass(frozen=True)
class BeyondLimit:
    """A joint that leaves its limits: the first time t, s, the value farthest out, and the limits, rad or m."""

    joint: str
    t: float
    value: float
    lower: float
    upper: float

    def __str__(self):
        limit = self.upper if self.value > self.upper else self.lower
        value = self.value if abs(self.value) > ROUNDING else 0.0
        return f"{self.joint} reaches {value:.4g} of {limit:.4g}, first at t = {self.t:.6g} s"


def beyond_limits(mechanism, t, q) -> tuple[BeyondLimit, ...]:
    """The joints that are outside of their limits in some row; `t` (n,) are times and `q` (n, nq) configurations.

    Whole turns by which a joint starts away from its limits do not count, those that it makes do. A coordinate of a
    joint of several is called ``joint[k]``; joints that store quaternions, or cosine and sine, have no such limits.
    """
    model, found = mechanism.model, []
    names = position_names(model)
    for i in range(1, model.njoints):
        for k in range(model.nqs[i] if model.nqs[i] == model.nvs[i] else 0):
            at = model.idx_qs[i] + k
            low, high, values = float(model.lowerPositionLimit[at]), float(model.upperPositionLimit[at]), q[:, at]
            if not low < high:
                continue
            if high - low < inf and model.joints[i].shortname().startswith("JointModelR"):
                values = values - tau * np.round((values[0] - (low + high) / 2) / tau)
            beyond = np.maximum(values - high, low - values)
            if (out := np.flatnonzero(beyond > ROUNDING)).size:
                value = float(values[np.argmax(beyond)])
                found.append(BeyondLimit(names[at], float(t[out[0]]), value, low, high))
    return tuple(found)
