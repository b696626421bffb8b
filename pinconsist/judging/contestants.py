"""The simulators that are judged: MuJoCo, Pinocchio's constrained dynamics with Baumgarte's method, this package."""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from typing import Any, Protocol

import numpy as np

from ..errors import MissingExtraError, PinconsistError
from ..mechanism.forces import bound_forces
from ..mechanism.lie import integrate
from ..mechanism.rigid import RigidDynamics
from ..run.simulation import simulate
from .mjcf import (
    NotTranslatedError,
    from_mujoco,
    refuse_controllers,
    scene_of,
    to_mujoco,
    torques_from_mujoco,
    torques_to_mujoco,
)

DEFAULT_SOLREF, DEFAULT_SOLIMP = (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0)
STIFF_SOLIMP = (0.9999, 0.9999, 0.001, 0.5, 2.0)
"""As close to a rigid constraint as MuJoCo's documentation allows. The time constant must be two steps at least; with
RK4 the force at the start of a step is then off by the fourth power of step over time constant, so that ten are better.
"""
STEPS = (2e-3, 1e-3, 5e-4, 2e-4, 1e-4, 5e-5, 2e-5, 1e-5)
SETTLING = 10.0  # steps: time constant of Baumgarte's correction
DEFAULT_RTOL = 1e-6
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8)


class Contestant(Protocol):
    """A simulator that is judged; created with its task."""

    name: str
    made_for: str

    def __init__(self, task: Task): ...

    def ladders(self) -> list[list[Setting]]:
        """Settings, each list from coarse to fine."""

    def run(self, setting: Setting) -> Rows:
        """Make the motion; FailedError if it became unstable."""


class FailedError(PinconsistError):
    """A simulator did not reach the end."""


@dataclass(frozen=True)
class Setting:
    """What a simulator is set to: how it is called in the table, its step, s, and the text for its users' files."""

    tool: str
    label: str
    step: float | None
    paste: str
    values: Any = None
    of_file: Any = None


