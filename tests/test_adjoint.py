"""The derivative of one number by the way back over the steps: equal to the one by the way forwards."""

import numpy as np
import pytest
from helpers.extras import skips_missing_extras
from helpers.gradients import SCENES, crank_rocker, hits

import pinconsist as pc
from benchmarks.gradient_reference import differences
from benchmarks.gradient_scenes import long_chain
from pinconsist.gradients import prepare
from pinconsist.mechanism.parameters import parameter


def both(mech, theta, until, v0, seed=0, **options):
    """A random sum over rows, differentiated by the way back and by the way forwards."""
    times, rng = np.linspace(0.0, until, 5)[1:], np.random.default_rng(seed)
    run = {"t_eval": times, **options}
    forwards = pc.sensitivities(mech, theta, (0.0, until), None, v0, **run)
    parts = forwards.dq, forwards.dv, forwards.dlam
    weights = [rng.normal(size=part.shape[:2]) for part in parts]

    def number(t, q, v, lam):
        i = int(np.argmin(np.abs(times - t)))
        return weights[1][i] @ v + weights[2][i] @ lam

    def derivatives(t, q, v, lam):
        i = int(np.argmin(np.abs(times - t)))
        return [part[i] for part in weights]

    back = pc.gradient(mech, theta, (0.0, until), None, v0, rows=(number, derivatives), **run)
    exact = sum(np.einsum("ni,nip->p", one, part) for one, part in zip(weights, parts, strict=True))
    sol = forwards.solution
    value = sum(number(*row) for row in zip(sol.t, sol.q, sol.v, sol.lam, strict=True))
    assert back.value == pytest.approx(value, rel=1e-13) and back.names == forwards.names
    return back.gradient, exact


