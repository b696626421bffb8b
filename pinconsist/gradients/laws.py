"""Digital controllers: torques that a law returns at samples depend on the states there, and on parameters.

Between two samples these torques are constant, so they are parameters of the steps like any other: a column of S for
each of them. With du = ∂u/∂q s_q + ∂u/∂v s_v + ∂u/∂θ at the sample of a torque u, a step moves S by its own
derivatives, and by those of the torques times du. Backwards, the derivative of a number by u, summed over the steps
in which u acts, is added to that by the state of its sample.
"""

from bisect import bisect_left, bisect_right
from types import FunctionType, MethodType

import numpy as np

from ..engine.arguments import may_read
from ..errors import InputError
from ..mechanism.breakpoints import jump_offset, with_own_state
from ..mechanism.checks import called, real_array
from ..mechanism.forces import Sampled
from ..mechanism.forces.held import BoundSampled
from ..run.known import unit_torque

REPEATABLE = 1e-9  # relative to the torques of a law: what it may differ by if it is called once more
ADVICE = (
    "give it an attribute `derivative`, a function (t, q, v) -> (∂u/∂q, ∂u/∂v), one row for each torque; torques that "
    "are given need none if the law uses its argument t alone"
)


def refuse_black_boxes(mechanism) -> None:
    """Raise InputError if torques are sampled from a law that uses the state, and has no derivative."""
    for force in mechanism.forces:
        if isinstance(force, Sampled) and getattr(force.law, "derivative", None) is None and _uses_state(force.law):
            raise InputError(
                f"the law of {force.label!r} uses the state, and its derivatives are not known, so that the run cannot "
                f"be differentiated: {ADVICE}"
            )


def _uses_state(law) -> bool:
    plain = law.__func__ if isinstance(law, MethodType) else law
    if not isinstance(plain, FunctionType):
        return True
    first = plain is not law
    return may_read(plain, first + 1) or may_read(plain, first + 2)


class Torque:
    """The torques of one sample: `columns` of the velocities that they act on, and their places among all."""

    def __init__(self, number, i, t, record, places):
        self.number, self.i, self.t, self.record, self.places = number, i, t, record, places

    def by_state(self, q, v):
        """∂u/∂(q, v), shape (m, 2 nv)."""
        m, nv, law = len(self.places), len(v), self.record.law
        if getattr(law, "derivative", None) is None:
            return np.zeros((m, 2 * nv))
        what = f"the derivative of the law of {self.record.label!r}"
        parts = called(law.derivative, what, self.t, q, v)
        if not (isinstance(parts, tuple | list) and len(parts) == 2):
            raise InputError(f"{what} must return two matrices, (∂u/∂q, ∂u/∂v), it returned {parts!r}")
        shaped = [np.zeros((m, nv)) if part is None else np.reshape(part, (m, -1)) for part in parts]
        return np.hstack([real_array(part, what, (m, nv), self.t) for part in shaped])


