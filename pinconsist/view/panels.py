"""The panels of each picture of a solution: one look, legible in grey, curves over time, and names of columns."""

from collections.abc import Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from textwrap import fill

import numpy as np

from ..errors import InputError, MissingExtraError
from ..files import as_path, written_whole
from ..mechanism.checks import require_mechanism
from ..mechanism.names import position_names, position_units, velocity_names
from ..mechanism.reactions import States, not_determined, reactions, shared_loads, undetermined
from ..mechanism.rows import LoopRows, Workspace
from .filled import as_solution, filled

COLORS = ("#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9")
DASHES = ("-", "--", "-.", ":", (0, (6, 2, 1, 2, 1, 2)))
MARKERS = ("o", "s", "^", "D", "v", "x", "P")  # 6, 5 and 7 have no common factor: 210 lines differ, 35 in grey
GREY = "#b0b4b8"  # of lines without a name in the legend
LEGEND = 12  # entries at most
SHORT = ((1e-4, 1e6, "µs"), (0.1, 1e3, "ms"))  # times up to this, s, are in a smaller unit
LOOK = {
    "font.size": 9, "axes.titlesize": 9, "axes.titlelocation": "left", "axes.grid": True, "axes.spines.top": False,
    "axes.spines.right": False, "grid.color": "#d8dce0", "grid.linewidth": 0.6, "lines.linewidth": 1.3,
    "lines.markersize": 4, "legend.fontsize": 7.5, "legend.frameon": False, "figure.dpi": 130, "savefig.dpi": 160,
}  # fmt: skip
FIRST_STEPS = 20
RESIDUAL_FLOOR = 1e-16  # lower end of axes of residuals
PORTRAITS, ABREAST = 12, 4  # largest number of phase portraits; portraits in a row


@contextmanager
def new_figure(width, height, file=None):
    """An empty figure in this style, inches, written to `file` at the end of the block, completely or not at all."""
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
        raise MissingExtraError("figures need matplotlib; install it with: pip install 'pinconsist[plot]'") from None
    known = matplotlib.backend_bases.FigureCanvasBase.get_supported_filetypes()
    ending = as_path("" if file is None else file).suffix.lstrip(".").lower()
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
    """A legend to the right of the panel, so that it does not cover curves."""
    axis.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), handlelength=4.5)


def clock(t) -> tuple[np.ndarray, str]:
    """Times in a unit that fits their duration, and the label of their axis."""
    span = np.ptp(t)
    factor, unit = next(((factor, unit) for most, factor, unit in SHORT if 0.0 < span < most), (1.0, "s"))
    return factor * np.asarray(t), f"t  [{unit}]"


def wrapped(t, angle) -> tuple[np.ndarray, np.ndarray]:
    """An angle within ±π over time, with a gap where it wraps."""
    within = (angle + np.pi) % (2 * np.pi) - np.pi
    gaps = 1 + np.flatnonzero(np.abs(np.diff(within)) > np.pi)
    return np.insert(t, gaps, np.nan), np.insert(within, gaps, np.nan)


def widest(values, most: int) -> list[int]:
    """The columns with the largest range, in their original order."""
    return sorted(int(k) for k in np.argsort(-np.ptp(values, axis=0), kind="stable")[:most])


