"""Derivatives of runs past known times at which forces or constraints jump, against differences of runs."""

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import pinconsist as pc

WITHIN = 1e-6
TIMES, TORQUES = np.array([0.03, 0.1, 0.17]), np.array([1.0, -2.0, 3.0])


@cache
def four_bar():
    return pc.load("four_bar")


@dataclass(frozen=True)
class PD:
    """A law that tells its derivative; not linear."""

    kp: float
    kd: float

    def __call__(self, t, q, v):
        return [self.kp * (np.sin(3.0 * t) - q[0]) - self.kd * v[0] ** 3]

    def derivative(self, t, q, v):
        return [[-self.kp, 0.0, 0.0]], [[-3.0 * self.kd * v[0] ** 2, 0.0, 0.0]]


def sampled(law, delay=0.0):
    return four_bar().with_forces(pc.Sampled(0.02, law, "crank", delay))


def held(linear):
    return lambda theta: four_bar().with_forces(pc.HeldTorque(TIMES, theta, ["crank"], linear=linear))


def piecewise(theta, **times):
    """A user's force without derivatives, which jumps."""

    def pull(t, q, v):
        return [theta[0] * (1.0 if t % 0.1 < 0.05 else -2.0) * np.cos(q[0]) - theta[1] * v[0], 0.0, 0.0]

    return four_bar().with_forces(pc.Piecewise(pull, **times))


def driven(theta):
    """The rate of a drive jumps, so that all velocities do."""
    bent = pc.Drive(
        "bent",
        "left_crank",
        lambda t: -2.2 + theta[0] * t + theta[1] * max(0.0, t - 0.1),
        rate=lambda t: theta[0] + theta[1] * (t > 0.1),
        acceleration=lambda t: 0.0,
        knots=[0.1],
    )
    return pc.load("five_bar").add_loops(bent)


CASES = {
    "held": (held(False), TORQUES),
    "linear": (held(True), TORQUES),
    "piecewise": (lambda theta: piecewise(theta, times=[0.05, 0.1, 0.15, 0.2]), [1.0, 0.3]),
    "periodic": (lambda theta: piecewise(theta, period=0.05), [1.0, 0.3]),
    "sampled law": (lambda theta: sampled(PD(*theta)), [8.0, 0.1]),
    "law, late by half a period": (lambda theta: sampled(PD(*theta), 0.01), [8.0, 0.1]),
    "law, late by more": (lambda theta: sampled(PD(*theta), 0.025), [8.0, 0.1]),
    "law of time": (lambda theta: sampled(lambda t, q, v: [theta[0] * np.sin(30.0 * t) + theta[1]]), [3.0, 1.0]),
    "mass under a law": (lambda theta: sampled(PD(8.0, 0.1)).with_parameters({"mass:coupler": theta[0]}), [1.4]),
    "drive": (driven, [2.0, 3.0]),
}


def jump_of(t):
    """The first of two rows of the last jump."""
    return np.flatnonzero(np.diff(t) == 0.0)[-1]


def rows(build, theta, span, **options):
    """The last row of a run, and the multipliers on both sides of its last jump."""
    sol = pc.simulate(build(theta), span, rtol=1e-12, atol=1e-13, **options)
    i = jump_of(sol.t)
    return np.concatenate((sol.q[-1], sol.v[-1], sol.lam[-1], sol.lam[i], sol.lam[i + 1]))


def differences(build, theta, span, **options):
    columns = []
    for unit in 1e-3 * np.eye(len(theta)):
        near, far = (rows(build, theta + m * unit, span, **options) - rows(build, theta - m * unit, span, **options)
                     for m in (1, 2))  # fmt: skip
        columns.append((8.0 * near - far) / 12e-3)
    return np.column_stack(columns)


def compared(build, theta, span, **options):
    theta = np.array(theta)
    exact = differences(build, theta, span, **options)
    found = pc.sensitivities(build, theta, span, rtol=1e-10, atol=1e-11, **options)
    i = jump_of(found.solution.t)
    got = np.concatenate((found.dq[-1], found.dv[-1], found.dlam[-1], found.dlam[i], found.dlam[i + 1]))
    np.testing.assert_allclose(got, exact, rtol=0, atol=WITHIN * np.abs(exact).max())


@pytest.mark.parametrize("span", [(0.0, 0.25), (0.25, 0.0)], ids=["forwards", "backwards"])
@pytest.mark.parametrize("kind", CASES)
def test_derivatives_go_on_over_jumps(kind, span):
    if kind == "linear" and span[0] == 0.0:
        span = (0.0, 0.05)  # the only jump is the first
    if kind == "drive" and span[0] > 0.0:
        pytest.skip("velocities are projected at the end of the jump: a run backwards is another one")
    compared(*CASES[kind], span)


@pytest.mark.parametrize("kind", ["held", "sampled law"])
def test_with_an_event_between(kind):
    """The torque that acts when an event changes the state was sampled before."""
    drop = pc.Event(lambda t, q, v, lam: q[0] + 0.95, apply=lambda t, q, v: 0.7 * v)
    compared(*CASES[kind], (0.0, 0.25), events=[drop])


