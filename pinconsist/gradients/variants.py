"""The mechanisms beside the one that was run: one parameter a little larger or smaller.

Differences of fourth order serve where they are taken once (of assembled states and of starts), differences of second
order in each step. At a bound, where `build` refuses one side, they are one-sided.
"""

import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from .._core.compiled_gradient import all_rows, index1_of
from ..dae.index1 import Index1
from ..errors import InputError, PinconsistError
from ..mechanism.assembly import assembled, velocity_on_constraints
from ..mechanism.closing import LoopSolver
from ..mechanism.mechanism import Mechanism
from ..mechanism.system import MechanismSystem
from .known import SIDES, Known


@dataclass
class Side:
    """A mechanism at one offset of a parameter, with the start of its run and the events that are looked for."""

    mechanism: Mechanism
    q0: Any
    v0: Any
    t: float
    events: tuple
    compiled: bool
    _systems: dict = field(default_factory=dict)
    _jacobian: Callable | None = None

    @cached_property
    def assembled(self):
        """(q, v, largest gap) at the start of the run."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of the run itself they were given
            assembly = assembled(self.solver, self.q0, self.v0, advises=False)
        return assembly.q, assembly.v, assembly.largest_gap[1]

    @cached_property
    def solver(self):
        return LoopSolver(self.mechanism, self.t)

    def velocity(self, q, kept):
        """That at the start of the run, at another configuration."""
        return velocity_on_constraints(self.solver, q, self.v0, kept)

    @cached_property
    def workspace(self):
        """Data for what is known of the equations."""
        return self.mechanism.model.createData()

    def multipliers(self, like, p, lam):
        """The multipliers of all rows, from those that the system `like` keeps."""
        return self.index1(like).system.full_multipliers(p, lam)

    def jacobian(self, like, p):
        """J of all rows at a configuration, (n_multipliers, nv)."""
        if self._jacobian is None:
            self._jacobian = all_rows(self.index1(like))
        return self._jacobian(p)

    def close(self) -> None:
        self._systems.clear()
        self._jacobian = None

    def index1(self, like):
        """The equations of index 1 with the rows that the system `like` keeps."""
        key = like.kept.tobytes()
        if key not in self._systems:
            q = self.mechanism.guess
            system = MechanismSystem(self.mechanism, q, like.chosen_at, kept=like.kept)
            system.dropped_are_zero = like.dropped_are_zero
            self._systems[key] = index1_of(system, self.compiled)
        return self._systems[key]


@dataclass
class Variant:
    """One parameter: its step, and the sides by their offsets in steps.

    `weights` are those of differences of fourth order, `near` of second.
    A parameter of the start alone is ``inert``: the equations are those of the run; ``idle`` if the events are, too.
    """

    name: str
    step: float
    sides: dict[int, Side]
    weights: dict[int, float]
    near: dict[int, float]
    inert: bool
    idle: bool

    @property
    def keeps_rows(self) -> bool:
        """Whether the constraints are the same."""
        return self.inert

    def close(self) -> None:
        for side in self.sides.values():
            side.close()

    def derivative(self, function: Callable):
        """That of ``function(side)``, an array."""
        return sum(weight * function(self.sides[m]) for m, weight in self.weights.items()) / self.step

    def residuals(self, like):
        """(weight, equations of index 1) whose residuals give r_θ, Φ_θ and ρ_θ in the steps of the system `like`."""
        if self.inert:
            return []
        return [(weight / self.step, self.sides[m].index1(like)) for m, weight in self.near.items()]


class KnownVariant:
    """One parameter with a known derivative of the equations, in `parts`; mechanisms beside are made where needed."""

    inert = idle = False
    keeps_rows = True

    def __init__(self, parts, base, make_sides):
        self.parts, self._base, self._make_sides = parts, base, make_sides

    def close(self) -> None:
        vars(self).pop("_full", None)

    @cached_property
    def _full(self) -> Variant:
        return self._make_sides()

    def derivative(self, function: Callable):
        """That of ``function(side)``, an array."""
        return self._full.derivative(function)

    def residuals(self, like):
        """As of a :class:`Variant`."""
        return [(weight, Index1(Known(part, like, self._base.workspace))) for weight, part in self.parts]


def variant_of(make, theta, i, name, step, base) -> Variant:
    """The variant of the parameter `i`, of a step."""
    errors, unit = [], np.arange(len(theta)) == i
    for weights, near in SIDES:
        try:
            sides = {m: make(theta + m * step * unit) if m else base for m in weights}
        except (PinconsistError, ValueError) as error:
            errors.append(error)
            continue
        for m, side in sides.items():
            _require_same(side.mechanism, base.mechanism, f"{name!r} is {theta[i] + m * step:.6g}")
        inert = all(side.mechanism is base.mechanism for side in sides.values())
        idle = inert and all(side.events == base.events for side in sides.values())
        return Variant(name, step, sides, weights, near, inert, idle)
    raise InputError(f"the parameter {name!r} cannot vary by {step:.1e} to either side: {errors[0]}") from errors[0]


def _require_same(mechanism, base, where) -> None:
    """Refuse a mechanism beside that is another one."""
    for what in ("nq", "nv", "joints", "row_labels") if mechanism is not base else ():
        if getattr(mechanism, what) != getattr(base, what):
            raise InputError(
                f"build() gives another kind of mechanism where {where}: its {what} differs. "
                "Joints and loops must stay the same while parameters vary"
            )