@dataclass(frozen=True)
class Rows:
    """What a simulator returned: t (n,), q (n, nq), v (n, nv), Jᵀλ (n, nv), and the processor time of its steps, s.

    A log has, instead of Jᵀλ, the forces of some loops (n, 3), by name.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    loads: np.ndarray | None
    seconds: float
    forces: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Task:
    """The motion to be made: the mechanism, its closed start, and the times of the rows, evenly spaced."""

    mechanism: Any
    q0: np.ndarray
    v0: np.ndarray
    times: np.ndarray
    tilted: tuple[str, ...]
    of_file: Any = None  # the settings of an MJCF file

    @property
    def spacing(self) -> float:
        return float(self.times[1] - self.times[0])

    def steps(self, step) -> tuple[int, int, float]:
        """(rows between those that are kept, steps from one to the next, the step) for a step near the given one."""
        stride = max(1, round(step / self.spacing))
        inner = max(1, round(stride * self.spacing / step))
        return stride, inner, stride * self.spacing / inner


class MuJoCo:
    """MuJoCo, from its defaults to as stiff as it goes. Its Python is called only for forces that it does not have."""

    name = "MuJoCo"
    made_for = "fast, stable contact-rich simulation for control and learning; its loops are soft by design"

    def __init__(self, task: Task):
        try:
            import mujoco
        except ImportError:
            raise MissingExtraError(
                "MuJoCo is not installed; install it with: pip install 'pinconsist[mujoco]'"
            ) from None
        self._mujoco, self.task = mujoco, task
        self.scene = scene_of(task.mechanism, task.tilted)
        mujoco.set_mju_user_warning(lambda text: None)  # the default writes a file; unstable runs are found below
        self._model(self.ladders()[0][0])  # errors of MuJoCo are raised now

    def ladders(self) -> list[list[Setting]]:
        """Settings, each list from coarse to fine."""
        found = [[self.setting("Euler", 2e-3, DEFAULT_SOLREF, DEFAULT_SOLIMP, "default loops")]]
        if (own := self.task.of_file) is not None:
            label = f"{own.integrator}, {_time(own.timestep)}, as in its file"
            values = own.integrator, DEFAULT_SOLREF, DEFAULT_SOLIMP
            found.insert(0, [Setting(self.name, label, own.timestep, "<!-- as in its file -->", values, own)])
        found.append([self.setting("implicitfast", 1e-3, DEFAULT_SOLREF, DEFAULT_SOLIMP, "default loops")])
        for integrator, steps in (("implicitfast", 2), ("RK4", 2), ("RK4", 10)):
            how = f"loops of {steps} steps"
            found.append([self.setting(integrator, h, (steps * h, 1.0), STIFF_SOLIMP, how) for h in STEPS])
        return found

    def setting(self, integrator, step, solref, solimp, how) -> Setting:
        paste = (
            f'<option timestep="{step:g}" integrator="{integrator}"/>\n'
            f'<default><equality solref="{" ".join(f"{x:g}" for x in solref)}" '
            f'solimp="{" ".join(f"{x:g}" for x in solimp)}"/></default>'
        )
        label = f"{integrator}, {_time(step)}, {how}"
        return Setting(self.name, label, step, paste, (integrator, solref, solimp))

    def _model(self, setting, step=None):
        integrator, solref, solimp = setting.values
        mujoco, step = self._mujoco, step or setting.step
        if solimp == STIFF_SOLIMP:  # its time constant is a number of steps
            solref = (solref[0] / setting.step * step, 1.0)
        try:
            model = mujoco.MjModel.from_xml_string(self.scene.text(step, integrator, solref, solimp))
        except ValueError as error:
            raise NotTranslatedError(f"MuJoCo refuses the model: {' '.join(str(error).split())}") from error
        if setting.of_file is not None:
            _set_as_in_file(model, setting.of_file)
        for equality, length in self.scene.lengths:
            tendon = model.tendon(equality).id
            model.equality(equality).data[0] = length - model.tendon_length0[tendon]
        return model

    def run(self, setting) -> Rows:
        """Make the motion; FailedError if it became unstable."""
        task, scene, mujoco = self.task, self.scene, self._mujoco
        stride, inner, step = task.steps(setting.step)
        model = self._model(setting, step)
        data, times = mujoco.MjData(model), task.times[::stride]
        data.qpos[:], data.qvel[:] = to_mujoco(scene.joints, task.q0, task.v0)
        data.qfrc_applied[:] = scene.steady
        each_step = bool((scene.commands and self._moving()) or scene.others)
        self._act(data, times[0], step)
        q, v, loads, seconds = [], [], [], 0.0
        for t in times:
            if len(q):
                began = time.process_time()
                if each_step:
                    for k in range(inner):
                        self._act(data, t - (inner - k) * step, step)
                        mujoco.mj_step(model, data)
                else:
                    mujoco.mj_step(model, data, inner)
                seconds += time.process_time() - began
            self._act(data, t, 0.0)
            row = self._row(model, data)
            for column, part in zip((q, v, loads), row, strict=True):
                column.append(part)
        if not all(np.isfinite(part).all() for part in (q, v, loads)) or any(
            data.warning[kind].number for kind in (mujoco.mjtWarning.mjWARN_BADQACC, mujoco.mjtWarning.mjWARN_BADQPOS)
        ):
            raise FailedError("the simulation became unstable")
        return Rows(times, np.array(q), np.array(v), np.array(loads), seconds)

    def _moving(self) -> bool:
        commands = [command for _, command in self.scene.commands]
        start, end = self.task.times[[0, -1]]
        return any(command(start) != command(t) for command in commands for t in np.linspace(start, end, 50))

    def _act(self, data, t, step):
        """Commands, in the middle of a step, and forces that MuJoCo does not have, at its start."""
        scene, middle = self.scene, min(t + 0.5 * step, self.task.times[-1])
        for i, command in scene.commands:
            data.ctrl[i] = command(middle)
        if scene.others:
            q, v = from_mujoco(scene.joints, self.task.mechanism.nq, data.qpos, data.qvel)
            tau = sum((force.torque(t, q, v) for force in scene.others), np.zeros(len(v)))
            data.qfrc_applied[:] = scene.steady + torques_to_mujoco(scene.joints, q, tau)

    def _row(self, model, data):
        """q, v and Jᵀλ of the equalities, at the state itself; the iteration starts from what it was before."""
        mujoco, warm = self._mujoco, data.qacc_warmstart.copy()
        mujoco.mj_forward(model, data)
        data.qacc_warmstart[:] = warm
        q, v = from_mujoco(self.scene.joints, self.task.mechanism.nq, data.qpos, data.qvel)
        forces, loads = np.zeros(data.nefc), np.zeros(model.nv)
        forces[: data.ne] = data.efc_force[: data.ne]  # not friction
        mujoco.mj_mulJacTVec(model, data, loads, forces)
        return q, v, torques_from_mujoco(self.scene.joints, q, loads)


def _set_as_in_file(model, own):
    for key, value in own.options.items():
        setattr(model.opt, key, value)
    for e in range(model.neq):
        name = model.eq(e).name
        name = name if name in own.equalities else name.partition(", second point")[0]
        if name in own.equalities:
            model.eq_solref[e], model.eq_solimp[e] = own.equalities[name]


class Pinocchio:
    """`pin.constraintDynamics` with Baumgarte's correction in explicit steps, from Python."""

    name = "Pinocchio"
    made_for = "rigid-body algorithms for planning and control; the step and the correction are its users'"

    def __init__(self, task: Task):
        self.task, self.model = task, task.mechanism.model
        refuse_controllers(task.mechanism)
        self.dynamics = RigidDynamics(task.mechanism, task.tilted)
        self.forces = list(bound_forces(self.model, task.mechanism.forces).values())

    def ladders(self) -> list[list[Setting]]:
        common = [self.setting("symplectic Euler", 1e-3, None)]
        steps = [h for h in STEPS if h >= 5e-5]  # one from Python takes 10 µs
        return [common, *([self.setting(name, h, SETTLING) for h in steps] for name in ("symplectic Euler", "RK4"))]

    def setting(self, integrator, step, settling) -> Setting:
        kp, kd = (0.0, 0.0) if settling is None else (1.0 / (settling * step) ** 2, 2.0 / (settling * step))
        how = "without correction" if settling is None else f"Baumgarte {_time(settling * step)}"
        paste = f"corrector.Kp[:] = {kp:g}\ncorrector.Kd[:] = {kd:g}\n# {integrator}, step {step:g} s"
        return Setting(self.name, f"{integrator}, {_time(step)}, {how}", step, paste, (integrator, settling))

    def run(self, setting) -> Rows:
        task, (integrator, settling) = self.task, setting.values
        stride, inner, step = task.steps(setting.step)
        self.dynamics.correct(0.0 if settling is None else 1.0 / (settling * step))
        q, v, times = task.q0.copy(), task.v0.copy(), task.times[::stride]
        move = self._runge_kutta if integrator == "RK4" else self._symplectic
        rows, seconds = [], 0.0
        with np.errstate(all="ignore"):
            for t in times:
                if rows:
                    began = time.process_time()
                    for k in range(inner):
                        q, v = move(t - (inner - k) * step, q, v, step)
                    seconds += time.process_time() - began
                if not (np.isfinite(q).all() and np.isfinite(v).all()):
                    raise FailedError("the simulation became unstable")
                rows.append((q, v, self.dynamics.loads(q, v, self._torque(t, q, v))))
        q, v, loads = (np.array(part) for part in zip(*rows, strict=True))
        if not np.isfinite(loads).all():
            raise FailedError("the simulation became unstable")
        return Rows(times, q, v, loads, seconds)

    def _torque(self, t, q, v):
        return sum((force.torque(t, q, v) for force in self.forces), np.zeros(self.model.nv))

    def _acceleration(self, t, q, v):
        return self.dynamics.acceleration(q, v, self._torque(t, q, v))

    def _symplectic(self, t, q, v, h):
        v = v + h * self._acceleration(t, q, v)
        return integrate(self.model, q, h * v), v

    def _runge_kutta(self, t, q, v, h):
        """The classical method; on rotations its positions are of order 2 where velocities turn."""
        k1 = self._acceleration(t, q, v)
        v2 = v + 0.5 * h * k1
        k2 = self._acceleration(t + 0.5 * h, integrate(self.model, q, 0.5 * h * v), v2)
        v3 = v + 0.5 * h * k2
        k3 = self._acceleration(t + 0.5 * h, integrate(self.model, q, 0.5 * h * v2), v3)
        v4 = v + h * k3
        k4 = self._acceleration(t + h, integrate(self.model, q, h * v3), v4)
        rate = (v + 2 * v2 + 2 * v3 + v4) / 6
        return integrate(self.model, q, h * rate), v + h * (k1 + 2 * k2 + 2 * k3 + k4) / 6


