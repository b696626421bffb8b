"""The closure of a mechanism on a grid of motor positions, as arrays and as a file."""

from collections import deque
from collections.abc import Mapping
from itertools import product
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import write_csv, written_whole
from ..mechanism.checks import finite_array
from ..mechanism.names import position_names, position_units, velocity_units


def table(act, positions, file=None) -> dict[str, np.ndarray]:
    """What :meth:`Actuation.table` returns."""
    suffix = "" if file is None else Path(file).suffix
    if file is not None and suffix not in (".npz", ".csv"):
        raise InputError(f"{file}: a table is written as .npz or .csv")
    if not isinstance(positions, Mapping) or not positions:
        raise InputError(f"a table needs a mapping of motors to positions, got {positions!r}")
    if wrong := [joint for joint in positions if joint not in act.motors]:
        raise InputError(f"{wrong[0]!r} is no motor; the motors are {', '.join(act.motors)}")
    axes = [np.atleast_1d(finite_array(values, f"positions of {joint!r}")) for joint, values in positions.items()]
    if deep := [joint for joint, axis in zip(positions, axes, strict=True) if axis.ndim != 1]:
        raise InputError(f"positions of {deep[0]!r} need one axis")
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
    """(q, ok) at the points of a grid, each reached from a neighbour, the first from where the motors stand."""
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
