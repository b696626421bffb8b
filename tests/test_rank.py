"""Kept rows do not depend on the size of a mechanism, and a loop that opens is never a success."""

from concurrent.futures import ThreadPoolExecutor
from functools import cache
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers.scenes import on_stage

import pinconsist as pc
from pinconsist.mechanism import rank
from pinconsist.mechanism.closing import LoopSolver
from pinconsist.mechanism.rank import independent_rows, row_scales
from pinconsist.mechanism.rows import LoopRows
from pinconsist.mechanism.system import MechanismSystem


@pytest.mark.parametrize("size", [1e-6, 1.0, 1e3])
def test_the_choice_of_rows_is_the_same_at_every_size(size):
    rng = np.random.default_rng(3)
    J = rng.standard_normal((5, 3))
    turns = np.array([False, False, False, True, True])
    scaled = np.where(turns[:, None], J, size * J)
    np.testing.assert_array_equal(independent_rows(scaled, turns), independent_rows(J, turns))


def test_rounding_is_not_scaled_up():
    J = np.diag([2.0, 1e-16, 3.0])
    assert independent_rows(J, np.array([False, False, False])).tolist() == [0, 2]
    assert independent_rows(np.diag([1e-16, 1.0, 0.5]), np.array([False, True, True])).tolist() == [1, 2]
    np.testing.assert_array_equal(row_scales(np.zeros((2, 2)), np.array([False, True])), [1.0, 1.0])


def test_rows_that_are_all_rounding_are_dependent():
    noise = 1e-16 * np.random.default_rng(2).standard_normal((10, 1))
    assert not len(independent_rows(noise, np.tile([False, False, False, True, True], 2)))


