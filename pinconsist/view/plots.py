"""Figures in one look, legible in grey: lines differ in colour, dash and marker."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingExtraError
from ..files import written_whole

COLORS = ("#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9")
DASHES = ("-", "--", "-.", ":")
MARKERS = ("o", "s", "^", "D", "v", "x")
LEGEND = 12  # entries at most
FIRST_STEPS = 20
LOOK = {
    "font.size": 9,
    "axes.titlesize": 9,
    "axes.titlelocation": "left",
    "axes.grid": True,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "grid.color": "#d8dce0",
    "grid.linewidth": 0.6,
    "lines.linewidth": 1.3,
    "lines.markersize": 4,
    "legend.fontsize": 7.5,
    "legend.frameon": False,
    "figure.dpi": 130,
    "savefig.dpi": 160,
}


def plot_solution(sol, file=None, mech=None):
    """Configuration, velocity and multipliers over time; the multipliers' first steps once more, magnified.

    Parameters
    ----------
    sol : object
        With ``t``, shape (n,), s, and ``q``, ``v``, ``lam``, of n rows each; ``lam`` may have no columns.
    file : path, optional
        Where the figure is written, whole or not at all; the ending chooses the format.
    mech : Mechanism, optional
        Gives the curves the names of its joints and loop rows.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        Sizes that do not fit, or a file ending that matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    """
    matplotlib, Figure = _matplotlib()
    t = np.asarray(sol.t, float)
    parts = {name: np.asarray(getattr(sol, name), float) for name in ("q", "v", "lam")}
    for name, values in parts.items():
        if values.ndim != 2 or len(values) != t.size:
            raise InputError(f"a figure needs {name} of shape ({t.size}, columns), got {values.shape}")
    labels = _labels(parts, mech)
    with matplotlib.rc_context(LOOK):
        rows = 2 if parts["lam"].shape[1] else 1
        figure = Figure(figsize=(9.5, 3.0 * rows), layout="constrained")
        axes = figure.subplots(rows, 2, squeeze=False)
        _curves(axes[0, 0], t, parts["q"], labels["q"], "configuration q  [rad, m]")
        _curves(axes[0, 1], t, parts["v"], labels["v"], "velocity v  [rad/s, m/s]")
        if rows == 2:
            first = slice(0, FIRST_STEPS + 1)
            named = _curves(axes[1, 0], t, parts["lam"], labels["lam"], "multipliers λ  [N, N·m]")
            title = f"λ, the first {min(FIRST_STEPS, t.size - 1)} steps"
            _curves(axes[1, 1], t[first], parts["lam"][first], labels["lam"], title, magnified=named)
        if mech is not None:
            figure.suptitle(mech.name)
    return _save(figure, file)


def plot_comparison(rows, file=None):
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
    matplotlib, Figure = _matplotlib()
    records = [{key: np.asarray(_field(row, key), float) for key in ("h", "t", "exact", "consistent")} for row in rows]
    if not records:
        raise InputError("a comparison needs at least one step size")
    for row in records:
        if not row["t"].shape == row["exact"].shape == row["consistent"].shape == (row["t"].size,):
            raise InputError(f"the errors for h = {row['h']:g} do not have the shape of t, {row['t'].shape}")
    with matplotlib.rc_context(LOOK):
        columns = min(len(records), 3)
        lines = -(-len(records) // columns)
        figure = Figure(figsize=(max(3.3 * columns, 4.5), 2.9 * lines + 0.4), layout="constrained")
        axes = figure.subplots(lines, columns, sharey=True, squeeze=False)
        for axis, row in zip(axes.flat, records, strict=False):
            for k, (key, label) in enumerate((("exact", "exact start"), ("consistent", "consistent start"))):
                error = np.where(row[key] > 0, row[key], np.nan)  # a logarithm has no zero
                axis.plot(row["t"], error, label=label, markevery=_sparse(len(error), 10), **_style(1 - k))
            axis.set_yscale("log")
            axis.set_title(f"h = {row['h']:g} s")
            axis.set_xlabel("t  [s]")
        for axis in axes[:, 0]:
            axis.set_ylabel("‖error of λ‖")
        for axis in axes.flat[len(records) :]:
            axis.set_axis_off()
        axes[0, 0].legend()
    return _save(figure, file)


def _curves(axis, t, values, labels, title, *, magnified=None):
    """All columns over time; beyond twelve the widest get a name, the others are thin and grey. Returns the named.

    `magnified` is what a first panel named: the same columns in the same style, every step marked, no legend.
    """
    named = magnified
    if named is None:
        spread = np.ptp(values, axis=0) if len(values) else np.zeros(values.shape[1])
        named = sorted(np.argsort(-spread, kind="stable")[: LEGEND if len(labels) <= LEGEND else LEGEND - 1])
    others = [k for k in range(values.shape[1]) if k not in set(named)]
    for k in others:
        label = f"{len(others)} more" if k == others[0] else None
        axis.plot(t, values[:, k], color="#b0b4b8", linewidth=0.7, zorder=1, label=label)
    for k, column in enumerate(named):
        marks = 1 if magnified is not None else _sparse(len(t), 8, k)
        axis.plot(t, values[:, column], label=labels[column], markevery=marks, **_style(k))
    axis.set_title(title)
    axis.set_xlabel("t  [s]")
    if magnified is None and len(labels):
        axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=3)
    return named


def _style(k: int) -> dict:
    color, dash, marker = (choices[k % len(choices)] for choices in (COLORS, DASHES, MARKERS))
    return {"color": color, "linestyle": dash, "marker": marker, "markerfacecolor": "white"}


def _sparse(count: int, marks: int, shift: int = 0) -> tuple[int, int]:
    every = max(count // marks, 1)
    return shift * every // 4 % every, every


def _labels(parts, mech) -> dict[str, list[str]]:
    """A name for each column: of joints and loop rows if the mechanism is known and fits, else symbols."""
    symbols = {"q": "q", "v": "v", "lam": "λ"}
    labels = {name: [f"{symbols[name]}{k + 1}" for k in range(part.shape[1])] for name, part in parts.items()}
    if mech is None:
        return labels
    rows = [f"{loop} {row}" for loop, row in mech.row_labels]
    named = {
        "q": _joint_labels(mech.joints, list(mech.model.nqs)[1:]),
        "v": _joint_labels(mech.joints, list(mech.model.nvs)[1:]),
        "lam": rows if len(rows) == len(labels["lam"]) else labels["lam"],  # redundant rows may have been left out
    }
    for name, names in named.items():
        if len(names) != len(labels[name]):
            raise InputError(f"{mech.name!r} has {len(names)} columns of {name}, the solution {len(labels[name])}")
    return named


def _joint_labels(joints, sizes) -> list[str]:
    return [f"{name}[{k}]" if size > 1 else name for name, size in zip(joints, sizes, strict=True) for k in range(size)]


def _field(row, key):
    return row[key] if isinstance(row, Mapping) else getattr(row, key)


def _matplotlib():
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("figures need matplotlib; install it by: pip install 'pinconsist[plot]'") from None
    return matplotlib, Figure


def _save(figure, file):
    if file is not None:
        ending = Path(file).suffix.lstrip(".").lower()
        known = figure.canvas.get_supported_filetypes()
        if ending not in known:
            raise InputError(f"{file}: a figure's file must end in one of {', '.join(sorted(known))}")
        with written_whole(file) as stream:
            figure.savefig(stream, format=ending)
    return figure
