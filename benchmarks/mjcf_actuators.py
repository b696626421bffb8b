"""Actuators of MJCF files against MuJoCo's own ``qfrc_actuator``, at random states and commands."""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinconsist import Actuator, FormatError, load
from pinconsist.formats.mjcf import Source
from pinconsist.formats.mjcf.model import Tree

STATES = 200


@dataclass(frozen=True)
class Compared:
    """One file: its actuators, how many act here, in how many states limits cut, and the largest difference."""

    file: str
    actuators: int
    acting: int
    cut: float  # share of the states
    largest: float  # |τ|, N·m or N
    difference: float  # of the largest


def compared(folder, states: int = STATES) -> tuple[list[Compared], dict[str, str]]:
    """The files of a folder that have actuators, and why others were refused."""
    rows, refused = [], {}
    for file in sorted(Path(folder).glob("*.xml")):
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # what exerts no force is in the table
                row = _compared(file, states)
        except FormatError as error:
            refused[file.name] = error.reason
            continue
        rows += [row] if row.actuators else []
    return rows, refused


def _compared(file, states) -> Compared:
    import mujoco

    mech, rng = load(file), np.random.default_rng(0)
    model = Source(file, [file.parent]).compiled()[0]
    tree, data = Tree(model, file.stem), mujoco.MjData(model)
    acting = {force.name for force in mech.forces if isinstance(force, Actuator)}
    names = [made.name if made else "" for made in _in_order(model, tree)]
    for i in (i for i, name in enumerate(names) if name not in acting):
        model.actuator_gainprm[i] = model.actuator_biasprm[i] = 0.0
    model.opt.disableflags |= (
        mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    )  # contacts change nothing here, and fill its memory
    worst = largest = cut = 0.0
    for _ in range(states):
        far = 10.0 ** rng.uniform(-2, 0.5)
        data.qpos[:] = model.qpos0
        mujoco.mj_integratePos(model, data.qpos, far * rng.normal(size=model.nv), 1.0)
        data.qvel[:], data.ctrl[:] = far * rng.normal(size=model.nv), far * rng.normal(size=model.nu)
        mujoco.mj_forward(model, data)
        commands = {name: u for name, u in zip(names, data.ctrl.tolist(), strict=True) if name}
        forces = [f.bind(mech.model) for f in mech.with_control(commands).forces if isinstance(f, Actuator)]
        state = 0.0, tree.configuration(data.qpos), np.array(data.qvel)
        mine = sum((force.torque(*state) for force in forces), np.zeros(mech.nv))
        cut += any(force.at_limit(*state) for force in forces) / states
        worst = max(worst, np.abs(mine - data.qfrc_actuator).max())
        largest = max(largest, np.abs(data.qfrc_actuator).max())
    return Compared(file.name, model.nu, len(acting), cut, largest, worst / max(largest, 1.0))


def _in_order(model, tree):
    """The Actuator of each of MuJoCo's, or None."""
    made = iter(tree.actuators())
    for kind, target in zip(model.actuator_trntype, model.actuator_trnid[:, 0], strict=True):
        yield next(made)[1] if tree._moved(kind, target) else None
