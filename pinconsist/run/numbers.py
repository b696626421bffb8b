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
OF_BODY = {"mass": slice(0, 1), "com": slice(1, 4), "inertia": slice(4, 13)}  # among those of a body, see numbers.hpp


@dataclass(eq=False)
class Change:
    """A number that can be changed: ``put(values, value)`` does it in the `values` of a :class:`Numbers`, or raises
    InputError; `least` is a bound; other values may open the loops.
    """

    put: Callable
    least: float = -inf
    opens: bool = False


class Numbers:
    """The compiled equations of a system, with a tree that no other system uses.

    ``native.set(values)`` gives them all numbers that were asked for so far, and ``native.values`` has them.
    """

    def __init__(self, mechanism, system):
        module = required()
        self._mechanism, self._model = mechanism, system.model
        own = tree(module, system.model)
        self.compiled = module.MechanismSystem(module.Workspace(own))
        self.native = module.Numbers(own, self.compiled)
        self._rows = system.kept_rows.hand_over(self.compiled)
        self._forces = system.hand_over_forces(self.compiled)
        self._places: dict = {}  # body, anchor or damping → the places of its numbers
        self._dampers: list = []  # columns and places of coefficients that can be changed
        self._rest: np.ndarray | None = None  # the damping of others, (nv,)
        self._changes: dict[str, Change | None] = {}
        self._by_place: dict[str, Change | None] = {}  # a number may have several names

    def changes(self, values) -> list[tuple[Change, float]] | None:
        """What to change for parameters by name; None if one of them cannot be changed in place."""
        found = []
        for name, value in values.items():
            change = self.change(name)
            if change is None:
                return None
            found.append((change, number(value, name, least=change.least)))
        return found

    def change(self, name) -> Change | None:
        """The number of this name; None if it cannot be changed in place."""
        if name not in self._changes:
            found = parameter(self._mechanism, name)
            place = repr(found.place)
            if place not in self._by_place:
                self._by_place[place] = self._made(name, found)
            self._changes[name] = self._by_place[place]
        return self._changes[name]

    def _made(self, name, found) -> Change | None:
        kind, *where = found.place or ("",)
        if kind == "body":
            return Change(self._of_body(name, *where))
        if kind == "joint" and where[0] == "damping":
            return self._of_damper(found.value, where[1])
        if kind == "loops":
            return self._of_loop(found.value, *where)
        if kind == "forces":
            return self._of_force(found.value, *where)
        return None

    def _kept(self, key, add):
        """The places of numbers that `add` adds once."""
        if key not in self._places:
            self._places[key] = add()
        return self._places[key]

    def _of_body(self, name, joint, kind, indices):
        first = self._kept(("body", joint), lambda: self.native.add_body(joint))

        def put(values, value):
            body = values[first : first + 13]
            part = body[OF_BODY[kind]].reshape((3, 3) if kind == "inertia" else (-1,))
            for index in indices:
                part[index or 0] = value
            mass = float(body[0])
            why = "its mass is negative" if mass < 0.0 else ""
            if kind == "inertia":
                try:
                    pin.Inertia(mass, body[1:4], body[4:].reshape(3, 3))
                except RuntimeError as error:
                    why = str(error)
            if why:
                raise InputError(f"{name} cannot be {value:g}: {why}")

        return put

    def _of_damper(self, value, columns) -> Change:
        first = self._kept("damping", self.native.add_damping)
        own = self.native.add_note(np.array([value]))
        if self._rest is None:
            self._rest = self.native.values[first : first + self._model.nv]
        self._rest[columns] -= value
        self._dampers.append((columns, own))

        def put(values, value):
            values[own] = value
            all_of_them = self._rest.copy()
            for columns, place in self._dampers:
                all_of_them[columns] += values[place]
            values[first : first + len(all_of_them)] = all_of_them

        return Change(put, 0.0)

    def _of_loop(self, value, label, path) -> Change | None:
        *_, loop = records_of(self._mechanism)[label]
        if not (isinstance(loop, Loop) and path[0] in ENDS):
            return None
        field, end = ENDS[path[0]]
        frame, axis = frame_of(self._model, getattr(loop, field), label).placement, int(path[1])
        at = np.array(getattr(loop, path[0]), float)
        anchor = self._kept((label, end), lambda: self.native.add_note(at))
        parts = []
        for i, point in self._rows.get(label, ()):
            beside = point if end == 2 else np.zeros(3)
            place = self._kept(
                (label, end, i), lambda i=i, to=beside: self.native.add_place(i, end, frame.act(at) + to)
            )
            if place < 0:
                return None
            parts.append((place, beside))

        def put(values, value):
            values[anchor + axis] = value
            there = frame.act(values[anchor : anchor + 3])
            for place, beside in parts:
                values[place : place + 3] = there + beside

        return Change(put, opens=True)

    def _of_force(self, value, label, path) -> Change | None:
        *_, record = records_of(self._mechanism)[label]
        if isinstance(record, JointDamping) and path[1] in self._mechanism.joints:
            return self._of_damper(value, self._mechanism.columns(path[1]))
        bounds, force = OF_FORCES.get(type(record), {}), self._forces.get(label)
        if force is None or path[0] not in bounds:
            return None
        place = self._kept((label, path[0]), lambda: self.native.add_number(force, path[0]))
        if place < 0:
            return None

        def put(values, value):
            values[place] = value

        return Change(put, bounds[path[0]])
