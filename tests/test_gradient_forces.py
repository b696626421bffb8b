"""Derivatives of runs with user-defined forces: complete without their derivatives, and refused across jumps."""

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc


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


def test_a_force_without_derivatives():
    """Newton's iteration does without ∂τ/∂q; the derivatives of a run were wrong by half without it."""

    def build(theta):
        return slider(lambda t, q, v: [theta[0] * np.sin(3.0 * q[0]) - theta[1] * v[0] ** 3])

    options = {"rtol": 1e-8, "atol": 1e-9}
    forward, back, exact = of_speed(build, np.array([2.0, 0.4]), **options)
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


class Tether:
    """An object that calls its stiffness small."""

    def torque(self, t, q, v):
        return np.array([-4.0 * q[0] ** 3])

    def derivatives(self, t, q, v):
        return None, None


def test_derivatives_that_a_force_leaves_out():
    mech = slider(lambda t, q, v: [0.0]).with_forces(Tether())
    found = pc.sensitivities(mech, ["slide_speed"], (0.0, 1.0), v0={"slide": 1.0})
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
MOVES = r"jumps or bends at t = 0\.[0-9]+ s, and the parameter 'theta\[0\]' moves this time.*by a smooth"
REFUSED = {where: MOVES if where == "time" else JUMPED for where in JUMPS}


@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("where", JUMPS)
def test_jumps_are_refused(where, span):
    start = ([0.0], [1.0]) if span[0] == 0.0 else ([1.0], [1.8])
    with pytest.raises(pc.InputError, match=REFUSED[where]):
        pc.sensitivities(lambda theta: slider(JUMPS[where](theta)), [1.0], span, *start)


