"""Figures of several runs: errors of the multipliers, and work against precision."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from ...errors import InputError
from .look import legend_beside, new_figure, positive, sparse, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OWN = "pinconsist BDF"  # what the others are measured against


def plot_comparison(rows, file=None) -> Figure:
    """Error of the multipliers over time, from exact and from consistent initial values, a panel for each step size.

    As figure 5.1 of Arévalo (2008).

    Parameters
    ----------
    rows : sequence
        Records with, as attributes or keys, ``h``, the step size, s; ``t``, shape (n,), s; ``exact`` and
        ``consistent``, shape (n,), norms of the error of λ.
    file : path, optional
        Where the figure is written, whole or not at all; the ending chooses the format.

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
    records = [{key: np.asarray(_field(row, key), float) for key in ("h", "t", "exact", "consistent")} for row in rows]
    columns = min(len(records), 3)
    lines = -(-len(records) // 3)
    with new_figure(max(3.3 * columns, 4.5), 2.9 * lines + 0.4, file) as figure:
        if not records:
            raise InputError("a comparison needs at least one step size")
        for row in records:
            if not row["t"].shape == row["exact"].shape == row["consistent"].shape == (row["t"].size,):
                raise InputError(f"the errors for h = {row['h']:g} do not have the shape of t, {row['t'].shape}")
        axes = figure.subplots(lines, columns, sharey=True, squeeze=False)
        for axis, row in zip(axes.flat, records, strict=False):
            for k, (key, label) in enumerate((("exact", "exact start"), ("consistent", "consistent start"))):
                error = positive(row[key])
                axis.plot(row["t"], error, label=label, markevery=sparse(len(error), 10), **style(1 - k))
            axis.set_yscale("log")
            axis.set_title(f"h = {row['h']:g} s")
            axis.set_xlabel("t  [s]")
        for axis in axes[:, 0]:
            axis.set_ylabel("‖error of λ‖")
        for axis in axes.flat[len(records) :]:
            axis.set_axis_off()
        axes[0, 0].legend()
    return figure


def plot_work_precision(series, file=None) -> Figure:
    """Run time against error, a line for each method: further left and lower is better.

    Parameters
    ----------
    series : mapping
        Label → (times, errors), of shape (n,) each: run times, s, and errors; what is not positive and finite is left
        out.
    file : path, optional
        Where the figure is written, whole or not at all; the ending chooses the format.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        No series, one with nothing to draw or of sizes that do not fit, or a file ending that matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    """
    if not isinstance(series, Mapping) or not series:
        raise InputError("work-precision needs a mapping label → (times, errors) with at least one label")
    with new_figure(6.8, 3.8, file) as figure:
        axis = figure.subplots()
        for k, (label, pair) in enumerate(series.items()):
            times, errors = _pair(label, pair)
            order = np.argsort(errors)
            bold = {"linewidth": 2.6, "markersize": 6} if label == OWN else {}
            axis.plot(errors[order], times[order], label=label, **style(k), **bold)
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.set_xlabel("error")
        axis.set_ylabel("run time  [s]")
        legend_beside(axis)
    return figure


def _pair(label, pair):
    try:
        times, errors = (np.asarray(each, float) for each in pair)
    except (TypeError, ValueError):
        raise InputError(f"the series {label!r} needs two rows of numbers, (times, errors)") from None
    if times.ndim != 1 or times.shape != errors.shape:
        raise InputError(f"the series {label!r} has times of shape {times.shape} and errors of shape {errors.shape}")
    shown = np.isfinite(times) & np.isfinite(errors) & (times > 0) & (errors > 0)
    if not shown.any():
        raise InputError(f"the series {label!r} has no point with a positive time and error")
    return times[shown], errors[shown]


def _field(row, key):
    return row[key] if isinstance(row, Mapping) else getattr(row, key)
