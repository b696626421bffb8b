"""What can be drawn of one solution, one call each; :func:`plot_solution` puts several under each other."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING

from ...errors import InputError
from . import panels
from .look import HEIGHT, WIDTH, new_figure
from .subject import Subject

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PICTURES = {
    "trajectory": ("configurations and velocities over time", panels.trajectory),
    "multipliers": ("constraint forces over time, the first steps magnified", panels.multipliers),
    "drift": ("how far the loops gape, and their velocities", panels.drift),
    "energy": ("energies, work of the forces, and the error of the balance", panels.energy),
    "steps": ("step size and order over time", panels.steps),
    "phase": ("phase portrait, velocity over configuration of each joint", panels.phase),
}
"""Name → what it shows, and what draws it: on two panels side by side, the phase portrait on a grid of its own."""


def plot_solution(sol, file=None, mech=None, what=("trajectory", "multipliers")) -> Figure:
    """Several pictures of a solution under each other.

    Parameters
    ----------
    sol : Solution
        Or any object with ``t``, shape (n,), s, and ``q``, ``v``, ``lam``, of n rows each; ``lam`` may have no
        columns, and is then not drawn.
    file : path, optional
        Where the figure is written, whole or not at all, over what was there; the ending chooses the format, such as
        ``.png``, ``.pdf`` or ``.svg``. Default: it is only returned.
    mech : Mechanism, optional
        Gives the curves the names of its joints and loop rows. Needed for the drift and the energy of a solution that
        was read from a file; by default the mechanism that was simulated.
    what : sequence of str
        Of ``"trajectory"``, ``"multipliers"``, ``"drift"``, ``"energy"``, ``"steps"`` and ``"phase"``.

    Returns
    -------
    matplotlib.figure.Figure
        Without a window, and unknown to pyplot; a notebook shows it.

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
    names = _known(what)
    subject = Subject(sol, mech)
    if len(names) > 1 and not subject.lam.shape[1]:
        names = [name for name in names if name != "multipliers"]
    groups = [(phase, list(group)) for phase, group in groupby(names, lambda name: name == "phase")]
    heights = [HEIGHT * (panels.lines(subject) if phase else len(group)) for phase, group in groups]
    with new_figure(WIDTH, sum(heights) + (0.3 if subject.mech is not None else 0.0), file) as figure:
        parts = figure.subfigures(len(groups), 1, height_ratios=heights, squeeze=False)[:, 0]
        for part, (phase, group) in zip(parts, groups, strict=True):
            if phase:
                panels.phase(part, subject)
                continue
            rows = part.subplots(len(group), 2, squeeze=False)  # in one grid, so that panels of equal width line up
            for (left, right), name in zip(rows, group, strict=True):
                PICTURES[name][1](left, right, subject)
        if subject.mech is not None:
            figure.suptitle(subject.mech.name)
    return figure


def plot_trajectory(sol, file=None, mech=None) -> Figure:
    """A figure of configuration and velocity over time.

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["trajectory"])


def plot_multipliers(sol, file=None, mech=None) -> Figure:
    """A figure of λ of each row over time, and its first twenty steps once more, magnified.

    Row 0 is the multiplier of the differential equation; from exact initial values (``consistency="exact"``) the rows
    after it are wrong by O(1), whatever the step size (Arévalo 2008).

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["multipliers"])


def plot_drift(sol, file=None, mech=None) -> Figure:
    """A figure of the largest size of Φ (m, rad) and of J v + Φ_t (m/s, rad/s) of each loop over time.

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["drift"])


def plot_energy(sol, file=None, mech=None) -> Figure:
    """A figure of energies and work of the forces, J, and the error of their balance, J (:class:`~pinconsist.Energy`).

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["energy"])


def plot_steps(sol, file=None, mech=None) -> Figure:
    """A figure of step size, s, and order over time; InputError for one with ``t_eval``, whose rows are no steps.

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["steps"])


def plot_phase(sol, file=None, mech=None) -> Figure:
    """A figure of velocity over configuration, a panel for each of the twelve widest joints of one freedom.

    A square marks the start.

    Parameters and errors as :func:`plot_solution`: `sol`, `file` (where the figure is written, if given) and `mech`.

    See Also
    --------
    plot_solution : Several pictures in one figure, and what `sol`, `file` and `mech` may be.
    """
    return plot_solution(sol, file, mech, ["phase"])


def _known(what) -> list[str]:
    names = [what] if isinstance(what, str) else list(what)
    for name in names:
        if name not in PICTURES:
            raise InputError(f"there is no picture {name!r}; there are {', '.join(PICTURES)}")
    if not names:
        raise InputError(f"what= names no picture; there are {', '.join(PICTURES)}")
    return list(dict.fromkeys(names))
