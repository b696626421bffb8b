"""Held torques: tables, and digital controllers, which record such a table while they run."""

from bisect import bisect_right
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ...engine.systems import held_table
from ...errors import InputError
from ..breakpoints import jump_offset
from ..checks import columns, finite_array, name, number, put, read_only, require_functions, returned, several
from .force import BoundForce, ForceRecord

SAME_TIME = 1e-9  # in periods: times that differ by less are equal
BEHIND = 0.25  # of the offset at a jump: on the steps of a run, a time later by less is not behind it; see HeldTable


class BoundHeld(BoundForce):
    """A table of torques (nv,), each held from its time to the next, in the direction of the run.

    Only the first `entered` entries are in effect, so that a step that ends at a time of the table uses the torques
    before that time. With `linear`, torques are interpolated linearly.
    """

    smooth = changes = True

    def __init__(self, nv, times=(), torques=(), sign=1.0, linear=False):
        self._nv, self._sign, self._linear = nv, sign, linear
        self.table = held_table()  # the same entries in the engine
        self._keys, self._torques = [sign * t for t in times], list(torques)
        self.entered = len(self._keys)
        self.in_order = True  # whether the entries are those given, and not reversed
        self._begun: int | None = None  # entries at the start of a run that is over, on whose steps it acts
        self._fill()

    @property
    def held(self) -> np.ndarray:
        """The entries in effect as rows of time and torques, shape (n, 1 + nv)."""
        n = len(self._keys) if self._linear else self.entered
        times, torques = self._sign * np.array(self._keys[:n]), np.array(self._torques[:n])
        return np.hstack((times.reshape(n, 1), torques.reshape(n, self._nv)))

    def entry(self, t):
        """The torques at a time, or None before the first entry."""
        return self.table.at(t)

    def share_of(self, i, t) -> float:
        """The share of the entry `i` in the torques at a time."""
        n, keys = self.table.reached(t), self._keys
        if not (self._linear and 0 < n < len(keys)):
            return float(i == n - 1)
        part = (self._sign * t - keys[n - 1]) / (keys[n] - keys[n - 1])
        return part if i == n else 1.0 - part if i == n - 1 else 0.0

    def torque(self, t, q, v):
        held = self.entry(t)
        return np.zeros(self._nv) if held is None else held

    def hold(self, t, torque) -> None:
        """Hold a torque (nv,) from `t` on; it replaces a torque that was added at the same time."""
        self._keys.append(self._sign * t)
        self._torques.append(torque)
        self.entered = len(self._keys)
        self.table.hold(t, torque)

    def forget(self) -> None:
        """Forget all entries before the next start: a program gives new ones."""
        self._keys, self._torques, self.entered = [], [], 0
        self._fill()

    def start(self, t, backwards) -> None:
        """Start a run at `t`: the entries up to this time are in effect."""
        if backwards != (self._sign < 0.0):  # reverse the table
            self.in_order = not self.in_order
            held = self.entry(t)
            now = np.zeros(self._nv) if held is None else held
            first = bisect_right(self._keys, self._sign * t)
            keys, torques = self._keys[:first], self._torques[: first if self._linear else max(0, first - 1)]
            zero = [np.zeros(self._nv)] if first else []
            self._keys = [-self._sign * t, *(-key for key in reversed(keys[: self._linear] + keys))]
            self._torques, self._sign = [now, *reversed(torques), *zero], -self._sign
        self.entered = bisect_right(self._keys, self._sign * t)
        self._fill()

    def on_steps(self, run, t, backwards) -> None:
        """Act as the same force of a `run` from `t` that is over, on its steps, which may be evaluated in any order.

        A step that ends at a time of the table has the torques before it.
        """
        self.start(t, backwards)
        if len(self._keys) == len(run._keys):  # the times at which steps ended
            self._keys = list(run._keys)
        self._begun, self.entered = self.entered, len(self._keys)
        self._fill()

    def times_between(self, low, high) -> list[float]:
        """The times of entries inside an interval."""
        return [t for t in (self._sign * key for key in self._keys) if low < t < high]

    def follow(self, other, t) -> None:
        """Continue at `t` what a controller does in another run; a table has it already."""

    def next_change(self, t) -> float:
        """The time of the next entry, or infinity, in the direction of the run."""
        later = self._keys[self.entered :]
        return self._sign * (later[0] if later else np.inf)

    def change(self, t, q, v) -> bool | None:
        """Put the entries up to a time into effect; return whether the torques jump, or None if there are none."""
        if not self._keys:
            return None
        before, now, offset = self.entered, self._sign * t, jump_offset(t)
        if before + 1 < len(self._keys):  # at large times entries may be closer than the offset
            offset = min(offset, 0.5 * (self._keys[before + 1] - self._keys[before]))
        n = bisect_right(self._keys, now + offset)
        if self._keys[before:n] != (met := [now] * (n - before)):
            self._keys[before:n] = met  # `t` is a sum of steps, and slightly too small, or that of another change
            self._fill()
        self.entered = self.table.entered = n
        return None if n == before else not (self._linear and before and n == before + 1)

    def hand_over(self, compiled) -> None:
        compiled.add_held(self.table)

    def _fill(self):
        """Copy the entries to the engine."""
        self.table.clear(self._sign)
        self.table.linear = self._linear
        for key, torque in zip(self._keys, self._torques, strict=True):
            self.table.hold(self._sign * key, torque)
        self.table.entered = self.entered
        if self._begun is not None:
            self.table.on_steps, self.table.begun = True, self._begun


