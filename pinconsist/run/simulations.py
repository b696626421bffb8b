"""Many runs of one mechanism, advanced together: for learning, sampling controllers and studies of parameters."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..engine.rounding import shortest_step
from ..errors import InputError, PinconsistError
from ..mechanism.checks import finite_array, number
from ..mechanism.mechanism import Mechanism
from .accuracy import processors
from .ensemble import Ensemble
from .options import positive_time
from .stepping import Simulation, actuators_of, hold, suits_many

log = logging.getLogger(__name__)


class States(NamedTuple):
    """Times (n,), s, configurations (n, nq) and velocities (n, nv) of several runs; arrays are the caller's own."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray


class Simulations:
    """Several runs of one mechanism, advanced together on the threads of this process.

    Each is that of a :class:`Simulation` that was reset to the same state, bit for bit, whatever the others do, and may
    have other parameters. Steps are not kept: there is no :class:`Solution`. Runs with functions of the user's,
    contacts, tables or events, and those with parameters that :meth:`Simulation.set_parameters` cannot change in place,
    are advanced one after another.

    Parameters
    ----------
    mech : Mechanism
        The scene.
    n : int
        The number of runs.
    q0, v0 : mapping or array, optional
        As in :func:`simulate`, for all runs; or arrays (n, nq) and (n, nv), a row for each.
    threads : int, optional
        The largest number of threads. Default: the processors that this process may use.
    **options
        As in :class:`Simulation`.

    Attributes
    ----------
    failed : ndarray of bool, shape (n,)
        The runs whose method has failed. They stand still until they are reset; ``messages[i]`` says why.

    Raises
    ------
    InputError, AssemblyError, SingularSystemError
        As for :class:`Simulation`.
    """

    def __init__(self, mech, n, q0=None, v0=None, *, threads=None, **options):
        self._n = _count(n, "n")
        self._threads = processors() if threads is None else _count(threads, "threads")
        self.failed, self.messages = np.zeros(self._n, bool), [""] * self._n
        q, v = _rows(q0, "q0", self._n), _rows(v0, "v0", self._n)
        self._first = Simulation(mech, q[0], v[0], **options)
        self._names, self._nv = actuators_of(self._first), mech.nv
        # The torques of all velocities and the commands that each run holds; NaN for commands that were never given.
        self._held = np.zeros((self._n, mech.nv + len(self._names)))
        self._held[:, mech.nv :] = np.nan
        self._together: Ensemble | None = None
        self._alone: dict[int, Simulation] = {}  # runs that are advanced one after another
        t, first_q, first_v = self._first.state
        same = [q[i] is q[0] and v[i] is v[0] for i in range(self._n)]
        if suits_many(self._first):
            self._together = Ensemble(self._first, self._n, self._threads)
            positions = [first_q if same[i] else q[i] for i in range(self._n)]
            velocities = [first_v if same[i] else v[i] for i in range(self._n)]
            self._together.begin(list(range(self._n)), positions, velocities, t)
            return
        for i in range(self._n):
            self._alone[i] = self._first.copy() if i else self._first
            if not same[i]:
                self._alone[i].reset(q[i], v[i], t)

    def __len__(self) -> int:
        return self._n

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism of the first run, with a force ``"control"``."""
        if self._together is None or 0 in self._alone:
            return self._alone[0].mechanism
        return self._together.mechanism_of(0)

    @property
    def state(self) -> States:
        """The states that were reached."""
        if self._together is None:
            states = [self._alone[i].state for i in range(self._n)]
            return States(*(np.array(column) for column in zip(*states, strict=True)))
        found = States(*self._together.states)
        for i, sim in self._alone.items():
            found.t[i], found.q[i], found.v[i] = sim.state
        return found

    @property
    def lam(self) -> np.ndarray:
        """The multipliers at the states, shape (n, nc), with the torques that were held until there."""
        if self._together is None:
            return np.array([self._alone[i].lam for i in range(self._n)])
        lam = self._together.multipliers()
        for i, sim in self._alone.items():
            lam[i] = sim.lam
        return lam

    def step(self, dt, control=None) -> States:
        """Advance all runs by a time.

        Parameters
        ----------
        dt : float
            Duration, s.
        control : mapping or array, optional
            Mapping: commands of actuators by name (others as before) and torques, joint → N·m or N (others zero); each
            a number for all runs or an array (n,), for joints of several velocities (n, k). Array (n, nv) or (nv,):
            torques of all velocities. They are held over this time. Default: as before.

        Returns
        -------
        tuple of ndarray
            For runs that have failed, the last state that was reached; :attr:`failed` marks them.

        Raises
        ------
        InputError
            Unknown joints, wrong sizes, numbers that are not finite.
        """
        dt = positive_time(dt, "dt")
        latest = float(np.abs(self.state.t).max())
        if dt < shortest_step(latest):
            raise InputError(f"dt = {dt:g} s is too small to differ from zero at t = {latest:g} s")
        if control is not None:
            self._hold(control)
        going = np.flatnonzero(~self.failed).tolist()
        if self._together is not None:
            together = [i for i in going if i not in self._alone]
            for i, message in self._together.advance(together, self._held, dt).items():
                self._fail(i, message)
        for i in going:
            if i in self._alone:
                self._step_alone(i, dt)
        return self.state

    def reset(self, which=None, q0=None, v0=None, t0=0.0) -> States:
        """The states after some runs have begun anew, without torques; others go on.

        `which` is a mask (n,) or indices, by default all. `q0` and `v0` are as in :func:`simulate` for all of these, or
        arrays (k, nq) and (k, nv) with a row for each; `t0` is the time, s.
        """
        chosen = self._chosen(which)
        q, v = _rows(q0, "q0", len(chosen)), _rows(v0, "v0", len(chosen))
        t0 = number(t0, "t0")
        together = [k for k, i in enumerate(chosen) if i not in self._alone]
        for k, i in enumerate(chosen):
            if i in self._alone:
                self._alone[i].reset(q[k], v[k], t0)
        if self._together is not None:
            runs = [chosen[k] for k in together]
            self._together.begin(runs, [q[k] for k in together], [v[k] for k in together], t0)
        for i in chosen:
            self.failed[i], self.messages[i] = False, ""
            self._held[i, : self._nv] = 0.0
            self._held[i, self._nv :] = np.nan
        return self.state

    def set_parameters(self, values: Mapping, which=None) -> States:
        """The states after parameters of some runs have changed.

        `values` maps names to a number, or to an array (k,) with one for each of these runs.
        `which` is a mask (n,) or indices, by default all; see :meth:`Simulation.set_parameters`.

        Raises
        ------
        InputError
            If a name or number is impossible, or `which` selects no run of these.
        AssemblyError
            If the loops of a run cannot be closed with the new numbers.
        """
        if not isinstance(values, Mapping):
            raise InputError(f"set_parameters needs a mapping name → number, got {values!r}")
        chosen = self._chosen(which)
        each = {name: _numbers(value, f"parameter {name!r}", (len(chosen),)) for name, value in values.items()}
        own = {i: {name: float(numbers[k]) for name, numbers in each.items()} for k, i in enumerate(chosen)}
        for i in own:
            if i in self._alone:
                self._alone[i].set_parameters(own[i])
        if self._together is not None:
            runs = [i for i in own if i not in self._alone]
            for i in self._together.set_parameters(runs, [own[i] for i in runs]):
                run = self._apart(self._together, i)
                run.set_parameters(own[i])
                self._alone[i] = run
        return self.state

    def _apart(self, together, i) -> Simulation:
        """A run of its own that goes on where one of those together is."""
        t, q, v = (column[i] for column in together.states)
        run = self._first.copy()
        run.set_parameters(together.values_of(i))
        run.reset(q, v, float(t))
        hold(run, *self._held_by(i))
        return run

    def _chosen(self, which) -> list[int]:
        """The indices of some runs."""
        if which is None:
            return list(range(self._n))
        which = np.atleast_1d(np.asarray(which))
        if which.dtype == bool and which.shape == (self._n,):
            return np.flatnonzero(which).tolist()
        if which.dtype.kind in "iu" and which.ndim == 1 and ((which >= 0) & (which < self._n)).all():
            return which.tolist()
        raise InputError(f"which must be a mask of {self._n} booleans, or indices from 0 to {self._n - 1}")

    def _hold(self, control) -> None:
        """Take over torques and commands."""
        nv = self._nv
        held = self._held.copy()
        if isinstance(control, Mapping):
            held[:, :nv] = 0.0
            for name, value in control.items():
                columns = self._columns(name)
                size = columns.stop - columns.start
                shape = (self._n,) if size == 1 else (self._n, size)
                held[:, columns] = _numbers(value, f"control of {name!r}", shape).reshape(self._n, size)
        else:
            held[:, :nv] = _numbers(control, "control", (self._n, nv))
        self._held = held

    def _columns(self, name) -> slice:
        """The columns of a joint or an actuator among what is held."""
        if name in self._names:
            place = self._nv + self._names.index(name)
            return slice(place, place + 1)
        return self.mechanism.columns(name)

    def _step_alone(self, i, dt) -> None:
        try:
            hold(self._alone[i], *self._held_by(i))
            self._alone[i].step(dt)
        except PinconsistError as error:
            self._fail(i, str(error))

    def _held_by(self, i) -> tuple[dict, np.ndarray]:
        """The commands by name and the torques, shape (nv,), that a run holds."""
        nv = self._nv
        commands = zip(self._names, self._held[i, nv:].tolist(), strict=True)
        return {name: value for name, value in commands if not np.isnan(value)}, self._held[i, :nv].copy()

    def _fail(self, i, message) -> None:
        self.failed[i], self.messages[i] = True, message
        log.warning("run %d failed: %s", i, message)


def _count(value, what) -> int:
    """A positive whole number, or InputError."""
    if isinstance(value, bool) or not isinstance(value, int | np.integer) or value < 1:
        raise InputError(f"{what} must be a positive whole number, got {value!r}")
    return int(value)


def _numbers(value, what, shape) -> np.ndarray:
    """Numbers of this shape from user input, the same for all runs if there is one less dimension; or InputError."""
    array = finite_array(value, what)
    if array.shape not in (shape, shape[1:]):
        raise InputError(f"{what} needs the shape {shape} or {shape[1:]}, got {array.shape}")
    return np.broadcast_to(array, shape)


def _rows(value, what, number) -> list:
    """A position or velocity for each of a number of runs; the same object for all if only one was given."""
    if not (isinstance(value, np.ndarray) and value.ndim == 2):
        return [value] * number
    if len(value) != number:
        raise InputError(f"{what} needs a row for each of {number} runs, got shape {value.shape}")
    return list(value)
