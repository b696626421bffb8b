"""Quantities by their names: one grammar in Python and on the command line; statistics against closed forms."""

import csv
import json
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.command_line import called

import pinconsist as pc

AMPLITUDE, FREQUENCY = 0.7, 1.25  # rad, Hz
WAY = 2 * np.pi * FREQUENCY


def arm(kind=pin.JointModelRY, mass=2.0, length=0.6):
    """A point mass at the end of an arm, which hangs at the angle zero."""
    model = pin.Model()
    joint = model.addJoint(0, kind(), pin.SE3.Identity(), "arm")
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0, 0, -length]), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("tip", joint, 0, pin.SE3(np.eye(3), np.array([0, 0, -length])), pin.FrameType.OP_FRAME))
    return pc.Mechanism(model)


def driven():
    curve = pc.Motion(amplitude=AMPLITUDE, frequency=FREQUENCY)
    return arm().with_loops(pc.Drive("motor", "arm", curve))


@pytest.fixture(scope="module", params=["BDF", "Radau"])
def run(request):
    """Two and a quarter periods."""
    return pc.simulate(driven(), (0.0, 1.8), method=request.param, rtol=1e-9, atol=1e-11)


@pytest.mark.parametrize(
    ("quantity", "exact"),
    [
        ("peak position arm", AMPLITUDE),
        ("max q arm", AMPLITUDE),
        ("min q arm", -AMPLITUDE),
        ("min velocity:arm", -AMPLITUDE * WAY),
        ("peak acceleration arm", AMPLITUDE * WAY**2),  # its size; the sign is of the first
        ("position arm at 0.33", AMPLITUDE * np.sin(WAY * 0.33)),
        ("final v arm", AMPLITUDE * WAY * np.cos(WAY * 1.8)),
        ("rms q arm", AMPLITUDE * np.sqrt(0.5 - np.sin(2 * WAY * 1.8) / (4 * WAY * 1.8))),
        ("mean q arm", AMPLITUDE * (1 - np.cos(WAY * 1.8)) / (WAY * 1.8)),
        ("max position tip x", 0.6 * np.sin(AMPLITUDE)),
        ("max position tip z", -0.6 * np.cos(AMPLITUDE)),
        ("peak velocity tip", 0.6 * AMPLITUDE * WAY),
        ("max energy kinetic", (0.6 * AMPLITUDE * WAY) ** 2),  # of 2 kg
        ("max joint_force arm", 2.0 * (9.81 + 0.6 * (AMPLITUDE * WAY) ** 2)),  # where the arm hangs it has no rate
    ],
)  # fmt: skip
def test_statistics_of_a_driven_arm(run, quantity, exact):
    found = run.evaluate(quantity)
    found = abs(found) if quantity == "peak acceleration arm" else found
    assert found == pytest.approx(exact, abs=3e-7 * max(1.0, abs(exact)))


def test_the_direction_of_time_makes_no_difference(run):
    back = pc.simulate(driven(), (1.8, 0.0), method=run.method["method"], rtol=1e-9, atol=1e-11)
    for quantity in ("peak q arm", "rms q arm", "mean reaction arm", "max torque motor", "min power motor"):
        assert back.evaluate(quantity) == pytest.approx(run.evaluate(quantity), rel=1e-6)


def test_few_rows_make_no_difference(run):
    few = pc.simulate(driven(), (0.0, 1.8), t_eval=np.linspace(0.0, 1.8, 7), rtol=1e-9, atol=1e-11)
    for quantity in ("peak torque motor", "rms q arm", "mean joint_force arm z"):
        found, exact = few.evaluate(quantity), run.evaluate(quantity)
        assert abs(found) == pytest.approx(abs(exact), rel=1e-6)  # of two peaks, one is as high as the other is low


