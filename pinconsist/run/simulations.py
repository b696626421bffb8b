"""Many runs of one mechanism, advanced together: for learning, sampling controllers and studies of parameters."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from ..engine import required
from ..engine.failure import FAILURES
from ..engine.rounding import shortest_step
from ..errors import InputError, PinconsistError
from ..mechanism.checks import finite_array
from ..mechanism.mechanism import Mechanism
from .accuracy import processors
from .options import positive_time
from .stepping import Simulation, actuators_of, hold, in_engine, set_advanced

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
    contacts, tables or events are advanced one after another.

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
        every = range(self._n)
        q, v = _rows(q0, "q0", self._n), _rows(v0, "v0", self._n)
        first = Simulation(mech, q[0], v[0], **options)
        self._runs = [first, *(first.copy() for _ in range(1, self._n))]
        self._names = actuators_of(first)
        self._t, self._q, self._v = np.empty(self._n), np.empty((self._n, mech.nq)), np.empty((self._n, mech.nv))
        # The torques of all velocities and the commands that each run holds; NaN for commands that were never given.
        self._held = np.zeros((self._n, mech.nv + len(self._names)))
        self._held[:, mech.nv :] = np.nan
        for i in every:
            if q[i] is not q[0] or v[i] is not v[0]:
                self._runs[i].reset(q[i], v[i], first.state.t)
            self._take(i)

    def __len__(self) -> int:
        return self._n

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism of the first run, with a force ``"control"``."""
        return self._runs[0].mechanism

    @property
    def state(self) -> States:
        """The states that were reached."""
        return States(self._t.copy(), self._q.copy(), self._v.copy())

    @property
    def lam(self) -> np.ndarray:
        """The multipliers at the states, shape (n, nc), with the torques that were held until there."""
        parts = [in_engine(run) for run in self._runs]
        lam = [run.lam if part is None else part.multipliers() for run, part in zip(self._runs, parts, strict=True)]
        return np.array(lam)

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
        if dt < max(map(shortest_step, self._t.tolist())):
            raise InputError(f"dt = {dt:g} s is too small to differ from zero at t = {self._t.max():g} s")
        if control is not None:
            self._hold(control)
        together = []
        for i in np.flatnonzero(~self.failed).tolist():
            part = in_engine(self._runs[i])
            if part is None:
                self._step_alone(i, dt)
            else:
                together.append((i, part))
        if together:
            self._step_together(together, dt)
        return self.state

    def reset(self, which=None, q0=None, v0=None, t0=0.0) -> States:
        """The states after some runs have begun anew, without torques; others go on.

        `which` is a mask (n,) or indices, by default all. `q0` and `v0` are as in :func:`simulate` for all of these, or
        arrays (k, nq) and (k, nv) with a row for each; `t0` is the time, s.
        """
        chosen = self._chosen(which)
        q, v = _rows(q0, "q0", len(chosen)), _rows(v0, "v0", len(chosen))
        for k, i in enumerate(chosen):
            self._runs[i].reset(q[k], v[k], t0)
            self.failed[i], self.messages[i] = False, ""
            self._held[i] = 0.0
            self._held[i, self._v.shape[1] :] = np.nan
            self._take(i)
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
        for k, i in enumerate(chosen):
            self._runs[i].set_parameters({name: float(numbers[k]) for name, numbers in each.items()})
            self._take(i)
        return self.state

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
        nv = self._v.shape[1]
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
            place = self._v.shape[1] + self._names.index(name)
            return slice(place, place + 1)
        return self.mechanism.columns(name)

    def _step_alone(self, i, dt) -> None:
        try:
            hold(self._runs[i], *self._held_by(i))
            self._runs[i].step(dt)
        except PinconsistError as error:
            self._fail(i, str(error))
        self._take(i)

    def _held_by(self, i) -> tuple[dict, np.ndarray]:
        """The commands by name and the torques, shape (nv,), that a run holds."""
        nv = self._v.shape[1]
        commands = zip(self._names, self._held[i, nv:].tolist(), strict=True)
        return {name: value for name, value in commands if not np.isnan(value)}, self._held[i, :nv].copy()

    def _step_together(self, together, dt) -> None:
        places = [i for i, _ in together]
        t, q, v, failures = required().advance_together(
            [part.run for _, part in together],
            [table for _, part in together for table in part.tables],
            self._held[places],
            dt,
            min(self._threads, len(together)),
        )
        self._t[places], self._q[places], self._v[places] = t, q, v
        for i, reason in zip(places, failures, strict=True):
            state = float(self._t[i]), self._q[i].copy(), self._v[i].copy()
            set_advanced(self._runs[i], *state, *self._held_by(i))
            if reason:
                self._fail(i, FAILURES.get(reason, reason))

    def _take(self, i) -> None:
        self._t[i], self._q[i], self._v[i] = self._runs[i].state

    def _fail(self, i, message) -> None:
        self.failed[i], self.messages[i] = True, message
        log.warning("run %d failed at t = %g: %s", i, self._t[i], message)


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
