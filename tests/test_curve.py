"""Motion laws by tables, in code and in files, against closed forms."""

from __future__ import annotations

from fractions import Fraction
from math import cos, pi, sin

import numpy as np
import pinocchio as pin
import pytest
import yaml
from scipy.interpolate import CubicSpline

import pinconsist as pc

TIMES, VALUES = (0.1, 0.4, 0.5, 1.1), (0.2, -0.3, 0.1, 0.1)
MASS = 2.0


def normed(law, s):
    """Value, rate and acceleration of a law from 0 to 1."""
    if law == "step5":
        return 6 * s**5 - 15 * s**4 + 10 * s**3, 30 * s**2 * (1 - s) ** 2, 60 * s * (1 - s) * (1 - 2 * s)
    if law == "cycloid":
        return s - sin(2 * pi * s) / (2 * pi), 1 - cos(2 * pi * s), 2 * pi * sin(2 * pi * s)
    return s, 1.0, 0.0


def expected(law, t):
    """What a curve through the table is at a time inside."""
    if law == "spline":
        spline = CubicSpline(TIMES, VALUES, bc_type="clamped")
        return [float(spline(t, order)) for order in range(3)]
    i = int(np.searchsorted(TIMES, t)) - 1
    length, rise = TIMES[i + 1] - TIMES[i], VALUES[i + 1] - VALUES[i]
    value, rate, acceleration = normed(law, (t - TIMES[i]) / length)
    return [VALUES[i] + rise * value, rise / length * rate, rise / length**2 * acceleration]


@pytest.mark.parametrize("law", ["spline", "step5", "cycloid", "table"])
def test_curves_are_their_closed_forms(law):
    curve = pc.Curve(TIMES, VALUES, law)
    for t in np.random.default_rng(0).uniform(TIMES[0], TIMES[-1], 200):
        mine = curve(t), curve.rate(t), curve.acceleration(t)
        np.testing.assert_allclose(mine, expected(law, t), rtol=1e-12, atol=1e-11)
    for outside, value in ((0.0, VALUES[0]), (2.0, VALUES[-1])):
        assert (curve(outside), curve.rate(outside), curve.acceleration(outside)) == (value, 0.0, 0.0)
    for t, value in zip(TIMES, VALUES, strict=True):
        assert curve(t) == pytest.approx(value, abs=1e-15)
        if law in ("step5", "cycloid"):
            assert curve.rate(t) == curve.acceleration(t) == pytest.approx(0.0, abs=1e-12)


def test_step5_in_rational_numbers():
    """At a third: 10/27 - 15/81 + 6/243 = 17/81."""
    s = Fraction(1, 3)
    exact = 10 * s**3 - 15 * s**4 + 6 * s**5
    assert exact == Fraction(17, 81) and pc.Curve((0, 3), (0, 81), "step5")(1.0) == pytest.approx(17.0, rel=1e-15)


