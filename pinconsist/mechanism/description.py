"""A mechanism in words: a few lines of text, HTML, and short texts that say whether two mechanisms are the same."""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Mapping
from html import escape

import numpy as np

from .drawing import svg_of
from .forces import bound_forces
from .names import position_names, position_units

WIDTH = 100  # characters of a line


def text_of(mechanism) -> str:
    """Name and sizes; then the names of joints, loops, forces and motors, a line each, cut where they are many."""
    model = mechanism.model
    loops = [f"{loop.name} ({loop.kind})" for loop in mechanism.loops]
    head = f"{mechanism.name}: {_counted(mechanism.joints, 'joint')} (nq {model.nq}, nv {model.nv})"
    head += f", {_counted(loops, 'loop')} ({mechanism.nc} rows)" if loops else ""
    parts = {
        "joints": mechanism.joints,
        "loops": loops,
        "forces": bound_forces(model, mechanism.forces),
        "motors": mechanism.actuated,
    }
    lines = [f"  {what:<7} {_cut(list(names))}" for what, names in parts.items() if names]
    return "\n".join([head, *lines])


def _counted(names, what) -> str:
    return f"{len(names)} {what}{'s' * (len(names) != 1)}"


def _cut(names) -> str:
    shown = len(names)
    while shown > 1 and len(", ".join(names[:shown])) > WIDTH:
        shown -= 1
    return ", ".join(names[:shown]) + (f", … ({len(names)})" if shown < len(names) else "")


def html_of(mechanism) -> str:
    """A picture, a table of the joints, with guess and limits, and a list of loops and forces."""
    model, rows, names, units = mechanism.model, [], position_names(mechanism.model), position_units(mechanism.model)
    motors = set(mechanism.actuated)
    kinds = [kind for i in range(1, model.njoints) for kind in [_kind(model, i)] * model.nqs[i]]
    for name, unit, kind, value, *ends in zip(
        names, units, kinds, mechanism.guess, model.lowerPositionLimit, model.upperPositionLimit, strict=True
    ):
        limits = " … ".join(f"{end:.4g}" for end in ends) if np.isfinite(ends).any() and ends[0] < ends[1] else ""
        motor = "motor" if name.partition("[")[0] in motors else ""
        rows.append((name, kind, f"{value:.5g} {unit}", limits, motor))
    records = [f"{loop.kind} {loop.name}" for loop in mechanism.loops]
    return (
        f"<b>{escape(mechanism.name)}</b><br/>{svg_of(mechanism)}"
        + _table(("joint", "kind", "guess", "limits", ""), rows)
        + "".join(
            f"<p>{what}: {escape(', '.join(each))}</p>"
            for what, each in (("loops", records), ("forces", list(bound_forces(model, mechanism.forces))))
            if each
        )
    )


def _kind(model, i) -> str:
    return model.joints[i].shortname().removeprefix("JointModel")


def _table(heads, rows) -> str:
    lines = ["".join(f"<th>{head}</th>" for head in heads)]
    lines += ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in rows]
    return "<table>" + "".join(f"<tr>{line}</tr>" for line in lines) + "</table>"


def digests(mechanism) -> dict[str, str]:
    """SHA-256 of ``model`` (as this version of Pinocchio writes it), ``loops``, ``forces`` and ``guess``.

    User-defined functions and objects are identified by their names alone.
    """
    parts = {"model": mechanism.model.saveToString()}
    parts |= {name: repr(_plain(getattr(mechanism, name))) for name in ("loops", "forces", "guess")}
    return {name: hashlib.sha256(text.encode()).hexdigest() for name, text in parts.items()}


def _plain(value):
    """An equivalent of `value` that has the same `repr` in every process."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = [field.name for field in dataclasses.fields(value)]
        return type(value).__name__, [(name, _plain(getattr(value, name))) for name in fields]
    if isinstance(value, Mapping):
        return [(key, _plain(each)) for key, each in value.items()]
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, functools.partial):
        return "partial", _plain(value.func), _plain(value.args), _plain(value.keywords)
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"
