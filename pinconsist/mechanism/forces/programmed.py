"""Runs that a program steers: actuators that it commands, and what it has held, for those who judge the run."""

from dataclasses import dataclass, fields, replace
from typing import Any, ClassVar

import numpy as np

from ...errors import InputError
from .actuators import Actuator, BoundActuator, commanded
from .held import BoundHeld, Held, HeldRecord


class BoundHeldActuator(BoundHeld):
    """An actuator of which a program gives the commands."""

    def __init__(self, record, model):
        entries = np.zeros((0, 2)) if record.entries is None else record.entries
        super().__init__(1, entries[:, 0], np.ascontiguousarray(entries[:, 1:]), record.sign)
        self.name, self._actuator = record.name, BoundActuator(record, model, self._command)
        self.derivatives, self.at_limit = self._actuator.derivatives, self._actuator.at_limit

    def _command(self, t):
        held = self.entry(t)
        return None if held is None else float(held[0])

    def torque(self, t, q, v):
        return self._actuator.torque(t, q, v)

    def hand_over(self, twin) -> bool:
        return self._actuator.hand_over(twin, self._in(twin))


@dataclass(frozen=True, eq=False)
class HeldActuator(Actuator):
    """An actuator that a program commands while a run is made, or has commanded: since when, and what, (n, 2)."""

    entries: np.ndarray | None = None
    sign: float = 1.0

    _law: ClassVar[Any] = BoundHeldActuator

    @classmethod
    def of(cls, actuator, entries=None, sign=1.0):
        """The same actuator, commanded so."""
        known = {each.name: getattr(actuator, each.name) for each in fields(Actuator)}
        return cls(**known, entries=entries, sign=sign)


def programmed(mechanism):
    """The mechanism with a force ``"control"`` and actuators that a program commands."""
    forces = [HeldActuator.of(force) if isinstance(force, Actuator) else force for force in mechanism.forces]
    return replace(mechanism, forces=(*forces, Held("control")))


def _commands_of(solution) -> dict:
    """Actuator → command of a run; None for functions of one that was read from a file."""
    own = getattr(getattr(solution, "system", None), "mechanism", None)
    if own is None:
        return getattr(solution, "method", {}).get("control", {})
    return {force.name: force.control for force in own.forces if isinstance(force, Actuator)}


def replayed(mechanism, solution):
    """The mechanism with the commands of a run of it, and what it has held in the place of the forces that made it."""
    if mechanism is not None and (control := _commands_of(solution)):
        given = {force.name for force in mechanism.forces if isinstance(force, Actuator) and callable(force.control)}
        known = {name: command for name, command in control.items() if command is not None}
        if unknown := [name for name in control if name not in known.keys() | given | solution.held.keys()]:
            raise InputError(
                f"the command of {unknown[0]!r} was a function of time, which is not kept with a solution: give it to "
                f"the mechanism, mechanism.with_control({{{unknown[0]!r}: …}})"
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
