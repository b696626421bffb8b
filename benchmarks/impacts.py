"""Many impacts in one run, without drift: ``python -m benchmarks impacts``.

A ball on a floor, a rod and a four-bar between stops: whether loops stay closed to rounding, and energy to the
tolerance, which includes what impacts lose and a motor gives.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import Annotated

import pinocchio as pin
import typer

import pinconsist as pc
from pinconsist.cli import output

from . import report
from .linkages import add_body, at, four_bar

TOLERANCES = 1e-3, 1e-6, 1e-9
REACH = 0.5  # rad on each side


@dataclass(frozen=True)
class Row:
    """A run: its impacts, by how much a loop is open or a contact too deep, its energy balance, its time."""

    scene: str
    rtol: float
    impacts: int
    steps: int
    closed: float  # m or rad
    balance: float  # relative to the energies exchanged
    per_impact: float  # s of processor time
    status: str


def ball():
    """A mass on a rail above a stop; nothing is lost."""
    model = pin.Model()
    add_body(model, 0, pin.JointModelPZ(), at(0, 0), "z", 1.0, (0, 0, 0), 0.1)
    return pc.Mechanism(model, contacts=[pc.Stop("z", lower=0.0, restitution=1.0)]), {"z": 1.0}, None, 1.0


def rod():
    """A rod between stops; nothing is lost."""
    model = pin.Model()
    add_body(model, 0, pin.JointModelRY(), at(0, 0), "hinge", 2.0, (0, 0, -0.5), 0.1)
    stops = pc.Stop("hinge", -REACH, REACH, restitution=1.0)
    return pc.Mechanism(model, contacts=[stops]), None, {"hinge": 3.0}, 0.5


def linkage(restitution, *forces):
    mech = four_bar()
    crank = float(pc.assemble(mech).q[0])
    stops = pc.Stop("crank", crank - REACH, crank + REACH, restitution=restitution)
    mech = mech.with_contacts(stops).add_forces(pc.JointSpring("crank", 20.0, crank), *forces)
    return mech, None, {"crank": 10.0}, 0.1 if restitution == 1.0 else 0.2


def sprung():
    """A four-bar with a spring, between stops; nothing is lost."""
    return linkage(1.0)


def shaken():
    """The same with impacts that lose, and a torque that changes."""
    return linkage(0.8, {"crank": pc.Motion(amplitude=200.0, frequency=1.5)})  # N·m, Hz


SCENES = {"ball": ball, "rod": rod, "four-bar, spring": sprung, "four-bar, motor": shaken}


def measured(scene, rtol, count) -> Row:
    """A run of about so many impacts."""
    mech, q0, v0, period = SCENES[scene]()
    until = period * count
    begun = time.process_time()
    sol = pc.simulate(mech, (0.0, until), q0, v0, rtol=rtol, atol=1e-2 * rtol)
    seconds = time.process_time() - begun
    gaps, energy, hits = sol.check(error=False), sol.energy(), len(sol.impacts)
    status = "ok" if sol.success else sol.message
    per_impact = seconds / max(hits, 1)
    return Row(scene, rtol, hits, sol.nsteps, gaps.position, energy.balance_error, per_impact, status)


# fmt: off
def command(
    count: Annotated[int, typer.Option(min=1, help="About how many impacts each run has.")] = 10_000,
    csv: report.Csv = None, as_json: output.Json = False,
) -> int:
    # fmt: on
    """Run a ball, a rod and four-bars through thousands of impacts: loops, energy, time.

    Example: python -m benchmarks impacts --count 1000
    """
    output.require_writable(csv=csv)
    rows = [asdict(measured(scene, rtol, count)) for scene in SCENES for rtol in TOLERANCES]
    if report.in_files(csv, as_json, rows, impacts=rows):
        return output.FINE
    columns = ["scene", ("rtol>", "{rtol:.0e}"), "impacts>", "steps>", ("closed to>", "{closed:.0e}")]
    columns += [("energy balance>", "{balance:.1e}"), ("µs per impact>", report.scaled("per_impact", 1e6, 0)), "status"]
    report.table(rows, columns, "Thousands of impacts in one run")
    return output.FINE
