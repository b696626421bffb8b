"""Forces that jump where no step ends: the derivatives of the steps do not see them, so the run is not differentiated.

The motion has a kink where a force jumps, and its derivative by a parameter jumps there by the difference of the
accelerations times the derivative of the time. Steps become short at a jump, but the linear equations of each step know
only the derivatives of the force on its two sides.
"""

from itertools import pairwise

import numpy as np

from ..errors import InputError
from ..mechanism.breakpoints import jump_offset
from ..mechanism.forces.piecewise import BoundPiecewise
from ..mechanism.system import MechanismSystem
from ..run.known import Pull

JUMP = 1e-3  # relative to the largest value of the force in the run: smallest jump
NARROWEST = 1e-12  # relative to the run, and to its times: a change within such an interval is a jump
EVENT_DISTANCE = 1e-9  # relative to the run between two starts: distance from an event at which forces are compared
INSIDE = (0.0, 1 / 3, 2 / 3)  # where forces are compared, in each step
ACCELERATION_MATCH = (
    0.05  # relative to the accelerations: largest difference between those of the run and of its equations
)
STAYS = 1e-6  # s for a parameter of size 1, in which a break point counts as fixed
STEP_FRACTION = 1e-3  # of a step: distance over which velocities are compared


def refuse_jumps(solution, legs, base) -> None:
    """Raise InputError if a force jumps in the run, also where an event stops it, or is not the one that acted.

    Steps end at the break points of functions of time, where the derivatives go on if these times are fixed.
    """
    first = legs[0].system
    known = np.array(sorted({*first.breakpoints.ends, *_times_of_changes(legs)}))
    ends = legs[0].span[0], legs[-1].span[1] if solution.status == 0 else None  # of the run, if no event ends it
    for leg in legs:
        grid = _grid(leg)
        for label, force in base.index1(leg.system).system.forces.items():
            if force.smooth or force.by_time or force.widths is not None or len(grid) < 2:
                continue
            largest = 0.0
            for part in _parts(grid, known):
                largest = max(largest, _refuse_jump(solution, part, label, force))
            for t, other in (grid[0], grid[1]), (grid[-1], grid[-2]):
                if t not in ends and not _are_known(np.array([t]), known)[0]:
                    _refuse_jump_at(leg, t, other, label, force, largest)
        if len(grid) > 1 and any(event.apply is not None for event in solution._events):
            _refuse_memory(solution, leg, grid, base)


def _times_of_changes(legs) -> list[float]:
    """The times at which forces jump in the run."""
    ends = sorted((legs[0].span[0], legs[-1].span[1]))
    return legs[0].system.times_of_changes(*ends)


def refuse_moving_jumps(variants, system, t, reached, t_end, q, v) -> None:
    """Raise InputError if a parameter moves a time at which a force jumps or bends, up to that `reached`."""
    breakpoints = system.breakpoints
    low, high = min(t, reached), max(t, reached)
    inside = low + jump_offset(low), high - jump_offset(high)
    ends = [at for at in breakpoints.ends if inside[0] < at < inside[1]]
    jumps = system.times_of_changes(*inside)
    for i, parts in variants.known if ends or jumps else ():
        for _, part in parts:
            if isinstance(part, Pull):
                if isinstance(part.bound, BoundPiecewise):
                    _refuse_moved(variants.names[i], variants.steps[i], part.bound.times_between(*inside), jumps)
                functions = part.bound.functions_of_time(q, v)
                changes = [change.time for each in functions for change in each.known or []]
                _refuse_moved(variants.names[i], variants.steps[i], [at for at in changes if low < at < high], ends)
    for variant in variants.moved.values() if ends or jumps else ():
        if not (variant.inert or variant.of_loop):
            sides, _, near = variant.beside
            varied = MechanismSystem(sides[max(near)].mechanism, q, system.chosen_at, like=system)
            varied.breakpoints.look_ahead(t, t_end, q, v)
            _refuse_moved(variant.name, variant.step, ends, varied.breakpoints.ends)
            for each in varied.changing:
                each.start(t, t_end < t)
            _refuse_moved(variant.name, variant.step, jumps, varied.times_of_changes(low, high))


def _refuse_moved(name, step, times, others) -> None:
    times = np.asarray(times, float)
    for t, moved in zip(times, _distances(times, np.sort(np.asarray(others, float))), strict=True):
        if moved > STAYS * abs(step) + 2.0 * jump_offset(t):
            raise InputError(
                f"a force or a constraint jumps or bends at t = {t:.4g} s, and the parameter {name!r} moves this time: "
                "runs are not differentiated by the times of jumps. Replace the jump by a smooth transition over a "
                "short time, such as 0.5 * (1 + tanh((t - t0) / width)) in place of t > t0"
            )


