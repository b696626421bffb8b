"""Derivatives of runs with user-defined forces: complete without their derivatives, and refused across jumps."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.twin import needs_both

import pinconsist as pc

METHODS = pytest.mark.parametrize("method", ["BDF", "Radau"])


def slider(force):
    """1 kg on a slide, without gravity."""
    model = pin.Model()
    model.gravity.setZero()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return pc.Mechanism(model, forces=[pc.Torque(force)])


def speed(t, q, v, lam):
    return v[0]


def of_speed(build, theta, events=None, span=(0.0, 1.0), **options):
    """The derivatives of the speed after 1 s, forwards and backwards, and by differences of runs."""
    start = [0.0], [1.0]
    forward = pc.sensitivities(build, theta, span, *start, events=events, **options).dv[-1, 0]
    back = pc.gradient(build, theta, span, *start, terminal=speed, events=events, **options).gradient

    def value(change):
        runs = pc.simulate(build(theta + change), span, *start, method="Radau", rtol=1e-11, atol=1e-13)
        return runs.v[-1, 0]

    units = 1e-4 * np.eye(len(theta))
    return forward, back, np.array([(value(unit) - value(-unit)) / 2e-4 for unit in units])


@METHODS
@needs_both
def test_a_force_without_derivatives(backend, method):
    """Newton's iteration does without ∂τ/∂q; the derivatives of a run were wrong by half without it."""

    def build(theta):
        return slider(lambda t, q, v: [theta[0] * np.sin(3.0 * q[0]) - theta[1] * v[0] ** 3])

    options = {"method": method, "backend": backend, "rtol": 1e-8, "atol": 1e-9}
    forward, back, exact = of_speed(build, np.array([2.0, 0.4]), **options)
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


class Tether:
    """An object that calls its stiffness small."""

    def torque(self, t, q, v):
        return np.array([-4.0 * q[0] ** 3])

    def derivatives(self, t, q, v):
        return None, None


@METHODS
def test_derivatives_that_a_force_leaves_out(method):
    mech = slider(lambda t, q, v: [0.0]).with_forces(Tether())
    found = pc.sensitivities(mech, ["slide_speed"], (0.0, 1.0), v0={"slide": 1.0}, method=method)
    ends = [
        pc.simulate(mech, (0.0, 1.0), v0={"slide": 1.0 + e}, rtol=1e-11, atol=1e-13).v[-1, 0] for e in (1e-4, -1e-4)
    ]
    np.testing.assert_allclose(found.dv[-1, 0, 0], (ends[0] - ends[1]) / 2e-4, rtol=1e-5)


JUMPS = {
    "position, scaled": lambda theta: lambda t, q, v: [theta[0] * (1.0 if q[0] < 0.5 else 3.0)],
    "position": lambda theta: lambda t, q, v: [1.0 if q[0] < 0.5 * theta[0] else 3.0],
    "time": lambda theta: lambda t, q, v: [3.0 if t > 0.4 * theta[0] else 0.0],
    "speed": lambda theta: lambda t, q, v: [2.0 - (1.5 if v[0] > 1.5 * theta[0] else 0.0)],
}
SWITCHES = {
    "position, scaled": lambda t, q, v, lam: q[0] - 0.5,
    "position": lambda t, q, v, lam: q[0] - 0.5,
    "time": lambda t, q, v, lam: t - 0.4,
    "speed": lambda t, q, v, lam: v[0] - 1.5,
}


JUMPED = r"force 'torque .*' jumps at t = 0\.[0-9]+ s .*by a smooth"


@METHODS
@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("where", JUMPS)
def test_jumps_are_refused(where, span, method):
    start = ([0.0], [1.0]) if span[0] == 0.0 else ([1.0], [1.8])
    with pytest.raises(pc.InputError, match=JUMPED):
        pc.sensitivities(lambda theta: slider(JUMPS[where](theta)), [1.0], span, *start, method=method)


@METHODS
@pytest.mark.parametrize("where", JUMPS)
def test_jumps_at_events_are_refused(where, method):
    """The steps that end there are on both sides of the jump."""
    events = [pc.Event(SWITCHES[where], apply=lambda t, q, v: v)]
    run = (0.0, 1.0), [0.0], [1.0]
    with pytest.raises(pc.PinconsistError, match=f"{JUMPED}|could not be repeated up to t = 0.4"):
        pc.sensitivities(lambda theta: slider(JUMPS[where](theta)), [1.0], *run, events=events, method=method)


@METHODS
@pytest.mark.parametrize("width", [1e-2, 1e-3])
def test_the_smooth_transition_that_the_message_advises(width, method):
    """Right, and near the derivative with the jump: dv/ds of the speed √(1 + s) at x = 1/2, and 3 s after that."""

    def build(theta):
        return slider(lambda t, q, v: [theta[0] * (2.0 + np.tanh((q[0] - 0.5) / width))])

    forward, back, exact = of_speed(build, np.array([1.0]), method=method)
    there = np.sqrt(2.0)
    rate = 0.5 / there
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)
    assert forward[0] == pytest.approx(rate + 3.0 * (2.0 - there) - 3.0 * (rate - (there - 1.0)), abs=width)


@METHODS
def test_a_latch_that_an_event_sets_is_refused(method):
    state = {"on": False}

    def build(theta):
        state["on"] = False
        return slider(lambda t, q, v: [theta[0] * (3.0 if state["on"] else 1.0)])

    def latch(t, q, v):
        state["on"] = True

    events = [pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=latch)]
    with pytest.raises(pc.InputError, match=r"not those that acted in the run.*apply= of an event"):
        pc.sensitivities(build, [1.0], (0.0, 1.0), [0.0], [1.0], events=events, method=method)


@METHODS
@pytest.mark.parametrize("begin", [0.0, 0.3])
def test_pulses_that_begin_smoothly(begin, method):
    """exp(-1/x) has no size at first, neither as a force nor as a difference that tells whether it is smooth."""

    def build(theta):
        def pulse(t, q, v):
            x = (t - begin) / (1.0 - begin)
            return [20.0 * theta[0] * np.exp(-1.0 / (x * (1.0 - x))) if 0.0 < x < 1.0 else 0.0]

        return slider(pulse)

    forward, back, exact = of_speed(build, np.array([1.0]), method=method, max_step=0.05)
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


@METHODS
def test_a_pulse_that_has_begun_when_the_run_does(method):
    """At the start its derivative is e⁻⁵⁶: no reason to call it a step function."""

    def build(theta):
        def pulse(t, q, v):
            x = t + 1.0 / 56.0
            return [np.exp(-theta[0] / x)]

        return slider(pulse)

    forward, back, exact = of_speed(build, np.array([1.0]), method=method)
    np.testing.assert_allclose(forward, exact, rtol=1e-5)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


@METHODS
def test_parameters_without_effect(method):
    def build(theta):
        return slider(lambda t, q, v: [np.sin(t) + 0.0 * theta[0] + (theta[1] + 0.1 - theta[1])])

    forward, back, _ = of_speed(build, np.array([1.0, 0.3]), method=method)
    np.testing.assert_allclose(np.concatenate((forward, back)), 0.0, rtol=0, atol=1e-8)
