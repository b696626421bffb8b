"""The closure of a mechanism on a grid of motor positions, as arrays and as a file."""

from __future__ import annotations

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
    axes = [np.atleast_1d(finite_array(values, f"positions of {joint!r}")) for joint, values in positions.items()]
    points = np.array([[axis[i] for axis, i in zip(axes, place, strict=True)] for place in _to_and_fro(axes)])
    model, m, start = act.mechanism.model, len(act.motors), act.q
    q, ok = act.closure({joint: points[:, k] for k, joint in enumerate(positions)})
    q, ok = np.reshape(q, (-1, model.nq)), np.atleast_1d(ok)
    act.q = start
    jacobian, condition = np.zeros((len(q), model.nv, m)), np.array([act.condition(each) for each in q])
    for i in np.flatnonzero(ok):
        jacobian[i] = act.jacobian(q[i])
    asked = np.array([act.positions(each) for each in q])
    for k, joint in enumerate(positions):
        asked[:, act.motors.index(joint)] = points[:, k]
    order = np.lexsort(points.T[::-1])
    found = {"positions": asked, "q": q, "ok": ok, "condition": condition, "jacobian": jacobian}
    found = {name: values[order] for name, values in found.items()}
    if suffix == ".npz":
        with written_whole(file) as stream:
            names = {"motors": np.array(act.motors), "joints": np.array(position_names(model))}
            np.savez(stream, **names, **found)  # type: ignore[arg-type]
    elif suffix == ".csv":
        of_v = velocity_units(model)
        names = [*act.motors, *(f"q.{name}" for name in position_names(model)), "ok", "condition"]
        units = [*(of_v[i] for i in act._columns), *position_units(model), "", ""]
        parts = found["positions"], found["q"], found["ok"][:, None], found["condition"][:, None]
        write_csv(file, names, units, np.hstack(parts))
    return found


def _to_and_fro(axes):
    """The places of a grid in an order in which neighbours follow each other."""
    if not axes:
        return [()]
    places = []
    counts = [range(len(axis)) for axis in axes]
    for number, outer in enumerate(product(*counts[:-1])):
        line = counts[-1] if number % 2 == 0 else reversed(counts[-1])
        places += [(*outer, i) for i in line]
    return places