def columns_of(model, joints, who) -> np.ndarray:
    """The velocity columns of some joints; all columns if `joints` is None."""
    every = np.arange(model.nv)
    return every if joints is None else np.concatenate([every[columns(model, joint, who)] for joint in joints])


def named(joints, who) -> tuple[str, ...] | None:
    """The names of joints from user input, each once; None for all."""
    if joints is None:
        return None
    names = tuple(name(each, f"{who}: each of its joints") for each in several(joints))
    if not names or len(set(names)) < len(names):
        raise InputError(f"{who}: joints needs one or more joints, each once, got {list(names)!r}")
    return names


class HeldRecord(ForceRecord):
    """A record with held torques; a run records their table, which its checks then use."""

    joints: str | Sequence[str] | None = None
    _acts_on = "joints"


@dataclass(frozen=True, eq=False)
class Held(HeldRecord):
    """Named torques from a program during a run, or a `table` recorded by a run."""

    name: str
    table: np.ndarray | None = None
    sign: float = 1.0
    joints: str | Sequence[str] | None = None
    linear: bool = False

    label = property(lambda self: self.name)

    def bind(self, model):
        table = np.zeros((0, 1 + model.nv)) if self.table is None else self.table
        return BoundHeld(model.nv, table[:, 0], np.ascontiguousarray(table[:, 1:]), self.sign, self.linear)


class Given(BoundHeld):
    """Torques (nv,) that are given before each evaluation."""

    def __init__(self, nv):
        super().__init__(nv, [-np.inf], [np.zeros(nv)])

    def give(self, torque) -> None:
        self._torques[0] = torque
        self._fill()


@dataclass(frozen=True, eq=False)
class HeldTorque(HeldRecord):
    """A table of torques, held (zero-order hold) or interpolated linearly. Steps end at its times.

    Parameters
    ----------
    times : array, shape (n,)
        Times from which the torques act, s, in the direction of the run. There is no torque before the first time.
    torques : array, shape (n, m) or (n,)
        One torque for each of the m velocities of the joints, N·m (or N).
    joints : sequence of str, optional
        Default: all joints of the mechanism.
    linear : bool
        Interpolate linearly between the times; the last torque is held.

    Raises
    ------
    InputError
        Invalid numbers, times that are not ordered; on a model, unknown joints and wrong sizes.
    """

    times: Sequence[float]
    torques: Sequence
    joints: str | Sequence[str] | None = None
    linear: bool = False

    _kind = "held torque"

    def __post_init__(self):
        times = finite_array(self.times, "HeldTorque: times")
        torques = finite_array(self.torques, "HeldTorque: torques")
        torques = torques[:, None] if torques.ndim == 1 else torques
        ways = set(np.sign(np.diff(times)).tolist()) if times.ndim == 1 else {0.0}
        if len(ways) > 1 or ways == {0.0} or torques.ndim != 2 or len(torques) != len(times):
            raise InputError(
                f"HeldTorque needs increasing (or decreasing) times and a row of torques for each, got shapes "
                f"{times.shape} and {torques.shape}"
            )
        put(self, times=read_only(times), torques=read_only(torques), joints=named(self.joints, "HeldTorque"))

    def bind(self, model) -> BoundHeld:
        here, times, given = columns_of(model, self.joints, "HeldTorque"), self.times, np.asarray(self.torques)
        if given.shape[1] != len(here):
            raise InputError(f"HeldTorque: torques need {len(here)} columns, got shape {given.shape}")
        torques = np.zeros((len(times), model.nv))
        torques[:, here] = given
        sign = -1.0 if len(times) > 1 and times[-1] < times[0] else 1.0
        return BoundHeld(model.nv, times, torques, sign, self.linear)


