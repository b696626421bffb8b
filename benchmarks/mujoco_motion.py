"""MJCF files as they are read here against MuJoCo's own motion: ``python -m benchmarks mujoco``.

Both start at the file's keyframe and move without contacts, limits, dry friction and actuators. MuJoCo takes steps of
its Runge-Kutta method, whose error is measured by halving them. First the equalities are left out, and all joints have
velocities at the start. Then the motion starts from rest where the loops are closed. MuJoCo holds equalities by
springs and dampers (``solref``, ``solimp``): the motion is compared as the file has them, and with springs that are 100
times as stiff, together with how far they give way.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from math import nan
from pathlib import Path
from typing import Annotated

import numpy as np
import pinocchio as pin
import typer

import pinconsist as pc
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.formats.catalogue import reader_of
from pinconsist.mechanism.forces import Actuator
from pinconsist.mechanism.joint_constraints import Coupling

from . import report
from .gallery import PACKAGES, files_of

STEP, STIFFER = 1e-3, 100.0
MOST = 400  # velocities of a file that is compared
SHOWN = 90
BALL, FREE = 1, 0


@dataclass
class Compared:
    """One file: the largest differences of the motions, and how far MuJoCo's equalities give way."""

    file: str
    nv: int = 0
    rows: int = 0
    own_error: float = nan  # of MuJoCo's steps, by halving them
    free: float = nan  # without the equalities: largest difference, m or rad
    difference: float = nan
    gives_way: float = nan  # largest |Φ| of MuJoCo's equalities, m or rad
    stiffer_difference: float = nan  # with equalities that are 100 times as stiff
    stiffer_gives_way: float = nan
    speed: float = nan  # largest, m/s or rad/s
    reason: str = ""  # why it is not compared


def compare(sources, until: float) -> Iterator[Compared]:
    """All MJCF files of the sources: names of packages, or folders."""
    for source in sources:
        for title, file in files_of(source):
            if reader_of(file) == "mjcf":
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")
                    yield compared(title, file, until)


def compared(title: str, file: Path, until: float) -> Compared:
    """The motions of one file."""
    found = Compared(title)
    try:
        mech = without_contacts(pc.load(file, package_dirs=[file.parents[1]]))
        found.nv, found.rows = mech.nv, mech.nc
        if mech.nv > MOST:
            found.reason = f"more than {MOST} velocities"
            return found
        theirs, times = Peer(file, mech), np.linspace(0.0, until, 6)
        freely(found, mech, theirs, times)
        if theirs.model.neq and not found.reason:
            held(found, mech, theirs, times)
    except (pc.PinconsistError, ValueError) as error:
        found.reason = str(error).replace(f"{Path(file).parent}/", "")
    return found


def freely(found, mech, theirs, times):
    """Compare the motions without equalities, from the same velocities of all joints."""
    mech = mech.with_loops(*(loop for loop in mech.loops if stands_for_a_tendon(loop)))
    q, v = np.array(mech.guess), np.random.default_rng(0).uniform(-0.5, 0.5, mech.nv)
    sol = pc.simulate(mech, (0.0, times[-1]), q, v, method="Radau", rtol=1e-9, atol=1e-10, t_eval=times)
    if not sol.success:
        found.reason = sol.message
        return
    found.speed = float(np.abs(sol.v).max(initial=0.0))
    coarse, fine = (theirs.motion(sol.q[0], times, step, v=sol.v[0], held=False)[0] for step in (STEP, STEP / 2))
    if coarse is None or fine is None:
        found.reason = "MuJoCo's steps of 1 ms are unstable"
        return
    found.own_error, found.free = apart(theirs, coarse, fine), apart(theirs, sol.q, fine)


def held(found, mech, theirs, times):
    """Compare the motions with equalities, from rest where they hold."""
    q = pc.assemble(mech).q
    sol = pc.simulate(mech, (0.0, times[-1]), q, method="Radau", rtol=1e-9, atol=1e-10, t_eval=times)
    if not sol.success:
        found.reason = sol.message
        return
    soft, found.gives_way = theirs.motion(q, times, STEP / 2)
    stiff, found.stiffer_gives_way = theirs.motion(q, times, STEP / 20, STIFFER)
    found.difference = apart(theirs, sol.q, soft) if soft is not None else nan
    found.stiffer_difference = apart(theirs, sol.q, stiff) if stiff is not None else nan


def stands_for_a_tendon(loop) -> bool:
    """Whether a coupling holds the slide of a tendon with an inertia to the tendon's joints."""
    return isinstance(loop, Coupling) and loop.name == loop.joint


def without_contacts(mech) -> pc.Mechanism:
    """Without actuators and dry friction, which is a constraint in MuJoCo."""
    model = mech.model.copy()
    model.lowerDryFrictionLimit[:] = model.upperDryFrictionLimit[:] = 0.0
    return replace(mech, model=model, forces=tuple(each for each in mech.forces if not isinstance(each, Actuator)))


def apart(peer, ours, theirs) -> float:
    """The largest difference of configurations of MuJoCo's joints, in the tangent space: m or rad."""
    pairs = zip(ours, theirs, strict=True)
    return max(float(np.abs(pin.difference(peer.tree, one, two)[: peer.model.nv]).max()) for one, two in pairs)


