"""A user's script over the public names: mypy --strict reads it, and it runs on the installed wheel, without checkout.

``.ci/run`` does both. ``assert_type`` fails where a public name or attribute has no type, or another one.
"""

from __future__ import annotations

import importlib
import pkgutil
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from typing_extensions import assert_type

import pinconsist as pc


def scenes() -> pc.Mechanism:
    for name in pc.models():
        if "<n>" not in name:
            assert_type(pc.load(name), pc.Mechanism)
    mech = pc.load("four_bar").add_forces({"crank": 0.1}, pc.JointDamping({"crank": 0.01}))
    assert_type(mech.nv, int)
    assert_type(mech.row_labels, list[tuple[str, str]])
    again = pc.Mechanism(mech.model, [*mech.loops], [pc.JointSpring("crank", 0.1)], guess={"crank": -1.0}, name="again")
    loops = (
        pc.Loop("pin", "hinge", "coupler_tip", "rocker_tip", axis=(0.0, 1.0, 0.0)),
        pc.Drive("motor", "crank", pc.Motion(speed=1.0)),
        pc.Coupling("gear", "rocker", "crank", ratio=-2.0),
        pc.Constraint("own", lambda t, q: q[:1], 1, rows=("first",)),
    )
    assert_type(again.with_loops(loops[0]), pc.Mechanism)
    assert_type(again.with_loops().add_loops(loops[0]).with_forces(), pc.Mechanism)
    for edited in (mech.lock(["crank"]), mech.reduced(), mech.reanchored(), mech.with_gravity((0.0, 0.0, -1.6))):
        assert_type(edited, pc.Mechanism)
    assert_type(pc.assemble(mech, {"crank": 0.3}).largest_gap, tuple[str, float])
    forces = [
        pc.JointFriction({"crank": 0.01}),
        pc.JointTorque({"crank": 1.0}),
        pc.Servo("crank", 0.5, 1.0),
        pc.SpringDamper("coupler_tip", stiffness=1.0, length=0.1),
        pc.Torque(lambda t, q, v: -0.1 * v),
        pc.Wrench("coupler_tip", force=(1.0, 0.0, 0.0)),
    ]
    return mech.add_forces(*forces)


def runs(mech: pc.Mechanism, folder: Path) -> pc.Solution:
    event = pc.Event(lambda t, q, v, lam: q[0] - 9.0, terminal=True)
    sol = pc.simulate(mech, (0.0, 0.2), v0={"crank": 1.0}, events=event, dense_output=True)
    assert_type(sol, pc.Solution)
    assert_type(sol.lam, np.ndarray)
    assert_type(sol.success, bool)
    assert sol.success and sol.sol is not None
    assert np.allclose(sol.sol(0.2)[0], sol.q[-1])
    assert_type(sol.check(error=False), pc.Certificate)
    assert_type(sol.check(error=False).concerns, list[str])
    assert_type(sol.energy().total, np.ndarray)
    assert_type(sol.reaction("coupler_rocker"), pc.Reaction | pc.JointForce)
    assert_type(sol.save(folder / "saved.npz"), Path)
    assert (pc.Solution.load(folder / "saved.npz").q == sol.q).all()

    kept = pc.record("four_bar", (0.0, 0.2), folder / "run.npz")
    assert_type(kept, pc.Solution)
    again = pc.rerun(folder / "run.npz")
    assert_type(again.same, bool)
    assert_type(again.solution, pc.Solution)
    assert again.same
    assert_type(pc.resume(folder / "run.npz"), pc.Solution)

    problem = pc.paper.reference_problem("problem52")
    assert_type(problem.system, pc.Mechanism | pc.HessenbergProblem)
    assert_type(pc.integrate(problem.system, (1.0, 1.1), problem.p0, problem.v0), pc.Solution)
    assert_type(pc.paper.consistent_initial_velocity(problem.system, 1.0, problem.p0, problem.v0, 1e-3), np.ndarray)
    assert_type(pc.paper.reference_solution(mech, 0.0, sol.q[0], sol.v[0], [0.1]).lam, np.ndarray)
    print(pc.paper.compare("problem51", [0.01], count=2))
    outcomes = pc.sweep(lambda case: case + 1, [1, 2])
    assert_type(outcomes, list[pc.Outcome])
    assert [outcome.value for outcome in outcomes] == [2, 3]
    return sol


def statics(mech: pc.Mechanism) -> None:
    rest = pc.equilibrium(pc.load("four_bar"))
    assert_type(rest, pc.Equilibrium)
    assert_type(rest.q, np.ndarray)
    linear = pc.linearize(pc.load("four_bar"), rest.q)
    assert_type(linear, pc.Linearization)
    assert_type(linear.modes(), pc.Modes)
    driven = pc.load("four_bar").with_loops(
        *pc.load("four_bar").loops, pc.Drive("motor", "crank", pc.Motion(speed=1.0))
    )
    found = pc.inverse_dynamics(driven, np.linspace(0.0, 0.1, 3))
    assert_type(found, pc.InverseDynamics)
    assert_type(found.torques, dict[str, np.ndarray])


def files(mech: pc.Mechanism, sol: pc.Solution, folder: Path) -> None:
    assert_type(pc.write(pc.load("four_bar"), folder / "scene.urdf"), Path)
    assert_type(pc.export_html(mech, {"one": sol, "two": sol}, folder / "two.html", forces=True), Path)
    try:
        sol.plot("multipliers", file=folder / "lam.png")
    except pc.MissingExtraError as error:
        assert "pinconsist[plot]" in str(error)
    try:
        pc.load("cassie")
    except pc.MissingExtraError as error:
        assert "pinconsist[robots]" in str(error)
    try:
        pc.load("four_bra")
    except pc.InputError as error:
        assert isinstance(error, pc.PinconsistError) and "four_bar" in str(error)
    else:
        raise SystemExit("no error for an unknown scene")


def everything_is_imported() -> None:
    for module in pkgutil.walk_packages(pc.__path__, "pinconsist."):
        if not module.name.endswith("__main__"):
            importlib.import_module(module.name)
    for name in pc.__all__:
        getattr(pc, name)


if __name__ == "__main__":
    everything_is_imported()
    with TemporaryDirectory() as place:
        scene = scenes()
        files(scene, runs(scene, Path(place)), Path(place))
    statics(scene)
    print(f"pinconsist {pc.__version__} of {Path(pc.__file__).parent} works")
