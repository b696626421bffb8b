"""Figures of a solution, and of any quantities of several."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np

from ..errors import InputError
from ..mechanism.checks import names as checked_names
from . import panels
from .panels import DrawnSolution, clock, new_figure, of_quantities

if TYPE_CHECKING:
    from matplotlib.figure import Figure

WIDTH, HEIGHT = 11.0, 3.0  # size of a row of panels, inches
BOTH = "trajectory", "multipliers"  # what is drawn if no picture is named
PICTURES = {
    "trajectory": ("configurations and velocities over time", panels.trajectory),
    "multipliers": ("constraint forces over time, the first steps magnified", panels.multipliers),
    "forces": ("forces and moments in all loops and joints over time", panels.forces),
    "contacts": ("gaps of contacts and their forces over time, with the times of impacts", panels.contacts),
    "drift": ("how far the loops are open, and how fast they open", panels.drift),
    "energy": ("energies, work of the forces, and the error of the balance", panels.energy),
    "steps": ("step size and order over time", panels.steps),
    "phase": ("phase portrait, velocity over configuration of each joint", panels.phase),
}
"""Name → description, and function that draws it: on two panels side by side; the phase portrait has its own grid."""


def plot(runs, *quantities: str, file=None, mech=None) -> Figure:
    """Plot any quantities over time, for one run or for several, such as those of two designs.

    ``pc.plot({"short": a, "long": b}, "reaction:pin", "torque motor")``. Each unit has its own panel. For a vector the
    norm is plotted, unless a component is named; other quantities with several components have a curve for each.

    Parameters
    ----------
    runs : Solution, or mapping of str to Solution
        One run; or several by names, which the legend shows. They may differ in their mechanisms and times.
    *quantities : str
        The quantities to plot, as for :meth:`Solution.evaluate`, without a statistic or a time.
    file : path, optional
        File to which the figure is written, atomically; an existing file is replaced. The file extension determines the
        format, such as ``.png``, ``.pdf`` or ``.svg``. Default: the figure is only returned.
    mech : Mechanism or mapping of str to Mechanism, optional
        Mechanism of all runs, or of each by its name. Needed for runs that were read from files.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        No run, no quantity, one that a run does not have, or a file extension that matplotlib cannot write.
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


def pictures_of(sol, pictures, file=None, mech=None) -> Figure:
    """A figure with pictures of a solution under each other: see :meth:`pinconsist.Solution.plot`.

    The solution may be any object with ``t``, shape (n,), s, and ``q``, ``v``, ``lam``, of n rows each; ``lam`` without
    columns is not drawn.
    """
    names = list(dict.fromkeys(checked_names(pictures, "pictures")))
    if not names or (unknown := [name for name in names if name not in PICTURES]):
        reason = f"there is no picture {unknown[0]!r}" if names else "plot() names no picture"
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
