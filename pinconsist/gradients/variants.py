"""All parameters of a run, and the derivatives of its equations with respect to them.

If the derivative by a parameter is not known, it is computed by differences of mechanisms with slightly different
values: of fourth order for assembled states and other starts, of second order in each step. They are one-sided at a
bound, that is, if `build` refuses values on one side.
"""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property, partial
from typing import Any

import numpy as np

from ..engine.index1 import Index1
from ..errors import InputError, PinconsistError
from ..mechanism.assembly import assembled, velocity_on_constraints
from ..mechanism.breakpoints import Breakpoints
from ..mechanism.closing import LoopSolver
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism
from ..mechanism.motion import difference_step
from ..mechanism.parameters import records_of
from ..mechanism.system import MechanismSystem
from ..run.known import SIDES, Known, parts_of
from ..run.propagator import all_rows

SMOOTH, ROUGH = 3e-8, 1e-5  # relative change of a difference quotient when the step is doubled: desired, and allowed
MOST_TRIES, SHORTER = 4, 5.0
RESIDUAL_ROUNDING = 1e-14  # relative to the residuals: rounding errors of their differences
WIDE_STEP = 1e-3  # relative to a value: step of parameters that need only fourth-order differences


class OfRun:
    """What the systems of all parameters take over from the run, as soon as it is made: the times of its changes."""

    def __init__(self):
        self.breakpoints = Breakpoints()
        self._system: MechanismSystem | None = None
        self._start = 0.0, False

    def take(self, system, t, backwards) -> None:
        """Take the changes of a `system` whose run from `t` is over."""
        system.breakpoints.on_steps(t)
        self.breakpoints.share(system.breakpoints)
        self._system, self._start = system, (t, backwards)

    def put(self, system) -> None:
        """Let another system change at the same times."""
        system.breakpoints.share(self.breakpoints)
        if self._system is not None:
            system.on_steps(self._system, *self._start)


