"""What every method is given to solve, what it gives back, and the interface of a method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import NamedTuple

import numpy as np

from pinconsist.mechanism.forces import JointTorque
from pinconsist.mechanism.mechanism import Mechanism
from pinconsist.mechanism.system import MechanismSystem


class Rows(NamedTuple):
    """A solution: t (n,), q (n, nq), v (n, nv), lam (n, nc) of all rows of the loops, at minimum norm.

    `first` is the row of the first step by the method itself, behind those of a one-step start.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    first: int = 1


@dataclass(frozen=True)
class Problem:
    """An initial value problem of a mechanism, from a state that satisfies its constraints.

    Attributes
    ----------
    name, description : str
    mechanism : Mechanism
    span : (float, float)
        s.
    q0, v0 : ndarray
    """

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
        solved = []
        for position, part in zip(q, kept, strict=True):
            J = self.system.loop_rows(position)[1]
            U, sizes, Vt = np.linalg.svd(J.T, full_matrices=False)
            rank = slice(self.system.nc)
            solved.append(Vt[rank].T @ ((U[:, rank].T @ (J[self.system.kept].T @ part)) / sizes[rank]))
        return np.array(solved)

    def multipliers_of_forces(self, q, forces) -> np.ndarray:
        """λ of all rows from the joint forces Jᵀλ, for stacks."""
        solved = [
            np.linalg.lstsq(self.system.loop_rows(row)[1].T, force, rcond=1e-10)[0]
            for row, force in zip(q, forces, strict=True)
        ]
        return np.array(solved)


class Peer(ABC):
    """One method.

    Attributes
    ----------
    name : str
    package : str
        As pip knows it.
    module : str
        As Python imports it.
    fixed_step : bool
        It has no error control, but takes a number of steps.
    detail : bool
        Measured only where its name is asked for.
    """

    name = package = module = ""
    fixed_step = detail = False

    def missing(self) -> str | None:
        """Why the method is not there, or None."""
        try:
            found = find_spec(self.module)
        except ImportError:  # a finder of the application's that refuses it
            found = None
        return None if found else f"{self.package} is not installed: pip install --group benchmarks"

    def version(self) -> str:
        """Of the package."""
        try:
            return version(self.package)
        except PackageNotFoundError:
            return "?"

    def can(self, problem: Problem) -> str | None:
        """Why the method cannot do this problem, or None."""
        if not problem.system.vector_like:
            return "configurations that are no vectors (unit quaternions, cos and sin)"
        return None

    @abstractmethod
    def prepare(self, problem: Problem, setting: float) -> tuple[Callable, Callable]:
        """(solve, read): ``solve()`` is what is timed, ``read(its result, thin) -> Rows`` is not.

        `setting` is the tolerance (rtol = atol), or the number of steps of a method of fixed step. ``thin(n)`` gives
        the indices of the steps that are looked at; ``thin(n, first)`` where that one must be among them.
        """


def tilts_count(system) -> bool:
    """Whether some hinge holds more than its point: in a planar loop its two other rows are redundant."""
    return any(system.rows.labels[row][1].startswith("tilt") for row in system.kept)


def untranslated(mechanism, known) -> str:
    """Names of the force laws that are not among the `known` classes, or are curves of time; or ""."""
    names = {type(force).__name__ for force in mechanism.forces if not isinstance(force, known)}
    torques = [force for force in mechanism.forces if isinstance(force, JointTorque)]
    if not all(hasattr(force.bind(mechanism.model), "value") for force in torques):
        names.add("JointTorque of time")
    return ", ".join(sorted(names))


def spring_ends(model, spring) -> list:
    """(joint, place on its body) of the two ends of a spring between frames."""
    ends = []
    for name, xyz in ((spring.frame1, spring.xyz1), (spring.frame2, spring.xyz2)):
        frame = model.frames[model.getFrameId(name)]
        ends.append((frame.parentJoint, frame.placement.act(np.array(xyz))))
    return ends


def needs_plain_joints(problem: Problem) -> str | None:
    """A reason where some joint is not a hinge or slider along a coordinate axis."""
    known = {f"JointModel{kind}{axis}" for kind in "RP" for axis in "XYZ"}
    other = {joint.shortname() for joint in list(problem.mechanism.model.joints)[1:]} - known
    return f"joints of kind {', '.join(sorted(other))}" if other else None


class SolverFailed(Exception):
    """A method gave up; its message says why."""