class Own:
    """This package: Radau IIA, its default."""

    name = "pinconsist"
    made_for = "closed chains whose loop forces are to be right"

    def __init__(self, task: Task):
        self.task = task

    def ladders(self) -> list[list[Setting]]:
        return [[self.setting(DEFAULT_RTOL)], [self.setting(rtol) for rtol in TOLERANCES]]

    def setting(self, rtol) -> Setting:
        paste = f"pc.simulate(mech, t_span, rtol={rtol:g}, atol={rtol / 100:g})"
        return Setting(self.name, f"Radau IIA, rtol {rtol:g}", None, paste, rtol)

    def run(self, setting) -> Rows:
        task, rtol = self.task, setting.values
        span = float(task.times[0]), float(task.times[-1])
        began = time.process_time()
        sol = simulate(task.mechanism, span, task.q0, task.v0, rtol=rtol, atol=rtol / 100)
        seconds = time.process_time() - began
        if not sol.success:
            raise FailedError(sol.message)
        return replace(rows_of(sol.at(task.times)), seconds=seconds)


def rows_of(sol) -> Rows:
    """The rows of a solution, with their loop forces."""
    from ..run.accuracy import loop_forces

    return Rows(sol.t, sol.q, sol.v, loop_forces(sol.system, sol.t, sol.q, sol.v, sol.lam), 0.0)


def _time(seconds) -> str:
    factor, unit = (1.0, "s") if seconds >= 0.9999 else (1e3, "ms") if seconds >= 0.9999e-3 else (1e6, "µs")
    return f"{seconds * factor:.4g} {unit}"


CONTESTANTS: dict[str, type[Contestant]] = {"mujoco": MuJoCo, "pinocchio": Pinocchio, "pinconsist": Own}
