"""Runs of one mechanism that are advanced in C++, on threads each of which has one system and one stepper."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from ..engine import required
from ..engine.failure import FAILURES
from ..engine.index1 import singular_message
from ..mechanism.assembly import assembled
from ..mechanism.closing import LoopSolver
from ..mechanism.rank import require_nonsingular
from ..mechanism.system import MechanismSystem
from .stepping import ON, Simulation, worker_like


class Ensemble:
    """Runs like a :class:`Simulation`, from its state. A run is a state, numbers, and what its stepper remembers.

    What a run reaches depends neither on the others nor on the thread that makes its steps.
    """

    def __init__(self, first: Simulation, n: int, threads: int):
        self.mechanism = first.mechanism
        self._workers = [worker_like(first) for _ in range(min(threads, n))]
        self._system = self._workers[0].stepper.system
        self._native = required().Ensemble(n, self._workers[0].numbers.compiled, len(self._workers[0].tables) - 1)
        for worker in self._workers:
            parts = worker.numbers.compiled, worker.numbers.native, worker.tables
            self._native.add_worker(worker.stepper.core, *parts)
        self._values: list[dict] = [{} for _ in range(n)]  # the parameters of each run that were changed

    @property
    def states(self) -> tuple:
        """t (n,), q (n, nq) and v (n, nv)."""
        return self._native.states

    def values_of(self, i) -> dict:
        """The parameters of a run that were changed."""
        return dict(self._values[i])

    def mechanism_of(self, i):
        """The mechanism of a run, with its parameters."""
        return self.mechanism.with_parameters(self._values[i]) if self._values[i] else self.mechanism

    def begin(self, runs, q, v, t) -> None:
        """Let runs begin anew at positions and velocities, lists that are as for `simulate`; without torques."""
        on = self._on_constraints(runs, q, v, t)
        found: dict = {}
        positions = np.empty((len(runs), self._system.npos))
        velocities = np.empty((len(runs), self._system.nv))
        for k, i in enumerate(runs):
            if on[k]:
                positions[k] = q[k]
                velocities[k] = 0.0 if v[k] is None else v[k]
                continue
            start = id(q[k]), id(v[k]), tuple(self._values[i].items())
            if start not in found:
                found[start] = self._assembled(self.mechanism_of(i), q[k], v[k], t)
            positions[k], velocities[k] = found[start]
        self._native.begin(runs, t, positions, velocities)

    def _on_constraints(self, runs, q, v, t) -> np.ndarray:
        """Which states are arrays on the constraints; they are used as they are."""
        system = self._system
        on = np.zeros(len(runs), bool)
        plain = [
            k
            for k in range(len(runs))
            if _is_array(q[k], system.npos)
            and (v[k] is None or _is_array(v[k], system.nv))
            and (system.vector_like or pin.isNormalized(system.model, q[k], ON))
        ]
        if plain:
            positions = np.array([q[k] for k in plain])
            velocities = np.array([np.zeros(system.nv) if v[k] is None else v[k] for k in plain])
            off = self._native.off([runs[k] for k in plain], t, positions, velocities)
            on[plain] = off <= ON * (1.0 + np.abs(velocities).max(axis=1, initial=0.0))
        return on

    def _assembled(self, mechanism, q, v, t):
        solver = LoopSolver(mechanism, t)
        assembly = assembled(solver, q, v)
        system = MechanismSystem(mechanism, assembly.q, t, solver)
        require_nonsingular(system, assembly.q)
        return assembly.q, assembly.v

    def set_parameters(self, runs, values: list[dict]) -> list[int]:
        """Give runs other parameters of the same names; they begin anew where they are, with closed loops.

        Returns those for which that is not possible in place: they are not changed.
        """
        for name in values[0] if values else ():
            for worker in self._workers:  # all of them have the numbers in the same places
                worker.numbers.change(name)
        self._make_room()
        found = [self._workers[0].numbers.changes(each) for each in values]
        changes = [each for each in found if each is not None]
        if len(changes) < len(found):
            return list(runs)
        rows = self._native.numbers[runs]
        for row, each in zip(rows, changes, strict=True):
            for change, value in each:
                change.put(row, value)
        opens = any(change.opens for each in changes for change, _ in each)
        left = []
        for i, new, failure in zip(runs, values, self._native.change(runs, rows, opens), strict=True):
            if failure:
                left.append(i)
            else:
                self._values[i] = {name: value for name, value in self._values[i].items() if name not in new} | new
        return left

    def _make_room(self) -> None:
        """For numbers that were not changed before."""
        numbers = self._native.numbers
        own = self._workers[0].numbers.native.values[numbers.shape[1] :]
        if len(own):
            self._native.numbers = np.hstack((numbers, np.tile(own, (len(numbers), 1))))

    def advance(self, runs, held, dt) -> dict[int, str]:
        """Advance runs by a time, with a row of torques and commands for each of all; why runs have failed."""
        times = self.states[0]
        failures = self._native.advance(runs, held, dt)
        return {i: self._words(failure, times[i]) for i, failure in zip(runs, failures, strict=True) if failure}

    @staticmethod
    def _words(failure, t) -> str:
        if failure == "singular":
            return singular_message(t)
        if failure == "open":
            return "the position could not be projected onto the constraint"
        return FAILURES.get(failure, failure)

    def multipliers(self) -> np.ndarray:
        """λ at the states, shape (n, nc), with what was held until there."""
        positions, velocities = self.states[1:]
        return self._system.full_multipliers(positions, self._native.multipliers(), v=velocities)


def _is_array(x, size) -> bool:
    return type(x) is np.ndarray and x.dtype == float and x.shape == (size,)