class Peer:
    """MuJoCo's model of a file, which starts from our configurations."""

    def __init__(self, file, mech):
        import mujoco

        from pinconsist.formats.mjcf import Source

        self._mujoco, self.tree = mujoco, mech.model
        self.model, _ = Source(file, [file.parents[1], file.parent]).compiled()
        off = mujoco.mjtDisableBit
        self.model.opt.disableflags |= (
            off.mjDSBL_CONTACT | off.mjDSBL_LIMIT | off.mjDSBL_FRICTIONLOSS | off.mjDSBL_ACTUATION
        )
        self.model.opt.integrator = mujoco.mjtIntegrator.mjINT_RK4
        self.model.opt.solver, self.model.opt.iterations = mujoco.mjtSolver.mjSOL_NEWTON, 200
        self.model.opt.tolerance = 0.0
        self._solref = self.model.eq_solref.copy()

    def motion(self, q, times, step, stiffer=1.0, v=None, held=True):
        """Our configurations at the times, or None where it is unstable, and how far the equalities give way."""
        mujoco, model, data = self._mujoco, self.model, self._mujoco.MjData(self.model)
        model.opt.timestep = step
        model.eq_solref[:] = self._stiffened(stiffer)
        flag = int(mujoco.mjtDisableBit.mjDSBL_EQUALITY)
        model.opt.disableflags = model.opt.disableflags & ~flag if held else model.opt.disableflags | flag
        data.qpos[:] = self._theirs(q)
        data.qvel[:] = 0.0 if v is None else self._rates(q, v)
        found, largest, done = [np.array(q)], 0.0, 0
        for time in times[1:]:
            while done < round(time / step):
                mujoco.mj_step(model, data)
                done += 1
                rows = data.efc_type[: data.nefc] == 0
                largest = max(largest, float(np.abs(data.efc_pos[: data.nefc][rows]).max(initial=0.0)))
            if not np.isfinite(data.qpos).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                return None, nan
            found.append(self._ours(data.qpos, q))
        return np.array(found), largest

    def _stiffened(self, factor):
        """``solref`` for springs stiffer by a factor: shorter time constants, or larger numbers if they are direct."""
        root = np.sqrt(factor)
        direct = self._solref[:, :1] <= 0
        return self._solref * np.where(direct, [factor, root], [1.0 / root, 1.0])

    def _theirs(self, q):
        qpos = np.array(q[: self.model.nq])
        for start in self._quaternions():
            qpos[start : start + 4] = np.roll(qpos[start : start + 4], 1)
        return qpos

    def _rates(self, q, v):
        """MuJoCo's velocity: free joints translate in the axes of the world."""
        qvel = np.array(v[: self.model.nv])
        for kind, start, dof in zip(self.model.jnt_type, self.model.jnt_qposadr, self.model.jnt_dofadr, strict=True):
            if kind == FREE:
                turn = pin.Quaternion(np.array(q[start + 3 : start + 7])).toRotationMatrix()
                qvel[dof : dof + 3] = turn @ qvel[dof : dof + 3]
        return qvel

    def _ours(self, qpos, start):
        q = np.array(start)
        q[: self.model.nq] = qpos
        for first in self._quaternions():
            q[first : first + 4] = np.roll(q[first : first + 4], -1)
        return pin.normalize(self.tree, q)

    def _quaternions(self):
        for kind, start in zip(self.model.jnt_type, self.model.jnt_qposadr, strict=True):
            if kind in (BALL, FREE):
                yield int(start) + 3 * (kind == FREE)


# fmt: off
def command(
    sources: Annotated[list[str] | None, typer.Argument(metavar="[mujoco|FOLDER ...]", help=(
        "The files of MuJoCo's wheel, or all files in a folder. Default: the first."))] = None,
    until: Annotated[float, option("--until", "SECONDS", "Simulated time.")] = 0.1,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Compare the motion of MJCF files, as they are read here, with MuJoCo's own, without contacts.

    Example: python -m benchmarks mujoco models/ --csv mujoco.csv
    """
    output.require_writable(csv=csv)
    logging.getLogger("pinconsist").setLevel(logging.ERROR)
    rows = [asdict(row) for row in compare(sources or [*PACKAGES][-1:], until)]
    if report.in_files(csv, as_json, rows, files=rows):
        return output.FINE
    moved = [row for row in rows if not row["reason"]]
    columns = ["file", "nv>", "rows>", ("MuJoCo's error>", "{own_error:.0e}"), ("free>", "{free:.0e}"),
               ("held>", "{difference:.0e}"),
               ("gives way>", "{gives_way:.0e}"), ("100 times stiffer>", "{stiffer_difference:.0e}"),
               ("gives way>", "{stiffer_gives_way:.0e}"), ("speed>", "{speed:.2g}")]  # fmt: skip
    report.table(moved, columns, f"motion in {until:g} s: largest differences, m or rad")
    others = [row for row in rows if row["reason"]]
    report.table(others, ["file", ("reason", lambda row: row["reason"][:SHOWN])], "not compared")
    return output.FINE
