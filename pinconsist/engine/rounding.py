"""Rounding of times, and runs that make no progress."""

import numpy as np

from . import constant

WINDOW = 1000  # number of steps after which the pace of a run is checked
CHATTER = 0.3  # failures of Newton per step from which a run may not end
LONG, ENDLESS = 1e5, 1e9  # remaining steps that are too many if a force jumps, and if not


def shortest_step(*times) -> float:
    """The shortest step, s, that can be distinguished from zero at these times."""
    return constant("SMALLEST_STEP") * float(np.spacing(max(map(abs, times))))


class Pace:
    """Finds runs that would not end in reasonable time because a force chatters.

    With a relay that switches against the motion no step of useful length has a solution, and Newton fails again and
    again. Long runs and steep forces alone are no reason to stop.
    """

    def __init__(self, control, t, steps=0):
        self._control, self._t, self._steps = control, t, steps
        self._failed = control.reasons.get("newton")

    def lost(self, steps, t, t_end, jumping) -> bool:
        """Whether the run, `steps` long until `t`, would not end; ``jumping()`` says whether a force jumps there."""
        made, gone = steps - self._steps, abs(t - self._t)
        if made < WINDOW or self._failed is None:  # with a fixed step nothing fails twice
            return False
        failed = self._control.reasons["newton"] - self._failed
        self._t, self._steps, self._failed = t, steps, self._control.reasons["newton"]
        to_come = made * abs(t_end - t) / gone if gone else np.inf
        return failed > CHATTER * made and (to_come > ENDLESS or (to_come > LONG and bool(jumping())))
