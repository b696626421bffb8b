"""A simulation that is advanced interval by interval under prescribed torques."""

from __future__ import annotations

from collections.abc import Mapping
from functools import wraps
from math import isfinite
from threading import Lock
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from ..engine.charts import turning_coordinates
from ..engine.rounding import shortest_step
from ..errors import AssemblyError, InputError, PinconsistError, SingularSystemError
from ..mechanism.assembly import assembled
from ..mechanism.checks import finite_array, near, number
from ..mechanism.closing import LoopSolver
from ..mechanism.forces.actuators import BoundHeldActuator, programmed
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.rank import require_nonsingular
from ..mechanism.system import MechanismSystem
from .discrete import Discrete, StepLinearization
from .events import EventWatch, as_events
from .integrate import March, modes_of, start_in_modes, trajectory_of
from .numbers import Numbers
from .options import Options, positive_time, without_backend
from .output import STOPPED, SUCCESS, Output, Record, Stop
from .propagator import Step
from .solution import Solution
from .steppers import stepper_for

ON = 1e-9  # m, rad and their rates: a state that is nearer to the constraints is on them; the first step projects it


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
    """A simulation that is advanced step by step: each step covers a time interval, under prescribed torques.

    For control loops, co-simulation and learning. All steps are stored until :meth:`reset`, see :meth:`solution`. For a
    control law of (t, q, v) that is called at a fixed rate, use :class:`Sampled` in :func:`simulate`.

    Parameters
    ----------
    mech, q0, v0
        As in :func:`simulate`.
    t0 : float
        The time at the start, s.
    method : {"Radau", "BDF", "ImplicitEuler"}
        A step of Radau starts from (q, v) alone. BDF must restart in each :meth:`step`, which is costly.
    step, order, rtol, atol, forces, events, max_step, backend
        As in :func:`simulate`; terminal ``events`` end the run.

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
        self._mechanism, self._events = programmed(mech), as_events(events, mech)
        self._values: dict = {}  # parameters that were changed since
        self._step, self._columns = step, {}
        self._options = Options(method, step, order, rtol, atol, max_step=max_step)
        self._free, self._discrete = Lock(), None
        self._quick = self._direct = False  # whether a run may start without assembly, and steps be made in the engine
        self.reset(q0, v0, t0)

    @property
    def mechanism(self) -> Mechanism:
        """The mechanism with an additional force ``"control"``, and with the values of :meth:`set_parameters`."""
        if self._values:
            self._mechanism, self._values = self._mechanism.with_parameters(self._values), {}
        return self._mechanism

    @_alone
    def reset(self, q0=None, v0=None, t0=0.0) -> State:
        """Start a new run and return its initial state.

        `q0` and `v0` are as in :func:`simulate`; `t0` is the time, s. Arrays that satisfy the constraints, such as the
        states of runs, need no assembly: the state is then used unchanged, which costs less than a step.
        """
        t0 = number(t0, "t0")
        if self._taken(q0, v0, t0):
            return self.state
        solver = LoopSolver(self.mechanism, t0)
        assembly = assembled(solver, q0, v0)
        system = MechanismSystem(self.mechanism, assembly.q, t0, solver)
        require_nonsingular(system, assembly.q)
        self._stand(system, t0, assembly.q, assembly.v)
        return self.state

    def _taken(self, q, v, t) -> bool:
        """Begin at a state that is on the constraints, with the same system; False if an assembly is needed."""
        if not self._quick or self._changing is not None:
            return False
        system = self._stepper.system
        v = np.zeros(system.nv) if v is None else v
        sizes = (q, system.npos), (v, system.nv)
        if any(type(x) is not np.ndarray or x.dtype != float or x.shape != (n,) for x, n in sizes):
            return False
        if not system.vector_like and not pin.isNormalized(system.model, q, ON):
            return False
        if not self._stepper.off(t, q, v) <= ON * (1.0 + np.abs(v).max(initial=0.0)):
            return False
        q, v = q.copy(), v.copy()
        for each in q, v:
            each.setflags(write=False)
        self._begins_anew(t, q, v)
        return True

    def _begins_anew(self, t, q, v) -> None:
        """A new run of the same stepper, without events to be watched, and with nothing held."""
        system = self._stepper.system
        for held in system.held_forces:
            held.forget()
        self._stepper.forget()
        self._begins(system, t, q, v)

    @_alone
    def copy(self) -> Simulation:
        """A new run from the state and torques of this one, without its history; laws are shared."""
        self._renew()
        other, (t, q, v) = object.__new__(type(self)), self.state
        vars(other).update(vars(self))
        other._free, other._discrete, other._values = Lock(), None, {}
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
        contacts = self.mechanism.contacts
        self._method = self._options.for_span((t, t + 1.0), 0 if contacts else system.nv - system.nc)
        self._stepper = stepper_for(system, self._method)
        self._numbers: Numbers | None = None
        self._renewed = True  # whether the system has the numbers of its compiled equations
        modes = modes_of(system, self._method, (t, t + 1.0))
        self._watch = EventWatch(self._events, self._stepper, bool, modes)
        self._begins(system, t, q, v, like)
        self._changing = system if len(system.changing) > 1 + len(self._actuators) else None  # besides by `control`
        plain = not self._events and self._step is None
        self._direct = plain and system.dropped_are_zero and not system.moving
        self._quick = self._direct and not contacts

    def _begins(self, system, t, q, v, like=None):
        """A run of the stepper that will begin at a state."""
        self._record = Record(Output(events=self._events), (t, t + 1.0), self._stepper.full_multipliers, bool)
        self._control, self._torque, self._commands = system.held_forces[-1], np.zeros(system.nv), {}
        self._actuators = {each.name: each for each in system.held_forces if isinstance(each, BoundHeldActuator)}
        self._place, self._resumes, self._jumped, self._message = (t, q, v), False, False, ""
        self._before = None
        system.start(t, q, v, False, like)

    @_alone
    def set_parameters(self, values: Mapping[str, float]) -> State:
        """Start a new run with a modified mechanism, at the same time, with the same controls, and return its state.

        `values` are parameters by name, ``{"mass:rod": 0.4}``, as in :meth:`Mechanism.with_parameters`. If lengths have
        changed, the loops are closed from the current state. Raises InputError for unknown names and impossible values,
        AssemblyError if the loops cannot be closed.
        """
        torque, commands = self._torque, self._commands
        if not self._changes_in_place(values):
            mechanism, (t, q, v) = self.mechanism.with_parameters(values), self.state
            solver, before = LoopSolver(mechanism, t), self._stepper.system
            assembly = assembled(solver, q, v)
            system = MechanismSystem(mechanism, assembly.q, t, solver)
            require_nonsingular(system, assembly.q)
            self._mechanism, self._discrete = mechanism, None
            self._stand(system, t, assembly.q, assembly.v, before)
        if commands or np.count_nonzero(torque):
            self._hold_these(self._place[0], commands, torque)
        return self.state

    def _changes_in_place(self, values) -> bool:
        """Change parameters in the compiled equations and begin a new run; False where that is not possible."""
        if not self._quick or self._changing is not None or not isinstance(values, Mapping):
            return False
        stepper = self._stepper
        numbers = self._numbers or Numbers(self.mechanism, stepper.system)
        changes = numbers.changes(values)
        if changes is None:
            return False
        if numbers is not self._numbers:
            stepper = stepper_for(stepper.system, self._method, numbers.compiled)
        t, q, v = self._place
        before = numbers.native.values
        now = before.copy()
        for change, value in changes:
            change.put(now, value)
        numbers.native.set(now)
        if any(change.opens for change, _ in changes):
            try:
                q, v = stepper.index1.projected(t, q, v)
            except (AssemblyError, SingularSystemError):  # too far from here
                numbers.native.set(before)
                return False
            for each in q, v:
                each.setflags(write=False)
        self._numbers = numbers
        self._stepper = stepper
        others = {name: value for name, value in self._values.items() if name not in values}
        self._values = others | dict(values)  # the last ones last, as a number may have several names
        self._renewed = False
        self._begins_anew(t, q, v)
        return True

    def _renew(self) -> None:
        """Make a system that has the numbers which were changed in place."""
        if self._renewed:
            return
        before = self._stepper.system
        system = MechanismSystem(self.mechanism, self._place[1], before.chosen_at, like=before)
        system.take_held(before)
        self._stepper.stand_for(system)
        self._renewed, self._discrete = True, None

    @_alone
    def step(self, dt, control=None) -> State:
        """Advance the run by a time interval.

        Parameters
        ----------
        dt : float
            Duration, s.
        control : mapping or array (nv,), optional
            Mapping: commands of actuators by name (others as before) and torques, joint → N·m or N (others zero).
            Array: torques of all velocities. They are held over the interval. Default: as before.

        Returns
        -------
        State
            The state reached, before the end of `dt` if a terminal event ended the run.

        Raises
        ------
        InputError
            Unknown joints, wrong sizes, numbers that are not finite; the run has ended.
        PinconsistError
            The method fails; :attr:`state` is then the last state reached.
        """
        if self._message:
            raise InputError(f"the run has ended: {self._message}. Start a new one with reset()")
        if not (isinstance(dt, float) and 0.0 < dt < np.inf):
            dt = positive_time(dt, "dt")
        t, q, v = self._before = self._place
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
            jumped, (t, q, v) = False, self._place
        hit = None
        if self._resumes and self._direct:
            reached = None
            try:  # as `March` does, without records, up to an end of a mode of contacts
                reached = self._stepper.reach(t_end, jumped, self._watch.compiled, self._changing)
            finally:
                if reached is None:
                    self._keep()
                self._place = reached or self._record.last()[:3]
            if reached is not None:
                return State(*reached)
            (t, q, v), jumped, hit = self._place, False, self._stepper.hit
        span, resumes, self._resumes = (t, t_end), self._resumes, False
        try:
            run = March(self._stepper, span, self._method, self._record, self._watch, bool)
            if hit is not None:
                run.after_events(*hit)
            elif resumes:
                self._stepper.resume()
            else:
                run.start(q, v)
            run.to_end(jumped)
            self._resumes = True
        except Stop as stop:
            self._message = str(stop)
            if stop.status != STOPPED:
                raise PinconsistError(f"{stop}; the last state is at t = {self._record.last()[0]:.6g}") from None
        finally:
            self._place = self._record.last()[:3]
        return self.state

    @_alone
    def linearized(self, dt=None, *, inputs=None) -> StepLinearization:
        """Linearise the last step with respect to the state before it and the inputs: ``A, B = sim.linearized()``.

        The accepted steps of Radau IIA are differentiated, with the torques and commands that were held. It can be used
        for several states of controllers: :meth:`copy` and :meth:`reset` change nothing.

        Parameters
        ----------
        dt : float, optional
            First take a step of this duration, s, with the controls held as before.
        inputs : sequence of str, optional
            Actuators and joints. Default: all actuators, and the motorised joints that have none; without both, all
            joints.

        Returns
        -------
        StepLinearization

        Raises
        ------
        InputError
            There is no step yet; a method other than Radau; an event or a jump of other forces in the step; sampled
            laws, whose torques depend on earlier states; unknown names.
        """
        if self.mechanism.contacts:
            raise InputError(
                "steps of a mechanism with contacts are not linearised, because its modes change. Leave out those that "
                "are open, mech.with_contacts(), and hold what sticks by a pc.Loop of kind 'point', or a joint by a "
                "pc.Drive, in a Simulation from the same state"
            )
        if dt is not None:
            type(self).step.__wrapped__(self, dt)
        if self._before is None:
            raise InputError("there is no step to linearise: call step(dt) first, or linearized(dt)")
        if self._method.name != "Radau":
            raise InputError(f"steps of Radau are linearised, not of {self._method.name}: choose method='Radau'")
        self._up_to_date()
        self._renew()
        start, reached = self._before, self._place
        made = self._stepper.steps_since(start[0]) if self._stepper.t == reached[0] else None
        if made is None:
            rows, orders = self._record.since(start[0])
            if not all(orders):
                what = "an event, or a force that jumps, acted in the last step"
                raise InputError(f"{what}: make shorter steps around it")
        discrete = self._linearizer(start[0], None if inputs is None else tuple(np.atleast_1d(inputs).tolist()))
        if made is None:
            return discrete.along(start, rows, orders, self._again)
        return discrete.of_steps(start, made, reached)

    def _linearizer(self, t, names) -> Discrete:
        """What linearises steps under the commands that are held; actuators may be at their limits."""
        key = self._stepper.system, names, tuple(self._commands.items())
        if self._discrete is None or self._discrete[0] != key or (self._actuators and self._changing is not None):
            self._discrete = key, Discrete(self._stepper.system, names, t)
        return self._discrete[1]

    def _again(self, start, t_end):
        """The steps from a state (t, q, v) to a time, made once more under what is held."""
        stepper, steps = stepper_for(self._stepper.system, self._options.for_span((start[0], t_end))), []
        stepper.place(*start)
        while stepper.t != t_end:
            made = stepper.advance(t_end, with_curve=True)
            if made.error is not None or made.why:
                raise PinconsistError(f"the last step cannot be linearised: {made.error or made.why}")
            curve = stepper.read().curve
            steps += [Step.of(curve, i) for i in range(len(curve.ends))]
        stepper.close()
        return steps

    def _up_to_date(self):
        if not self._record.begun:
            self._begin()
        self._keep()

    def _keep(self):
        if self._direct and self._resumes:
            self._record.add(self._stepper.read())

    def _begin(self):
        t, q, v = self._place
        if self._watch.modes is not None:
            q, v = start_in_modes(self._stepper, self._watch, t, q, v)
            self._place = t, q, v
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
        return self._hold_these(t, commands, torque)

    def _hold_these(self, t, commands, torque) -> bool:
        """The same, of commands by name and of torques, shape (nv,)."""
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
        self._renew()
        t, message = self._place[0], self._message or f"{self._record.nsteps} steps"
        span = self._record.span[0], t
        status = STOPPED if self._message else SUCCESS
        found = trajectory_of(self._stepper, self._method, self._record, self._watch, span, status, message)
        return Solution._from_trajectory(found, self._method, self._events)


def suits_many(sim: Simulation) -> bool:
    """Whether runs like this one can be advanced together in C++: Python has nothing to do in their steps."""
    if not sim._quick or sim._changing is not None or sim._method.name != "Radau" or sim._stepper.core is None:
        return False
    return sim._stepper.index1.compiled.in_lanes


class Worker(NamedTuple):
    """What makes the steps of many runs, one at a time: a stepper, its numbers, and the tables of what is held."""

    stepper: Any
    numbers: Numbers
    tables: list


def worker_like(sim: Simulation) -> Worker:
    """A worker for runs of the mechanism of a run, from its state; it shares nothing with that or others."""
    (t, q, v), before = sim.state, sim._stepper.system
    system = MechanismSystem(sim.mechanism, q, t, like=before)
    numbers = Numbers(sim.mechanism, system)
    stepper = stepper_for(system, sim._options.for_span((t, t + 1.0)), numbers.compiled)
    stepper.core.turns = turning_coordinates(system, q)
    system.start(t, q, v, False)
    actuators = [each for each in system.held_forces if isinstance(each, BoundHeldActuator)]
    return Worker(stepper, numbers, [held.table for held in (system.held_forces[-1], *actuators)])


def hold(sim: Simulation, commands, torque) -> None:
    """Let a run hold commands by name and torques (nv,) from now on; actuators may have the names of joints."""
    sim._jumped |= sim._hold_these(sim._place[0], commands, torque)


def actuators_of(sim: Simulation) -> list[str]:
    """The names of the actuators of a run, which take commands."""
    return list(sim._actuators)