def curves(axis, t, values, labels, title, *, magnified=None, running=()):
    """All columns over time; of more than twelve the widest have a name, others and zeros are grey. Returns the named.

    `magnified` holds the columns that a first panel named: they are drawn in the same style, every step marked, without
    a legend. Angles `running` on are drawn within ±π, so that they leave room for the others.
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
    axis.ticklabel_format(scilimits=(-2, 4))  # short, so that no label is cut off at the figure's edge
    axis.locator_params(axis="x", nbins=6)
    if magnified is None and len(labels):
        legend_beside(axis)
    return named


@dataclass(frozen=True)
class Curve:
    """A quantity of a run over time."""

    run: str
    of: str
    unit: str
    t: np.ndarray
    values: np.ndarray


def curves_of(sol, run: str, quantities, mech=None) -> list[Curve]:
    """The curves of quantities of a run, at rows and between them."""
    fine, found = filled(sol, mech), []
    if not len(fine.t):
        raise InputError("the solution has no rows to draw")
    for text in quantities:
        series, t = fine.series(text, mech), fine.t
        if not series.between:
            series, t = sol.series(text, mech), sol.t
        if series.vector:
            found.append(Curve(run, text, series.unit, t, np.linalg.norm(series.values, axis=1)))
            continue
        columns = series.values[:, None] if series.values.ndim == 1 else series.values
        names = [f"{text} {part}" if series.parts else text for part in series.parts or ("",)]
        found += [Curve(run, name, series.unit, t, column) for name, column in zip(names, columns.T, strict=True)]
    return found


def of_quantities(axis, found: list[Curve], unit, span):
    """Curves of one unit: a colour for each run and quantity, named by what differs between them."""
    factor = np.ptp(clock(span)[0]) / (np.ptp(span) or 1.0) or 1.0
    runs, quantities = ({getattr(curve, name) for curve in found} for name in ("run", "of"))
    for k, curve in enumerate(found):
        label = ": ".join(
            name for name, several in ((curve.run, len(runs) > 1), (curve.of, len(quantities) > 1)) if several
        )
        axis.plot(factor * curve.t, curve.values, label=label, markevery=sparse(len(curve.t), 8, k), **style(k))
    what = next(iter(quantities)) if len(quantities) == 1 else ""
    axis.set_title("  ".join(filter(None, (what, f"[{unit}]" if unit else ""))))
    axis.ticklabel_format(scilimits=(-2, 4))
    if len(found) > 1:
        legend_beside(axis)


class DrawnSolution:
    """The rows of a solution, its mechanism (None if it is not known), and a name for each column.

    Its ``curves`` are those of a solution with states between the rows as well, so that lines join them well.
    """

    def __init__(self, sol, mech=None):
        self.sol = as_solution(sol)
        self.system = self.sol.system
        self.mech = self.sol.mechanism if mech is None else mech
        if mech is not None:
            require_mechanism(mech, "a figure: mech=")
        missing = [name for name in ("t", "q", "v", "lam") if not hasattr(sol, name)]
        if missing:
            several = "; pc.plot({name: run, …}, quantity) draws several runs" if isinstance(sol, Mapping) else ""
            raise InputError(
                f"a figure needs a Solution, or an object with t, q, v and lam, got {type(sol).__name__}{several}"
            )
        self.t = np.asarray(sol.t, float)
        if not self.t.size:
            raise InputError("the solution has no rows to draw")
        self.q, self.v, self.lam = (np.asarray(values, float) for values in (sol.q, sol.v, sol.lam))
        known, self.labels = {}, {}
        if self.mech is not None:
            known = {"q": position_names(self.mech.model), "v": velocity_names(self.mech.model)}
            known["lam"] = [f"{loop} {row}" for loop, row in self.mech.row_labels]
        for name, values in (("q", self.q), ("v", self.v), ("lam", self.lam)):
            if values.ndim != 2 or len(values) != self.t.size:
                raise InputError(f"a figure needs {name} of shape ({self.t.size}, columns), got {values.shape}")
            labels = [f"{'λ' if name == 'lam' else name}{k + 1}" for k in range(values.shape[1])]
            names = known.get(name, labels)
            if len(names) != len(labels) and name != "lam":  # redundant rows may have been left out
                raise InputError(f"{self.mech.name!r} has {len(names)} columns of {name}, the solution {len(labels)}")
            self.labels[name] = names if len(names) == len(labels) else labels

    @cached_property
    def curves(self):
        """The solution at the times of curves."""
        if self.mech is None and self.system is None:
            return self
        of_file = self.mech if self.sol.mechanism is None else None
        sol = filled(self.sol, of_file)
        return self if sol is self.sol else DrawnSolution(sol, self.mech)

    def need_mechanism(self, of_what: str):
        """The mechanism, or an error that explains how to pass it."""
        if self.mech is None:
            why = "A solution read from a file does not contain it, and a general problem has none"
            raise InputError(f"a picture of the {of_what} needs the mechanism: pass it as mech=. {why}")
        return self.mech

    def residuals(self) -> tuple[list[str], np.ndarray, np.ndarray]:
        """Loops, and the largest |Φ| and |J v + Φ_t| of each, shapes (n, loops); of a general problem, of each row."""
        if self.mech is None and (system := self.system) is not None:
            parts = {f"row {k + 1}": slice(k, k + 1) for k in range(system.nc)}

            def evaluate(t, q, v):
                rate = system.constraint(t, q, system.rate(t, q, v))[1]
                return system.evaluate(t, q, v, np.zeros(len(v)))[1], rate
        else:
            mech = self.need_mechanism("constraint drift")
            rows = LoopRows.of(mech)
            parts = rows.slices

            def evaluate(t, q, v):
                phi, J = rows.at(q, t)
                return phi, J @ v + rows.time_rate(t, q)

        both = np.abs([evaluate(*state) for state in zip(self.t, self.q, self.v, strict=True)])
        worst = np.reshape([both[..., part].max(axis=-1) for part in parts.values()], (len(parts), self.t.size, 2))
        return list(parts), worst[..., 0].T, worst[..., 1].T

    @property
    def running(self) -> list[int]:
        """Columns of angles that make whole turns, if other columns of `q` do not."""
        if self.mech is None:
            return []
        turns = np.array(position_units(self.mech.model)) == "rad"
        running = np.flatnonzero(turns & (np.ptp(self.q, axis=0) > 2 * np.pi)).tolist()
        return running if len(running) < self.q.shape[1] else []

    @cached_property
    def portraits(self) -> list[tuple[int, int]]:
        """Columns of q and of v that belong together."""
        if self.mech is None:
            return [(k, k) for k in range(self.q.shape[1])] if self.q.shape == self.v.shape else []
        m = self.mech.model
        return [(m.idx_qs[j], m.idx_vs[j]) for j in range(1, m.njoints) if m.nqs[j] == m.nvs[j] == 1]

    @property
    def portrait_lines(self) -> int:
        return max(1, -(-min(len(self.portraits), PORTRAITS) // ABREAST))


def trajectory(left, right, drawn):
    """q and v over time."""
    drawn = drawn.curves
    curves(left, drawn.t, drawn.q, drawn.labels["q"], "configuration q  [rad, m]", running=drawn.running)
    curves(right, drawn.t, drawn.v, drawn.labels["v"], "velocity v  [rad/s, m/s]")


def multipliers(left, right, drawn):
    """λ over time, and its first steps magnified."""
    if not drawn.lam.shape[1]:
        raise InputError("there are no multipliers to draw: the solution has no constraints")
    first = slice(0, FIRST_STEPS + 1)
    labels, fine = drawn.labels["lam"], drawn.curves
    lam, of_rows = fine.lam, drawn.lam
    without = {} if drawn.mech is None else undetermined(drawn.mech, drawn.t, drawn.q)
    if without and len(labels) == len(drawn.mech.row_labels):
        kept = [k for k, (loop, _) in enumerate(drawn.mech.row_labels) if loop not in without]
        labels, lam, of_rows = [labels[k] for k in kept], lam[:, kept], of_rows[:, kept]
        note = fill(f"not drawn: {not_determined(without)}", 72)
        left.text(0.0, -0.25, note, transform=left.transAxes, va="top", fontsize="small")
    named = curves(left, fine.t, lam, labels, "multipliers λ  [N, N·m]")
    title = f"λ, the first {min(FIRST_STEPS, drawn.t.size - 1)} steps  [N, N·m]"
    curves(right, drawn.t[first], of_rows[first], labels, title, magnified=named)


def forces(left, right, drawn):
    """The sizes of the forces and moments of all loops and joints of the tree."""
    mech, drawn = drawn.need_mechanism("forces"), drawn.curves
    t, q, v, lam = drawn.t, drawn.q, drawn.v, drawn.lam
    a, workspace = drawn.sol.acceleration(None, mech), Workspace(mech.model)
    states = States(mech, t, q, lam, workspace, lambda rows: (v[rows], a[rows]))
    anchored = [loop.name for loop in mech.anchored_loops]
    found = {each.loop: (each.force, each.moment) for each in reactions(mech, anchored, t, q, lam, workspace=workspace)}
    for joint, wrench in states.transmission().wrenches().items():
        found[f"joint {joint}" if joint in found else joint] = wrench[:, :3], wrench[:, 3:]
    if not found:
        raise InputError("there are no forces to draw: no loop and no joint transmits any")
    shared = shared_loads(states)
    labels = [f"{name} *" if name in shared else name for name in found]
    for axis, part, title in (left, 0, "forces in loops and joints  [N]"), (right, 1, "moments  [N·m]"):
        curves(axis, t, np.column_stack([np.linalg.norm(each[part], axis=1) for each in found.values()]), labels, title)
    if shared:
        note = "* not unique: redundant loops share the load"
        left.text(0.0, -0.25, note, transform=left.transAxes, va="top", fontsize="small")


def drift(left, right, drawn):
    """|Φ| and |J v + Φ_t| of each loop: dots on a logarithmic scale, as lines of rounding errors cannot be read."""
    labels, gaps, rates = drawn.residuals()
    if not labels:
        raise InputError("there is no drift to draw: the solution has no constraints")
    titles = ("loops are open by |Φ|  [m, rad]", "loops open at |J v + Φ_t|  [m/s, rad/s]")
    t, time = clock(drawn.t)
    for axis, values, title in zip((left, right), (gaps, rates), titles, strict=True):
        named = sorted(np.argsort(-values.max(axis=0), kind="stable")[:LEGEND])
        for k, column in enumerate(named):
            dots = style(k) | {"linestyle": "none", "markersize": 2.5}
            seen = np.where(values[:, column] > 0, np.maximum(values[:, column], RESIDUAL_FLOOR), np.nan)
            axis.plot(t, seen, label=labels[column], **dots)
        worst = "" if len(named) == len(labels) else f", the worst {len(named)} of {len(labels)}"
        axis.set(title=title + worst, xlabel=time)
        if values.any():
            axis.set(yscale="log", ylim=(RESIDUAL_FLOOR, max(10 * values.max(), 100 * RESIDUAL_FLOOR)))
            legend_beside(axis)
        else:
            axis.set_yticks([0.0])
            axis.text(0.5, 0.5, "zero throughout", transform=axis.transAxes, ha="center", va="bottom")


def energy(left, right, drawn):
    """Energies relative to the start, as the zero of heights is arbitrary, and works; and the error of the balance."""
    mech = drawn.need_mechanism("energy")
    found, of_rows = drawn.curves.sol.energy(mech), drawn.sol.energy(mech)
    parts = {"kinetic": found.kinetic, "potential": found.potential}
    parts |= {"elastic": found.elastic} if found.stored else {}
    parts |= {"total": found.total} | {f"work of {name}": work for name, work in found.work.items()}
    since = np.column_stack([part - part[0] for part in parts.values()])
    curves(left, found.t, since, list(parts), "energies since the start, and work  [J]")
    t, time = clock(of_rows.t)
    right.plot(t, of_rows.error, markevery=sparse(of_rows.t.size, 8), **style(0))
    right.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    right.set(title="error of the energy balance  [J]", xlabel=time)


def contacts(left, right, drawn):
    """The gaps of contacts, and the sizes of their forces, with a thin line at each impact."""
    mech, drawn = drawn.need_mechanism("contacts"), drawn.curves
    if not mech.contacts or drawn.sol.contacts is None:
        raise InputError("there are no contacts to draw: the mechanism has none, see mech.with_contacts()")
    found = {each.name: drawn.sol.contact(each.name, mech) for each in mech.contacts}
    gaps = {each.name: found[each.name].gap for each in mech.contacts if each.has_gap}
    sizes = {
        name: np.linalg.norm(each.force, axis=1) if each.force.ndim > 1 else np.abs(each.force)
        for name, each in found.items()
    }
    factor = np.ptp(clock(drawn.t)[0]) / (np.ptp(drawn.t) or 1.0)
    for axis, parts, title in (left, gaps, "gaps of contacts  [m, rad]"), (right, sizes, "contact forces  [N, N·m]"):
        columns = np.column_stack([*parts.values()]) if parts else np.zeros((len(drawn.t), 0))
        curves(axis, drawn.t, columns, list(parts), title)
        for time in factor * np.array([each.t for each in drawn.sol.impacts]):
            axis.axvline(time, color=GREY, linewidth=0.5, zorder=0)


def steps(left, right, drawn):
    """Step size and order at the end of each step."""
    h, order = np.asarray(drawn.sol.h), np.asarray(drawn.sol.order)
    taken = h != 0  # zero at the state change of an event
    if len(h) != drawn.t.size - 1 or not taken.any():
        raise InputError("there are no steps to draw: with t_eval the rows of a solution are not steps")
    t, time = clock(drawn.t)
    t, h, order = t[1:][taken], np.abs(h[taken]), order[taken]
    left.plot(t, h, drawstyle="steps-pre", color=COLORS[0])
    left.set(title="step size  [s]", yscale="log", xlabel=time)
    right.plot(t, order, drawstyle="steps-pre", color=COLORS[0])
    if (start := order == 0).any():
        right.plot(t[start], order[start], label="one-step start", **style(1) | {"linestyle": "none"})
        legend_beside(right)
    right.set(title="order", yticks=range(int(order.max()) + 1), xlabel=time)


def phase(figure, drawn):
    """v over q of each joint of one degree of freedom."""
    if not drawn.portraits:
        raise InputError("there is no phase portrait to draw: no joint has one configuration and one velocity")
    drawn = drawn.curves
    shown = [drawn.portraits[k] for k in widest(drawn.q[:, [i for i, _ in drawn.portraits]], PORTRAITS)]
    axes = list(figure.subplots(drawn.portrait_lines, min(len(shown), ABREAST), squeeze=False).flat)
    for axis, (i, k) in zip(axes, shown, strict=False):
        axis.plot(drawn.q[:, i], drawn.v[:, k], color=COLORS[0], linewidth=1.0)
        axis.plot(drawn.q[0, i], drawn.v[0, k], **style(1) | {"linestyle": "none"}, zorder=3)
        axis.axhline(0.0, color=GREY, linewidth=0.7, zorder=1)
        axis.set_title(drawn.labels["q"][i])
    for axis in axes[len(shown) :]:
        axis.set_axis_off()
    figure.supxlabel("configuration  [rad, m]", fontsize="medium")
    figure.supylabel("velocity  [rad/s, m/s]", fontsize="medium")