@pytest.mark.parametrize("span", [(0.0, 1.0), (1.0, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("where", JUMPS)
@pytest.mark.parametrize("what", [{"apply": lambda t, q, v: v}, {"terminal": True}], ids=["apply", "terminal"])
def test_jumps_at_events_are_refused(what, where, span):
    """The steps that end there are on both sides of the jump; where they crowd, too."""
    events, start = [pc.Event(SWITCHES[where], **what)], ([0.0], [1.0]) if span[0] == 0.0 else ([1.0], [1.8])
    with pytest.raises(pc.InputError, match=f"{REFUSED[where]}|not smooth in the parameter"):
        pc.sensitivities(lambda theta: slider(JUMPS[where](theta)), [1.0], span, *start, events=events)


@pytest.mark.parametrize("what", [{"apply": lambda t, q, v: v}, {"terminal": True}, {}], ids=["apply", "ends", "plain"])
def test_an_event_where_a_function_of_time_jumps(what):
    """The step before the event, or that after it, may have no length at all. v = 1 + 3 θ (t - 0.4)."""
    events = [pc.Event(lambda t, q, v, lam: t - 0.4, **what)]

    def build(theta):
        return slider(lambda t, q, v: [3.0 * theta[0] if t > 0.4 else 0.0])

    found = pc.sensitivities(build, [1.0], (0.0, 1.0), [0.0], [1.0], events=events)
    assert found.dv[-1, 0, 0] == pytest.approx(0.0 if "terminal" in what else 1.8, abs=1e-9)


KNEE = 0.0771  # s
OF_TIME = {  # of theta and t, in units of a torque
    "jump": lambda x, t: x * (t > KNEE),
    "pulse": lambda x, t: x * (KNEE <= t < 0.2),
    "jump of a varying force": lambda x, t: x * ((3.0 + np.cos(9.0 * t)) * (t >= KNEE) - 1.0),
    "bend": lambda x, t: x * (0.5 + 30.0 * max(0.0, t - KNEE)),
}


@pytest.mark.parametrize("span", [(0.0, 0.3), (0.3, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("kind", OF_TIME)
def test_fixed_times_at_which_functions_of_time_jump(kind, span):
    """Steps end there; the last stage of a step, and a step of BDF, must not see what begins at their ends."""
    base = pc.load("four_bar")

    def build(theta):
        return base.with_forces({"crank": lambda t: OF_TIME[kind](theta[0], t)})

    def end(x):
        return pc.simulate(build([x]), span, method="Radau", rtol=1e-12, atol=1e-13).q[-1]

    exact = (8.0 * (end(1.01) - end(0.99)) - end(1.02) + end(0.98)) / 0.12
    options = {}
    found = pc.sensitivities(build, [1.0], span, **options).dq[-1, :, 0]
    back = pc.gradient(build, [1.0], span, terminal=lambda t, q, v, lam: q[0], **options).gradient
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())
    np.testing.assert_allclose(back[0], found[0], rtol=0, atol=1e-10 * np.abs(exact).max())


@pytest.mark.parametrize(
    "law",
    [
        lambda x: lambda t: 1.0 * (t > KNEE * x),
        lambda x: lambda t: 30.0 * max(0.0, t - KNEE * x),
        lambda x: lambda t: x * (0.1 * x <= t < 0.2),
    ],
    ids=["jump", "bend", "pulse"],
)
def test_times_of_jumps_as_parameters_are_refused(law):
    """A bend had a derivative that was wrong by 5e-3: forces at the ends of steps were those of both its sides."""
    base = pc.load("four_bar")
    with pytest.raises(pc.InputError, match=MOVES):
        pc.sensitivities(lambda theta: base.with_forces({"crank": law(theta[0])}), [1.0], (0.0, 0.3))


def test_a_known_derivative_of_a_force_that_jumps():
    """The force is differentiated by its own numbers, without other mechanisms: it must jump with the run."""
    mech = pc.load("four_bar").add_forces(pc.Wrench("coupler", force=lambda t: (0.0, 0.0, 20.0 * (t > KNEE) - 5.0)))
    name, span = "wrench coupler.xyz[0]", (0.3, 0.0)

    def end(x):
        return pc.simulate(mech.with_parameters({name: x}), span, method="Radau", rtol=1e-12, atol=1e-13).q[-1]

    exact = (8.0 * (end(1e-3) - end(-1e-3)) - end(2e-3) + end(-2e-3)) / 12e-3
    found = pc.sensitivities(mech, [name], span).dq[-1, :, 0]
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-7 * np.abs(exact).max())


def test_times_of_a_table_are_refused():
    """The derivative by a time at which a table bends was wrong by 2 to 6 %."""
    mech = pc.load("four_bar").with_forces(pc.Actuator("motor", "crank"))
    mech = mech.with_control({"motor": ([0.0, 0.1, 0.2, 0.3], [1.0, 2.0, -1.0, 0.0])})
    with pytest.raises(pc.InputError, match=r"at t = 0\.1 s, and the parameter 'motor\.control\.times\[1\]' moves"):
        pc.sensitivities(mech, ["motor.control.times[1]"], (0.0, 0.3))
    pc.sensitivities(mech, ["motor.control.values[1]", "motor.control.times[3]"], (0.0, 0.05))


@pytest.mark.parametrize("width", [1e-2, 1e-3])
def test_the_smooth_transition_that_the_message_advises(width):
    """Right, and near the derivative with the jump: dv/ds of the speed √(1 + s) at x = 1/2, and 3 s after that."""

    def build(theta):
        return slider(lambda t, q, v: [theta[0] * (2.0 + np.tanh((q[0] - 0.5) / width))])

    forward, back, exact = of_speed(build, np.array([1.0]))
    there = np.sqrt(2.0)
    rate = 0.5 / there
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)
    assert forward[0] == pytest.approx(rate + 3.0 * (2.0 - there) - 3.0 * (rate - (there - 1.0)), abs=width)


def test_a_latch_that_an_event_sets_is_refused():
    state = {"on": False}

    def build(theta):
        state["on"] = False
        return slider(lambda t, q, v: [theta[0] * (3.0 if state["on"] else 1.0)])

    def latch(t, q, v):
        state["on"] = True

    events = [pc.Event(lambda t, q, v, lam: q[0] - 0.5, apply=latch)]
    with pytest.raises(pc.InputError, match=r"not those that acted in the run.*apply= of an event"):
        pc.sensitivities(build, [1.0], (0.0, 1.0), [0.0], [1.0], events=events)


@pytest.mark.parametrize("begin", [0.0, 0.3])
def test_pulses_that_begin_smoothly(begin):
    """exp(-1/x) has no size at first, neither as a force nor as a difference that tells whether it is smooth."""

    def build(theta):
        def pulse(t, q, v):
            x = (t - begin) / (1.0 - begin)
            return [20.0 * theta[0] * np.exp(-1.0 / (x * (1.0 - x))) if 0.0 < x < 1.0 else 0.0]

        return slider(pulse)

    forward, back, exact = of_speed(build, np.array([1.0]), max_step=0.05)
    np.testing.assert_allclose(forward, exact, rtol=1e-6)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


def test_a_pulse_that_has_begun_when_the_run_does():
    """At the start its derivative is e⁻⁵⁶: no reason to call it a step function."""

    def build(theta):
        def pulse(t, q, v):
            x = t + 1.0 / 56.0
            return [np.exp(-theta[0] / x)]

        return slider(pulse)

    forward, back, exact = of_speed(build, np.array([1.0]))
    np.testing.assert_allclose(forward, exact, rtol=1e-5)
    np.testing.assert_allclose(back, forward, rtol=1e-8)


def test_parameters_without_effect():
    def build(theta):
        return slider(lambda t, q, v: [np.sin(t) + 0.0 * theta[0] + (theta[1] + 0.1 - theta[1])])

    forward, back, _ = of_speed(build, np.array([1.0, 0.3]))
    np.testing.assert_allclose(np.concatenate((forward, back)), 0.0, rtol=0, atol=1e-8)


@pytest.mark.parametrize("end, side", [(0.3, 1.0), (-0.1, -1.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("bend", [0.1, 0.1 + 3e-4, 0.1 - 3e-4])
def test_a_drive_that_bends_where_the_run_starts(bend, end, side):
    """The rate of a drive is a difference, which the run does not take across a bend: nor do its derivatives."""
    base = pc.load("four_bar")

    def build(theta):
        return base.add_loops(pc.Drive("turn", "crank", lambda t: base.guess[0] + theta[0] * abs(t - bend)))

    found = pc.sensitivities(build, [1.0], (0.1, end))
    first = side if bend == 0.1 else np.sign(0.1 - bend)
    assert found.dv[0, 0, 0] == pytest.approx(first, abs=1e-5)
    np.testing.assert_allclose(found.dv[-1, 0, 0], np.sign(end - bend), rtol=0, atol=1e-7)
    assert found.solution.v[0, 0] == pytest.approx(first, abs=1e-7)
