"""A run as an object, advanced interval by interval under given torques."""

from __future__ import annotations

from collections.abc import Mapping
from functools import wraps
from math import isfinite
from threading import Lock
from typing import NamedTuple

import numpy as np

from ..engine.rounding import shortest_step
from ..errors import InputError, PinconsistError
from ..mechanism.assembly import assembled
from ..mechanism.checks import finite_array, near, number
from ..mechanism.closing import LoopSolver
from ..mechanism.forces.actuators import BoundHeldActuator, programmed
from ..mechanism.mechanism import with_added_forces
from ..mechanism.rank import require_nonsingular
from ..mechanism.system import MechanismSystem
from .events import EventWatch, as_events
from .integrate import March, Resumption, Start, march, trajectory_of
from .options import Options, positive_time, without_backend
from .output import STOPPED, SUCCESS, Output, Record, Stop
from .solution import Solution
from .steppers import stepper_for


def _alone(method):
    """A method that changes or reads the workspaces of a run, which only one call at a time may do."""

    @wraps(method)
    def alone(self, *arguments, **named):
        if not self._free.acquire(blocking=False):
            raise InputError(
                f"this Simulation is in use: {method.__name__} was called by another thread, or by a function that the "
                "run itself calls, before a call had returned. Give each thread a Simulation of its own, as by copy(), "
                "or share one by a lock"
            )
        try:
            return method(self, *arguments, **named)
        finally:
            self._free.release()

    return alone


class State(NamedTuple):
    """Time (s), configuration (nq,) and velocity (nv,); arrays are read-only."""

    t: float
    q: np.ndarray
    v: np.ndarray


