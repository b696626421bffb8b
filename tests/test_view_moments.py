"""Moments of loops, and torques of drives and motors, on the page: as arrows that turn about their axis."""

import re
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers.browser import needs_browser, opened
from helpers.pictures import arrow, drawn, shown, stated, track

import pinconsist as pc
from pinconsist.mechanism.loops import Loop
from pinconsist.view.arrows import FORCE, Action, round_amount, scale_of
from pinconsist.view.arrows import arrow as arrow_of

WEIGHT, ARM = 3.0, 0.3  # kg, m


def moment(page, path):
    """Centre and vector of a turning arrow at every frame, (n, 3) each: the vector in metres of radius."""
    turns = [pin.Quaternion(row).matrix()[:, 2] for row in track(page, f"{path}/turn", ".quaternion")]
    scale = track(page, f"{path}/turn", ".scale")
    np.testing.assert_array_equal(scale, scale[:, :1].repeat(3, axis=1))
    return track(page, f"{path}/turn", ".position"), turns * scale[:, :1]


@pytest.mark.parametrize("first", [True, False])
def test_a_weight_on_a_bracket_needs_force_and_moment(first):
    """The weight pulls down ARM to the right of the wall's bracket, so that the wall turns it back, about -y."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "weight")
    model.appendBodyToJoint(joint, pin.Inertia(WEIGHT, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    end = pin.SE3(np.eye(3), np.array([-ARM, 0.0, 0.0]))
    model.addFrame(pin.Frame("end", joint, 0, end, pin.FrameType.OP_FRAME))
    ends = ("end", "universe") if first else ("universe", "end")
    mech = pc.Mechanism(model, (Loop("wall", "frame", *ends),), name="bracket")
    page = shown(mech, pc.simulate(mech, (0.0, 0.1)), forces=True)
    _, force = arrow(page, "/forces/wall")
    centre, turn = moment(page, "/forces/wall moment")
    np.testing.assert_allclose(force * stated(page), [[0, 0, WEIGHT * 9.81]] * 6, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(turn * stated(page, "N·m"), [[0, -WEIGHT * 9.81 * ARM, 0]] * 6, rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(centre, np.zeros((6, 3)), atol=1e-6)
    assert [each["text"] for each in page["legend"][1:]] == ["force on the weight", "moment on the weight"]


def test_a_ring_starts_on_its_x_axis_and_its_head_points_right_handed():
    mech = pc.load("jansen_leg")
    (ring, head) = drawn(shown(mech, pc.simulate(mech, (0.0, 0.1)), forces=True), "/forces/motor crank/turn")
    (torus,), (cone,) = (each["object"]["geometries"] for each in (ring, head))
    assert (torus["type"], torus["radius"]) == ("TorusGeometry", 1.0)
    end = np.array([np.cos(torus["arc"]), np.sin(torus["arc"]), 0.0])
    matrix = np.reshape(head["object"]["object"]["matrix"], (4, 4)).T
    assert cone["radiusTop"] == 0.0  # the tip of a cone of three.js is at +y
    np.testing.assert_allclose(matrix[:3, 1], np.cross([0, 0, 1], end), atol=1e-12)
    np.testing.assert_allclose(matrix[:3, 3] - cone["height"] / 2 * matrix[:3, 1], end, atol=1e-12)


def test_the_torque_of_a_drive_turns_about_its_joint():
    mech = pc.load("jansen_leg")
    sol = pc.simulate(mech, (0.0, 1.0), method="BDF", step=0.02)
    page = shown(mech, sol, forces=True)
    centre, turn = moment(page, "/forces/motor crank")
    torque = sol.reaction("motor").torque[:, None]
    np.testing.assert_allclose(turn * stated(page, "N·m"), torque * [[0, 1, 0]], rtol=5e-3, atol=1e-3)
    np.testing.assert_allclose(centre, centre[:1].repeat(len(centre), axis=0))  # the crank's pivot stands still
    assert (torque > 0).any() and (torque < 0).any()
    loops = {each["path"].split("/")[2] for each in drawn(page, "/forces/")}
    assert loops == {"Q", "S", "T", "motor crank"}  # the hinges of a planar linkage have no moments


def test_a_drive_of_a_slider_pushes():
    mech = pc.load("slider_crank")
    mech = mech.add_loops(pc.Drive("press", "piston", lambda t: 1.0 + 0.02 * np.sin(5 * t)))
    sol = pc.simulate(mech, (0.0, 0.5), q0={"piston": 1.0}, step=0.02)
    _, push = arrow(page := shown(mech, sol, forces=True), "/forces/press piston")
    factor, force = stated(page), sol.reaction("press").torque
    assert page["legend"][1]["text"] == "force on the piston_block; drive force in joint piston"
    np.testing.assert_allclose(
        push[:-1] * factor, force[:-1, None] * [[1, 0, 0]], rtol=5e-3, atol=1e-2 * abs(force).max()
    )


def test_motors_together_are_one_torque_on_each_joint():
    mech = pc.load("double_pendulum")
    first, second = mech.joints
    servo = pc.Servo(second, target=0.5, stiffness=8.0, damping=0.2)
    mech = mech.add_forces({first: 2.0, second: 1.0}, servo, pc.JointDamping({first: 5.0}))
    sol = pc.simulate(mech, (0.0, 0.4), step=0.02)
    page = shown(mech, sol, forces=True)
    factor = stated(page, "N·m")
    axis = moment(page, f"/forces/motor {first}")[1][0] * factor / 2.0
    np.testing.assert_allclose(np.abs(axis), [0, 1, 0], atol=1e-4)
    turn = moment(page, f"/forces/motor {second}")[1] * factor
    q, v = sol.q[:, 1], sol.v[:, 1]
    torque = 1.0 + 8.0 * (0.5 - q) - 0.2 * v
    np.testing.assert_allclose(turn, torque[:, None] * axis, rtol=5e-3, atol=1e-3)
    with pytest.raises(pc.InputError, match="no v"):
        shown(mech, SimpleNamespace(t=sol.t, q=sol.q, lam=sol.lam), forces=True)
    with pytest.raises(pc.InputError, match=re.escape("needs v of shape (21, 2), got (21, 1)")):
        shown(mech, SimpleNamespace(t=sol.t, q=sol.q, lam=sol.lam, v=sol.v[:, :1]), forces=True)


def force_of(sizes):
    return Action("a", "a", FORCE, np.zeros((len(sizes), 3)), np.outer(sizes, [0.6, 0.0, 0.8]), ("rocker",))


def test_only_a_peak_that_stands_out_is_cut():
    """What there is for more than a twentieth of the time, or three times what there mostly is, is no outlier."""
    scale = lambda *peak: scale_of(FORCE, [force_of(np.append(np.full(200, 100.0), peak))], 0.5)  # noqa: E731
    for peak, most in ((290.0, 290.0), (2000.0, 100.0)):
        assert scale(peak).metres * most == pytest.approx(0.5)
        assert scale(peak).most == pytest.approx(most) and scale(peak).cuts == (peak > most)
    assert not scale(*[2000.0] * 12).cuts
    around = arrow_of("/forces/a", force_of(np.array([50.0, 2000.0])), scale(2000.0))[1]
    np.testing.assert_allclose(np.linalg.norm(around[:, 0], axis=1), [0.25, 0.5], rtol=1e-6)


@pytest.mark.parametrize(("amount", "rounded"), [(7.3, 5.0), (1.0, 1.0), (0.0499, 0.02), (999.0, 500.0)])
def test_the_bar_of_the_legend_is_a_round_amount(amount, rounded):
    assert round_amount(amount) == pytest.approx(rounded)


@needs_browser
def test_a_torque_turns_in_a_browser(tmp_path):
    mech = pc.load("jansen_leg")
    sol = pc.simulate(mech, (0.0, 1.0), method="BDF", step=0.02)
    with opened(pc.export_html(mech, sol, tmp_path / "leg.html", forces=True)) as tab:
        tab.run("running = false; seek(0.5); var turn = object('/forces/motor crank/turn')")
        matrix = np.reshape(tab.run("turn.updateWorldMatrix(true, false); turn.matrixWorld.toArray()"), (4, 4)).T
        shapes = tab.run("turn.children.map(child => (child.isMesh ? child : child.children[0]).geometry.type)")
    assert shapes == ["TorusGeometry", "CylinderGeometry"]
    turn = moment(shown(mech, sol, forces=True), "/forces/motor crank")[1][25]
    matrix[:3] = matrix[[0, 2, 1]] * [[1], [-1], [1]]  # from axes with y up
    np.testing.assert_allclose(matrix[:3, 2], turn, atol=1e-4)
