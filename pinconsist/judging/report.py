"""A judgement as text, as a table, and as a page with two motions over each other."""

from __future__ import annotations

import csv
import io
from dataclasses import fields
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from ..errors import InputError
from ..view.page import write_page
from .contestants import CONTESTANTS

COLUMNS = {
    "setting": "setting", "joints": "joints [rad, m]", "gap": "gap [mm]", "energy": "energy [%]",
    "force": "forces [%]", "here": "here [%]", "drift": "drift [%]", "time": "time [ms/s]",
}  # fmt: skip
NUMBERS = ("step", "time", "joints_turn", "joints_slide", "energy", "force", "force_here", "force_drift",
           "force_peak", "gap", "tilt")  # fmt: skip


def cells(row) -> list[str]:
    """The cells of one run."""
    if row.failed:
        return [f"{row.tool}: {row.setting}", row.failed, *[""] * (len(COLUMNS) - 2)]
    percent = (100.0 * each for each in (row.energy, row.force, row.force_here, row.force_drift))
    joints = max(row.joints_turn, row.joints_slide)
    values = [joints, 1e3 * row.gap, *percent, 1e3 * row.time]
    return [f"{row.tool}: {row.setting}", *(_number(value) for value in values)]


def _number(value) -> str:
    return "–" if not np.isfinite(value) else f"{value:.2g}" if abs(value) < 1e3 else f"{value:.3g}"


def text_of(judgement) -> str:
    """The table, the cheapest settings, and what was not judged."""
    t, (joints, forces) = judgement.t, judgement.agreement
    lines = [f"{judgement.mechanism.name}, t = {t[0]:g} to {t[-1]:g} s, errors at {len(t)} times"]
    if np.isfinite(joints):
        lines.append(f"reference: Radau IIA and BDF agree to {joints:.1e} rad or m, forces to {forces:.1e}")
    else:
        lines.append("reference: Radau IIA alone; BDF failed")
    lines += ["", *_table([list(COLUMNS.values()), *map(cells, judgement.rows)]), ""]
    lines.append("here: against the true forces at its own states; drift: these against those of the true motion")
    for name in judgement.left_out:
        lines.append(f"left out: the forces of {name} are not determined by the equations of motion")
    for tool, best in judgement.cheapest.items():
        lines += ["", _advice(judgement, tool, best)]
        if best is not None:
            lines += [f"    {line}" for line in best.paste.splitlines()]
    lines += [""] * bool(judgement.not_judged or judgement.notes)
    lines += [f"note: {note}" for note in judgement.notes]
    lines += [f"{tool} is not judged: {why}" for tool, why in judgement.not_judged.items()]
    return "\n".join(lines)


def _advice(judgement, tool, best) -> str:
    percent = f"{100 * judgement.below:g} %"
    made_for = next(each.made_for for each in CONTESTANTS.values() if each.name == tool)
    if best is None:
        least = min((row.force for row in judgement.of(tool) if not row.failed), default=np.nan)
        reached = f"the least is {100 * least:.2g} %" if np.isfinite(least) else "all failed"
        return f"{tool} (made for {made_for}): no setting tried has force errors of at most {percent}; {reached}"
    return (
        f"{tool} (made for {made_for}): force errors of at most {percent} from {1e3 * best.time:.2g} ms per second of "
        f"motion on, with {best.setting}:"
    )


def _table(rows) -> list[str]:
    widths = [max(len(row[k]) for row in rows if not (k == 1 and row[2] == "")) for k in range(len(rows[0]))]
    lines = []
    for row in rows:
        if row[2] == "":
            lines.append(f"{row[0]:<{widths[0]}}  {row[1]}")
            continue
        aligned = (f"{cell:>{width}}" for cell, width in zip(row[1:], widths[1:], strict=True))
        lines.append("  ".join([f"{row[0]:<{widths[0]}}", *aligned]).rstrip())
    return [lines[0], "─" * max(map(len, lines)), *lines[1:]]


def csv_of(judgement) -> str:
    """All runs, numbers in SI units with all digits."""
    writer = csv.writer(out := io.StringIO(), lineterminator="\n")
    writer.writerow(["tool", "setting", *NUMBERS, "joint", "failed", "paste"])
    for row in judgement.rows:
        numbers = ["" if getattr(row, name) is None else repr(float(getattr(row, name))) for name in NUMBERS]
        writer.writerow([row.tool, row.setting, *numbers, row.joint, row.failed, row.paste])
    return out.getvalue()


def plain(judgement) -> dict:
    """A judgement as plain data."""
    names = [each.name for each in fields(judgement.rows[0])] if judgement.rows else []
    rows = [{name: getattr(row, name) for name in names if not name.startswith("_")} for row in judgement.rows]
    return {
        "scene": judgement.mechanism.name, "from": judgement.t[0], "until": judgement.t[-1], "times": len(judgement.t),
        "agreement": dict(zip(("joints", "forces"), judgement.agreement, strict=True)), "below": judgement.below,
        "rows": rows, "not_judged": judgement.not_judged, "left_out": judgement.left_out,
        "cheapest": {tool: best and best.setting for tool, best in judgement.cheapest.items()},
    }  # fmt: skip


def write_page_of(judgement, file, run, speed) -> Path:
    """The page of :meth:`Judgement.to_html`."""
    if run is None:
        others = [row for row in judgement.rows if row.tool != "pinconsist" and row._rows is not None]
        if not others:
            raise InputError("there is no run of another simulator to show")
        run = others[0]
    elif run._rows is None:
        raise InputError(f"{run.tool}: {run.setting} has no motion to show: {run.failed}")
    mech, rows, true = judgement.mechanism, run._rows, judgement.reference
    sols = {
        "true": SimpleNamespace(t=true.t, q=true.q, v=true.v, lam=true.lam),
        f"{run.tool}: {run.setting}": SimpleNamespace(t=rows.t, q=rows.q, v=rows.v, lam=_multipliers(mech, rows)),
    }
    return write_page(file, mech, sols, speed=speed, over=True)


def _multipliers(mech, rows):
    from ..mechanism.rows import LoopRows

    if rows.loads is None:
        return np.zeros((len(rows.t), mech.nc))
    loops = LoopRows.of(mech)
    jacobians = (loops.at(q, t)[1] for t, q in zip(rows.t, rows.q, strict=True))
    pairs = zip(jacobians, rows.loads, strict=True)
    return np.array([np.linalg.lstsq(J.T, load, rcond=1e-10)[0] for J, load in pairs])