@pytest.mark.parametrize("kind", CASES)
def test_the_adjoint_is_the_transpose(kind):
    build, theta = CASES[kind]
    times, span, rng = np.linspace(0.0, 0.25, 6)[1:], (0.0, 0.25), np.random.default_rng(0)
    found = pc.sensitivities(build, theta, span, t_eval=times)
    weights = [rng.normal(size=part.shape[:2]) for part in (found.dq, found.dv, found.dlam)]

    def derivatives(t, q, v, lam):
        i = int(np.argmin(np.abs(times - t)))
        return [part[i] for part in weights]

    def number(t, q, v, lam):
        return sum(part @ x for part, x in zip(derivatives(t, q, v, lam), (q, v, lam), strict=True))

    pair = number, derivatives
    back = pc.gradient(build, theta, span, rows=pair, terminal=pair, t_eval=times[:-1]).gradient
    parts = zip(weights, (found.dq, found.dv, found.dlam), strict=True)
    forward = sum(np.einsum("ij,ijp->p", weight, part) for weight, part in parts)
    np.testing.assert_allclose(back, forward, rtol=0, atol=1e-9 * np.abs(forward).max())


@pytest.mark.parametrize("linear", [False, True])
@pytest.mark.parametrize("span", [(0.0, 0.2), (0.2, 0.0)], ids=["forwards", "backwards"])
def test_the_torques_of_a_table_are_parameters_with_names(span, linear):
    mech, n = pc.load("five_bar"), 20
    times = np.arange(n) * 0.01
    torques = np.column_stack((np.sin(9.0 * times), np.cos(7.0 * times)))
    joints = ["left_crank", "right_crank"]

    def build(theta):
        return mech.with_forces(pc.HeldTorque(times, np.reshape(theta, (n, 2)), joints, linear=linear))

    named = build(torques.ravel())
    names = [f"{named.forces[0].label}.torques[{i}][{j}]" for i in range(n) for j in (0, 1)]
    number = {"terminal": lambda t, q, v, lam: q[0] + lam[0]}
    exact = pc.gradient(build, torques.ravel(), span, **number).gradient
    found = pc.gradient(named, names, span, **number).gradient
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-8 * np.abs(exact).max())
    assert named.with_parameters({names[3]: 7.0}).forces[0].torques[1, 1] == 7.0


def test_the_torques_of_one_joint_have_one_number_each():
    mech = four_bar().with_forces(pc.HeldTorque(TIMES, TORQUES, "crank"))
    names = ["held torque crank.torques[1]", "mass:coupler"]
    found = pc.sensitivities(mech, names, (0.0, 0.2))

    def build(theta):
        torques = [TORQUES[0], theta[0], TORQUES[2]]
        return (
            four_bar().with_forces(pc.HeldTorque(TIMES, torques, "crank")).with_parameters({"mass:coupler": theta[1]})
        )

    of_build = pc.sensitivities(build, found.values, (0.0, 0.2)).dq
    np.testing.assert_allclose(found.dq, of_build, rtol=0, atol=1e-8 * np.abs(of_build).max())


def test_numbers_of_a_law_are_parameters():
    names = ["sampled crank.law.kp", "sampled crank.law.kd"]
    found = pc.sensitivities(sampled(PD(8.0, 0.1)), names, (0.0, 0.2)).dq
    of_build = pc.sensitivities(*CASES["sampled law"], (0.0, 0.2)).dq
    np.testing.assert_allclose(found, of_build, rtol=0, atol=1e-9 * np.abs(of_build).max())


class PI:
    """Integrates the position."""

    def __init__(self):
        self.sum = 0.0

    def __call__(self, t, q, v):
        self.sum += q[0]
        return [self.sum]

    def derivative(self, t, q, v):
        return None, None


class Wrong(PI):
    def __call__(self, t, q, v):
        return [0.0]

    def derivative(self, t, q, v):
        return np.zeros((2, 3)), None


MOVES = "and the parameter .* moves this time"
REFUSED = {
    "black box": (lambda theta: sampled(lambda t, q, v: [-theta[0] * q[0]]), "law of 'sampled crank' uses the state"),
    "memory": (lambda theta: sampled(PI()), "law of 'sampled crank' returned .* state of its own"),
    "wrong derivative": (lambda theta: sampled(Wrong()), "derivative of the law of 'sampled crank' returned shape"),
    "times": (lambda theta: four_bar().with_forces(pc.HeldTorque(TIMES * theta[0], TORQUES, "crank")), MOVES),
    "jumps": (lambda theta: four_bar().with_forces(pc.Piecewise({"crank": np.sin}, [0.1 * theta[0]])), MOVES),
    "not of Python": (lambda theta: four_bar().with_forces(pc.Sampled(0.02, np.sin, "crank")), "uses the state"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_not_known_is_refused_by_name(what):
    build, why = REFUSED[what]
    with pytest.raises(pc.InputError, match=why):
        pc.sensitivities(build, [1.0], (0.0, 0.15))


def test_the_period_of_samples_is_refused():
    build = lambda theta: four_bar().with_forces(pc.Sampled(0.02 * theta[0], lambda t, q, v: [t], "crank"))  # noqa: E731
    with pytest.raises(pc.InputError, match=MOVES):
        pc.sensitivities(build, [1.0], (0.0, 0.15))


def test_times_after_the_run_do_not_matter():
    def build(theta):
        return four_bar().with_forces(pc.HeldTorque([0.0, 0.1, theta[0]], TORQUES, "crank"))

    assert np.abs(pc.sensitivities(build, [0.7], (0.0, 0.2)).dq).max() < 1e-15


def test_both_rows_of_a_jump_of_a_function_of_time():
    """The multipliers behind the jump had the derivative of those before it."""

    def build(theta):
        return four_bar().with_forces({"crank": lambda t: theta[0] * (1.0 if t < 0.1 else 3.0)})

    compared(build, [1.0], (0.0, 0.2))
