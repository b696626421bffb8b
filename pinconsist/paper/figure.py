"""A figure of the errors of a force, from exact and from numerically consistent initial values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

STARTS = {  # name in a comparison → style, and label
    "exact": (1, "exact start"),
    "consistent": (0, "consistent start"),
    "every_step": (2, "every step corrected"),
}
EXACT_START = 1e-6  # relative to the largest error: a first row with a smaller one is an exact start


def plot_comparison(rows, file=None) -> Figure:
    """A figure of the error of a force over time, from exact and consistent values, a panel for each step size.

    Like figure 5.1 of Arévalo (2008), and also with every step corrected. Rows of an exact start are omitted.

    Parameters
    ----------
    rows : sequence
        Records with, as attributes or keys, ``h``, the step size, s; ``t``, shape (n,), s; ``exact`` and
        ``consistent``, shape (n,), the errors; and optionally ``every_step``, ``of`` and ``unit``: the quantity,
        by default λ, N or N·m.
    file : path, optional
        File to which the figure is written, whole or not at all, ``.png``, ``.pdf``, ``.svg``. Default: none.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        No record, sizes that do not fit, or a file ending that matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    """
    from ..view.panels import clock, new_figure, sparse, style  # needs Pinocchio

    if not hasattr(rows, "__iter__"):
        raise InputError(f"plot_comparison needs rows of paper.compare, got {type(rows).__name__}")
    rows = list(rows.values() if isinstance(rows, Mapping) else rows)
    records = [row if isinstance(row, Mapping) else getattr(row, "__dict__", {}) for row in rows]
    for record, row in zip(records, rows, strict=True):
        if missing := [name for name in ("h", "t", "exact", "consistent") if name not in record]:
            raise InputError(
                f"plot_comparison needs rows of paper.compare, or records with h, t, exact and consistent; "
                f"a {type(row).__name__} has no {missing[0]}"
            )
    lines, columns = -(-len(records) // 3), min(len(records), 3)
    with new_figure(max(3.3 * columns, 4.5), 2.9 * lines + 0.6, file) as figure:
        if not records:
            raise InputError("a comparison needs at least one step size")
        axes = figure.subplots(lines, columns, sharey=True, squeeze=False)
        for axis, row, record in zip(axes.flat, rows, records, strict=False):
            h, t = float(record["h"]), np.asarray(record["t"], float)
            errors = {name: np.asarray(record[name], float) for name in STARTS if name in record}
            for error in errors.values():
                if not error.shape == t.shape == (t.size,):
                    raise InputError(f"the errors for h = {h:g} do not have the shape of t, {t.shape}")
            size = np.max(list(errors.values()), axis=0)
            first = int(np.argmax(size > EXACT_START * size.max(initial=0.0)))
            times, label = clock(t[first:])
            for name, error in errors.items():
                k, what = STARTS[name]
                shown = np.where(error > 0, error, np.nan)[first:]
                axis.plot(times, shown, label=what, markevery=sparse(times.size, 10), **style(k))
            wrong = f"\nexact start: {row.wrong} at the first step" if hasattr(row, "wrong") else ""
            axis.set(yscale="log", title=f"step size h = {h:g} s{wrong}", xlabel=label)
        of = dict.fromkeys((record.get("of", "λ"), record.get("unit", "N, N·m")) for record in records)
        what, unit = next(iter(of)) if len(of) == 1 else ("the most wrong force", "N, N·m")
        for axis in axes[:, 0]:
            axis.set_ylabel(f"error of {what}" + (f"  [{unit}]" if unit else ""))
        for axis in axes.flat[len(records) :]:
            axis.set_axis_off()
        axes[0, 0].legend()
        figure.suptitle("error of the constraint forces, by the initial values")
    return figure