class Laws:
    """The sampled torques of a run, and their derivatives, along all its legs; `system` has them as in the run."""

    def __init__(self, system, base, variants):
        self._base, self._variants, self._nv = base, variants, system.nv
        records = [force for force in base.mechanism.forces if isinstance(force, Sampled)]
        self._forces = [force for force in system.forces.values() if isinstance(force, BoundSampled)]
        self._columns: list[int] = []  # of the velocities on which they act, of all of them
        self._torques = []
        for number, (record, force) in enumerate(zip(records, self._forces, strict=True)):
            places = np.arange(len(self._columns), len(self._columns) + len(force.columns))
            self._columns += np.arange(system.nv)[force.columns].tolist()
            samples = force.sampled()
            self._torques.append([Torque(number, i, t, record, places) for i, t in enumerate(samples)])
        self._due = sorted((each for torques in self._torques for each in torques), key=lambda each: each.t)
        self._times = [each.t for each in self._due]
        self._rates: dict = {}  # torque → du, (m, P)
        self._copies: dict = {}  # law → it, and a copy that may be called
        self._bars: dict = {}  # torque → derivative of a number by it, (m,)

    def __len__(self):
        return len(self._columns)

    def parts(self, before):
        """(index, parts) of the torques as parameters of steps, after so many others."""
        torques = [unit_torque(self._nv, column) for column in self._columns]
        return [(before + k, [(1.0, torque)]) for k, torque in enumerate(torques)]

    def cuts(self, leg) -> list[int]:
        """The numbers of steps of a leg after which the torques change, with 0 and all."""
        sign = leg.sign
        ends = sorted(leg.span)
        changes = sorted(sign * t for force in self._forces for t in force.times_between(*ends))
        ends, found = leg.t, [0]
        for i, t in enumerate(ends[:-1]):
            near = bisect_right(changes, sign * t - jump_offset(t))
            if near < len(changes) and changes[near] <= sign * t + jump_offset(t):
                found.append(i + 1)
        return [*found, len(ends)]

    def _sampled_at(self, t):
        near = jump_offset(t)
        return self._due[bisect_left(self._times, t - near) : bisect_right(self._times, t + near)]

    def acting(self, t) -> list[Torque]:
        """The torques in effect from a time on."""
        numbers = [force.entries_until(t) - 1 for force in self._forces]
        return [torques[n] for torques, n in zip(self._torques, numbers, strict=True) if n >= 0]

    def rates(self, t, q, v, S):
        """The derivatives (m, P) of the torques that act from `t` on, after those that are sampled there."""
        for each in self._sampled_at(t):
            if each not in self._rates:
                self._rates[each] = each.by_state(q, v) @ S.T + self.by_parameters(each, q, v)
        found = np.zeros((len(self), len(S)))
        for each in self.acting(t):
            found[each.places] = self._rates.get(each, 0.0)
        return found

    def add_bars(self, t, of_torques) -> None:
        """Add the derivatives (m,) of a number by the torques that act from `t` on."""
        for each in self.acting(t):
            self._bars[each] = self._bars.get(each, 0.0) + of_torques[each.places]

    def pull_back(self, t, q, v):
        """The derivatives of a number by the state (2 nv,) and the parameters (P,), by way of the samples at `t`."""
        by_state, own = np.zeros(2 * self._nv), np.zeros(len(self._variants))
        for each in self._sampled_at(t):
            bar = self._bars.pop(each, None)
            if bar is not None:
                by_state += bar @ each.by_state(q, v)
                own += bar @ self.by_parameters(each, q, v)
        return by_state, own

    def by_parameters(self, torque, q, v):
        """∂u/∂θ, (m, P); InputError if the law no longer returns what it did in the run."""
        found = np.zeros((len(torque.places), len(self._variants)))
        own = self._called(self._base, torque, q, v)
        held = self._forces[torque.number].entry_of(torque.i)
        if np.abs(own - held).max() > REPEATABLE * (1.0 + np.abs(held).max()):
            raise InputError(
                f"the law of {torque.record.label!r} returned {held} at t = {torque.t:.6g} s in the run, and {own} "
                "if called once more with the same state: it has a state of its own, whose derivatives are not known. "
                "Make it a function of t, q and v"
            )
        for i, variant in self._variants.moved.items():
            sides = {} if variant.inert else variant.beside[0]
            if any(self._record(side, torque).law is not torque.record.law for side in sides.values()):
                found[:, i] = variant.derivative(lambda side: self._called(side, torque, q, v))
        return found

    @staticmethod
    def _record(side, torque):
        return [force for force in side.mechanism.forces if isinstance(force, Sampled)][torque.number]

    def _called(self, side, torque, q, v):
        law = self._record(side, torque).law
        if id(law) not in self._copies:
            self._copies[id(law)] = law, with_own_state(law)
        _, copied = self._copies[id(law)]
        return np.array(called(copied, f"the law of {torque.record.label!r}", torque.t, q, v), float, ndmin=1)


class WithTorques:
    """Residuals of parameters (see :class:`~pinconsist.gradients.variants.Residuals`) and of torques, after them."""

    def __init__(self, residuals, laws):
        self.beside, self.workspace = residuals.beside, residuals.workspace
        self.known = [*residuals.known, *laws.parts(len(residuals))]
        self._size = len(residuals) + len(laws)

    def __len__(self):
        return self._size