def test_without_a_statistic_they_are_the_results_by_name():
    spring = pc.SpringDamper("coupler", "universe", stiffness=50.0, damping=1.0, length=0.5)
    mech = pc.load("crank_rocker").with_forces(spring)
    sol = pc.simulate(mech, (0.0, 0.3), v0={"crank": 8.0})
    pin_, strut = sol.reaction("rocker_ground"), sol.force(spring.label)
    frame, energy = sol.frame("rocker_tip"), sol.energy()
    expected = {
        "crank": sol.position("crank"), "q crank": sol.position("crank"), "v:rocker": sol.velocity("rocker"),
        "a rocker": sol.acceleration("rocker"), "position rocker_tip": frame.position, "rocker_tip": frame.position,
        "velocity rocker_tip z": frame.velocity[:, 2], "reaction rocker_ground": pin_.force,
        "reaction:rocker_ground x": pin_.force[:, 0], "force rocker_ground": pin_.force,
        "moment rocker_ground": pin_.moment,
        "joint force crank": sol.joint_force("crank").force,
        "joint_moment crank y": sol.joint_force("crank").moment[:, 1],
        "reaction crank": sol.joint_force("crank").force, f"force {spring.label}": strut.force,
        f"length {spring.label}": strut.length, f"speed {spring.label}": strut.speed, spring.label: strut.force,
        "torque crank": sol.torque("crank"), "power crank": sol.power("crank"), "lam rocker_ground": sol.lam,
        "rocker_ground": sol.lam, "energy": energy.total, "energy elastic": energy.elastic,
        "energy error": energy.error,
    }  # fmt: skip
    for quantity, values in expected.items():
        np.testing.assert_array_equal(sol.evaluate(quantity), values, err_msg=quantity)
    assert sol.evaluate("error q") == sol.error.q and sol.evaluate("peak energy error") == pytest.approx(
        energy.error[np.argmax(np.abs(energy.error))]
    )
    np.testing.assert_array_equal(sol.evaluate("final reaction rocker_ground"), pin_.force[-1])
    assert sol.evaluate("peak reaction rocker_ground") == pin_.peak().value


def test_a_saved_run_needs_its_mechanism(tmp_path):
    mech = driven()
    sol = pc.simulate(mech, (0.0, 0.5))
    loaded = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    assert loaded.evaluate("peak torque motor", mech) == pytest.approx(sol.evaluate("peak torque motor"), rel=1e-9)
    with pytest.raises(pc.InputError, match="needs its mechanism"):
        loaded.evaluate("peak torque motor")


def test_angles_that_store_cosine_and_sine_have_no_jumps():
    """Between rows, too: three and a half turns at constant speed."""
    mech = arm(pin.JointModelRUBY).with_gravity((0.0, 0.0, 0.0))
    sol = pc.simulate(mech, (0.0, 1.0), v0={"arm": 7 * np.pi})
    assert sol.evaluate("mean position arm") == pytest.approx(3.5 * np.pi, rel=1e-6)
    assert sol.evaluate("peak position arm") == pytest.approx(7 * np.pi, rel=1e-6)
    back = pc.simulate(mech, (1.0, 0.0), v0={"arm": 7 * np.pi})
    assert back.evaluate("min position arm") == pytest.approx(-7 * np.pi, rel=1e-6)


@pytest.mark.parametrize(
    ("quantity", "words"),
    [
        ("", "names no quantity"),
        ("peak", "no joint, loop, frame or force 'peak'"),
        ("peak reaction", "of what?"),
        ("peak position tip", "name one of them, as in 'position tip x'"),
        ("peak reaction arn", "no loop or joint 'arn'; similar: arm"),
        ("arn", "similar: arm"),
        ("velocity arm y", "a single number"),
        ("reaction arm w", "no part 'w'; its parts are x, y, z"),
        ("peak q arm at 1", "leave out the time"),
        ("q arm at noon", "'noon' is not a time"),
        ("q arm at nan", "not finite"),
        ("q arm at 3", "covers t = 0 to 1.8 s, not 3 s"),
        ("energy thermal", "energy is total, kinetic, potential, elastic, error"),
        ("energy error at 1", "at the rows of the solution only"),
        ("peak error q", "one number of the whole run"),
        ("length motor", "is a drive, not a force"),
    ],
)
def test_what_is_no_quantity(run, quantity, words):
    with pytest.raises(pc.InputError) as error:
        run.evaluate(quantity)
    assert words in str(error.value)