class BoundSampled(BoundHeld):
    def __init__(self, record, model):
        super().__init__(model.nv)
        self._record, self._columns = record, columns_of(model, record.joints, "Sampled")
        self._what = f"the law of {record.label!r}"

    def start(self, t, backwards):
        record = self._record
        self._sign, self._start, self._taken, self._waiting = -1.0 if backwards else 1.0, t, 0, []
        self._keys, self._torques, self.entered = [], [], 0
        self._fill()
        late = record.delay / record.period
        self._late = round(late) if abs(late - round(late)) < SAME_TIME else late  # avoids almost equal times

    def follow(self, other, t):
        self._start, self._taken, self._waiting = other._start, other._taken, list(other._waiting)
        if (held := other.entry(t)) is not None:
            self.hold(t, held)

    def next_change(self, t):
        due = min(self._taken, self._waiting[0][0]) if self._waiting else self._taken
        return self._start + self._sign * due * self._record.period

    def on_steps(self, run, t, backwards):
        self.start(t, backwards)
        self._keys, self._torques = list(run._keys), list(run._torques)
        self._begun, self.entered = bisect_right(self._keys, self._sign * t + jump_offset(t)), len(self._keys)
        self._fill()

    def times_between(self, low, high):
        """The times of its samples, and those at which their torques begin to act, inside an interval."""
        period, delay = self._record.period, self._record.delay
        last = max(self._sign * (t - self._start) for t in (low, high))
        begun = [self._start + self._sign * period * n for n in range(int(last / period) + 2)]
        return [t for each in begun for t in {each, each + self._sign * delay} if low < t < high]

    @property
    def columns(self) -> np.ndarray:
        """The velocities that the torques act on."""
        return self._columns

    def entries_until(self, t) -> int:
        """The number of entries in effect behind a time."""
        return bisect_right(self._keys, self._sign * t + jump_offset(t))

    def entry_of(self, i) -> np.ndarray:
        """The torques of a sample."""
        return self._torques[i][self._columns]

    def sampled(self) -> list[float]:
        """The times of the samples whose torques were held, in order."""
        return [self._start + self._sign * i * self._record.period for i in range(len(self._keys))]

    def change(self, t, q, v):
        apart = min(max(SAME_TIME, jump_offset(t) / self._record.period), 0.5)  # `t` is rounded
        now = self._sign * (t - self._start) / self._record.period + apart
        sampled, before = self._taken <= now, self.entered
        if sampled:
            self._sample(t, q, v)
        while self._waiting and self._waiting[0][0] <= now:
            self.hold(t, self._waiting.pop(0)[1])
        return self.entered != before if sampled or self.entered != before else None

    def _sample(self, t, q, v):
        torque, shape = np.zeros(self._nv), (len(self._columns),)
        torque[self._columns] = found = returned(self._law, self._what, shape, t, q, v)
        if not np.isfinite(found).all():
            raise InputError(f"{self._what} returned {found} at t = {t:.6g}; torques must be finite")
        self._waiting.append((self._taken + self._late, torque))
        self._taken += 1

    def _law(self, t, q, v):
        return np.array(self._record.law(t, q, v), ndmin=1)


@dataclass(frozen=True, eq=False)
class Sampled(HeldRecord):
    """A digital controller: a control law called once per period, with its torques held until the next call.

    Steps end at the samples, the first of which is at the start of the run. The torques are kept as ``solution.held``;
    ``check``, ``energy`` and the error estimate use them, and do not call the law again.

    Parameters
    ----------
    period : float
        Time between samples, s.
    law : callable
        ``law(t, q, v) -> torques``, one for each velocity of the joints, N·m (or N); called with read-only arrays, once
        per sample, in the order of the run. If it has internal state, use a new law for each run. Derivatives of runs
        need ``law.derivative(t, q, v) -> (∂u/∂q, ∂u/∂v)``, each (m, nv) or None, if the law uses q or v.
    joints : str or sequence of str, optional
        Joints that the torques act on. Default: all.
    delay : float
        Time from a sample until its torques act, s. There is no torque before the first one acts.

    Raises
    ------
    InputError
        Invalid numbers; on a model, unknown joints; during a run, an invalid return value of the law.
    UserFunctionError
        The law raised an exception.
    """

    period: float
    law: Callable
    joints: str | Sequence[str] | None = None
    delay: float = 0.0

    _kind, _law = "sampled", BoundSampled

    def __post_init__(self):
        require_functions(self, "Sampled", "(t, q, v)", "law")
        put(self, period=number(self.period, "Sampled: period", above=0.0), joints=named(self.joints, "Sampled"))
        put(self, delay=number(self.delay, "Sampled: delay", least=0.0))


def sided(t, may_end_at_jump=True):
    """The times of rows, shifted slightly before and after jumps, so that forces are evaluated on the right side.

    With `may_end_at_jump` the last time is shifted, too: a run that ends where a force jumps has the force before.
    """
    jumps, sign = np.diff(t) == 0.0, 1.0 if t[-1] >= t[0] else -1.0
    apart = np.abs(np.diff(t)[~jumps]).min(initial=np.inf)
    return t + sign * np.minimum(jump_offset(t), 0.5 * apart) * (
        np.append(False, jumps) * 1.0 - np.append(jumps, may_end_at_jump and len(t) > 1)
    )
