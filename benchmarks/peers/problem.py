"""What every method is given to solve, what it gives back, and the interface of a method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from pinconsist import JointTorque, Mechanism
from pinconsist.mechanism.system import MechanismSystem


class Rows(NamedTuple):
    """A solution: t (n,), q (n, nq), v (n, nv), lam (n, nc) of all rows of the loops, at minimum norm.

    `first` is the row of the first step by the method itself, after those of a one-step start.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    first: int = 1


@dataclass(frozen=True)
class Problem:
    """An initial value problem of a mechanism over a span in s, from a state that satisfies its constraints."""

    name: str
    description: str
    mechanism: Mechanism
    span: tuple[float, float]
    q0: np.ndarray
    v0: np.ndarray

    @cached_property
    def system(self) -> MechanismSystem:
        """The equations that all methods on Pinocchio evaluate, by the same calls as the package's own."""
        return MechanismSystem(self.mechanism, self.q0, self.span[0])

    def multipliers(self, q, kept) -> np.ndarray:
        """λ of all rows from λ of the kept ones, for stacks, at any q near the loops."""
        q, kept = np.asarray(q), np.asarray(kept)
        if self.system.dropped_are_zero or not self.system.rows.steady.all():
            return self.system.full_multipliers(q, kept)
        solved, rank = [], slice(self.system.nc)
        for position, part in zip(q, kept, strict=True):
            J = self.system.loop_rows(position)[1]
            U, sizes, Vt = np.linalg.svd(J.T, full_matrices=False)
            solved.append(Vt[rank].T @ ((U[:, rank].T @ (J[self.system.kept].T @ part)) / sizes[rank]))
        return np.array(solved)

    def multipliers_of_forces(self, q, forces) -> np.ndarray:
        """λ of all rows from the joint forces Jᵀλ, for stacks."""
        transposed = (self.system.loop_rows(row)[1].T for row in q)
        return np.array([np.linalg.lstsq(J, tau, rcond=1e-10)[0] for J, tau in zip(transposed, forces, strict=True)])


class SolverFailed(Exception):
    """A method gave up; its message says why."""


class Peer(ABC):
    """One method: its name, its package for pip, and the module to import."""

    name = package = module = ""
    fixed_step = False  # no error control: it takes a number of steps
    detail = False  # measured only where its name is asked for
    loops: tuple[str, ...] | None = None  # kinds that it can translate; None where it takes Pinocchio's equations
    forces: tuple[type, ...] = ()  # force laws that it can translate

    def missing(self) -> str | None:
        """Why the method is not there, or None."""
        try:
            found = find_spec(self.module)
        except ImportError:  # raised by a finder of the application
            found = None
        return None if found else f"{self.package} is not installed: pip install --group benchmarks"

    def version(self) -> str:
        try:
            return version(self.package)
        except PackageNotFoundError:
            return "?"

    def can(self, problem: Problem) -> str | None:
        """Why the method cannot solve this problem, or None."""
        mechanism, system = problem.mechanism, problem.system
        if not system.vector_like:
            return "configurations that are not vectors (unit quaternions, cos and sin)"
        if self.loops is None:
            return None
        if kinds := {loop.kind for loop in mechanism.loops} - {*self.loops}:
            return f"loops of kind {', '.join(sorted(kinds))} are not translated"
        if any(system.rows.labels[row][1].startswith("tilt") for row in system.kept):
            return "hinges whose tilts count are not translated (redundant in planar loops only)"
        laws = {type(force).__name__ for force in mechanism.forces if not isinstance(force, self.forces)}
        torques = [force.torques for force in mechanism.forces if isinstance(force, JointTorque)]
        if any(callable(torque) for each in torques if isinstance(each, Mapping) for torque in each.values()):
            laws.add("JointTorque of time")
        if laws:
            return f"forces {', '.join(sorted(laws))} are not translated"
        plain = {f"JointModel{kind}{axis}" for kind in "RP" for axis in "XYZ"}
        other = {joint.shortname() for joint in list(mechanism.model.joints)[1:]} - plain
        return f"joints of kind {', '.join(sorted(other))} are not translated" if other else None

    @abstractmethod
    def prepare(self, problem: Problem, setting: float) -> tuple[Callable, Callable]:
        """(solve, read): ``solve()`` is what is timed, ``read(its result, thin) -> Rows`` is not.

        `setting` is the tolerance (rtol = atol), or the number of steps of a method of fixed step. ``thin(n)`` returns
        the indices of the steps that are looked at; ``thin(n, first)`` where that one must be among them.
        """


def loop_ends(closure) -> list:
    """(joint, place on its body) of the two anchors of a loop."""
    return [(closure.joint1, closure.place1.translation), (closure.joint2, closure.place2.translation)]
