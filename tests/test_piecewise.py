"""Forces that jump or bend at known times, against the closed form of a parallelogram, whose inertia is constant."""

from itertools import pairwise

import numpy as np
import pytest

import pinconsist as pc

INERTIA = 5.0 / 3.0  # kg m²: two rods and one that they carry, 1 m and 1 kg each
TIMES, VALUES = [0.01, 0.03, 0.05], [3.0, -2.0, 5.0]
END, FULL = 0.06, {"rtol": 1e-9, "atol": 1e-11}


def held(t):
    """A torque that is 0, 3, -2 and 5 N·m."""
    return float(np.select([t >= TIMES[2], t >= TIMES[1], t >= TIMES[0]], VALUES[::-1], 0.0))


def straight(t):
    """The same in straight lines between the times."""
    return float(np.interp(t, TIMES, VALUES)) if t >= TIMES[0] else 0.0


def wave(t):
    """A square wave that jumps every 0.01 s."""
    return 2.0 if int(t / 0.01) % 2 == 0 else -1.0


def moved(torque, jumps, end):
    """Change of the crank's speed and angle by a torque that is straight between jumps, from rest, by exact sums."""
    speed = angle = 0.0
    ends = [0.0, *(t for t in jumps if 0.0 < t < end), end]
    for a, b in pairwise(ends):
        first, last = (torque(a + part * (b - a)) for part in (0.25, 0.75))
        h, slope = b - a, 2.0 * (last - first) / (b - a)
        start = first - 0.25 * h * slope
        angle += speed * h + (start * h**2 / 2.0 + slope * h**3 / 6.0) / INERTIA
        speed += (start * h + slope * h**2 / 2.0) / INERTIA
    return angle, speed


FORCES = {
    "held": (held, TIMES, pc.HeldTorque(TIMES, VALUES, "crank0")),
    "straight": (straight, TIMES, pc.HeldTorque(TIMES, VALUES, "crank0", linear=True)),
    "times": (held, TIMES, pc.Piecewise({"crank0": held}, times=TIMES)),
    "after": (held, TIMES, pc.Piecewise({"crank0": lambda t: held(np.nextafter(t, -1.0))}, times=TIMES)),
    "a law": (held, TIMES, pc.Piecewise(lambda t, q, v: [held(t), 0.0, 0.0], times=TIMES)),
    "period": (wave, 0.01 * np.arange(7), pc.Piecewise({"crank0": wave}, period=0.01)),
}


@pytest.fixture(scope="module")
def mech():
    return pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0))


def run(mech, force, method="Radau", back=False, start=None, **options):
    span, options = (END, 0.0) if back else (0.0, END), FULL | options
    return pc.simulate(mech, span, *(start or ()), forces=[force], method=method, **options)


@pytest.mark.parametrize("method", ["Radau", "BDF"])
@pytest.mark.parametrize("name", FORCES)
def test_steps_end_where_forces_jump(mech, name, method):
    torque, jumps, force = FORCES[name]
    sol = run(mech, force, method)
    angle, speed = moved(torque, jumps, END)
    assert sol.q[-1, 0] - sol.q[0, 0] == pytest.approx(angle, abs=1e-10)
    assert sol.v[-1, 0] == pytest.approx(speed, abs=1e-8)
    inside = [t for t in jumps if 0.0 < t < END]
    assert set(inside) <= set(sol.t)
    assert sum(sol.rejected.values()) == 0
    certificate = sol.check(error=True)
    assert certificate.force < 1e-8
    assert certificate.error.q < 1e-8
    again = run(mech, force, method, back=True, start=(sol.q[-1], sol.v[-1]))
    np.testing.assert_allclose(again.q[-1], sol.q[0], atol=1e-10)
    np.testing.assert_allclose(again.v[-1], sol.v[0], atol=1e-8)
    assert again.check(error=False).force < 1e-8
    doubled = TIMES[:1] if name == "straight" else inside  # λ bends at the others, and does not jump
    for each in (sol, again):
        np.testing.assert_array_equal(np.sort(each.t[1:][np.diff(each.t) == 0.0]), doubled)


