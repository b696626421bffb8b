"""Rounding: how far to iterate, when an error is rounding, and when a run makes no progress."""

import numpy as np

from ..errors import SingularSystemError
from . import tuning
from .kkt import kkt_at
from .norms import EPS, largest

TO_ROUNDING = 2.0 * EPS  # tolerance of Newton's increments, relative to the state, with fixed steps


def shortest_step(*times) -> float:
    """The shortest step, s, that can be distinguished from zero at these times."""
    return tuning.SMALLEST_STEP * float(np.spacing(max(map(abs, times))))


def representable(t, h) -> float:
    """`h`, rounded so that t + h, t + 2h, … are exact (but for one, where the spacing of t doubles).

    Otherwise all steps of one length are rounded alike, and the time of a run drifts away from the sum of its steps.
    Where that is far below any accuracy of a multistep method, as near t = 0, it is `h`.
    """
    return float(2.0 * t + h) - 2.0 * t if np.spacing(abs(t)) > tuning.DRIFT * abs(h) else h


def rounding_weights(system, y):
    """Weight and tolerance with which Newton iterates down to rounding: increments relative to the state's size."""
    size_x, size_v = 1.0 + largest(y[: system.nx]), largest(y[system.nx : system.nx + system.nv]) or 1.0
    return np.repeat((1.0 / size_x, 1.0 / size_v), (system.nx, system.nv)), TO_ROUNDING


def per_position(c, tol) -> float:
    """Changes of v that belong to changes of the position, 1/c, if Newton iterates down to rounding, else 0."""
    return 1.0 / abs(c) if tol <= TO_ROUNDING else 0.0


def is_noise(dv, moved, v, psi_v, p, noise, per_position=0.0, closed=False) -> bool:
    """Whether Newton's increments are rounding errors, which more iterations or a smaller step cannot reduce.

    `dv` are increments of the velocity by the dynamics, `moved` of the position by the constraint; `noise` is the size,
    relative to the velocities, that may be rounding. Forces have rounding errors at rest, too: with `per_position`,
    increments that hardly move the position are noise. If the loops are `closed` to rounding and the position still
    moves far, it is near a singular one, and what moves it less is noise as well.
    """
    step, far, reach = largest(dv), largest(moved), 1.0 + largest(p)
    scale = largest(v) + largest(psi_v) + step  # v = ψ_v + c v' may be a small difference of larger numbers
    least = per_position * max(tuning.UNMOVED * EPS * reach, far if closed else 0.0)
    return step <= max(noise * scale, least) and far <= (tuning.HALF if closed else 1e4 * EPS) * reach


def rounding_gap(p, W) -> float:
    """The gap that rounding causes in closed loops, from the position and from W or G."""
    return tuning.GAP * (1.0 + largest(p)) * (1.0 + largest(W))


def velocity_rounding(system, t, p, v) -> tuple[float, float]:
    """How much rounding may change v: a worst-case bound from norms, and an estimate along the constraint rows.

    It is eps |v|, and more because loops can only be closed to eps. Near singular positions this moves p far, by eps/σ,
    and v with the constraint rows, by eps/σ² where they turn most.
    """
    nv, nc = system.nv, system.nc
    speed, reach = largest(v), 1.0 + largest(p)
    if not nc:
        return EPS * speed, tuning.SURE * EPS * speed
    try:
        kkt, _, _, W = kkt_at(system, t, p, v)
    except SingularSystemError:
        return np.inf, np.inf
    closing = kkt.solve(np.vstack((np.zeros((nv, nc)), np.eye(nc))))[:nv]
    farthest = closing[np.abs(closing).sum(axis=1).argmax()]
    s, turn = np.abs(farthest).sum(), np.abs(W).sum(axis=1).max()
    moved = closing @ np.sign(farthest)  # the farthest that gaps of size 1 can move a coordinate
    share = tuning.TURNED * reach / largest(moved)
    there = system.integrate(p, system.rate(t, p, v + share * moved) - system.rate(t, p, v))
    hidden = [system.constraint(t, q, system.rate(t, q, v))[1] for q in (p, there)]
    turned = reach * largest(closing @ (hidden[1] - hidden[0])) / share
    return EPS * speed * (1.0 + reach * s**2 * turn), tuning.SURE * EPS * (speed + turned)


class RoundingTest:
    """Whether the error of a step is rounding of the velocities, which a shorter step would not reduce.

    Truncation errors can be predicted from the last step and fall with the step size: ∇ᵏ⁺¹y is compared with this
    prediction or, after a longer step from the same point has failed, with the error of that step. As forces that are
    not smooth have the same effect, the change of v by rounding is estimated along the constraint rows, too.
    """

    def __init__(self):
        self.restart()

    def restart(self) -> None:
        """Forget the noise of earlier steps."""
        self._noise = 0.0  # in v of the last steps; the noise of a step fades from later differences

    def passes(self, size, h, k, d, expected, tried, v, noise) -> bool:
        """Whether the error of a step h of order k is rounding.

        `d` is ∇ᵏ⁺¹ of [ξ | v] and ``size(d)`` the error that belongs to it, `expected` is d as predicted by the last
        step, `tried` are the length and the error of the step that failed, or zeros. ``noise()`` is
        :func:`velocity_rounding`; no more than half of the digits are taken for rounding.
        """
        error, (longer, its_error) = size(d), tried
        if longer:
            shows = abs(h) < longer and error >= its_error * (abs(h) / longer) ** (tuning.SLOW * (k + 1))
        else:
            shows = size(d - expected) >= tuning.SUDDEN * error

        def explained(velocity):
            return size(np.append(np.zeros(len(d) - len(v)), np.full(len(v), 2.0 ** (k + 1) * velocity)))

        speed, sure = largest(v), tuning.SURE * error
        most = explained(tuning.HALF * speed)
        if error > most or (not shows and (error <= 1.0 or sure > most)):
            return False
        if shows and error <= explained(self._noise):
            return True
        worst, likely = noise()
        if worst >= tuning.BESIDE * speed and sure <= explained(min(worst, tuning.HALF * speed)):
            return True  # without further evidence; otherwise only tiny steps would pass, by chance
        self._noise = max(self._noise, min(likely, speed))  # infinite noise would never fade
        return shows and error <= explained(self._noise)

    def accepted(self) -> None:
        """A step was accepted."""
        self._noise *= 0.5


class Headway:
    """Counts failed tries, and forgets them when the run has advanced."""

    def __init__(self):
        self.restart(0.0, 0.0)

    def restart(self, start, t) -> None:
        """The run begins, or begins again, at `start`; its history ends at `t`."""
        self._start, self._counted_from, self._setbacks = start, t, 0

    def setback(self) -> bool:
        """Count a failed try; returns whether there were too many without progress."""
        self._setbacks += 1
        return self._setbacks > tuning.SETBACKS

    def reached(self, t) -> None:
        """An accepted step ended at `t`."""
        if abs(t - self._counted_from) > tuning.PROGRESS * abs(t - self._start):
            self._counted_from, self._setbacks = t, 0


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
        if made < tuning.WINDOW or self._failed is None:  # with a fixed step nothing fails twice
            return False
        failed = self._control.reasons["newton"] - self._failed
        self._t, self._steps, self._failed = t, steps, self._control.reasons["newton"]
        to_come = made * abs(t_end - t) / gone if gone else np.inf
        return failed > tuning.CHATTER * made and (
            to_come > tuning.ENDLESS or (to_come > tuning.LONG and bool(jumping()))
        )
