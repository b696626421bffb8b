"""Numbers of the equations of a run, changed in place in C++: masses, springs, dampers and anchors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from math import inf

import numpy as np
import pinocchio as pin

from ..engine import required
from ..engine.tree import tree
from ..errors import InputError
from ..mechanism.checks import frame_of, number
from ..mechanism.forces import JointDamping, JointSpring, Servo, SpringDamper
from ..mechanism.loops import Loop
from ..mechanism.parameters import parameter, records_of

ENDS = {"xyz1": ("frame1", 1), "xyz2": ("frame2", 2)}
OF_FORCES: dict[type, dict] = {  # their numbers, and the least value of each
    SpringDamper: {"stiffness": -inf, "damping": 0.0, "length": 0.0},
    JointSpring: {"stiffness": -inf, "damping": 0.0},
    Servo: {"stiffness": 0.0, "damping": 0.0},
}


@dataclass(eq=False)
class Change:
    """A number that can be changed: ``put(value)`` does it; `least` is a bound; other values may open the loops."""

    put: Callable
    value: float
    least: float = -inf
    opens: bool = False


class Numbers:
    """The compiled equations of a system, with a tree that no other system uses."""

    def __init__(self, mechanism, system):
        module = required()
        self._mechanism, self._model = mechanism, system.model
        self._tree = tree(module, system.model)
        self.compiled = module.MechanismSystem(module.Workspace(self._tree))
        self._rows = system.kept_rows.hand_over(self.compiled)
        self._forces = system.hand_over_forces(self.compiled)
        self._bodies: dict = {}  # joint → mass, centre of mass and inertia
        self._anchors: dict = {}  # loop, end → position in the frame
        self._changes: dict[str, Change | None] = {}
        self._by_place: dict[str, Change | None] = {}  # a number may have several names

    def changes(self, values) -> list[tuple[Change, float]] | None:
        """What to change for parameters by name; None if one of them cannot be changed in place."""
        found = []
        for name, value in values.items():
            if name not in self._changes:
                self._changes[name] = self._change(name)
            change = self._changes[name]
            if change is None:
                return None
            found.append((change, number(value, name, least=change.least)))
        return found

    @staticmethod
    def put(changes) -> None:
        """Make changes; if one of them is not possible, none is made."""
        done = []
        try:
            for change, value in changes:
                before = change.value
                change.put(value)
                change.value = value
                done.append((change, before))
        except InputError:
            Numbers.undo(done)
            raise

    @staticmethod
    def undo(changes) -> None:
        """Give the numbers of changes the values that are listed, the last one first."""
        for change, value in reversed(changes):
            change.put(value)
            change.value = value

    def _change(self, name) -> Change | None:
        found = parameter(self._mechanism, name)
        place = repr(found.place)
        if place not in self._by_place:
            self._by_place[place] = self._made(name, found)
        return self._by_place[place]

    def _made(self, name, found) -> Change | None:
        kind, *where = found.place or ("",)
        if kind == "body":
            return Change(self._of_body(name, *where), found.value)
        if kind == "joint" and where[0] == "damping":
            return Change(self._of_damper(found.value, where[1]), found.value, 0.0)
        if kind == "loops":
            return self._of_loop(found.value, *where)
        if kind == "forces":
            return self._of_force(found.value, *where)
        return None

    def _of_body(self, name, joint, kind, indices):
        inertia = self._model.inertias[joint]
        parts = {"mass": np.array(inertia.mass), "com": inertia.lever.copy(), "inertia": inertia.inertia.copy()}
        body = self._bodies.setdefault(joint, parts)

        def put(value):
            before = body[kind][indices[0]]
            for place in indices:
                body[kind][place] = value
            mass = float(body["mass"])
            why = "its mass is negative" if mass < 0.0 else ""
            if kind == "inertia":
                try:
                    pin.Inertia(mass, body["com"], body["inertia"])
                except RuntimeError as error:
                    why = str(error)
            if why:
                for place in indices:
                    body[kind][place] = before
                raise InputError(f"{name} cannot be {value:g}: {why}")
            self._tree.set_body(joint, mass, body["com"], body["inertia"])
            self.compiled.renew_lanes()

        return put

    def _of_damper(self, value, columns):
        now, unit = [value], np.zeros(self._model.nv)
        unit[columns] = 1.0

        def put(value):
            self.compiled.add_damping((value - now[0]) * unit)
            now[0] = value

        return put

    def _of_loop(self, value, label, path) -> Change | None:
        *_, loop = records_of(self._mechanism)[label]
        if not (isinstance(loop, Loop) and path[0] in ENDS):
            return None
        field, end = ENDS[path[0]]
        frame, axis = frame_of(self._model, getattr(loop, field), label).placement, int(path[1])
        anchor = self._anchors.setdefault((label, end), np.array(getattr(loop, path[0]), float))
        parts = [(i, point if end == 2 else 0.0 * point) for i, point in self._rows.get(label, ())]

        def put(value):
            anchor[axis] = value
            there = frame.act(anchor)
            for i, point in parts:
                self.compiled.place_rows(i, end, there + point)

        return Change(put, value, opens=True)

    def _of_force(self, value, label, path) -> Change | None:
        *_, record = records_of(self._mechanism)[label]
        if isinstance(record, JointDamping) and path[1] in self._mechanism.joints:
            return Change(self._of_damper(value, self._mechanism.columns(path[1])), value, 0.0)
        bounds, force = OF_FORCES.get(type(record), {}), self._forces.get(label)
        if force is None or path[0] not in bounds or not self.compiled.set_number(force, path[0], value):
            return None
        return Change(lambda value: self.compiled.set_number(force, path[0], value), value, bounds[path[0]])
