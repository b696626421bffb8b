"""Reach of motors: the range of each one, up to a joint limit or a singular position, and tables on a grid."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import inf, tau
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import write_csv, written_whole
from ..mechanism.checks import finite_array
from ..mechanism.names import beyond_limits, joints_in, position_names, position_units, velocity_units

STRIDE = 0.05  # rad, or lengths of the mechanism: step in which a motor is moved
MOST_STRIDES = 400  # of a sliding motor
HALVINGS = 40


@dataclass(frozen=True)
class MotorRange:
    """How far a motor can go, the others held.

    Attributes
    ----------
    motor : str
        Name of the motor.
    lower, upper : float
        The ends of the range, rad or m; infinite if it can turn all the way round, or if no end was found.
    lower_by, upper_by : str
        The reason for each end: the joint that is at its limit, ``"singular"``, or ``"nothing"``.
    lower_condition, upper_condition : float
        :meth:`Actuation.condition` at the ends.
    lower_moves, upper_moves : tuple of str
        Joints that can move with all motors held in the singular position at the end.
    """

    motor: str
    lower: float
    upper: float
    lower_by: str
    upper_by: str
    lower_condition: float
    upper_condition: float
    lower_moves: tuple[str, ...]
    upper_moves: tuple[str, ...]

    def __str__(self):
        return (
            f"{self.motor}: {self.lower:.6g} ({self.lower_by}, condition {self.lower_condition:.2g}) … "
            f"{self.upper:.6g} ({self.upper_by}, condition {self.upper_condition:.2g})"
        )


def ranges(act, q) -> list[MotorRange]:
    """See :meth:`Actuation.limits`."""
    chosen, found, units = act._chosen, [], velocity_units(act.mechanism.model)
    for k in range(chosen.n_motors):
        column = chosen.columns[k]
        stride, most = STRIDE * chosen.sizes[column], tau if units[column] == "rad" else inf
        name, start = act.motors[chosen.own[k]], act.positions(q)[chosen.own[k]]
        ends = [_end(act, q, k, start, sign * stride, most) for sign in (-1.0, 1.0)]
        found.append(MotorRange(name, *(each for pair in zip(*ends, strict=True) for each in pair)))
    return found


def _end(act, q, k, start, stride, most):
    """(position, its reason, condition, joints that can move there) of the end of a motor's range in one direction."""
    chosen, begun, gone = act._chosen, q, 0.0
    unit = np.zeros(len(chosen.columns))
    unit[k] = stride

    def beyond(there):
        """The joint that is farthest outside its limits, or an empty string."""
        found = beyond_limits(act.mechanism, (0.0, 1.0), np.array([begun, there]))
        return max(found, key=lambda one: max(one.value - one.upper, one.lower - one.value)).joint if found else ""

    by = beyond(q)
    while not by and abs(gone) < most and abs(gone) < MOST_STRIDES * abs(stride):
        there, share = chosen.follower.follow(q, unit)
        if by := beyond(there):
            low, high = 0.0, share
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                inside = not (joint := beyond(chosen.follower.follow(q, middle * unit)[0]))
                by, low, high = joint or by, middle if inside else low, high if inside else middle
            there, share = chosen.follower.follow(q, low * unit)[0], low
        q, gone = there, gone + share * stride
        if share < 1.0:
            by = by or "singular"
    sizes, motions = chosen.weakest(q)
    n = chosen.n_motors
    moves = joints_in(act.mechanism, motions[:, n - 1]) if by == "singular" else ()
    end = start + gone if by else np.sign(stride) * inf
    return float(end), by or "nothing", float(sizes[n - 1]), moves


def table(act, positions, file=None) -> dict[str, np.ndarray]:
    """See :meth:`Actuation.table`."""
    suffix = "" if file is None else Path(file).suffix
    if file is not None and suffix not in (".npz", ".csv"):
        raise InputError(f"{file}: a table is written as .npz or .csv")
    if not isinstance(positions, Mapping) or not positions:
        raise InputError(f"a table needs a mapping of motors to positions, got {positions!r}")
    if wrong := [joint for joint in positions if joint not in act.motors]:
        raise InputError(f"{wrong[0]!r} is not a motor; the motors are {', '.join(act.motors)}")
    axes = [np.atleast_1d(finite_array(values, f"positions of {joint!r}")) for joint, values in positions.items()]
    if deep := [joint for joint, axis in zip(positions, axes, strict=True) if axis.ndim != 1]:
        raise InputError(f"positions of {deep[0]!r} must be one-dimensional")
    sizes, joints, start = [len(axis) for axis in axes], list(positions), act.q
    points = np.array([each.ravel() for each in np.meshgrid(*axes, indexing="ij")]).T
    q, ok = _filled(act, joints, points, sizes)
    act.closure({}, q=start)
    asked = np.tile(act.positions(start), (len(points), 1))
    asked[:, [act.motors.index(joint) for joint in joints]] = points
    jacobian = np.zeros((len(q), act.mechanism.nv, len(act.motors)))
    condition = np.array([act.condition(each) if np.isfinite(each).all() else np.nan for each in q])
    for i in np.flatnonzero(ok):
        jacobian[i] = act.jacobian(q[i])
    found = {"positions": asked, "q": q, "ok": ok, "condition": condition, "jacobian": jacobian}
    if suffix == ".npz":
        with written_whole(file) as stream:
            names = {"motors": np.array(act.motors), "joints": np.array(position_names(act.mechanism.model))}
            np.savez(stream, **names, **found)  # type: ignore[arg-type]
    elif suffix == ".csv":
        of_v = velocity_units(act.mechanism.model)
        names = [*act.motors, *(f"q.{name}" for name in position_names(act.mechanism.model)), "ok", "condition"]
        units = [*(of_v[i] for i in act._columns), *position_units(act.mechanism.model), "", ""]
        parts = found["positions"], found["q"], found["ok"][:, None], found["condition"][:, None]
        write_csv(file, names, units, np.hstack(parts))
    return found


def _filled(act, joints, points, sizes):
    """(q, ok) at the points of a grid, each reached from a neighbour, the first from the current motor positions."""
    q, ok = np.full((len(points), act.mechanism.nq), np.nan), np.zeros(len(points), bool)
    here = act.q

    def reach(i, origin):
        q[i], ok[i] = act.closure(dict(zip(joints, points[i], strict=True)), q=origin)
        return ok[i]

    now = act.positions(here)[[act.motors.index(joint) for joint in joints]]
    nearest = np.argsort(np.abs(points - now).max(axis=1), kind="stable")
    first = next((int(i) for i in nearest if reach(i, here)), None)
    waiting = deque([] if first is None else [first])
    while waiting:
        i = waiting.popleft()
        place = np.unravel_index(i, sizes)
        for axis, step in product(range(len(sizes)), (-1, 1)):
            beside = place[axis] + step
            if 0 <= beside < sizes[axis]:
                j = int(np.ravel_multi_index((*place[:axis], beside, *place[axis + 1 :]), sizes))
                if not ok[j] and reach(j, q[i]):
                    waiting.append(j)
    return q, ok
