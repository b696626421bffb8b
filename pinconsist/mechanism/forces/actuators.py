"""Actuators of robot files: affine laws with a gear and limits; their commands by name, from a program, or of a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from ...errors import InputError
from ..breakpoints import TimeCurve, TimeFunction
from ..checks import finite_array, name, near, number, numbers, put, put_checked, triple
from ..curve import Curve
from ..joint_constraints import Coordinate
from ..motion import Motion
from ..sampling import Change
from .force import CompiledForce, ForceRecord
from .held import BoundHeld, Held, HeldRecord

UNLIMITED = (-np.inf, np.inf)


class BoundActuator(CompiledForce):
    """An actuator on a model; the entries of a held table, commands of a program, take precedence over the record's."""

    def __init__(self, record, model, table=None):
        super().__init__(model)
        self._record, self._table = record, table
        self._joints = [Coordinate(model, joint, record._who, "actuated") for joint in record.arms]
        self.by_time = not record.force_range
        control = record.control
        if callable(control) and type(control) is not Motion and not isinstance(control, Table):
            self.curves.append(TimeCurve(control, f"the command of {record._who}"))

    def command(self, t) -> float:
        """The command before clipping."""
        held = None if self._table is None else self._table.at(t)
        if held is not None:
            return float(held[0])
        control: Any = self.curves[0] if self.curves else self._record.control
        return float(control(t)) if callable(control) else control

    def functions_of_time(self, q, v):
        control = self._record.control
        if isinstance(control, Table):
            return [TimeFunction(control, known=control.changes(*(self._record.control_range or UNLIMITED)))]
        return super().functions_of_time(q, v)

    def at_limit(self, t, q, v) -> bool:
        """Whether the command or the force is clipped at a state."""
        return self._alone.limited(t, q, v)

    def element(self, t, q, v):
        return self._along(t, q, v)

    def hand_over(self, compiled) -> None:
        record, control = self._record, self._record.control
        curve = Motion().numbers
        points = Table((), ())
        if self.curves:
            curve = self.curves[0]
        elif isinstance(control, Table):
            points = control
        elif type(control) is Motion:  # a subclass may have another law
            curve = control.numbers
        else:
            curve = Motion(control).numbers
        arms = np.array(list(record.arms.values()))
        limits = record.control_range or UNLIMITED, record.force_range or UNLIMITED
        law = np.array(record.gain), np.array(record.bias), *limits
        places = [joint.place for joint in self._joints]
        compiled.add_actuator(places, arms, *law, curve, points.times, points.values, self._table)


@dataclass(frozen=True)
class Actuator(ForceRecord):
    """An actuator of a joint: τ = gear · f, f = gain·(1, l, l̇) u + bias·(1, l, l̇), l = gear · θ.

    u is the command and l the actuator's length. An actuator on several joints, such as a tendon, has l = gear · Σ
    share · θ, and exerts gear · share · f on each joint. Command and force are clipped at their limits. A motor has
    gain (1, 0, 0) and no bias, a position actuator (k, 0, 0) and (0, -k, -d), a velocity actuator (d, 0, 0) and (0, 0,
    -d).

    Parameters
    ----------
    name : str
        Name in results and in :meth:`Mechanism.with_control`.
    joint : str or mapping
        A joint of one degree of freedom, or joint → its share in the length.
    gain, bias : tuple of 3 float
        Coefficients of 1, l and l̇ in the factor of the command and in the term without it; SI.
    gear : float
        Actuator length per joint position.
    control : float or callable
        The command u; a function of time such as a :class:`Motion`.
    control_range, force_range : tuple of 2 float
        Limits of u and of f; no limits if empty.

    Raises
    ------
    InputError
        Invalid numbers; on a model, an unknown joint or one with several degrees of freedom.
    UserFunctionError
        The command is a function that raised an exception.
    """

    name: str
    joint: str | Mapping[str, float]
    gain: tuple[float, float, float] = (1.0, 0.0, 0.0)
    bias: tuple[float, float, float] = (0.0, 0.0, 0.0)
    gear: float = 1.0
    control: float | Callable = 0.0
    control_range: tuple[float, ...] = ()
    force_range: tuple[float, ...] = ()

    _kind, _acts_on = "actuator", "joint"
    _law: ClassVar[Any] = BoundActuator
    _who = property(lambda self: f"actuator {self.name!r}")

    @property
    def arms(self) -> dict[str, float]:
        """Joint → length per position."""
        shares = self.joint if isinstance(self.joint, Mapping) else {self.joint: 1.0}
        return {joint: self.gear * share for joint, share in shares.items()}

    @property
    def label(self) -> str:
        """The name of the force in energy reports and messages: that of the actuator."""
        return self.name

    def __post_init__(self):
        put_checked(self, "Actuator", name, "name")
        if isinstance(self.joint, Mapping):
            shares = {
                name(joint, self._who): number(share, f"{self._who}: {joint}") for joint, share in self.joint.items()
            }
            put(self, joint=shares)
        else:
            put_checked(self, self._who, name, "joint")
        put_checked(self, self._who, triple, "gain", "bias")
        put_checked(self, self._who, number, "gear")
        if isinstance(self.control, Curve) and self.control.law == "table":  # as a file has it
            put(self, control=Table(self.control.times, self.control.values))
        if not callable(self.control):
            put_checked(self, self._who, number, "control")
        for field in ("control_range", "force_range"):
            ends = numbers(getattr(self, field), f"{self._who}: {field}")
            if ends and (len(ends) != 2 or not ends[0] <= ends[1]):
                raise InputError(f"{self._who}: {field} needs two numbers, the lower one first, got {ends}")
            put(self, **{field: ends})