def test_what_a_step_across_a_jump_would_cost(mech):
    """The jumps of a function of time are found by sampling it; those of a law that depends on the state are not."""
    _, _, force = FORCES["a law"]
    known, found = run(mech, force), run(mech, force.force)
    assert found.nsteps + found.rejected["error"] < 1.5 * known.nsteps
    unknown = run(mech, lambda t, q, v: [held(t) if v[0] or t < 0.02 else 3.0, 0.0, 0.0])  # sampled at rest
    assert unknown.nsteps + unknown.rejected["error"] > 1.5 * known.nsteps


def test_a_saved_run_is_judged_alike(mech, tmp_path):
    for name in ("straight", "a law"):
        sol = run(mech, FORCES[name][2])
        again = pc.Solution.load(sol.save(tmp_path / "run.npz"))
        assert again.check(mech.add_forces(FORCES[name][2]), error=False).force < 1e-8


def test_a_run_that_ends_at_a_jump_has_the_force_before_it(mech):
    sol = pc.simulate(mech, (0.0, TIMES[-1]), forces=[FORCES["times"][2]], method="Radau")
    assert sol.energy().power["torque crank0"][-1] == pytest.approx(VALUES[-2] * sol.v[-1, 0])
    assert sol.check(mech.add_forces(FORCES["times"][2]), error=False).force < 1e-8


@pytest.mark.parametrize("options", [{}, {"events": lambda t, q, v, lam: 1.0}])
@pytest.mark.parametrize("method", ["Radau", "BDF"])
def test_a_force_that_is_not_finite_after_a_jump_ends_the_run(mech, method, options):
    """An integrator whose first step is not a number must not try for ever; what was reached can be judged."""
    force = pc.Piecewise({"crank0": lambda t: np.nan if t > 0.01 else 1.0}, times=[0.01])
    sol = pc.simulate(mech, (0.0, END), forces=[force], method=method, **options)
    assert not sol.success
    assert sol.t[-1] == 0.01
    assert "torque crank0" in sol.message and "not finite" in sol.message
    assert sol.check(error=False).force < 1e-4


def test_a_recorded_run_is_made_again_and_has_no_checkpoints(mech, tmp_path):
    force = FORCES["period"][2]
    sol = pc.record(mech, (0.0, END), tmp_path / "run", forces=[force], method="Radau")
    assert sol.check(error=False).force < 1e-8
    assert pc.rerun(tmp_path / "run.npz", scene=mech, forces=[force]).same
    with pytest.raises(pc.InputError, match="checkpoint"):
        pc.record(mech, (0.0, END), tmp_path / "run", forces=[force], save_every=0.02)


def test_a_simulation_ends_steps_there(mech):
    _, _, force = FORCES["period"]
    sim = pc.Simulation(mech, forces=[force], **FULL)
    for _ in range(12):
        sim.step(END / 12)
    angle, speed = moved(wave, FORCES["period"][1], END)
    assert sim.state.q[0] - sim.solution().q[0, 0] == pytest.approx(angle, abs=1e-10)
    assert sim.state.v[0] == pytest.approx(speed, abs=1e-8)


def test_locked_joints_keep_the_jumps(mech):
    two = pc.load("n_four_bar_2")
    force = pc.Piecewise({"crank0": held}, times=TIMES)
    joint = next(name for name in two.joints if name not in mech.joints)
    smaller = two.add_forces(force, pc.Piecewise({joint: held}, times=TIMES)).lock(joint)
    assert [type(each) for each in smaller.forces] == [pc.Piecewise]


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda mech: pc.Piecewise({"crank0": held}), "times or a period"),
        (lambda mech: pc.Piecewise({"crank0": held}, [0.1], 0.1), "times or a period"),
        (lambda mech: pc.Piecewise({"crank0": held}, [0.2, 0.1]), "increase"),
        (lambda mech: pc.Piecewise({"crank0": held}, period=0.0), "period"),
        (lambda mech: run(mech, pc.Piecewise(FORCES["held"][2], TIMES)), "times of its own"),
    ],
)
def test_what_cannot_be_is_refused(mech, make, words):
    with pytest.raises(pc.InputError, match=words):
        make(mech)
