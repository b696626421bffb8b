"""The one look of all figures, and how they are made and written."""

from __future__ import annotations

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...errors import InputError, MissingExtraError
from ...files import written_whole

COLORS = ("#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9")
DASHES = ("-", "--", "-.", ":", (0, (6, 2, 1, 2, 1, 2)))
MARKERS = ("o", "s", "^", "D", "v", "x", "P")  # 7, 6 and 5: 210 lines differ, and 35 without colour
GREY = "#b0b4b8"  # of what has no name of its own
LEGEND = 12  # entries at most
WIDTH, HEIGHT = 11.0, 3.0  # inches, of a row of panels
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


@contextmanager
def new_figure(width, height, file=None):
    """An empty figure in this look, written to `file` at the end of the block, whole or not at all.

    Raises
    ------
    InputError
        A file ending that matplotlib cannot write.
    MissingExtraError
        matplotlib is not installed.
    """
    try:
        import matplotlib
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtraError("figures need matplotlib; install it by: pip install 'pinconsist[plot]'") from None
    with matplotlib.rc_context(LOOK):
        figure = Figure(figsize=(width, height), layout="constrained")
        yield figure
        if file is None:
            return
        ending = Path(file).suffix.lstrip(".").lower()
        known = figure.canvas.get_supported_filetypes()
        if ending not in known:
            raise InputError(f"{file}: a figure's file must end in one of {', '.join(sorted(known))}")
        with written_whole(file) as stream:
            figure.savefig(stream, format=ending)


def style(k: int) -> dict:
    """Colour, dash and marker of the k-th line."""
    color, dash, marker = (choices[k % len(choices)] for choices in (COLORS, DASHES, MARKERS))
    return {"color": color, "linestyle": dash, "marker": marker, "markerfacecolor": "white"}


def sparse(count: int, marks: int, shift: int = 0) -> tuple[int, int]:
    """Which of `count` points carry one of about `marks` markers, those of neighbouring lines apart."""
    every = max(count // marks, 1)
    return shift * every // 4 % every, every


def curves(axis, t, values, labels, title, *, magnified=None):
    """All columns over time; of more than twelve the widest get a name, others and zeros are grey. Returns the named.

    `magnified` is what a first panel named: the same columns in the same style, every step marked, no legend.
    """
    named = magnified
    if named is None:
        named = widest(values, LEGEND if len(labels) <= LEGEND else LEGEND - 1)
        named = [k for k in named if values[:, k].any()] or named
    others = [k for k in range(values.shape[1]) if k not in set(named)]
    rest = f"{len(others)} {'more' if values[:, others].any() else 'zero throughout'}"
    for k in others:
        axis.plot(t, values[:, k], color=GREY, linewidth=0.7, zorder=1, label=rest if k == others[0] else None)
    for k, column in enumerate(named):
        marks = 1 if magnified is not None else sparse(len(t), 8, k)
        axis.plot(t, values[:, column], label=labels[column], markevery=marks, **style(k))
    axis.set_title(title)
    axis.set_xlabel("t  [s]")
    axis.ticklabel_format(scilimits=(-2, 4))  # short, so that none is cut at the figure's edge
    axis.locator_params(axis="x", nbins=6)
    if magnified is None and len(labels):
        legend_beside(axis)
    return named


def widest(values, most: int) -> list[int]:
    """The columns with the largest range, in their own order."""
    spread = np.ptp(values, axis=0) if len(values) else np.zeros(values.shape[1])
    return sorted(int(k) for k in np.argsort(-spread, kind="stable")[:most])


def legend_beside(axis):
    """A legend on the right of the panel, where it covers nothing."""
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=4.5)


def positive(values):
    """NaN for what a logarithm cannot show."""
    return np.where(np.asarray(values) > 0, values, np.nan)