def swung(mech, theta, **options):
    """A run of the crank rocker with a spring, with an anchor and the speed of its crank by `theta`."""
    mech = mech.with_parameters({NAMES[0]: theta[0]})
    return pc.simulate(mech, (0.0, 0.3), v0={"crank": theta[1]}, rtol=1e-9, atol=1e-11, **options)


NAMES = "anchor:rocker_ground.xyz2[0]", "crank_speed"
SPRING = pc.SpringDamper("coupler", "universe", 50.0, 1.0, 0.5, xyz1=(0.3, 0, 0.1))
DIFFERENTIATED = (
    "peak reaction rocker_ground", "max energy kinetic", "rms joint_force coupler", "mean reaction rocker_ground",
    f"peak force {SPRING.label}", "rms v rocker", "reaction rocker_ground at 0.2", "final rocker_tip", "max v rocker",
    "peak joint_force crank", "crank at 0.21",
)  # fmt: skip


def test_derivatives_of_statistics_are_those_of_differences_of_runs():
    mech = pc.load("crank_rocker").with_forces(SPRING)
    found = pc.sensitivities(mech, list(NAMES), (0.0, 0.3), v0={"crank": 9.0})
    theta, expected = np.array(found.values), {name: [] for name in DIFFERENTIATED}
    for i, value in enumerate(theta):
        step = 3e-4 * value
        shifted = {m: swung(mech, theta + m * step * np.eye(2)[i]) for m in (-2, -1, 1, 2)}
        for name, rates in expected.items():
            f = {m: np.asarray(sol.evaluate(name)) for m, sol in shifted.items()}
            rates.append((8 * (f[1] - f[-1]) - (f[2] - f[-2])) / (12 * step))
    for name, rates in expected.items():
        exact = np.stack(rates, axis=-1)
        np.testing.assert_allclose(found.of(name), exact, atol=3e-6 * np.abs(exact).max(), err_msg=name)
    series = found.of("reaction rocker_ground")
    assert series.shape == (len(found.solution.t), 3, 2)
    np.testing.assert_allclose(series[-1], found.of("final reaction rocker_ground"), rtol=1e-12)


def test_a_peak_at_the_end_of_a_run_has_the_derivative_there():
    """Free fall: the speed grows until the end; the peak of the mass times it does, too."""
    found = pc.sensitivities(arm(), ["arm_speed"], (0.0, 0.1), q0={"arm": -1.0}, v0={"arm": 0.5})
    np.testing.assert_allclose(found.of("max v arm"), found.of("final v arm"), rtol=1e-9)


def test_times_of_events_are_not_ignored():
    """The speed at which the mass reaches the end is the peak, and its time depends on the start."""
    bottom = pc.Event(lambda t, q, v, lam: q[0] + 0.3, terminal=True, name="bottom")
    found = pc.sensitivities(arm(), ["arm"], (0.0, 3.0), q0={"arm": -1.0}, events=bottom)
    for quantity in ("max v arm", "final v arm", "mean v arm"):
        with pytest.raises(pc.InputError, match="event"):
            found.of(quantity)
    assert np.isfinite(found.of("v arm at 0.1")).all()
    for quantity in ("error q", "peak energy error"):
        with pytest.raises(pc.InputError, match="has no derivatives"):
            found.of(quantity)


@pytest.fixture
def command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


