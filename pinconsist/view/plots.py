"""Figures of a solution, one call each; and of several runs: errors of the multipliers, work against precision."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..mechanism.checks import names as checked_names
from . import panels
from .panels import DrawnSolution, clock, legend_beside, new_figure, of_quantities, sparse, style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 11.0, 3.0  # size of a row of panels, inches
OWN = "pinconsist BDF"  # drawn bold; other methods are compared with it
STARTS = {  # name in a comparison → style, and label
    "exact": (1, "exact start"),
    "consistent": (0, "consistent start"),
    "every_step": (2, "every step corrected"),
}
EXACT = 1e-6  # relative to the largest error: a first row with a smaller one is an exact start
PICTURES = {
    "trajectory": ("configurations and velocities over time", panels.trajectory),
    "multipliers": ("constraint forces over time, the first steps magnified", panels.multipliers),
    "forces": ("forces and moments in all loops and joints over time", panels.forces),
    "drift": ("how far the loops are open, and how fast they open", panels.drift),
    "energy": ("energies, work of the forces, and the error of the balance", panels.energy),
    "steps": ("step size and order over time", panels.steps),
    "phase": ("phase portrait, velocity over configuration of each joint", panels.phase),
}
"""Name → description, and function that draws it: on two panels side by side; the phase portrait has its own grid."""


def plot(runs, *quantities: str, file=None, mech=None) -> Figure:
    """A figure of any quantities over time, of one run or of several, such as those of two designs.

    ``pc.plot({"short": a, "long": b}, "reaction:pin", "torque motor")``. Each unit has a panel of its own. A vector is
    drawn by its length, unless a component is named; other quantities of several numbers have a curve for each.

    Parameters
    ----------
    runs : Solution, or mapping of str to Solution
        One run; or several by names, which the legend shows. They may differ in their mechanisms and times.
    *quantities : str
        What is drawn, as for :meth:`Solution.evaluate`, without a statistic or a time.
    file : path, optional
        As in :func:`plot_solution`.
    mech : Mechanism or mapping of str to Mechanism, optional
        Mechanism of all runs, or of each by its name. Needed for runs that were read from files.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        No run, no quantity, one that a run does not have, or a file ending that matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    OSError
        The file cannot be written.
    """
    by_name = dict(runs) if isinstance(runs, Mapping) else {"": runs}
    if not by_name or not quantities:
        raise InputError("plot() needs a run, or several by names, and at least one quantity: 'reaction pin'")
    if isinstance(mech, Mapping) and (missing := [name for name in by_name if name not in mech]):
        raise InputError(f"mech= has no mechanism for {missing[0]!r}")
    curves = []
    for name, sol in by_name.items():
        if not hasattr(sol, "evaluate"):
            raise InputError(f"plot() needs a Solution, or a mapping of names to them, got {type(sol).__name__}")
        curves += panels.curves_of(sol, name, quantities, mech[name] if isinstance(mech, Mapping) else mech)
    order = list(dict.fromkeys(curve.of for curve in curves))
    curves.sort(key=lambda curve: order.index(curve.of))  # the same of all runs next to each other
    units = list(dict.fromkeys(curve.unit for curve in curves))
    with new_figure(WIDTH * 0.7, HEIGHT * len(units), file) as figure:
        axes = figure.subplots(len(units), 1, sharex=True, squeeze=False)[:, 0]
        span = max((curve.t for curve in curves), key=np.ptp)
        for axis, unit in zip(axes, units, strict=True):
            of_quantities(axis, [curve for curve in curves if curve.unit == unit], unit, span)
        axes[-1].set_xlabel(clock(span)[1])
    return figure


def plot_solution(sol, file=None, mech=None, what=("trajectory", "multipliers")) -> Figure:
    """Several pictures of a solution under each other.

    Parameters
    ----------
    sol : Solution
        A solution, or any object with ``t``, shape (n,), s, and ``q``, ``v``, ``lam``, of n rows each; ``lam`` without
        columns is not drawn.
    file : path, optional
        File to which the figure is written, whole or not at all; an existing file is replaced. The ending chooses the
        format, such as ``.png``, ``.pdf`` or ``.svg``. Default: the figure is only returned.
    mech : Mechanism, optional
        Mechanism whose joints and loop rows name the curves. Needed for forces, drift and energy of a solution that
        was read from a file; by default the mechanism that was simulated.
    what : sequence of str
        Of ``"trajectory"``, ``"multipliers"``, ``"forces"``, ``"drift"``, ``"energy"``, ``"steps"`` and ``"phase"``.

    Returns
    -------
    matplotlib.figure.Figure
        A figure without a window, not registered with pyplot; a notebook shows it.

    Raises
    ------
    InputError
        Sizes that do not fit, an unknown picture, one that this solution does not have, or a file ending that
        matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    OSError
        The file cannot be written.
    """
    names = list(dict.fromkeys(checked_names(what, "what")))
    if not names or (unknown := [name for name in names if name not in PICTURES]):
        reason = f"there is no picture {unknown[0]!r}" if names else "what= names no picture"
        raise InputError(f"{reason}; available: {', '.join(PICTURES)}")
    drawn = DrawnSolution(sol, mech)
    if len(names) > 1 and not drawn.lam.shape[1]:
        names = [name for name in names if name != "multipliers"]
    groups = [(phase, list(group)) for phase, group in groupby(names, "phase".__eq__)]
    heights = [HEIGHT * (drawn.portrait_lines if phase else len(group)) for phase, group in groups]
    with new_figure(WIDTH, sum(heights) + (0.3 if drawn.mech is not None else 0.0), file) as figure:
        parts = figure.subfigures(len(groups), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, (phase, group) in zip(parts, groups, strict=True):
            if phase:
                panels.phase(part, drawn)
                continue
            rows = part.subplots(len(group), 2, squeeze=False)  # in one grid, so that panels of equal width line up
            for (left, right), name in zip(rows, group, strict=True):
                PICTURES[name][1](left, right, drawn)
        if drawn.mech is not None:
            figure.suptitle(drawn.mech.name)
    return figure


def plot_trajectory(sol, file=None, mech=None) -> Figure:
    """A figure of q and v over time. Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`."""
    return plot_solution(sol, file, mech, ["trajectory"])


def plot_multipliers(sol, file=None, mech=None) -> Figure:
    """A figure of λ of each row over time, and its first twenty steps once more, magnified.

    Row 0 is the multiplier of the differential equation; from exact initial values (``consistency="exact"``) the rows
    after it are wrong by O(1), whatever the step size (Arévalo 2008).
    Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["multipliers"])


def plot_forces(sol, file=None, mech=None) -> Figure:
    """A figure of the sizes of force, N, and moment, N·m, in each loop and each joint of the tree over time.

    Those that redundant loops share in a way that is not unique have a star.
    Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["forces"])


def plot_drift(sol, file=None, mech=None) -> Figure:
    """A figure of the largest size of Φ (m, rad) and of J v + Φ_t (m/s, rad/s) of each loop over time.

    Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["drift"])


def plot_energy(sol, file=None, mech=None) -> Figure:
    """A figure of energies and work of the forces, J, and the error of their balance, J (:class:`~pinconsist.Energy`).

    Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["energy"])


def plot_steps(sol, file=None, mech=None) -> Figure:
    """A figure of step size, s, and order over time; InputError for one with ``t_eval``, whose rows are not steps.

    Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["steps"])


def plot_phase(sol, file=None, mech=None) -> Figure:
    """A figure of velocity over configuration, a panel for each of the twelve widest joints of one degree of freedom.

    A square marks the start. Parameters and errors as :func:`plot_solution`: `sol`, `file`, `mech`.
    """
    return plot_solution(sol, file, mech, ["phase"])


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
        As in :func:`plot_solution`.

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
            first = int(np.argmax(size > EXACT * size.max(initial=0.0)))
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


def plot_work_precision(series, file=None, error="largest error of q  [rad, m]") -> Figure:
    """A figure of run time against error, a line for each method: further left and lower is better.

    Parameters
    ----------
    series : mapping
        Label → (times, errors), of shape (n,) each: run times, s, and errors; values that are not positive and finite
        are omitted.
    file : path, optional
        As in :func:`plot_solution`.
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