def _grid(leg):
    """The times between which the steps of a leg are, without those beyond its end, which an event has cut off."""
    begin, end = leg.span
    inside = [t for t in leg.t if leg.sign * (t - begin) > 0.0 and leg.sign * (end - t) > 0.0]
    return np.array([begin, *inside, end] if abs(end - begin) > jump_offset(end) else [begin])


def _distances(times, known):
    """The distances of times from the nearest of the sorted times `known`."""
    if not len(known):
        return np.full(len(times), np.inf)
    after = np.searchsorted(known, times)
    near = np.column_stack([known[np.maximum(after - 1, 0)], known[np.minimum(after, len(known) - 1)]])
    return np.abs(near - times[:, None]).min(axis=1)


def _are_known(times, known):
    """Whether each of the times is one of the sorted times `known`."""
    return _distances(times, known) <= jump_offset(times)


def _parts(grid, known):
    """The grid, split at break points."""
    cuts = 1 + np.flatnonzero(_are_known(grid[1:-1], known))
    return [grid[i : j + 1] for i, j in pairwise([0, *cuts, len(grid) - 1])]


def _refuse_jump(solution, grid, label, force) -> float:
    """Look between the ends of a part of the run; return the largest entry of the torques."""

    def torque(times):
        q, v, _ = solution.sol(times)
        return np.array([force.torque(*state) for state in zip(times.tolist(), q, v, strict=True)])

    begin, end = grid[0], grid[-1]
    narrowest = NARROWEST * abs(end - begin) + 8.0 * np.spacing(max(abs(begin), abs(end)))
    times = np.unique((grid[:-1, None] + np.diff(grid)[:, None] * INSIDE).ravel())
    times = times[(np.abs(times - begin) > narrowest) & (np.abs(times - end) > narrowest)]
    values = torque(times) if len(times) else np.zeros((0, 1))
    least = JUMP * np.abs(values).max(initial=0.0)
    changes = np.abs(np.diff(values, axis=0)).max(axis=1, initial=0.0)
    for i in np.flatnonzero(changes > least):
        t, a, b = times[i : i + 2], values[i], values[i + 1]
        while t[1] - t[0] > narrowest and np.abs(b - a).max() > least:
            middle = 0.5 * (t[0] + t[1])
            (c,) = torque(np.array([middle]))
            first = np.abs(c - a).max() > np.abs(b - c).max()
            t, a, b = ((t[0], middle), a, c) if first else ((middle, t[1]), c, b)
        if np.abs(b - a).max() > least:
            raise _jumps(label, t[1], a, b)
    return least / JUMP


def _refuse_jump_at(leg, t, other, label, force, largest) -> None:
    """Look at an end of a leg, an event, on both sides of its state along the motion."""
    system, length = leg.system, abs(leg.span[1] - leg.span[0])
    away = EVENT_DISTANCE * length + 8.0 * np.spacing(abs(t))
    beside = t + np.copysign(min(max(STEP_FRACTION * abs(other - t), 1e2 * away), length), other - t)
    (q, near), y = leg.states(np.array([t, beside]))[:2]
    v, v_near = y[:, system.nx : system.nx + system.nv]
    move, change = system.difference(q, near) / (beside - t), (v_near - v) / (beside - t)
    a, b = (force.torque(t + e, system.integrate(q, e * move), v + e * change) for e in (-away, away))
    if not np.abs(b - a).max() <= JUMP * max(largest, np.abs(a).max(), np.abs(b).max()):
        raise _jumps(label, t, a, b)


def _jumps(label, t, a, b) -> InputError:
    i = int(np.argmax(np.abs(b - a)))
    return InputError(
        f"the force {label!r} jumps at t = {t:.6g} s (entry {i} of its torques from {a[i]:.4g} to {b[i]:.4g}), and "
        "runs are not differentiated across jumps. Replace the jump by a smooth transition over a short distance or "
        "time, such as 0.5 * (1 + tanh(x / width)) in place of x > 0"
    )


def _refuse_memory(solution, leg, grid, base) -> None:
    """The forces of the run must be functions of t, q and v: a latch that an event has set has its last state now."""
    longest = int(np.argmax(np.abs(np.diff(grid))))
    begin, end = grid[longest : longest + 2]
    t, step = 0.5 * (begin + end), STEP_FRACTION * (end - begin)
    q, v, _ = (part[0] for part in solution.sol(np.array([t])))
    forward, backward = (solution.sol(np.array([t + side * step]))[1][0] for side in (1.0, -1.0))
    of_run = (forward - backward) / (2.0 * step)
    a = base.index1(leg.system).acceleration(t, q, v)[0]
    if np.abs(a - of_run).max() > ACCELERATION_MATCH * max(np.abs(a).max(), np.abs(of_run).max()):
        raise InputError(
            f"the forces near t = {t:.6g} s are not those that acted in the run: a force depends on something "
            "else than t, q and v, such as a variable that the apply= of an event changes, and its derivatives are not "
            "known. Make it a function of t, q and v"
        )