def commanded(mechanism, control: Mapping):
    """The mechanism with the commands of actuators by name; what :meth:`Mechanism.with_control` returns."""
    if not isinstance(control, Mapping):
        raise InputError(f"control= needs a mapping of actuators to commands, got {control!r}")
    forces, by = list(mechanism.forces), {}
    for given, command in control.items():
        places = [i for i, force in enumerate(forces) if isinstance(force, Actuator)]
        found = [i for i in places if forces[i].name == given] or [i for i in places if given in forces[i].arms]
        if len(found) != 1:
            names = [forces[i].name for i in places]
            what = "several actuators act on joint" if found else "no actuator"
            raise InputError(
                f"{mechanism.name}: {what} {given!r}{near(given, names)}; available: {', '.join(names) or 'none'}"
            )
        if (first := by.setdefault(found[0], given)) != given:
            raise InputError(f"{mechanism.name}: {first!r} and {given!r} are the same actuator, which has one command")
        forces[found[0]] = replace(forces[found[0]], control=_command(given, command))
    return replace(mechanism, forces=tuple(forces))


def commands(mechanism) -> dict[str, float | list | None]:
    """The commands of the actuators by name, as plain data: tables become (times, values), and functions None."""
    controls = {force.name: force.control for force in mechanism.forces if isinstance(force, Actuator)}
    tables = {name: [list(each.times), list(each.values)] for name, each in controls.items() if isinstance(each, Table)}
    return {name: None if callable(control) else control for name, control in controls.items()} | tables


def _command(actuator, command):
    """A command from user input: a number, a function of time, or a table (times, values)."""
    if callable(command) or np.ndim(command) == 0:
        return command
    table = finite_array(command, f"the command of {actuator!r}")
    if table.ndim != 2 or table.shape[0] != 2 or table.shape[1] < 2 or (np.diff(table[0]) <= 0.0).any():
        raise InputError(
            f"the command of {actuator!r} must be a number, a function of time, or (times, values) with increasing "
            f"times; got shape {table.shape}"
        )
    return Table(*map(tuple, table.tolist()))


def _crossings(values):
    """The indices after which the sign of finite values changes."""
    return np.flatnonzero(values[:-1] * values[1:] < 0.0) if np.isfinite(values).all() else ()


@dataclass(frozen=True)
class Table:
    """A command from a table, linearly interpolated; constant before the first time and after the last."""

    times: tuple[float, ...]
    values: tuple[float, ...]

    def __call__(self, t: float) -> float:
        return float(np.interp(t, self.times, self.values))

    def changes(self, low, high) -> list[Change]:
        """Where it may bend: its times, also if it is straight there, as its derivatives by its values are not.

        And where limits of the command cut it.
        """
        t, u = np.array(self.times), np.array(self.values)
        slopes = np.diff(u) / np.diff(t)
        cut = [float(t[i] + (limit - u[i]) / slopes[i]) for limit in (low, high) for i in _crossings(u - limit)]
        return [Change(time, 1) for time in sorted({*self.times, *cut})]


