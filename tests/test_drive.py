"""Driven joints: constraints that move, and the motor torque as their multiplier."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from helpers.zoo import SliderCrank

import pinconsist as pc

OMEGA = 10.0


def driven(rate=None, acceleration=None):
    mech = pc.load("slider_crank")
    return mech.add_loops(pc.Drive("motor", "crank", lambda t: -1.0 + OMEGA * t, rate, acceleration))


@cache
def slider_crank():
    return SliderCrank([pc.load("slider_crank").model.inertias[i].mass for i in (1, 2, 3)])


def inverse_dynamics(q, rate, angular):
    """Crank torque of the slider-crank by hand: virtual power with one degree of freedom."""
    linkage = slider_crank()
    x = linkage.T @ q
    C = linkage.jacobian(x)
    k = np.concatenate(([1.0], -np.linalg.solve(C[:, 1:], C[:, 0])))
    xd = k * rate
    kd = np.concatenate(([0.0], -np.linalg.solve(C[:, 1:], linkage.jacobian_rate(x, xd) @ k)))
    return k @ (linkage.mass(x) @ (k * angular + kd * rate) + linkage.bias(x, xd))


@pytest.mark.parametrize("derivatives", [True, False])
def test_motor_torque_of_a_driven_crank(derivatives):
    mech = driven(lambda t: OMEGA, lambda t: 0.0) if derivatives else driven()
    sol = pc.simulate(mech, (0.0, 1.0), rtol=1e-9, atol=1e-9)
    assert sol.success
    np.testing.assert_allclose(sol.q[:, 0], -1.0 + OMEGA * sol.t, atol=1e-12)
    np.testing.assert_allclose(sol.v[:, 0], OMEGA, atol=1e-8)
    by_hand = [inverse_dynamics(q, OMEGA, 0.0) for q in sol.q]
    np.testing.assert_allclose(sol.lam[:, -1], by_hand, atol=1e-5 * np.abs(by_hand).max())  # every step, the first too


def test_fixed_step_orders_of_the_motor_torque():
    """An accelerating drive, BDF-3: the multiplier converges with order 3 from the first step on."""
    mech = pc.load("slider_crank")
    curve = pc.Drive("motor", "crank", lambda t: -1.0 + 3 * t**2, lambda t: 6 * t, lambda t: 6.0)
    mech = mech.add_loops(curve)
    errors = []
    for h in (1 / 200, 1 / 400):
        sol = pc.simulate(mech, (0.0, 1.0), step=h, order=3, method="BDF")
        by_hand = np.array([inverse_dynamics(q, 6 * t, 6.0) for t, q in zip(sol.t, sol.q, strict=True)])
        errors.append(np.abs(sol.lam[:, -1] - by_hand).max())
    assert np.log2(errors[0] / errors[1]) == pytest.approx(3.0, abs=0.3)


def test_energy_counts_what_the_motor_puts_in():
    sol = pc.simulate(driven(), (0.0, 1.0), rtol=1e-8, atol=1e-8, method="BDF")
    assert np.ptp(sol.check(error=False).energy) > 0.1 * np.abs(sol.check(error=False).energy).max()
    assert sol.check(error=False).energy_error < 1e-5


def test_assembly_starts_on_the_curve_with_its_velocity():
    mech = driven()
    assembly = pc.assemble(mech, t=0.1)
    assert assembly.q[0] == pytest.approx(-1.0 + OMEGA * 0.1, abs=1e-12) and assembly.v[0] == pytest.approx(OMEGA)
    assert assembly.mobility == 0
    assert pc.simulate(mech, (0.1, 0.2), step=0.01).q[-1, 0] == pytest.approx(1.0)


def test_prismatic_and_unbounded_joints_can_be_driven():
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    turn = model.addJoint(slide, pin.JointModelRUBZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(turn, pin.Inertia(2.0, np.zeros(3), np.eye(3) * 0.5), pin.SE3.Identity())
    loops = [
        pc.Drive("push", "slide", lambda t: t**2, lambda t: 2 * t, lambda t: 2.0),
        pc.Drive("spin", "turn", lambda t: 3 * t**2, lambda t: 6 * t, lambda t: 6.0),
    ]
    sol = pc.simulate(pc.Mechanism(model, loops), (0.0, 2.0), rtol=1e-8, atol=1e-8)
    assert sol.success
    np.testing.assert_allclose(sol.lam, np.tile([2.0 * 2.0, 0.5 * 6.0], (len(sol.t), 1)), atol=1e-6)
    np.testing.assert_allclose(sol.q[-1], [4.0, np.cos(12.0), np.sin(12.0)], atol=1e-9)


def test_bad_drives_are_named():
    mech = pc.load("slider_crank")
    with pytest.raises(pc.InputError, match=r"'motor'.*no joint 'krank'"):
        mech.with_loops(pc.Drive("motor", "krank", np.sin))
    with pytest.raises(pc.InputError, match="curve must be a function"):
        pc.Drive("motor", "crank", 3.0)
    with pytest.raises(pc.UserFunctionError, match=r"'motor' raised ZeroDivisionError"):
        pc.simulate(mech.add_loops(pc.Drive("motor", "crank", lambda t: 1 / 0)), (0, 1))
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    with pytest.raises(pc.InputError, match="3 degrees of freedom"):
        pc.Mechanism(model, [pc.Drive("motor", "ball", np.sin)])


def test_more_drives_than_the_linkage_has_freedom_are_refused():
    """One of the two would leave the system as a dependent row, and its curve would be missed in silence."""
    mech = pc.load("slider_crank")
    two = [pc.Drive("motor", "crank", lambda t: -1.0 + t), pc.Drive("press", "rod", lambda t: 1.2843049058942417)]
    with pytest.raises(pc.SingularSystemError, match=r"drives motor, press are more"):
        pc.simulate(mech.add_loops(*two), (0.0, 1.0))


def test_derivatives_that_contradict_their_curve_are_refused():
    arm = pc.load("slider_crank")
    curve = pc.Motion(start=0.3, speed=2.0, amplitude=0.1, frequency=1.0)

    def assembled(**given):
        return pc.assemble(arm.add_loops(pc.Drive("motor", "crank", **given)), t=0.4).v

    right = assembled(curve=curve)
    np.testing.assert_allclose(assembled(curve=lambda t: curve(t), rate=curve.rate), right)
    with pytest.raises(
        pc.InputError, match=r"drive 'motor': its rate at t = 0\.4 is .*, which is not the derivative of its curve"
    ):
        assembled(curve=curve, rate=lambda t: 1.01 * curve.rate(t))
    with pytest.raises(pc.InputError, match=r"its acceleration at .* not the derivative of its rate"):
        assembled(curve=curve, acceleration=lambda t: -curve.acceleration(t))
    with pytest.raises(pc.InputError, match=r"the rate of drive 'motor' is nan at t = 0\.4"):
        assembled(curve=curve, rate=lambda t: np.nan)
    curve, rate = (lambda t: np.sin(2.0 * t)), (lambda t: 2.0 * np.cos(2.0 * t))
    drive = pc.Drive("motor", "crank", curve, rate, lambda t: -np.sin(2.0 * t))
    with pytest.raises(pc.InputError, match=r"its acceleration at t = 0\.0017 .* not the derivative of its rate"):
        pc.assemble(arm.add_loops(drive))  # at t = 0 both are zero


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("frequency", [50.0, 500.0, 1e3, 1e4])
def test_differences_resolve_a_fast_curve(frequency, method):
    """Differences over 1 ms had the velocity of a 50 Hz curve wrong by 7e-6, and Radau went on in steps of 1e-9 s."""
    w = 2.0 * np.pi * frequency
    sol = pc.simulate(on_a_rail(lambda t: 0.3 + 0.01 * np.sin(w * t)), (0.0, 2.3 / frequency), method=method)
    assert sol.success and len(sol.t) < 600
    np.testing.assert_allclose(sol.v[:, 0], 0.01 * w * np.cos(w * sol.t), atol=1e-9 * w)
    np.testing.assert_allclose(sol.lam[:, 0], -0.01 * w**2 * np.sin(w * sol.t), atol=1e-8 * w**2)


@pytest.mark.parametrize("corner", [1e-5, 1.5e-3, 1e-2])
@pytest.mark.parametrize("power", [1, 2])
def test_differences_smooth_a_corner(corner, power):
    """Shorter steps on either side of a corner, but not over it, would let the velocity jump, and stop the run."""
    curve = lambda t: 0.1 * np.sin(6.0 * t) + max(t - corner, 0.0) ** power  # noqa: E731
    sol = pc.simulate(on_a_rail(curve), (0.0, 0.05))
    assert sol.success, sol.message
    np.testing.assert_allclose(sol.q[:, 0], [curve(t) for t in sol.t], atol=1e-9)


@pytest.mark.parametrize("frequency", [1.0, 1e3, 1e6])
def test_right_derivatives_are_not_refused(frequency):
    """At corners, at the border of where the curve is defined, and on any scale of time."""
    arm, shake = pc.load("slider_crank"), pc.Motion(0.3, amplitude=0.1 / frequency, frequency=frequency, phase=1.0)

    def from_zero_on(t):
        if t < 0:
            raise ValueError("too early")
        return shake(t)

    drives = (
        pc.Drive("motor", "crank", shake, shake.rate, shake.acceleration),
        pc.Drive("motor", "crank", from_zero_on, shake.rate, shake.acceleration),
        pc.Drive("motor", "crank", lambda t: 0.3 + max(t, 0.0), lambda t: 1.0 * (t >= 0), lambda t: 0.0),
        pc.Drive("motor", "crank", lambda t: 0.3 + 0.5 * max(t, 0.0) ** 2, lambda t: max(t, 0.0), lambda t: 1.0),
    )
    for drive in drives:
        pc.assemble(arm.add_loops(drive))


@pytest.mark.parametrize("fields", [{"name": 3}, {"joint": None}])
def test_names_of_drives_are_texts(fields):
    with pytest.raises(pc.InputError, match="must be a name"):
        pc.Drive(**({"name": "motor", "joint": "crank", "curve": pc.Motion()} | fields))


def on_a_rail(curve):
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "rail")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return pc.Mechanism(model, [pc.Drive("motor", "rail", curve)])


def test_a_drive_that_jumps_within_the_start_is_not_followed():
    """At rest until it jumps: the first steps could have reached beyond it."""
    sol = pc.simulate(on_a_rail(lambda t: 0.1 * (t > 0.1)), (0.0, 0.2), rtol=1e-3, max_steps=2000)
    assert not sol.success and np.abs(sol.q).max() < 1e-6 and 0.09 < sol.t[-1] < 0.1 + 1e-9, sol.message


def test_a_drive_that_jumps_at_the_start_is_named():
    """Differences over 3 ms would see the jump from the start on; the run goes as far as the curve does."""
    for method in ("BDF", "Radau"):
        sol = pc.simulate(on_a_rail(lambda t: 0.1 * (t > 3e-3)), (0.0, 0.2), method=method)
        assert not sol.success and sol.t[-1] == pytest.approx(3e-3)
        assert "cannot continue at t = 0.003: loop 'motor' row motor jumps there, by 0.1" in sol.message