@pytest.mark.parametrize("scene", SCENES, ids=lambda scene: scene.__name__)
def test_back_is_forwards(scene):
    mech, names, until, v0 = scene()
    back, exact = both(mech, names, until, v0, rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(back, exact, rtol=1e-10, atol=1e-11 * np.abs(exact).max())


def test_back_is_forwards_on_a_real_robot_that_floats():
    """Rounding of its matrices, with near-massless links, leaves 1e-8."""
    with skips_missing_extras():
        mech = pc.load("cassie", free_flyer=True)
    spin = {"left-knee-op": 3.0, "right-knee-op": -2.0}
    back, exact = both(mech, ["left-knee-op_speed"], 0.002, spin, rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(back, exact, rtol=1e-6)


def test_back_is_forwards_for_the_values_of_a_table():
    """And both are what runs with other values say; one of them acts after the end, one before the start."""
    times, values, until, v0 = (
        [-0.02, -0.01, 0.02, 0.035, 0.06, 0.1],
        [0.3, 1.0, -2.0, 5.0, 3.0, 7.0],
        0.05,
        {"crank": 6.0},
    )
    mech = (
        pc.load("crank_rocker")
        .add_forces(pc.Actuator("motor", "crank", gear=2.0))
        .with_control({"motor": (times, values)})
    )
    names = [f"motor.control.values[{i}]" for i in range(6)] + ["gravity[2]", "inertia:coupler[yy]"]
    run = {"rtol": 1e-7, "atol": 1e-9}
    back, exact = both(mech, names, until, v0, **run)
    np.testing.assert_allclose(back, exact, rtol=1e-10, atol=1e-12 * np.abs(exact).max())
    end = (lambda t, q, v, lam: q[2]), (lambda t, q, v, lam: (np.eye(3)[2], 0.0, 0.0))
    found = pc.gradient(mech, names, (0.0, until), v0=v0, terminal=end, **run).gradient
    assert found[0] == found[5] == 0.0
    for i in (2, 3, 4):
        ends = []
        for change in (0.5, -0.5):
            beside = mech.with_parameters({names[i]: values[i] + change})
            ends.append(pc.simulate(beside, (0.0, until), v0=v0, rtol=1e-10, atol=1e-12).q[-1, 2])
        assert found[i] == pytest.approx(ends[0] - ends[1], rel=1e-4)


def test_values_of_a_table_are_one_group_in_any_order(monkeypatch):
    """Among others, twice, and one by one they have the same derivatives; names are looked up once for all."""
    looked, plain = [], prepare.parameter
    monkeypatch.setattr(prepare, "parameter", lambda mech, name: looked.append(name) or plain(mech, name))
    times = np.linspace(0.0, 0.02, 40)
    mech = pc.load("crank_rocker").add_forces(pc.Actuator("motor", "crank", gear=2.0))
    mech = mech.with_control({"motor": (times, np.cos(90.0 * times))})

    def found(names):
        end = (lambda t, q, v, lam: v[2]), (lambda t, q, v, lam: (0.0, np.eye(3)[2], 0.0))
        run = {"v0": {"crank": 6.0}, "rtol": 1e-4, "atol": 1e-6, "method": "Radau"}
        return pc.gradient(mech, names, (0.0, 0.02), terminal=end, **run).gradient

    table = [f"motor.control.values[{i}]" for i in range(40)]
    exact = found(table)
    assert len(looked) == 1 and np.count_nonzero(exact) > 10
    mixed = [*table[30:], "mass:coupler", "crank_speed", *table[:30], "gravity[2]"]
    np.testing.assert_allclose(found(mixed)[[*range(12, 42), *range(10)]], exact, rtol=1e-12)
    np.testing.assert_allclose(found([table[3], table[7], table[3]]), exact[[3, 7, 3]], rtol=1e-12)
    with pytest.raises(pc.InputError, match="40"):
        found([*table, "motor.control.values[40]"])


def test_trees_without_loops():
    """Back is forwards, and forwards is what reference runs say."""
    mech, names = pc.load("double_pendulum"), ["mass:lower", "length:lower", "upper", "upper_speed"]
    times, v0 = np.linspace(0.0, 0.1, 3), {"upper": 1.0}
    run = {"rtol": 1e-5, "atol": 1e-7}
    back, exact = both(mech, names, 0.1, v0, **run)
    np.testing.assert_allclose(back, exact, rtol=1e-10)
    found = pc.sensitivities(mech, names, (0.0, 0.1), None, v0, t_eval=times, **run)
    for ours, theirs in zip((found.dq, found.dv), differences(mech, names, times, None, v0), strict=False):
        assert np.abs(ours - theirs).max() < 1e-4 * np.abs(theirs).max()


def test_back_through_events():
    mech, _, _, v0 = crank_rocker()
    run = {"events": hits}
    back, exact = both(lambda theta: mech.with_parameters({"mass:coupler": theta[0]}), [1.4, 1.0], 0.2, v0, **run)
    np.testing.assert_allclose(back, exact, rtol=1e-7)  # differences of states at the event


def test_a_number_of_the_end_against_differences():
    mech, v0 = pc.load("crank_rocker"), {"crank": 12.0}
    found = pc.gradient(
        mech, ["mass:coupler"], (0.0, 0.1), v0=v0, terminal=lambda t, q, v, lam: np.sin(q[0]) * v[1] + lam[0] ** 2
    )

    def value(mass):
        beside = mech.with_parameters({"mass:coupler": mass})
        end = pc.simulate(beside, (0.0, 0.1), v0=v0, rtol=1e-12, atol=1e-12)
        return np.sin(end.q[-1, 0]) * end.v[-1, 1] + end.lam[-1, 0] ** 2

    step = 1e-3
    exact = (8 * (value(1.4 + step) - value(1.4 - step)) - value(1.4 + 2 * step) + value(1.4 - 2 * step)) / (12 * step)
    assert found.gradient[0] == pytest.approx(exact, rel=1e-6) and found.value == pytest.approx(value(1.4), rel=1e-6)


def test_a_number_of_the_end_behind_jumps():
    """No row lies before them."""
    mech, _, _, v0 = crank_rocker()
    options = {"v0": v0, "events": hits}
    build = lambda theta: mech.with_parameters({"mass:coupler": theta[0]})  # noqa: E731
    end = lambda t, q, v, lam: q[2]  # noqa: E731
    back = pc.gradient(build, [1.4, 1.0], (0.0, 0.2), terminal=end, **options)
    forwards = pc.sensitivities(build, [1.4, 1.0], (0.0, 0.2), **options)
    np.testing.assert_allclose(back.gradient, forwards.dq[-1, 2], rtol=1e-7)


def test_refusals():
    mech, span = pc.load("crank_rocker"), (0.0, 0.01)
    with pytest.raises(pc.InputError, match="needs a number: a function rows="):
        pc.gradient(mech, ["mass:coupler"], span)
    with pytest.raises(pc.InputError, match="rows= and t_eval= go together"):
        pc.gradient(mech, ["mass:coupler"], span, rows=lambda t, q, v, lam: q[0])
    with pytest.raises(pc.PinconsistError, match="ended early: stopped by the event"):
        stop = pc.Event(lambda t, q, v, lam: t - 0.005, terminal=True, name="stop")
        pc.gradient(mech, ["mass:coupler"], span, terminal=lambda t, q, v, lam: q[0], events=stop)
    with pytest.raises(pc.UserFunctionError, match="rows= or terminal="):
        pc.gradient(mech, ["mass:coupler"], span, terminal=lambda t, q, v, lam: q[7])


@pytest.mark.slow
def test_a_run_that_begins_with_tiny_steps():
    """A long chain in free fall, whose first steps are too short for stages to be iterated to rounding."""
    mech, names, until = long_chain()
    end = (lambda t, q, v, lam: q[0]), (lambda t, q, v, lam: (np.eye(mech.nv)[0], 0.0, 0.0))
    back = pc.gradient(mech, names, (0.0, until), terminal=end, rtol=1e-8, atol=1e-10).gradient
    forwards = pc.sensitivities(mech, names[:2], (0.0, until), rtol=1e-8, atol=1e-10).dq[-1, 0]
    np.testing.assert_allclose(back[:2], forwards, rtol=0, atol=1e-7 * np.abs(back).max())

    def reached(scale):
        changed = mech.with_parameters({names[0]: scale * found})
        return pc.simulate(changed, (0.0, until), rtol=1e-11, atol=1e-12, method="Radau").q[-1, 0]

    found = parameter(mech, names[0]).value
    exact = (reached(1.001) - reached(0.999)) / (0.002 * found)
    assert abs(back[0] - exact) < 1e-4 * np.abs(back).max()