def saturated(mechanism, t, q, v) -> dict[str, float]:
    """Actuator → fraction of the rows in which its command or force was clipped; only if this happened."""
    found = {}
    for force in mechanism.forces:
        if isinstance(force, Actuator) and (force.control_range or force.force_range):
            bound = force.bind(mechanism.model)
            share = np.mean([bound.at_limit(*state) for state in zip(t, q, v, strict=True)]) if len(t) else 0.0
            if share > 0.0:
                found[force.name] = float(share)
    return found


class BoundHeldActuator(BoundHeld):
    """An actuator with commands from a program."""

    smooth = False

    def __init__(self, record, model):
        entries = np.zeros((0, 2)) if record.entries is None else record.entries
        super().__init__(1, entries[:, 0], np.ascontiguousarray(entries[:, 1:]), record.sign)
        self.name = record.name
        self._actuator = actuator = BoundActuator(record, model, self.table)
        self.by_time = actuator.by_time
        self.torque = actuator.torque
        self.derivatives = actuator.derivatives
        self.element = actuator.element
        self.command = actuator.command
        self.at_limit = actuator.at_limit
        self.functions_of_time = actuator.functions_of_time
        self.set_breakpoints = actuator.set_breakpoints
        self.hand_over = actuator.hand_over


@dataclass(frozen=True, eq=False)
class HeldActuator(Actuator):
    """An actuator with commands from a program, now or in a run: `entries` (n, 2) are start times and commands."""

    entries: np.ndarray | None = None
    sign: float = 1.0

    _law: ClassVar[Any] = BoundHeldActuator

    @classmethod
    def of(cls, actuator, entries=None, sign=1.0):
        known = {each.name: getattr(actuator, each.name) for each in fields(Actuator)}
        return cls(**known, entries=entries, sign=sign)


def programmed(mechanism):
    """The mechanism with actuators that take their commands from a program, and a force ``"control"``."""
    forces = [HeldActuator.of(force) if isinstance(force, Actuator) else force for force in mechanism.forces]
    return replace(mechanism, forces=(*forces, Held("control")))


def _commands_of(solution) -> dict:
    """Actuator → its command in a run; None for functions if the run was read from a file."""
    own = getattr(getattr(solution, "system", None), "mechanism", None)
    if own is None:
        return getattr(solution, "method", {}).get("control", {})
    return {force.name: force.control for force in own.forces if isinstance(force, Actuator)}


def replayed(mechanism, solution):
    """The mechanism with the commands of its run, and with recorded torques in place of forces that were sampled."""
    if mechanism is not None and (control := _commands_of(solution)):
        given = {force.name for force in mechanism.forces if isinstance(force, Actuator) and callable(force.control)}
        known = {name: command for name, command in control.items() if command is not None}
        if unknown := [name for name in control if name not in known.keys() | given | solution.held.keys()]:
            raise InputError(
                f"the command of {unknown[0]!r} was a function of time, which a solution file does not store: pass it "
                f"again, mechanism.with_control({{{unknown[0]!r}: …}})"
            )
        mechanism = commanded(mechanism, known)
    if mechanism is None or not getattr(solution, "held", None):
        return mechanism
    actuators = {force.name for force in mechanism.forces if isinstance(force, Actuator)}
    tables = iter([table for label, table in solution.held.items() if label not in actuators])
    forces, sign = [], 1.0 if solution.t[-1] >= solution.t[0] else -1.0
    for force in mechanism.forces:
        if isinstance(force, HeldRecord):
            force = Held(force.label, next(tables), sign, force.joints, getattr(force, "linear", False))
        elif isinstance(force, Actuator) and force.name in solution.held:
            force = HeldActuator.of(force, solution.held[force.name], sign)
        forces.append(force)
    return replace(mechanism, forces=tuple(forces))
