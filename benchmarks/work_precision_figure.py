"""A figure of run time against error."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from pinconsist import InputError
from pinconsist.view.panels import legend_beside, new_figure, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

OWN = "pinconsist BDF"  # drawn bold; other methods are compared with it


def plot_work_precision(series, file=None, error="largest error of q  [rad, m]") -> Figure:
    """A figure of run time against error, a line for each method: further left and lower is better.

    Parameters
    ----------
    series : mapping
        Label → (times, errors), of shape (n,) each: run times, s, and errors; values that are not positive and finite
        are omitted.
    file : path, optional
        File to which the figure is written, ``.png``, ``.pdf`` or ``.svg``. Default: none.
    error : str
        Label of the axis of the errors.

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
            try:
                times, errors = (np.asarray(each, float) for each in pair)
            except (TypeError, ValueError):
                raise InputError(f"the series {label!r} needs two rows of numbers, (times, errors)") from None
            if times.ndim != 1 or times.shape != errors.shape:
                shapes = f"times of shape {times.shape} and errors of shape {errors.shape}"
                raise InputError(f"the series {label!r} has {shapes}")
            shown = np.isfinite(times) & np.isfinite(errors) & (times > 0) & (errors > 0)
            if not shown.any():
                raise InputError(f"the series {label!r} has no point with a positive time and error")
            times, errors = np.array([times, errors])[:, shown][:, np.argsort(errors[shown])]
            bold = {"linewidth": 2.6, "markersize": 6} if label == OWN else {}
            axis.plot(errors, times, label=label, **style(k), **bold)
        axis.set(xscale="log", yscale="log", xlabel=error, ylabel="run time  [s]")
        legend_beside(axis)
    return figure
