"""What figures are made of: one look, legible in grey, and curves over time."""

from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingExtraError
from ..files import written_whole

COLORS = ("#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9")
DASHES = ("-", "--", "-.", ":", (0, (6, 2, 1, 2, 1, 2)))
MARKERS = ("o", "s", "^", "D", "v", "x", "P")  # 7, 6 and 5: 210 lines differ, and 35 without colour
GREY = "#b0b4b8"  # of lines without a name in the legend
LEGEND = 12  # entries at most
SHORT = ((1e-4, 1e6, "µs"), (0.1, 1e3, "ms"))  # s up to which times are in a smaller unit
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
    """An empty figure in this look, inches, written to `file` at the end of the block, whole or not at all."""
    ending = require_figure(file)
    from matplotlib import rc_context
    from matplotlib.figure import Figure

    with rc_context(LOOK):
        yield (figure := Figure(figsize=(width, height), layout="constrained"))
        if file is not None:
            with written_whole(file) as stream:
                figure.savefig(stream, format=ending)


def require_figure(file=None) -> str:
    """The format for the ending of `file`; MissingExtraError without matplotlib, InputError if it has none."""
    try:
        import matplotlib.backend_bases
    except ImportError:
        raise MissingExtraError("figures need matplotlib; install it by: pip install 'pinconsist[plot]'") from None
    known = matplotlib.backend_bases.FigureCanvasBase.get_supported_filetypes()
    ending = Path(file or "").suffix.lstrip(".").lower()
    if file is not None and ending not in known:
        raise InputError(f"{file}: a figure's file must end in one of {', '.join(sorted(known))}")
    return ending


def style(k: int) -> dict:
    """Colour, dash and marker of the k-th line."""
    color, dash, marker = (choices[k % len(choices)] for choices in (COLORS, DASHES, MARKERS))
    return {"color": color, "linestyle": dash, "marker": marker, "markerfacecolor": "white"}


def sparse(count: int, marks: int, shift: int = 0) -> tuple[int, int]:
    """Which of `count` points have one of about `marks` markers, those of neighbouring lines apart."""
    every = max(count // marks, 1)
    return shift * every // 4 % every, every


def legend_beside(axis):
    """A legend on the right of the panel, where it covers nothing."""
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=4.5)


def clock(t) -> tuple[np.ndarray, str]:
    """Times in a unit that fits how long they last, and the label of their axis."""
    span = np.ptp(t)
    factor, unit = next(((factor, unit) for most, factor, unit in SHORT if 0.0 < span < most), (1.0, "s"))
    return factor * np.asarray(t), f"t  [{unit}]"


def wrapped(t, angle) -> tuple[np.ndarray, np.ndarray]:
    """An angle within ±π over time, with a gap where it goes round."""
    within = (angle + np.pi) % (2 * np.pi) - np.pi
    gaps = 1 + np.flatnonzero(np.abs(np.diff(within)) > np.pi)
    return np.insert(t, gaps, np.nan), np.insert(within, gaps, np.nan)


def positive(values):
    """NaN for what a logarithm cannot show."""
    return np.where(values > 0, values, np.nan)


def widest(values, most: int) -> list[int]:
    """The columns with the largest range, in their own order."""
    return sorted(int(k) for k in np.argsort(-np.ptp(values, axis=0), kind="stable")[:most])


def curves(axis, t, values, labels, title, *, magnified=None, running=()):
    """All columns over time; of more than twelve the widest have a name, others and zeros are grey. Returns the named.

    `magnified` is what a first panel named: the same columns in the same style, every step marked, no legend. Angles
    `running` on are drawn within ±π, so that they leave room for the others.
    """
    t, time = clock(t)
    named = magnified
    if named is None:
        named = widest(values, LEGEND if len(labels) <= LEGEND else LEGEND - 1)
        named = [k for k in named if values[:, k].any()] or named
    others = sorted({*range(values.shape[1])} - {*named})
    rest = f"{len(others)} {'more' if values[:, others].any() else 'zero throughout'}"
    for k in others:
        line = wrapped(t, values[:, k]) if k in running else (t, values[:, k])
        axis.plot(*line, color=GREY, linewidth=0.7, zorder=1, label=rest if k == others[0] else None)
    for k, column in enumerate(named):
        marks = 1 if magnified is not None else sparse(len(t), 8, k)
        line = wrapped(t, values[:, column]) if column in running else (t, values[:, column])
        label = f"{labels[column]}, modulo 2π" if column in running else labels[column]
        axis.plot(*line, label=label, markevery=marks, **style(k))
    axis.set(title=title, xlabel=time)
    axis.ticklabel_format(scilimits=(-2, 4))  # short, so that none is cut at the figure's edge
    axis.locator_params(axis="x", nbins=6)
    if magnified is None and len(labels):
        legend_beside(axis)
    return named
