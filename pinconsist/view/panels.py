"""A solution with named columns, and the panels of each picture of it."""

from functools import cached_property
from textwrap import fill

import numpy as np

from ..errors import InputError
from ..mechanism.names import position_names, position_units, velocity_names
from ..mechanism.reactions import not_determined, undetermined
from ..mechanism.rows import LoopRows
from .figure import COLORS, GREY, LEGEND, clock, curves, legend_beside, sparse, style, widest

FIRST_STEPS = 20
ROUNDING = 1e-16  # where axes of residuals begin
PORTRAITS, ABREAST = 12, 4  # phase portraits at most, and in a line


class DrawnSolution:
    """The rows of a solution, its mechanism (None if it is not known), and a name for each column."""

    def __init__(self, sol, mech=None):
        self.sol, self.system = sol, getattr(sol, "system", None)
        self.mech = mech if mech is not None else getattr(self.system, "mechanism", None)
        self.t = np.asarray(sol.t, float)
        if not self.t.size:
            raise InputError("the solution has no rows to draw")
        self.q, self.v, self.lam = (np.asarray(values, float) for values in (sol.q, sol.v, sol.lam))
        self.labels = {}
        for name, values in (("q", self.q), ("v", self.v), ("lam", self.lam)):
            if values.ndim != 2 or len(values) != self.t.size:
                raise InputError(f"a figure needs {name} of shape ({self.t.size}, columns), got {values.shape}")
            labels = [f"{'λ' if name == 'lam' else name}{k + 1}" for k in range(values.shape[1])]
            if self.mech is None:
                names = labels
            elif name == "lam":
                names = [f"{loop} {row}" for loop, row in self.mech.row_labels]
            else:
                names = (position_names if name == "q" else velocity_names)(self.mech.model)
            if len(names) != len(labels) and name != "lam":  # redundant rows may have been left out
                raise InputError(f"{self.mech.name!r} has {len(names)} columns of {name}, the solution {len(labels)}")
            self.labels[name] = names if len(names) == len(labels) else labels

    def need_mechanism(self, of_what: str):
        """The mechanism, or an error that says how to give it."""
        if self.mech is None:
            why = "A solution read from a file does not hold it, a general problem has none"
            raise InputError(f"a picture of the {of_what} needs the mechanism: give it as mech=. {why}")
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
            data, rows = mech.model.createData(), LoopRows.of(mech)
            parts = rows.slices

            def evaluate(t, q, v):
                phi, J = rows.at(data, q, t)
                return phi, J @ v + rows.time_rate(t, q)

        both = np.abs([evaluate(*state) for state in zip(self.t, self.q, self.v, strict=True)])
        worst = np.reshape([both[..., part].max(axis=-1) for part in parts.values()], (len(parts), self.t.size, 2))
        return list(parts), worst[..., 0].T, worst[..., 1].T

    @property
    def running(self) -> list[int]:
        """Columns of angles that make whole turns, where others of `q` do not."""
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
    curves(left, drawn.t, drawn.q, drawn.labels["q"], "configuration q  [rad, m]", running=drawn.running)
    curves(right, drawn.t, drawn.v, drawn.labels["v"], "velocity v  [rad/s, m/s]")


def multipliers(left, right, drawn):
    """λ over time, and its first steps magnified."""
    if not drawn.lam.shape[1]:
        raise InputError("there are no multipliers to draw: the solution has no constraints")
    first, labels, lam = slice(0, FIRST_STEPS + 1), drawn.labels["lam"], drawn.lam
    without = {} if drawn.mech is None else undetermined(drawn.mech, drawn.t, drawn.q)
    if without and len(labels) == drawn.mech.nc:
        kept = [k for k, (loop, _) in enumerate(drawn.mech.row_labels) if loop not in without]
        labels, lam = [labels[k] for k in kept], lam[:, kept]
        note = fill(f"not drawn: {not_determined(without)}", 72)
        left.text(0.0, -0.25, note, transform=left.transAxes, va="top", fontsize="small")
    named = curves(left, drawn.t, lam, labels, "multipliers λ  [N, N·m]")
    title = f"λ, the first {min(FIRST_STEPS, drawn.t.size - 1)} steps  [N, N·m]"
    curves(right, drawn.t[first], lam[first], labels, title, magnified=named)


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
            seen = np.where(values[:, column] > 0, np.maximum(values[:, column], ROUNDING), np.nan)
            axis.plot(t, seen, label=labels[column], **dots)
        worst = "" if len(named) == len(labels) else f", the worst {len(named)} of {len(labels)}"
        axis.set(title=title + worst, xlabel=time)
        if values.any():
            axis.set(yscale="log", ylim=(ROUNDING, max(10 * values.max(), 100 * ROUNDING)))
            legend_beside(axis)
        else:
            axis.set_yticks([0.0])
            axis.text(0.5, 0.5, "zero throughout", transform=axis.transAxes, ha="center", va="bottom")


def energy(left, right, drawn):
    """Energies since the start, so that a height is no matter, and works; and the error of the balance."""
    found = drawn.sol.energy(drawn.need_mechanism("energy"))
    parts = {"kinetic": found.kinetic, "potential": found.potential}
    parts |= {"elastic": found.elastic} if found.stored else {}
    parts |= {"total": found.total} | {f"work of {name}": work for name, work in found.work.items()}
    since = np.column_stack([part - part[0] for part in parts.values()])
    curves(left, found.t, since, list(parts), "energies since the start, and work  [J]")
    t, time = clock(found.t)
    right.plot(t, found.error, markevery=sparse(found.t.size, 8), **style(0))
    right.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    right.set(title="error of the energy balance  [J]", xlabel=time)


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