@pytest.mark.parametrize("away", [0.0, 5e3])
@pytest.mark.parametrize("tilt", [0.2, 0.7, 1.1])
def test_a_tilted_door_on_three_hinges_swings_as_on_one(tilt, away):
    axes, top = pin.rpy.rpyToMatrix(tilt, 0.0, 0.0), np.array([away, 0.1, 2.1])
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3(axes, top), "upper")
    model.appendBodyToJoint(joint, pin.Inertia(23.0, np.array([0.45, 0.02, -1.0]), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("leaf", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    at = {"middle": -0.9, "lower": -1.7}
    hinges = [
        pc.Loop(name, "hinge", "universe", "leaf", axes[:, 2] * z + top, (tilt, 0.0, 0.0), (0, 0, z), axis=(0, 0, 1))
        for name, z in at.items()
    ]
    alone = pc.simulate(pc.Mechanism(model), (0.0, 1.5), {"upper": 0.4})
    assert abs(alone.q[-1, 0] - 0.4) > 0.5
    sol = pc.simulate(pc.Mechanism(model, hinges), (0.0, 1.5), {"upper": 0.4})
    np.testing.assert_allclose(sol.q[-1], alone.q[-1], atol=1e-9)
    assert set(sol.check(error=False).not_unique) == {"upper", *at}
    assert "force z" in sol.reaction("lower").not_unique


def test_an_opened_loop_is_seen_beside_a_drive(monkeypatch):
    """A parallelogram started in line (and the check of the start switched off), with an unrelated driven joint."""
    plain = pc.load("n_four_bar_1")
    model = plain.model.copy()
    model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "fan")
    mech = pc.Mechanism(model, [*plain.loops, pc.Drive("fan", "fan", lambda t: 0.01 * t)])
    monkeypatch.setattr("pinconsist.mechanism.system.RANK_DISTANCE", 0.0)
    sol = pc.simulate(mech, (0.0, 1.0), np.array([np.pi / 2, -np.pi / 2, np.pi / 2, 0.0]))
    assert not sol.success and "are open by" in sol.message and "'B1'" in sol.message


def test_a_reference_whose_loops_open_is_none(monkeypatch):
    monkeypatch.setattr("pinconsist.mechanism.system.RANK_DISTANCE", 0.0)
    in_line = np.array([np.pi / 2, -np.pi / 2, np.pi / 2])
    with pytest.raises(pc.PinconsistError, match="no reference: the loops are open"):
        pc.paper.reference_solution(pc.load("n_four_bar_1"), 0.0, in_line, np.zeros(3), [0.5, 1.0], rtol=1e-8)


def bennett(size):
    """Bennett's 4R linkage closed by a hinge: five rows of rank two."""
    twist, ratio = 0.7, 0.6
    other = np.arcsin(ratio * np.sin(twist))
    links = [
        pin.SE3(pin.rpy.rpyToMatrix(angle, 0, 0), np.array([length * size, 0, 0]))
        for length, angle in ((ratio, other), (1.0, twist), (ratio, other), (1.0, twist))
    ]
    model, last = pin.Model(), 0
    for i in range(3):
        last = model.addJoint(last, pin.JointModelRZ(), links[i], f"j{i}")
        inertia = np.diag([0.1, 0.2, 0.3]) * size**2
        model.appendBodyToJoint(last, pin.Inertia(1.0, np.array([0.3, 0.1, 0.05]) * size, inertia), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", last, 0, links[3], pin.FrameType.OP_FRAME))
    loop = pc.Loop("loop", "hinge", "universe", "tip", axis=(0, 0, 1))
    return pc.Mechanism(model, [loop], guess=[1.0, 3.45541751, -1.0])


@cache
def turned():
    """Where the linkage of 1 m has turned to."""
    return pc.simulate(bennett(1.0), (0.0, 4.0), v0={"j0": 6.0}, rtol=1e-9, atol=1e-9, method="BDF").q[-1]


@pytest.mark.parametrize("size", [1.0, 1e-2, 1e-6])
def test_a_turning_bennett_linkage_is_the_same_at_every_size(size):
    """Time goes with the root of the size; the kept rows change on the way, and the loop stays closed."""
    unit = np.sqrt(size)
    sol = pc.simulate(
        bennett(size), (0.0, 4 * unit), v0={"j0": 6.0 / unit}, rtol=1e-8, atol=(1e-8, 1e-8 / unit), method="BDF"
    )
    assert sol.success
    assert sol.check(error=False).position < 1e-9  # tilts of micrometre links are known to eps over their size
    np.testing.assert_allclose(sol.q[-1], turned(), atol=2e-5)


def test_rows_are_chosen_again_on_the_way_and_nothing_jumps():
    """Bricard's mechanism over a full swing: P3 at t = 10 s is the benchmark's, whichever rows were kept."""
    mech = pc.load("bricard")
    begin, poor = pc.assemble(mech), np.array([0, 2, 3, 4])  # as good as others at the start alone
    like = SimpleNamespace(kept=poor, scales=MechanismSystem(mech, begin.q).scales, dropped_are_zero=False)
    system = MechanismSystem(mech, begin.q, like=like)
    sol = pc.integrate(system, (0.0, 10.0), begin.q, begin.v, rtol=1e-8, atol=1e-8, dense_output=True)
    assert (sol.system.kept != poor).any()
    p3 = on_stage(mech.model, sol.q[-1], "P3").translation
    np.testing.assert_allclose(p3, (0.9999999638063, -1.0002690126962, 0.9997309511199), atol=1e-5)
    found = sol.check(error=False)
    assert found.force < 1e-5 and found.energy_error < 1e-5 and found.position < 1e-12
    for i in range(10, len(sol.t), 25):  # multipliers of all rows do not know which were kept
        q, _, lam = sol.sol(sol.t[i])
        np.testing.assert_allclose(q, sol.q[i], atol=1e-12)
        np.testing.assert_allclose(lam, sol.lam[i], atol=1e-7 * np.abs(sol.lam).max())


def test_several_threads_evaluate_the_rows_of_one_mechanism():
    mech, rng = pc.load("four_bar"), np.random.default_rng(0)
    mech = mech.add_loops(pc.Constraint("own", lambda t, q: np.array([np.sin(q).sum()]), 1))
    places = rng.uniform(-1.0, 1.0, (40, mech.nq))
    alone = [LoopRows.of(mech).at(q) for q in places]

    def all_of_them(_):
        rows = LoopRows.of(mech)
        return [rows.at(q) for q in places]

    with ThreadPoolExecutor(4) as pool:
        for found in pool.map(all_of_them, range(8)):
            for (phi, J), (own_phi, own_J) in zip(found, alone, strict=True):
                assert np.array_equal(phi, own_phi) and np.array_equal(J, own_J)


def test_a_start_is_closed_and_ranked_once(monkeypatch):
    """A second run from one place finds the loops closed there; another place, another time, another guess do not."""
    closed, ranked, evaluated = [], [], []
    evaluate = LoopRows._at
    monkeypatch.setattr(LoopRows, "_at", lambda rows, *args: evaluated.append(args) or evaluate(rows, *args))
    solved, look = LoopSolver._closed, rank.Ranking.__init__
    monkeypatch.setattr(LoopSolver, "_closed", lambda solver, *args: closed.append(args) or solved(solver, *args))
    monkeypatch.setattr(rank.Ranking, "__init__", lambda self, J, turns: ranked.append(J) or look(self, J, turns))
    mech = pc.load("four_bar").add_forces()
    mech = mech.with_loops(*mech.loops)  # nothing is known of it
    nearby = mech.guess + 0.05
    first, before = pc.simulate(mech, (0.0, 0.1), nearby), len(evaluated)
    again = pc.simulate(mech, (0.0, 0.1), nearby)
    assert len(closed) == len(ranked) == 1 and len(evaluated) <= before + 1
    np.testing.assert_array_equal(again.q, first.q)
    turned = pc.assemble(mech, {"crank": 1.0})
    assert turned.q[0] == pytest.approx(1.0)
    pc.assemble(mech, nearby + 0.05)
    assert len(closed) > 1
    driven = mech.add_loops(pc.Drive("motor", "crank", lambda t: 0.3 + t))
    for t in (0.0, 0.5):
        assert pc.assemble(driven, t=t).q[0] == pytest.approx(0.3 + t, abs=1e-12)


@pytest.mark.parametrize("kind", ["constraint", "drive"])
def test_loops_that_have_changed_are_closed_anew(kind):
    """A function of the user's may depend on something that changes between two runs."""
    length = [1.0]
    mech = pc.load("double_pendulum")
    if kind == "drive":
        mech = mech.with_loops(pc.Drive("held", mech.joints[0], lambda t: length[0]))
    else:
        mech = mech.with_loops(pc.Constraint("held", lambda t, q: np.array([q[0] - length[0]]), 1))
    for length[0] in (1.0, 0.5):
        assert pc.assemble(mech).q[0] == pytest.approx(length[0], abs=1e-12)


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_a_run_makes_no_workspace_of_pinocchio(monkeypatch, method):
    """Those of large models take seconds, and memory O(nv³)."""
    made, make = [], pin.Model.createData
    monkeypatch.setattr(pin.Model, "createData", lambda model: made.append(model) or make(model))
    mech = pc.load("crank_rocker")
    pc.simulate(mech, (0.0, 0.1), {"crank": 0.3}, {"crank": 2.0}, method=method)
    assert not made


def test_redundant_rows_that_all_move():
    """There is no steady row to share the multipliers of: the process died."""
    pendulum = pc.load("double_pendulum")
    start = pc.assemble(pendulum).q.sum()
    rows = [
        pc.Constraint(name, lambda t, q, k=k: np.array([k * (q[0] + q[1] - start - 0.05 * np.sin(3.0 * t))]), 1)
        for name, k in (("once", 1.0), ("twice", 2.0))
    ]
    sol = pc.simulate(pendulum.with_loops(*rows), (0.0, 0.1))
    alone = pc.simulate(pendulum.with_loops(rows[1]), (0.0, 0.1))
    assert sol.success and (sol.lam == 0.0).any(axis=0).tolist() == [True, False]
    np.testing.assert_allclose(sol.lam[-1, 1], alone.lam[-1, 0], rtol=1e-5)


def test_a_constraint_of_ones_own_that_repeats_a_loop_is_evaluated_while_its_rows_are_left_out():
    """A run without functions of Python among the rows that it keeps, but among those whose choice it watches."""
    mech = pc.load("four_bar")
    rows = LoopRows.of(mech)

    def again(t, q):
        return rows.at(np.array(q), t)[0]

    doubled = pc.simulate(mech.add_loops(pc.Constraint("again", again, 5)), (0.0, 0.5))
    assert doubled.success
    np.testing.assert_allclose(doubled.q[-1], pc.simulate(mech, (0.0, 0.5)).q[-1], atol=1e-6)