@dataclass
class Side:
    """A mechanism at one offset of a parameter, with the initial values of its run and its events."""

    mechanism: Mechanism
    q0: Any
    v0: Any
    t: float
    of_run: OfRun
    events: tuple
    _systems: dict = field(default_factory=dict)
    _jacobian: Callable | None = None

    @cached_property
    def assembled(self):
        """(q, v, largest gap) at the start of the run."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they were already issued for the run itself
            assembly = assembled(self.solver, self.q0, self.v0, advises=False)
        return assembly.q, assembly.v, assembly.largest_gap[1]

    @cached_property
    def solver(self):
        solver = LoopSolver(self.mechanism, self.t)
        if solver.loop_rows.breakpoints:
            solver.loop_rows.breakpoints.share(self.of_run.breakpoints)
        return solver

    def velocity(self, q, kept):
        """The initial velocity of the run, at another configuration."""
        return velocity_on_constraints(self.solver, q, self.v0, kept)

    @cached_property
    def workspace(self):
        """Data for the known derivatives of the equations."""
        return self.mechanism.model.createData()

    def multipliers(self, like, p, lam):
        """The multipliers of all rows, from those of the rows that the system `like` keeps."""
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
        """The index-1 equations with the rows that the system `like` keeps."""
        key = like.kept.tobytes()
        if key not in self._systems:
            q = self.mechanism.guess
            system = MechanismSystem(self.mechanism, q, like.chosen_at, like=like)
            system.differentiate_forces()
            self.of_run.put(system)
            self._systems[key] = Index1(system)
        return self._systems[key]


@dataclass
class Variant:
    """One parameter: its value, its step, and the `parts` of the derivative of the equations if it is known.

    ``make(m)`` returns the mechanism with the parameter m steps away from `base`; it is called when needed. `of_loop`
    says that it is a number of a loop between anchors: its rows depend smoothly on it, and no jump of a force moves.
    """

    name: str
    value: float
    step: float
    base: Side
    make: Callable
    parts: list = field(default_factory=list)
    of_loop: bool = False

    @cached_property
    def beside(self) -> tuple[dict, dict, dict]:
        """The sides by their offsets in steps, and the weights of differences of fourth and of second order."""
        errors = []
        for fourth, near in SIDES:
            weights = near if self.of_loop else fourth  # rows are quadratic in anchors
            try:
                sides = {m: self.make(m) if m else self.base for m in weights}
            except (PinconsistError, ValueError) as error:
                errors.append(error)
                continue
            for m, side in sides.items():
                where = f"{self.name!r} is {self.value + m * self.step:.6g}"
                _require_same(side.mechanism, self.base.mechanism, where)
            return sides, weights, near
        raise InputError(
            f"the parameter {self.name!r} cannot vary by {self.step:.1e} to either side: {errors[0]}"
        ) from errors[0]

    @cached_property
    def inert(self) -> bool:
        """Whether the parameter changes only the start, not the equations."""
        return not self.parts and all(side.mechanism is self.base.mechanism for side in self.beside[0].values())

    @cached_property
    def idle(self) -> bool:
        """Whether the parameter changes neither the equations nor the events."""
        return self.inert and all(side.events == self.base.events for side in self.beside[0].values())

    @property
    def keeps_rows(self) -> bool:
        return self.inert or bool(self.parts)

    def close(self) -> None:
        for side in vars(self).get("beside", ({},))[0].values():
            side.close()

    def derivative(self, function: Callable):
        """The derivative of ``function(side)``, an array, by the parameter."""
        sides, weights, _ = self.beside
        return sum(weight * function(sides[m]) for m, weight in weights.items()) / self.step

    def residuals(self, like):
        """(weight, index-1 equations) whose weighted residuals are r_θ, Φ_θ and ρ_θ in steps of the system `like`."""
        if self.parts:
            return [(weight, Index1(Known(part, like, self.base.workspace))) for weight, part in self.parts]
        if self.inert:
            return []
        sides, _, near = self.beside
        return [(weight / self.step, sides[m].index1(like)) for m, weight in near.items()]


class Variants(Sequence):
    """The variants of all parameters, in order.

    `moved` are those without a known derivative of the equations, by their indices. For the others, `known` has
    (index, parts), or (indices, parts) for values of a table; ``make(i, parts)`` creates their variants when needed.
    """

    def __init__(self, names, steps, base, moved, known, make):
        self.names, self.steps, self.base, self.moved, self.known = names, steps, base, moved, known
        self._make, self._made = make, dict(moved)

    def __len__(self):
        return len(self.names)

    def __getitem__(self, i):
        if i not in self._made:
            self._made[i] = self._make(i, self._parts[i])
        return self._made[i]

    @cached_property
    def _parts(self):
        parts: list = [None] * len(self)
        for i, own in self.known:
            for j, column in enumerate(np.atleast_1d(i).tolist()):
                parts[column] = own if np.ndim(i) == 0 else [(1.0, own[0][1].one(j))]
        return parts

    def residuals(self, like):
        """The derivatives of the residuals in steps of the system `like`."""
        return Residuals(self, like)

    def close(self) -> None:
        for variant in self._made.values():
            variant.close()


class Residuals(Sequence):
    """The :meth:`Variant.residuals` of each parameter; `known` is that of :class:`Variants`."""

    def __init__(self, variants, like):
        self._variants, self._like, self.known = variants, like, variants.known
        self.beside = {i: variant.residuals(like) for i, variant in variants.moved.items()}
        self.evaluations = sum(map(len, self.beside.values())) + sum(np.size(i) * len(parts) for i, parts in self.known)
        self._terms = dict(self.beside)

    def __len__(self):
        return len(self._variants)

    def __getitem__(self, i):
        if i not in self._terms:
            self._terms[i] = self._variants[i].residuals(self._like)
        return self._terms[i]

    @property
    def workspace(self):
        """Model and data for the known derivatives."""
        return self._like.model, self._variants.base.workspace


def variants_of(make, theta, names, steps, base: Side, system, t, p, v, parameters=()) -> Variants:
    """The variants of all parameters; ``make(theta)`` returns a Side. Smoothness is checked at the state (t, p, v).

    `parameters` are the parameters that were given by names, with their indices.
    """
    given = np.array([step is not None for step in steps] if steps is not None else [False] * len(names))
    chosen = difference_step(theta)
    if given.any():
        chosen[given] = [float(step) for step in steps if step is not None]
    wide = np.where(given, chosen, np.maximum(WIDE_STEP * np.abs(theta), 0.1 * chosen))

    of_loops = {i for i, each in parameters if _is_of_loop(each, base.mechanism)}

    def beside(i, step, parts=()):
        unit = np.arange(len(theta)) == i

        def at(m):
            return make(theta + m * step * unit)

        return Variant(names[i], theta[i], float(step), base, at, list(parts), i in of_loops)

    of_base = base.index1(system).system
    parts = [(i, parts_of(each, of_base, chosen[i])) for i, each in parameters]
    known = [(i, each) for i, each in parts if each]
    moved = {}
    of_known = {column for i, _ in known for column in np.atleast_1d(i).tolist()}
    for i in sorted(set(range(len(names))) - of_known):
        if i in of_loops:
            moved[i] = beside(i, chosen[i])
            continue
        moved[i] = _smooth(partial(beside, i), chosen[i], 1 if given[i] else MOST_TRIES, system, t, p, v)
        chosen[i] = moved[i].step
    return Variants(names, chosen, base, moved, known, lambda i, own: beside(i, wide[i], own))


def _is_of_loop(parameter, mechanism) -> bool:
    """Whether a parameter is a number of a loop between anchors."""
    kind, *where = parameter.place or ("",)
    return kind == "loops" and isinstance(records_of(mechanism)[where[0]][-1], Loop)


def _smooth(beside, step, tries, system, t, p, v) -> Variant:
    """The variant with a step over which the equations are smooth; ``beside(step)`` creates a variant."""
    tried, sizes = [], []
    for _ in range(tries):
        variant = beside(step)
        rough, size = (0.0, 0.0) if variant.inert else _roughness(variant, system, t, p, v)
        tried.append((rough, -len(tried), variant))
        sizes.append(size)
        if rough <= SMOOTH:
            break
        step /= SHORTER
    rough, _, variant = min(tried)
    if max(sizes) > 2.0 * min(sizes):  # a step function
        rough = 1.0
    if rough > ROUGH:
        raise InputError(
            f"the equations are not smooth in the parameter {variant.name!r}: differences over {variant.step:.1e} and "
            f"{2 * variant.step:.1e} differ by {rough:.1e} of their size. A table, a rounded number or a kink "
            "depends on it; pass steps= for it, or omit it"
        )
    return variant


def _roughness(variant, system, t, p, v) -> tuple[float, float]:
    """The relative change of residual differences when the step is doubled, and their largest value.

    Both are zero if the parameter has no effect in this state: differences of rounding errors say nothing.
    """
    v = v + 0.3 * np.cos(np.arange(system.nv))
    a = 1.0 + np.abs(v)
    sizes, values = 1e-300, {}
    sides, _, near = variant.beside
    for m in {*near, *(2 * m for m in near)}:
        f, phi, G, rho = sides[m].index1(system).system.evaluate(t, p, v, a)
        values[m] = np.concatenate((f, phi, rho, (G @ np.ones(system.nc)) if system.nc else np.zeros(0)))
        sizes = max(sizes, np.abs(values[m]).max())
    one = sum(weight * values[m] for m, weight in near.items())
    two = sum(weight * values[2 * m] for m, weight in near.items()) / 2.0
    noise = RESIDUAL_ROUNDING * sizes
    size = float(np.abs(one).max())
    if max(size, np.abs(two).max()) <= noise:
        return 0.0, 0.0
    return float(np.abs(one - two).max() / (size + noise / ROUGH)), size / variant.step


def _require_same(mechanism, base, where) -> None:
    """Raise InputError if a mechanism with another parameter value has other joints or rows."""
    for what in ("nq", "nv", "joints", "row_labels") if mechanism is not base else ():
        if getattr(mechanism, what) != getattr(base, what):
            raise InputError(
                f"build() returns another kind of mechanism if {where}: its {what} differs. "
                "Joints and loops must not depend on the parameters"
            )