@pytest.fixture
def cart():
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    free = model.addJoint(0, pin.JointModelPY(), pin.SE3.Identity(), "free")
    model.appendBodyToJoint(free, pin.Inertia(MASS, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return lambda curve: pc.Mechanism(model, [pc.Drive("motor", "slide", curve)], name="cart")


@pytest.mark.parametrize("method", ["BDF", "Radau"])
@pytest.mark.parametrize("law", ["spline", "step5", "cycloid"])
def test_a_drive_follows_its_law_with_the_force_of_its_mass(cart, law, method):
    curve = pc.Curve(TIMES, VALUES, law)
    sol = pc.simulate(cart(curve), (0.0, 1.5), method=method)
    assert sol.success and set(TIMES) <= set(sol.t)
    largest = MASS * max(abs(expected(law, t)[2]) for t in np.linspace(TIMES[0] + 1e-9, TIMES[-1], 1000))
    away = [i for i, t in enumerate(sol.t) if min(abs(t - each) for each in TIMES) > 1e-9]
    for i in away:
        t = sol.t[i]
        inside = TIMES[0] < t < TIMES[-1]
        q, v, a = expected(law, t) if inside else (VALUES[0] if t < 1 else VALUES[-1], 0.0, 0.0)
        assert sol.q[i, 0] == pytest.approx(q, abs=1e-12)
        assert sol.v[i, 0] == pytest.approx(v, abs=1e-10)
        assert sol.lam[i, 0] == pytest.approx(MASS * a, abs=1e-6 * largest)  # rtol of the run


def test_straight_lines_act_as_impulses_at_their_bends(cart):
    sol = pc.simulate(cart(pc.Curve(TIMES, VALUES, "table")), (0.0, 1.5))
    doubled = np.flatnonzero(np.diff(sol.t) == 0.0)
    np.testing.assert_allclose(sol.t[doubled], TIMES)
    slopes = np.array([0.0, *np.diff(VALUES) / np.diff(TIMES), 0.0])
    np.testing.assert_allclose(sol.v[doubled, 0], slopes[:-1], atol=1e-10)
    np.testing.assert_allclose(sol.v[doubled + 1, 0], slopes[1:], atol=1e-10)
    np.testing.assert_allclose(sol.q[:, 0], np.interp(sol.t, TIMES, VALUES), atol=1e-12)
    assert np.abs(sol.lam).max() < 1e-6  # between the impulses it moves without force


# In files ------------------------------------------------------------------------------------------------------------

TABLE = f"times: {list(TIMES)}, values: {list(VALUES)}"


def loaded(tmp_path, text):
    pc.write(pc.load("four_bar"), tmp_path / "bars.urdf")
    record = yaml.safe_load((tmp_path / "bars.yaml").read_text())
    added = yaml.safe_load(text)
    for key in ("loops", "forces"):
        record[key] = (record.get(key) or []) + added.get(key, [])
    (tmp_path / "bars.yaml").write_text(yaml.safe_dump(record))
    return pc.load(tmp_path / "bars.urdf")


@pytest.mark.parametrize("law", ["spline", "step5", "cycloid", "table"])
def test_a_law_in_a_file_is_read_and_written_back(tmp_path, law):
    drive = f"loops: [{{name: m, kind: drive, joint: crank, curve: {{law: {law}, {TABLE}}}}}]"
    curve = pc.Curve(TIMES, VALUES, law)
    mech = loaded(tmp_path, drive)
    assert mech.loops[-1] == pc.Drive("m", "crank", curve)
    again = pc.load(pc.write(mech, tmp_path / "again.urdf"))
    assert again.loops[-1] == mech.loops[-1]


def test_sine_is_a_motion(tmp_path):
    drive = (
        "loops: [{name: m, kind: drive, joint: crank, curve: {law: sine, amplitude: 0.2, frequency: 1.5, start: -1}}]"
    )
    mech = loaded(tmp_path, drive)
    assert mech.loops[-1] == pc.Drive("m", "crank", pc.Motion(start=-1.0, amplitude=0.2, frequency=1.5))
    assert pc.load(pc.write(mech, tmp_path / "again.urdf")).loops == mech.loops


def test_forces_by_laws(tmp_path):
    forces = f"""forces:
- {{kind: servo, joint: crank, target: {{law: step5, {TABLE}}}, stiffness: 100, damping: 5}}
- {{kind: torque, torques: {{rocker: {{law: table, {TABLE}}}}}}}
"""
    mech = loaded(tmp_path, forces)
    step5, table = (pc.Curve(TIMES, VALUES, law) for law in ("step5", "table"))
    assert mech.forces == (pc.Servo("crank", step5, 100.0, 5.0), pc.JointTorque({"rocker": table}))
    assert pc.load(pc.write(mech, tmp_path / "again.urdf")).forces == mech.forces
    sol = pc.simulate(mech, (0.0, 1.2))
    other = pc.simulate(
        pc.load("four_bar").with_forces(
            pc.Servo("crank", lambda t: step5(t), 100.0, 5.0, rate=lambda t: step5.rate(t)),
            pc.JointTorque({"rocker": lambda t: float(np.interp(t, TIMES, VALUES))}),
        ),
        (0.0, 1.2), rtol=1e-9, atol=1e-11,
    )  # fmt: skip
    np.testing.assert_allclose(sol.q[-1], other.q[-1], atol=1e-4)


BAD = {
    "unknown": ("{law: step7, times: [0, 1], values: [0, 1]}", "unknown law 'step7'; choose from sine, spline, step5"),
    "no law": ("{times: [0, 1], values: [0, 1]}", "'law' is missing; choose from spline"),
    "no values": ("{law: step5, times: [0, 1]}", "'values' is missing"),
    "order": ("{law: step5, times: [0, 1, 1], values: [0, 1, 2]}", "the times of a table must increase"),
    "lengths": ("{law: cycloid, times: [0, 1, 2], values: [0, 1]}", "two rows of the same length"),
    "nan": ("{law: table, times: [0, .nan], values: [0, 1]}", "a finite number is needed"),
    "key": ("{law: step5, times: [0, 1], values: [0, 1], start: 2}", "the key 'start' is not known"),
    "sine": ("{law: sine, times: [0, 1]}", "the key 'times' is not known"),
    "nothing": ("{law: sine}", "a motion needs one or more of"),
    "a list": ("[0, 1]", "keys such as law, times, values are needed"),
}


@pytest.mark.parametrize(("curve", "told"), BAD.values(), ids=BAD)
def test_bad_laws_are_named(tmp_path, curve, told):
    with pytest.raises(pc.FormatError, match=told) as caught:
        loaded(tmp_path, f"loops: [{{name: m, kind: drive, joint: crank, curve: {curve}}}]")
    assert "bars.yaml" in str(caught.value) and "'m'" in str(caught.value)


def test_bad_curves_are_named():
    for arguments, told in (
        (((0, 1), (0, 1), "line"), "curve: law='line' is not one of 'spline', 'step5', 'cycloid', 'table'"),
        (((1, 0), (0, 1)), "curve: the times of a table must increase"),
        (((0, 1), (0, float("inf"))), "not finite"),
        (((0,), (0,)), "at least 2"),
    ):
        with pytest.raises(pc.InputError, match=told):
            pc.Curve(*arguments)


def test_bdf_goes_on_behind_a_knot_where_all_is_driven():
    """The velocity before the knot is that of the other piece; from there no step passed the error test."""
    law = pc.Curve((0.1, 0.4, 0.5, 1.1), (-1.0, -0.8, -0.9, -0.5))
    mech = pc.load("four_bar").add_loops(pc.Drive("d", "crank", law))
    sol = pc.simulate(mech, (0.0, 1.2), method="BDF")
    assert sol.success, sol.message
    np.testing.assert_allclose(sol.q[:, 0], [law(t) for t in sol.t], atol=1e-9)


@pytest.mark.parametrize("law", ["spline", "step5", "table"])
def test_values_of_curves_are_parameters(law):
    mech = pc.load("planar_pendulum").with_loops(
        pc.Drive("motor", "pendulum", pc.Curve((0.0, 0.5, 1.0), (0.0, 0.2, 0.1), law))
    )
    other = mech.with_parameters({"motor.curve.values.1": 0.3})
    assert other.loops[0].curve.values == (0.0, 0.3, 0.1) and mech.loops[0].curve.values == (0.0, 0.2, 0.1)
    if law != "table":  # whose rates jump
        sol = pc.simulate(other, (0.0, 1.0), t_eval=[0.5])
        np.testing.assert_allclose(sol.q[-1], 0.3, atol=1e-8)


def test_tables_of_commands_are_written(tmp_path):
    motor = pc.Actuator("motor", "pendulum", control=pc.Curve((0.0, 0.4, 1.0), (0.0, 2.0, -1.0), "table"))
    mech = pc.load("planar_pendulum").with_forces(motor)
    as_table = mech.with_control({"motor": ((0.0, 0.4, 1.0), (0.0, 2.0, -1.0))})
    assert as_table.forces == mech.forces  # a curve of straight lines is the table
    back = pc.load(pc.write(as_table, tmp_path / "m.urdf"))
    assert back.forces == mech.forces
    ours, theirs = (pc.simulate(each, (0.0, 1.0), t_eval=[0.3, 0.7, 1.0]) for each in (mech, back))
    np.testing.assert_array_equal(ours.q, theirs.q)
