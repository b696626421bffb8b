"""What happens between the rows of long steps: limits, unilateral constraints and work are judged there, too."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

TURN = 2.0 * np.pi  # rad/s
METHODS = pytest.mark.parametrize("method", ["Radau", "BDF"])


def slider(joint, gravity=9.81):
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -gravity])
    index = model.addJoint(0, joint, pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    return model


@METHODS
@pytest.mark.parametrize(("share", "leaves"), [(0.9, False), (1.02, True), (1.2, True)])
def test_a_table_that_would_have_to_pull_between_two_rows(method, share, leaves):
    """A body on a shaken table leaves it where the table falls faster than the body would: a ω² > g."""
    amplitude = share * 9.81 / TURN**2
    table = pc.Constraint("table", lambda t, q: np.array([q[0] - amplitude * np.sin(TURN * t)]), 1, unilateral=True)
    mech = pc.Mechanism(slider(pin.JointModelPZ()), [table])
    sol = pc.simulate(mech, (0.0, 0.95), v0={"slide": amplitude * TURN}, method=method, rtol=1e-4)
    certificate = sol.check()
    assert ("table" in certificate.pulling) == leaves == ("look at unilateral" in certificate.verdict)
    if leaves:
        first = np.arcsin(1.0 / share) / TURN  # where λ = g - a ω² sin(ω t) becomes 0
        assert first < certificate.pulling["table"] < first + 0.05
    if method == "Radau" and share == 1.02:
        assert sol.lam.min() > 0.0  # nothing in the rows tells


@METHODS
def test_a_limit_that_is_passed_between_two_rows(method):
    model = slider(pin.JointModelPX(), gravity=0.0)
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = -0.98, 0.98
    mech = pc.Mechanism(model, [], [pc.JointSpring("slide", TURN**2)])
    (beyond,) = pc.simulate(mech, (0.0, 1.0), v0={"slide": TURN}, method=method, rtol=1e-3).check().beyond_limits
    assert beyond.joint == "slide" and abs(beyond.value) == pytest.approx(1.0, abs=5e-3)


@METHODS
@pytest.mark.parametrize("dense", [False, True])
def test_the_work_of_a_drive_is_the_change_of_energy(method, dense):
    """½ m v², by the motion itself; by rows alone the work along steps of Radau was wrong by a part of it."""
    motion = pc.Motion(start=0.1, speed=0.3, amplitude=0.2, frequency=3.0)
    mech = pc.Mechanism(slider(pin.JointModelPX()), [pc.Drive("motor", "slide", motion)])
    sol = pc.simulate(mech, (0.0, 1.37), method=method, rtol=1e-7, dense_output=dense)
    speed = 0.3 + 0.2 * 3.0 * TURN * np.cos(3.0 * TURN * sol.t)
    energy, exact = sol.energy(), 0.5 * (speed**2 - speed[0] ** 2)
    np.testing.assert_allclose(energy.work["motor"], exact, atol=1e-5 * np.abs(exact).max())
    assert energy.balance_error < 1e-5 and energy.work_error < 1e-2


@METHODS
def test_work_in_a_linkage_closes_the_balance(method):
    mech = pc.load("crank_rocker").add_forces(pc.JointDamping({"crank": 0.3}), pc.JointSpring("rocker", 5.0))
    sol = pc.simulate(mech, (0.0, 2.0), v0={"crank": 12.0}, method=method, rtol=1e-8, atol=1e-10)
    assert sol.energy().balance_error < 1e-7
    backwards = pc.integrate(mech, (2.0, 0.0), sol.q[-1], sol.v[-1], method=method, rtol=1e-8, atol=1e-10)
    there, back = sol.energy(), backwards.energy()
    assert back.balance_error < 1e-6
    label = next(iter(there.work))
    assert back.work[label][-1] == pytest.approx(-there.work[label][-1], rel=1e-5)


def test_a_verdict_that_judged_nothing_of_the_motion_is_not_ok():
    """As of a crank at 5,900 rad/s, whose few rows say nothing of its energy, without a finer run."""
    found = pc.simulate(pc.load("four_bar"), (0.0, 0.1)).check()
    assert found.verdict.endswith(": ok") and found.not_judged == []
    unknown = replace(found, energy_error=0.05, work_error=1.0, error=None)
    assert unknown.not_judged == ["error", "energy"]
    assert unknown.verdict.endswith(": not judged: error, energy")
    loose = replace(unknown, force=0.1)
    assert loose.verdict.endswith(": look at forces; not judged: error, energy")
