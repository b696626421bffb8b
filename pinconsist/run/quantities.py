"""Quantities of a run by their names, as they are written on the command line: ``peak reaction boom_pin``.

The grammar is that of :meth:`pinconsist.Solution.evaluate`. It is read here only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from math import isfinite
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..mechanism.checks import frame_of, near
from ..mechanism.contacts import contact_units
from ..mechanism.energy import integrals
from ..mechanism.forces import bound_forces
from ..mechanism.joint_constraints import JointConstraint
from ..mechanism.names import position_names, position_units, velocity_names, velocity_units
from ..mechanism.peaks import Sought
from ..mechanism.reactions import Reaction
from ..mechanism.rows import LoopRows
from .results import element_units, joint_of, torque_unit

RANKS: dict[str, Callable] = {"min": np.negative, "max": np.array, "peak": np.abs}
MEANS = ("rms", "mean")
STATISTICS = (*RANKS, *MEANS, "final")
AXES = ("x", "y", "z")
ENERGIES = ("total", "kinetic", "potential", "elastic", "error")
SHORT = {"q": "position", "v": "velocity", "a": "acceleration", "lam": "multipliers"}  # as in tables
FORM = "[min | max | peak | rms | mean | final] QUANTITY NAME [x | y | z] [at TIME]"


@dataclass(frozen=True, eq=False)
class Series:
    """A quantity at all rows of a solution: `values` of shape (n,), or (n, k) with the names of its k `parts`.

    A `vector` has a length; other parts are numbers of their own, as those of a joint, or coordinates of a point. What
    is not known `between` the rows is a result of the rows, such as the error of their energy balance.
    """

    values: np.ndarray
    unit: str
    parts: tuple[str, ...] = ()
    vector: bool = False
    between: bool = True


@dataclass(frozen=True)
class Quantity:
    """A quantity as it was read from a text: what, of which joint, loop, frame or force; which part; and when."""

    text: str
    what: str
    name: str = ""
    part: str = ""
    statistic: str = ""  # empty: the values of all rows
    time: float | None = None

    @classmethod
    def of(cls, text: str, mechanism) -> Quantity:
        """The quantity that a text means; InputError if it means none."""
        words = str(text).split()
        statistic = words.pop(0) if len(words) > 1 and words[0] in STATISTICS else ""
        time = None
        if len(words) > 2 and words[-2] == "at":
            time = _time(text, words.pop())
            words.pop()
            if statistic:
                raise InputError(f"{text!r}: {statistic} is of the whole run; leave out the time")
            statistic = "at"
        if not words:
            raise InputError(f"{text!r} names no quantity: {FORM}, QUANTITY one of {', '.join(SERIES)}")
        if words[0] == "joint" and words[1:2] and words[1] in ("force", "moment"):
            words[:2] = [f"joint_{words[1]}"]
        what, colon, rest = words[0].partition(":")
        what = SHORT.get(what, what)
        if what not in SERIES or not (colon or len(words) > 1 or what in WITHOUT_NAME):
            return _named(text, " ".join(words), mechanism, statistic, time)
        rest = " ".join(([rest] if rest else []) + words[1:])
        if what in WITHOUT_NAME:
            known = WITHOUT_NAME[what]
            if rest and rest not in known:
                raise InputError(f"{text!r}: {what} is {', '.join(known)}, not {rest!r}")
            return cls(text, what, "", rest or known[0], statistic, time)
        name, part = _split(rest, mechanism)
        return cls(text, what, name, part, statistic, time)

    def series(self, run, mechanism=None) -> Series:
        """The quantity at all rows of a solution; `mechanism` is as in :meth:`pinconsist.Solution.check`."""
        scene = run._mechanism(mechanism, "evaluate")
        found = SERIES[self.what](_Run(run, mechanism, scene), self)
        if not self.part or self.what in WITHOUT_NAME:
            return replace(found, between=not self.only_rows)
        if self.part not in found.parts:
            there = f"its parts are {', '.join(found.parts)}" if found.parts else "it is a single number"
            raise InputError(f"{self.text!r}: there is no part {self.part!r}; {there}")
        return Series(found.values[:, found.parts.index(self.part)], found.unit)

    def curve(self, run, mechanism=None) -> Series:
        """The series; InputError for a quantity that is one number of the whole run."""
        if self.statistic or self.what == "error":
            raise InputError(f"{self.text!r} is a number, not a curve; leave out {self.statistic or 'it'}")
        return self.series(run, mechanism)

    def value(self, run, mechanism=None) -> float | np.ndarray:
        """Its number, or one number for each part, by the statistic or at the time; by default at the last row."""
        if self.what == "error":
            return self._error(run, mechanism)
        if not len(run.t):
            raise InputError(f"{self.text!r}: the solution has no rows")
        if self.statistic in ("", "final", "at"):
            run = run if self.statistic != "at" else self._there(run, [self.time], mechanism)
            found = self.series(run, mechanism).values[-1]
            return found if found.ndim else float(found)
        if self.statistic in RANKS:
            return self.sought(run, mechanism).best()[0]
        points = self.sought(run, mechanism)
        squares = points.values**2 if self.statistic == "rms" else points.values
        mean = averages(points.t, squares[:, None])[0]
        return float(np.sqrt(mean) if self.statistic == "rms" else mean)

    def number(self, run, mechanism=None) -> float:
        """Its value, of a vector its length; InputError for one of several numbers."""
        found = self.value(run, mechanism)
        if np.ndim(found) == 0:
            return float(found)
        return float(self._sizes(self.series(run, mechanism), np.atleast_2d(found))[0])

    def labels(self, run, mechanism=None) -> list[str]:
        """A name for each number of its value."""
        found = self.series(run, mechanism)
        if self.statistic in (*RANKS, *MEANS) or not found.parts:
            return [self.name if self.text == self.name else self.text]
        return [f"λ {part}" for part in found.parts] if self.what == "multipliers" else list(found.parts)

    def require_number(self, run, mechanism=None) -> None:
        """Raise InputError if it is not a number of runs of this mechanism; `run` may end before its time."""
        if self.what != "error":
            found = self.series(run, mechanism)
            self._sizes(found, found.values)
        elif self.statistic not in ("", "final"):
            self._error(run, mechanism)

    def sought(self, run, mechanism=None) -> Sought:
        """The numbers of which its statistic is taken: at the rows, between them, and closer around an extremum."""
        values = self._sizes(found := self.series(run, mechanism), found.values)
        points = Sought(run.t, values, RANKS.get(self.statistic, np.abs))
        if len(run.t) < 2 or self.only_rows:
            return points

        def between(times):
            others = self.series(self._there(run, times, mechanism), mechanism)
            return self._continued(self._sizes(others, others.values), times, run, values, mechanism)

        return points.searched(between) if self.statistic in RANKS else points.refined(between)

    @property
    def only_rows(self) -> bool:
        """Whether it is a result of the rows, which has no meaning between them."""
        return self.what == "energy" and self.part == "error"

    def _there(self, run, times, mechanism):
        if self.only_rows:
            raise InputError(f"{self.text!r}: the error of the energies is known at the rows of the solution only")
        return run.at(np.array(times, float), mechanism)

    def _sizes(self, found: Series, values):
        """One number a row: the length of a vector."""
        if values.ndim == 1:
            return values
        if not found.vector:
            example = f"{self.name} {found.parts[0]}" if found.parts[0] in AXES else found.parts[0]
            raise InputError(
                f"{self.text!r} has {len(found.parts)} numbers, {', '.join(found.parts)}: name one of them, as in "
                f"'{self.what} {example}'"
            )
        return np.linalg.norm(values, axis=1)

    def turns(self, mechanism) -> bool:
        """Whether it is an angle that is known up to whole turns only."""
        return self.what == "position" and _stores_cos_sin(mechanism, self.name)

    def _continued(self, found, times, run, values, mechanism):
        """Angles, which are unwrapped from row to row, by whole turns next to those of the rows."""
        if not self.turns(run._mechanism(mechanism, "position", False)):
            return found
        sign = 1.0 if run.t[-1] >= run.t[0] else -1.0
        return next_to(found, np.interp(sign * times, sign * run.t, values))

    def _error(self, run, mechanism) -> float:
        if self.statistic not in ("", "final"):
            raise InputError(f"{self.text!r}: the error is one number of the whole run")
        certificate = run.check(mechanism, error=True)
        if certificate.error is None:
            raise InputError(f"{self.text!r}: {certificate.error_missing}")
        return getattr(certificate.error, self.part)


def averages(t, values):
    """Means over time of values of shape (n, k) at n times, shape (k,)."""
    if len(t) < 2 or t[-1] == t[0]:
        return values.mean(axis=0)
    return integrals(t, values)[-1] / (t[-1] - t[0])


def next_to(angles, others):
    """Angles changed by whole turns so that they are next to others."""
    return angles + 2 * np.pi * np.round((others - angles) / (2 * np.pi))


@dataclass(frozen=True)
class _Run:
    """A solution, the mechanism that was passed with it, if any, and the mechanism with names, forces and loops."""

    solution: Any
    passed: Any
    scene: Any


def _time(text, word) -> float:
    try:
        time = float(word)
    except ValueError:
        raise InputError(f"{text!r}: {word!r} is not a time, s") from None
    if not isfinite(time):
        raise InputError(f"{text!r}: the time is not finite")
    return time


def _names(mechanism) -> dict[str, str]:
    """What each name alone means: the position of a joint, multipliers of a loop, position of a frame, force."""
    model = mechanism.model
    found = dict.fromkeys(bound_forces(model, mechanism.forces), "force")
    found |= dict.fromkeys((frame.name for frame in model.frames), "position")
    found |= dict.fromkeys((loop.name for loop in mechanism.loops), "multipliers")
    found |= dict.fromkeys(
        (name for each in mechanism.contact_elements for name in (each.record.name, each.name)), "contact"
    )
    return found | dict.fromkeys((*mechanism.joints, *position_names(model), *velocity_names(model)), "position")


def _split(rest, mechanism) -> tuple[str, str]:
    """A name and a part of it."""
    before, _, last = rest.rpartition(" ")
    known = _names(mechanism)
    if before and rest not in known and (last in AXES or before in known):
        return before, last
    return rest, ""


def _named(text, rest, mechanism, statistic, time) -> Quantity:
    """The quantity of a name alone."""
    name, part = _split(rest, mechanism)
    known = _names(mechanism)
    if name in SERIES and name not in known:
        raise InputError(f"{text!r}: of what? {FORM}")
    if name not in known:
        raise InputError(
            f"{text!r}: {mechanism.name} has no joint, loop, frame or force {name!r}{near(name, (*known, *SERIES))}; a "
            f"quantity is {FORM}, QUANTITY one of {', '.join(SERIES)}"
        )
    return Quantity(text, known[name], name, part, statistic, time)


def _is_joint(mechanism, name) -> bool:
    return name in mechanism.joints or (name.partition("[")[0] in mechanism.joints and name.endswith("]"))


def _stores_cos_sin(mechanism, name) -> bool:
    if name not in mechanism.joints:
        return False
    joint, model = mechanism.joint_index(name), mechanism.model
    return model.nqs[joint] == 2 and model.nvs[joint] == 1


def _of_joint(run, name, values, rate="") -> Series:
    """The positions of a joint, or with the unit of a `rate` its velocities."""
    model = run.scene.model
    names, units = (velocity_names(model), velocity_units(model)) if rate else (position_names(model),) * 2
    units = units if rate else position_units(model)
    own = [k for k, each in enumerate(names) if each == name or each.partition("[")[0] == name.partition("[")[0]]
    own = [k for k in own if names[k] == name] or own
    unit = "rad" if values.ndim == 1 and not rate and _stores_cos_sin(run.scene, name) else units[own[0]]
    parts = tuple(names[k] for k in own) if values.ndim > 1 else ()
    return Series(values, f"{unit}{rate}" if unit else "", parts)


def _position(run, quantity) -> Series:
    if _is_joint(run.scene, quantity.name):
        return _of_joint(run, quantity.name, run.solution.position(quantity.name, run.passed))
    model = run.scene.model
    frame = frame_of(model, quantity.name, run.scene.name)
    data, values = model.createData(), np.empty((len(run.solution.t), 3))
    for row, q in zip(values, run.solution.q, strict=True):
        pin.forwardKinematics(model, data, q)
        row[:] = data.oMi[frame.parentJoint].act(frame.placement.translation)
    return Series(values, "m", AXES)


def _velocity(run, quantity) -> Series:
    if _is_joint(run.scene, quantity.name):
        return _of_joint(run, quantity.name, run.solution.velocity(quantity.name, run.passed), "/s")
    return Series(run.solution.frame(quantity.name, run.passed).velocity, "m/s", AXES, vector=True)


def _acceleration(run, quantity) -> Series:
    if _is_joint(run.scene, quantity.name):
        return _of_joint(run, quantity.name, run.solution.acceleration(quantity.name, run.passed), "/s²")
    return Series(run.solution.frame(quantity.name, run.passed).acceleration, "m/s²", AXES, vector=True)


def _wrench(run, quantity, found, part) -> Series:
    values = getattr(found, part)
    if values is not None:
        return Series(values, {"force": "N", "moment": "N·m"}[part], AXES, vector=True)
    if part == "force" and isinstance(found, Reaction) and found.torque is not None:
        rows = LoopRows.of(run.scene)
        return Series(found.torque, rows.multiplier_units[rows.slices[quantity.name].start])
    raise InputError(
        f"{quantity.text!r}: {quantity.name!r} has no {part}; its multipliers: 'multipliers {quantity.name}'"
    )


def _reaction(run, quantity) -> Series:
    return _wrench(run, quantity, run.solution.reaction(quantity.name, run.passed), "force")


def _moment(run, quantity) -> Series:
    return _wrench(run, quantity, run.solution.reaction(quantity.name, run.passed), "moment")


def _joint_force(run, quantity) -> Series:
    return _wrench(run, quantity, run.solution.joint_force(quantity.name, run.passed), "force")


def _joint_moment(run, quantity) -> Series:
    return _wrench(run, quantity, run.solution.joint_force(quantity.name, run.passed), "moment")


def _force(run, quantity) -> Series:
    if quantity.name in run.scene.joints or quantity.name in [loop.name for loop in run.scene.loops]:
        return _reaction(run, quantity)
    found = run.solution.force(quantity.name, run.passed)
    if found.force is None:
        raise InputError(f"{quantity.text!r}: {found.label!r} is known by its torque: 'torque {found.label}'")
    if found.force.ndim > 1:
        return Series(found.force, "N", AXES, vector=True)
    return Series(found.force, element_units(run.scene, found.label)[0])


def _element(which):
    """The length or the speed of an element: number `which` of its units."""

    def series(run, quantity) -> Series:
        found = run.solution.force(quantity.name, run.passed)
        values = (found.force, found.length, found.speed)[which]
        if values is None:
            raise InputError(f"{quantity.text!r}: {found.label!r} has no {quantity.what}")
        return Series(values, element_units(run.scene, found.label)[which])

    return series


def _torque(run, quantity) -> Series:
    values = run.solution.torque(quantity.name, run.passed)
    if values.ndim > 1:
        own = _is_joint(run.scene, quantity.name) and quantity.name in run.scene.joints
        every = velocity_names(run.scene.model)
        parts = [every[k] for k in range(run.scene.nv)[run.scene.columns(quantity.name)]] if own else every
        return Series(values, "", tuple(parts))
    drives = {loop.name: loop.joints[0] for loop in run.scene.loops if isinstance(loop, JointConstraint)}
    joint = drives.get(quantity.name) or quantity.name.partition("[")[0]
    if joint not in run.scene.joints:
        joint = joint_of(run.scene, run.solution._label(run.scene, quantity.name))
    return Series(values, torque_unit(run.scene, joint))


def _power(run, quantity) -> Series:
    return Series(run.solution.power(quantity.name, run.passed), "W")


def _multipliers(run, quantity) -> Series:
    rows = LoopRows.of(run.scene)
    if quantity.name not in rows.slices:
        raise InputError(f"{run.scene.name}: no loop {quantity.name!r}{near(quantity.name, rows.slices)}")
    part = rows.slices[quantity.name]
    labels = tuple(rows.labels[k][1] for k in range(part.start, part.stop))
    units = {rows.multiplier_units[k] for k in range(part.start, part.stop)}
    values = run.solution.lam[:, part]
    unit = units.pop() if len(units) == 1 else ""
    return Series(values[:, 0], unit) if len(labels) == 1 else Series(values, unit, labels)


def _gap(run, quantity) -> Series:
    found = run.solution.contact(quantity.name, run.passed)
    return Series(found.gap, contact_units(run.scene, quantity.name)[0])


def _contact(run, quantity) -> Series:
    found = run.solution.contact(quantity.name, run.passed).force
    unit = contact_units(run.scene, quantity.name)[1]
    return Series(found, unit, AXES, vector=True) if found.ndim > 1 else Series(found, unit)


def _slip(run, quantity) -> Series:
    found = run.solution.contact(quantity.name, run.passed).slip
    unit = contact_units(run.scene, quantity.name)[0]
    return Series(np.linalg.norm(found, axis=1), f"{unit}/s")


def _energy(run, quantity) -> Series:
    return Series(getattr(run.solution.energy(run.passed), quantity.part), "J")


def _no_series(run, quantity) -> Series:
    raise InputError(f"{quantity.text!r}: the error is one number of the whole run")


SERIES: dict[str, Callable[[_Run, Quantity], Series]] = {
    "position": _position,
    "velocity": _velocity,
    "acceleration": _acceleration,
    "reaction": _reaction,
    "force": _force,
    "moment": _moment,
    "joint_force": _joint_force,
    "joint_moment": _joint_moment,
    "torque": _torque,
    "power": _power,
    "length": _element(1),
    "speed": _element(2),
    "multipliers": _multipliers,
    "gap": _gap,
    "contact": _contact,
    "slip": _slip,
    "energy": _energy,
    "error": _no_series,
}
WITHOUT_NAME = {"energy": ENERGIES, "error": ("q", "v", "force")}
