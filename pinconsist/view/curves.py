"""The curves beside the motion: forces, torques, energies, joints, steps and orders, at rows that show all peaks."""

from __future__ import annotations

from base64 import b64encode

import numpy as np

from ..errors import InputError
from ..mechanism.names import position_names, position_units
from .arrows import FORCE, UNITS, actions
from .motion import Run, body_poses

ROWS = 500  # at most


def packed(values) -> str:
    """Numbers as the page unpacks them, in single precision."""
    return b64encode(np.asarray(values, "<f4").tobytes()).decode()


def panel(runs: list[Run], size: float, without) -> dict:
    """Seconds since the start for each run, and groups of curves over them; those of the loops `without` are left out.

    A curve of a loop or a motor names it and the bodies between which it acts, by which the page finds its force.
    """
    groups: dict[str, dict] = {}
    times = []
    for number, run in enumerate(runs):
        rows = _telling(run)
        times.append(packed(run.elapsed[rows]))
        for group, unit, name, values, about in _curves(run, rows, size, without):
            label = f"{run.title}: {name}" if run.title else name
            curve = {"name": label, "run": number, "y": packed(values), **about}
            groups.setdefault(group, {"name": group, "unit": unit, "curves": []})["curves"].append(curve)
    return {"times": times, "groups": list(groups.values())}


def _telling(run: Run) -> np.ndarray:
    """Rows of a run: all, or of each part the first and those with the largest and smallest multiplier and speed."""
    n = len(run.t)
    if n <= ROWS:
        return np.arange(n)
    sizes = [np.abs(x).max(axis=1) for x in (run.lam, run.v) if x is not None and x.size]
    found = [0, n - 1]
    for part in np.array_split(np.arange(n), ROWS // (2 * len(sizes) + 1)):
        found += [part[0], *(part[pick(x[part])] for x in sizes for pick in (np.argmin, np.argmax))]
    return np.unique(found)


def _curves(run: Run, rows: np.ndarray, size: float, without):
    """(group, unit, name, values, what it is of) of each curve."""
    some, source, model = run.rows(rows), run.source, run.mech.model
    if run.lam is not None and (run.v is not None or not run.mech.forces):
        for action in actions(some, body_poses(model, some.q), size, without):
            group = "forces" if action.kind == FORCE else "torques"
            values = action.norms if action.on_joint is None else action.on_joint
            yield group, UNITS[action.kind], action.name, values, {"of": action.of, "bodies": action.bodies}
    for name, energies in _energies(run).items():
        yield "energy", "J", name, energies[rows], {}
    for name, unit, values in zip(position_names(model), position_units(model), some.q.T, strict=True):
        if unit:
            yield {"rad": "angles", "m": "positions"}[unit], unit, name, values, {}
    for name, unit in ("h", "s"), ("order", ""):
        values = np.asarray(getattr(source, name, ()), float)
        if len(run.t) > 1 and values.shape == (len(run.t) - 1,):
            reached = np.concatenate((values[:1], values))[rows]
            yield {"h": "step", "order": "order"}[name], unit, name, np.where(reached > 0, reached, np.nan), {}


def _energies(run: Run) -> dict[str, np.ndarray]:
    """Energies less those at the start, of solutions that know them."""
    try:
        energy = run.source.energy(run.mech)
    except (AttributeError, InputError):
        return {}
    kinds = {name: getattr(energy, name) for name in ("kinetic", "potential", "elastic", "total")}
    return {f"{name}, since the start": values - values[0] for name, values in kinds.items() if values.any()}


def verdicts(runs: list[Run]) -> list[dict]:
    """What the certificate of each run says, where a solution has one."""
    out = []
    for run in runs:
        try:
            certificate = run.source.check(run.mech, error=False)
        except (AttributeError, InputError):
            continue
        text = f"{run.title}: {certificate.verdict}" if run.title else certificate.verdict
        out.append({"text": text, "ok": certificate.ok})
    return out