class Simulation:
    """A run as an object: each :meth:`step` advances it by a given time, under given torques.

    For control loops, co-simulation and learning. All steps are kept until :meth:`reset`, see :meth:`solution`. For a
    control law of (t, q, v) that is called at a fixed rate, :class:`Sampled` in :func:`simulate` does the same.

    Parameters
    ----------
    mech, q0, v0
        As in :func:`simulate`.
    t0 : float
        The time at the start, s.
    method : {"Radau", "BDF", "ImplicitEuler"}
        A step of Radau starts from (q, v) alone. BDF has to restart in each :meth:`step`, which is costly.
    step, order, rtol, atol, forces, events, max_step, backend
        As in :func:`simulate`; ``events`` that are terminal end the run.

    Attributes
    ----------
    mechanism : Mechanism
        The mechanism with an additional force ``"control"``, the torques given to :meth:`step`.

    Raises
    ------
    InputError, AssemblyError, SingularSystemError
        As for :func:`simulate`.
    """

    def __init__(
        self, mech, q0=None, v0=None, *, t0=0.0, method="Radau", step=None, order=None, rtol=1e-6, atol=1e-8,
        forces=(), events=None, max_step=np.inf, backend=None,
    ):  # fmt: skip
        without_backend(backend)
        mech = with_added_forces(mech, forces, "Simulation")
        self.mechanism, self._events = programmed(mech), as_events(events, mech)
        self._step, self._columns = step, {}
        self._options = Options(method, step, order, rtol, atol, max_step=max_step)
        self._free = Lock()
        self.reset(q0, v0, t0)

    @_alone
    def reset(self, q0=None, v0=None, t0=0.0) -> State:
        """The state at which a new run begins.

        `q0` and `v0` are as in :func:`simulate`; `t0` is the time, s.
        """
        t0 = number(t0, "t0")
        solver = LoopSolver(self.mechanism, t0)
        assembly = assembled(solver, q0, v0)
        system = MechanismSystem(self.mechanism, assembly.q, t0, solver)
        require_nonsingular(system, assembly.q)
        self._stand(system, t0, assembly.q, assembly.v)
        return self.state

    @_alone
    def copy(self) -> Simulation:
        """A new run from the state and torques of this one, without its history; laws are shared."""
        other, (t, q, v) = object.__new__(type(self)), self.state
        vars(other).update(vars(self))
        other._free = Lock()
        other._stand(MechanismSystem(self.mechanism, q, t), t, q, v, self._stepper.system)
        other._hold(t, self._commands)
        other._hold(t, self._torque)
        return other

    def __copy__(self):
        return self.copy()

    def __deepcopy__(self, _):
        return self.copy()

    def __reduce__(self):
        raise InputError("a Simulation cannot be pickled; pickle its solution(), or its state to reset another one to")

    def _stand(self, system, t, q, v, like=None):
        """Where a run will begin, with what controllers hold in the system of another run."""
        self._method = self._options.for_span((t, t + 1.0), system.nv - system.nc)
        self._stepper = stepper_for(system, self._method)
        self._record = Record(Output(events=self._events), (t, t + 1.0), self._stepper.full_multipliers, bool)
        self._watch = EventWatch(self._events, self._stepper, bool)
        self._control, self._torque, self._commands = system.held_forces[-1], np.zeros(system.nv), {}
        self._actuators = {each.name: each for each in system.held_forces if isinstance(each, BoundHeldActuator)}
        self._place, self._resumes, self._jumped, self._message = (t, q, v), False, False, ""
        system.start(t, q, v, False, like)
        self._changing = system if len(system.changing) > 1 + len(self._actuators) else None  # besides by `control`
        plain = not self._events and self._step is None and system.dropped_are_zero
        self._quick = plain and self._stepper.passes_changes(False)

    @_alone
    def step(self, dt, control=None) -> State:
        """Advance the run by a time.

        Parameters
        ----------
        dt : float
            Duration, s.
        control : mapping or array (nv,), optional
            Mapping: commands of actuators by name (others as before) and torques, joint → N·m or N (others zero).
            Array: torques of all velocities. They are held over this time. Default: as before.

        Returns
        -------
        State
            The state reached; before the end of `dt` if a terminal event ended the run.

        Raises
        ------
        InputError
            Unknown joints, wrong sizes, numbers that are not finite; the run has ended.
        PinconsistError
            The method fails; :attr:`state` is then the last one that was reached.
        """
        if self._message:
            raise InputError(f"the run has ended: {self._message}. Start a new one with reset()")
        if not (isinstance(dt, float) and 0.0 < dt < np.inf):
            dt = positive_time(dt, "dt")
        t, q, v = self._place
        t_end = t + dt
        if dt < shortest_step(t):
            raise InputError(f"dt = {dt:g} s is too small to differ from zero at t = {t:g} s")
        if control is not None:
            self._jumped |= self._hold(t, control)
        if self._changing is not None:
            self._jumped |= bool(self._changing.change(t, q, v))
            self._stepper.system.breakpoints.look_on(t, t_end, q, v)
        jumped, self._jumped = self._jumped, False
        if not self._record.begun:
            self._begin()
            jumped = False
        if self._resumes and self._quick:
            reached = None
            try:  # as `march` does, without events or records
                reached = self._stepper.reach(t_end, jumped, self._changing)
            finally:
                if reached is None:
                    self._keep()
                self._place = reached or self._record.last()[:3]
            if reached is not None:
                return State(*reached)
            (t, q, v), jumped = self._place, False
        span, resumes, self._resumes = (t, t_end), self._resumes, False
        try:
            run = March(self._stepper, span, self._method, self._record, self._watch, bool)
            march(run, Resumption(jumped) if resumes else Start(q, v))
            self._resumes = True
        except Stop as stop:
            self._message = str(stop)
            if stop.status != STOPPED:
                raise PinconsistError(f"{stop}; the last state is at t = {self._record.last()[0]:.6g}") from None
        finally:
            self._place = self._record.last()[:3]
        return self.state

    def _up_to_date(self):
        if not self._record.begun:
            self._begin()
        self._keep()

    def _keep(self):
        if self._quick and self._resumes:
            self._record.add(self._stepper.unread())

    def _begin(self):
        t, q, v = self._place
        lam = self._stepper.index1.acceleration(t, q, v)[1]
        self._record.first(t, q, v, lam)
        self._watch.restart(t, q, v, lam)

    def _hold(self, t, control) -> bool:
        """Hold commands and torques from now on; returns whether they have changed."""
        if isinstance(control, Mapping):
            commands, torque = self._of_names(control)
        else:
            commands, torque = {}, finite_array(control, "control")
            if torque.shape != self._torque.shape:
                raise InputError(
                    f"control must map actuators to commands, joints to torques, or have {len(self._torque)} torques, "
                    f"got {control!r}"
                )
        changed = False
        for name, value in commands.items():
            if self._commands.get(name) != value:
                self._actuators[name].hold(t, np.array([float(value)]))
                self._commands[name] = value
                changed = True
        if torque.tobytes() != self._torque.tobytes():
            self._torque, changed = torque, True
            self._control.hold(t, torque)
        return changed

    def _of_names(self, control):
        """Commands by name, and the torques of all velocities."""
        commands, torque, columns = {}, np.zeros(len(self._torque)), self._columns
        for name, value in control.items():
            if name not in columns:
                columns[name] = self._place_of(name)
            if (here := columns[name]) is None:
                commands[name] = number(value, f"the command of {name!r}")
            elif isinstance(value, float) and isfinite(value):
                torque[here] = value
            else:
                value, size = finite_array(value, f"the torque of {name!r}"), here.stop - here.start
                if value.size not in (1, size):
                    raise InputError(f"the torque of {name!r} needs {size} number(s), got shape {value.shape}")
                torque[here] = value
        return commands, torque

    def _place_of(self, name):
        """The columns of a joint; None for an actuator."""
        if name in self._actuators:
            return None
        if name not in self.mechanism.joints:
            known = [*self._actuators, *self.mechanism.joints]
            raise InputError(f"control: no actuator or joint {name!r}{near(name, known)}")
        return self.mechanism.columns(name)

    @property
    def state(self) -> State:
        """The state reached."""
        return State(*self._place)

    @property
    @_alone
    def lam(self) -> np.ndarray:
        """The multipliers at the state, shape (nc,), with the torques that were held until there."""
        self._up_to_date()
        return self._record.last()[3]

    @property
    def events(self) -> list:
        """The times at which each event has occurred, a list for each event."""
        return [[row[0] for row in rows] for rows in self._watch.found]

    @_alone
    def solution(self) -> Solution:
        """A :class:`Solution` of all steps since the start: for checks, pages and files. The run can be continued."""
        self._up_to_date()
        t, message = self._place[0], self._message or f"{self._record.nsteps} steps"
        span = self._record.span[0], t
        status = STOPPED if self._message else SUCCESS
        found = trajectory_of(self._stepper, self._method, self._record, self._watch, span, status, message)
        return Solution._from_trajectory(found, self._method, self._events)
