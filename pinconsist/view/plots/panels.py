"""The panels of each picture: functions of two axes, of the phase portrait of a (sub)figure, and of a subject."""

from __future__ import annotations

import numpy as np

from ...errors import InputError
from .look import COLORS, GREY, LEGEND, curves, legend_beside, positive, sparse, style, widest

FIRST_STEPS = 20
PORTRAITS, ABREAST = 12, 4


def trajectory(left, right, subject):
    """q and v over time."""
    curves(left, subject.t, subject.q, subject.labels["q"], "configuration q  [rad, m]")
    curves(right, subject.t, subject.v, subject.labels["v"], "velocity v  [rad/s, m/s]")


def multipliers(left, right, subject):
    """λ over time, and its first steps magnified."""
    if not subject.lam.shape[1]:
        raise InputError("there are no multipliers to draw: the solution has no constraints")
    first, labels = slice(0, FIRST_STEPS + 1), subject.labels["lam"]
    named = curves(left, subject.t, subject.lam, labels, "multipliers λ  [N, N·m]")
    title = f"λ, the first {min(FIRST_STEPS, subject.t.size - 1)} steps"
    curves(right, subject.t[first], subject.lam[first], labels, title, magnified=named)


def drift(left, right, subject):
    """|Φ| and |J v + Φ_t| of each loop."""
    loops, gaps, rates = subject.residuals
    if not loops:
        raise InputError("there is no drift to draw: the solution has no constraints")
    _specks(left, subject.t, gaps, loops, "loops gape by |Φ|  [m, rad]")
    _specks(right, subject.t, rates, loops, "loops open at |J v + Φ_t|  [m/s, rad/s]")


def _specks(axis, t, values, labels, title):
    """Sizes of rounding as specks on a logarithmic scale, where lines would be a thicket; zeros cannot be shown."""
    named = sorted(np.argsort(-values.max(axis=0), kind="stable")[:LEGEND])
    for k, column in enumerate(named):
        shown = positive(values[:, column])
        axis.plot(t, shown, label=labels[column], **style(k) | {"linestyle": "none", "markersize": 2.5})
    axis.set_title(title if len(named) == len(labels) else f"{title}, the worst {len(named)} of {len(labels)}")
    axis.set_xlabel("t  [s]")
    if values.any():
        axis.set_yscale("log")
        legend_beside(axis)
    else:
        axis.set_yticks([0.0])
        axis.text(0.5, 0.5, "zero throughout", transform=axis.transAxes, ha="center", va="bottom")


def energy(left, right, subject):
    """Energies and works, and the error of the balance."""
    found = subject.sol.energy(subject.need_mechanism("energy"))
    parts = {"kinetic": found.kinetic, "potential": found.potential}
    parts |= {"elastic": found.elastic} if found.stored else {}
    parts |= {"total": found.total} | {f"work of {name}": work for name, work in found.work.items()}
    curves(left, found.t, np.column_stack(list(parts.values())), list(parts), "energy and work  [J]")
    right.plot(found.t, found.error, markevery=sparse(found.t.size, 8), **style(0))
    right.set_title("error of the energy balance  [J]")
    right.ticklabel_format(axis="y", style="sci", scilimits=(-3, 4))
    right.set_xlabel("t  [s]")


def steps(left, right, subject):
    """Step size and order at the end of each step."""
    h, order = np.asarray(subject.sol.h), np.asarray(subject.sol.order)
    taken = h != 0  # zero where an event jumps
    if len(h) != subject.t.size - 1 or not taken.any():
        raise InputError("there are no steps to draw: with t_eval the rows of a solution are no steps")
    t, h, order = subject.t[1:][taken], np.abs(h[taken]), order[taken]
    left.plot(t, h, drawstyle="steps-pre", color=COLORS[0])
    left.set_title("step size  [s]")
    left.set_yscale("log")
    right.plot(t, order, drawstyle="steps-pre", color=COLORS[0])
    start = order == 0
    if start.any():
        right.plot(t[start], order[start], label="one-step start", **style(1) | {"linestyle": "none"})
        legend_beside(right)
    right.set_title("order")
    right.set_yticks(range(int(order.max()) + 1))
    for axis in (left, right):
        axis.set_xlabel("t  [s]")


def lines(subject) -> int:
    """Lines of panels that the phase portrait takes."""
    return max(1, -(-min(len(_portraits(subject)), PORTRAITS) // ABREAST))


def phase(figure, subject):
    """v over q of each joint with one freedom."""
    pairs = _portraits(subject)
    if not pairs:
        raise InputError("there is no phase portrait to draw: no joint has one configuration and one velocity")
    shown = [pairs[k] for k in widest(np.column_stack([subject.q[:, i] for i, _ in pairs]), PORTRAITS)]
    axes = figure.subplots(lines(subject), min(len(shown), ABREAST), squeeze=False).flat
    for axis, (i, k) in zip(axes, shown, strict=False):
        axis.plot(subject.q[:, i], subject.v[:, k], color=COLORS[0], linewidth=1.0)
        axis.plot(subject.q[0, i], subject.v[0, k], **style(1) | {"linestyle": "none"}, zorder=3)
        axis.axhline(0.0, color=GREY, linewidth=0.7, zorder=1)
        axis.set_title(subject.labels["q"][i])
    for axis in list(axes)[len(shown) :]:
        axis.set_axis_off()
    figure.supxlabel("configuration  [rad, m]", fontsize="medium")
    figure.supylabel("velocity  [rad/s, m/s]", fontsize="medium")


def _portraits(subject) -> list[tuple[int, int]]:
    """Columns of q and of v that belong together."""
    if subject.mech is None:
        return [(k, k) for k in range(subject.q.shape[1])] if subject.q.shape == subject.v.shape else []
    model = subject.mech.model
    joints = range(1, model.njoints)
    return [(model.idx_qs[j], model.idx_vs[j]) for j in joints if model.nqs[j] == model.nvs[j] == 1]