def test_columns_of_a_sweep(command):
    quantities = ("peak reaction rocker_ground", "rms v rocker", "final velocity rocker_tip", "q crank at 0.15")
    of = [word for quantity in quantities for word in ("--of", quantity)]
    sweep = ("sweep", "crank_rocker", "--vary", "crank_speed=5:7:1", "--until", "0.2", *of)
    code, _, err = command(*sweep, "--out", "t.csv")
    assert code == 0, err
    with open("t.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    for row in rows:
        sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.2), v0={"crank": float(row["crank_speed"])})
        for quantity in quantities:
            assert float(row[quantity]) == pytest.approx(np.linalg.norm(sol.evaluate(quantity)), rel=1e-9), quantity
    code, _, _ = command(*sweep, "--workers", "2", "--out", "u.csv")
    assert code == 0 and Path("u.csv").read_bytes() == Path("t.csv").read_bytes()


def test_a_run_that_ends_early_has_no_value_after_its_end_and_says_so(command):
    sweep = ("sweep", "four_bar", "--vary", "crank_speed=0,30", "--max-steps", "10", "--until", "0.3", "--json")
    told = json.loads(command(*sweep, "--of", "q crank at 0.3", "--of", "peak q crank")[1])
    first, second = (dict(zip(told["columns"], row, strict=True)) for row in told["rows"])
    assert first["q crank at 0.3"] == pytest.approx(first["q.crank"])
    assert second["q crank at 0.3"] is None and "not 0.3 s" in second["message"] and second["peak q crank"] is not None


def test_a_quantity_that_does_not_exist_is_refused_before_the_sweep(command):
    for quantity, words in (("peak reaction pin", "no loop or joint 'pin'"), ("position rocker_tip", "has 3 numbers")):
        code, out, err = command("sweep", "crank_rocker", "--vary", "crank=0,0.1", "--of", quantity)
        assert (code, out) == (2, "") and words in err


def test_the_sensitivity_of_a_peak(command):
    start = ("--until", "0.3", "--with-velocity", "crank=9")
    arguments = ("sensitivity", "crank_rocker", "--of", "peak reaction rocker_ground", "--to", "mass:coupler", *start)
    code, out, err = command(*arguments, "--json")
    told = json.loads(out)
    assert code == 0, err

    def peak(mass):
        mech = pc.load("crank_rocker").with_parameters({"mass:coupler": mass})
        sol = pc.simulate(mech, (0.0, 0.3), v0={"crank": 9.0}, rtol=1e-9, atol=1e-11)
        return sol.evaluate("peak reaction rocker_ground")

    (row,) = told["rows"]
    assert told["values"] == [pytest.approx(peak(row["value"]), rel=1e-6)]
    by = (peak(row["value"] + 1e-3) - peak(row["value"] - 1e-3)) / 2e-3
    assert row["derivatives"] == [pytest.approx(by, rel=1e-4)] and told["quantities"] == [told["of"]]
    code, out, _ = command(*arguments)
    assert code == 0 and "peak reaction rocker_ground of crank_rocker to t = 0.3 s is" in out


def test_the_torque_of_a_coupling_of_sums():
    """Rotors with q_one + 2 q_two = q_three: λ = (T / I₃) / (1/I₁ + 4/I₂ + 1/I₃) for a torque T on the third."""
    model, inertias = pin.Model(), {"one": 0.2, "two": 0.5, "three": 0.3}
    for name, inertia in inertias.items():
        joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
    gears = pc.Coupling("gears", {"one": 1.0, "two": 2.0}, "three")
    mech = pc.Mechanism(model, [gears], forces=[pc.JointTorque({"three": 1.5})])
    series = pc.simulate(mech, (0.0, 0.5)).series("torque gears")
    expected = (1.5 / inertias["three"]) / (1 / inertias["one"] + 4 / inertias["two"] + 1 / inertias["three"])
    np.testing.assert_allclose(series.values, expected, rtol=1e-9)
    assert series.unit == "N·m"
