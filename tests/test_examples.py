"""Every example runs, and its number is the one it should be: closed forms, benchmarks and hand-derived equations."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers import zoo
from helpers.bodies import circles_meet
from helpers.extras import skips_missing_extras
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, least_squares, minimize
from scipy.special import ellipj

import pinconsist as pc
from benchmarks.gradient_reference import differences, reference

EXAMPLES = Path(__file__).parents[1] / "examples"
G = 9.81


def module(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    loaded = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(loaded)
    return loaded


def four_bar():
    """scipy in the crank's angle alone."""
    start = pc.assemble(pc.load("four_bar")).q
    return zoo.reduced_solution(zoo.FourBar(), start, 0.0, [0.0, 5.0])[0][-1, 0]


def motor_torque():
    """Inverse dynamics by hand at the example's 601 times: virtual work of inertia and weight along the crank."""
    linkage = zoo.SliderCrank((0.6, 1.8, 1.0))
    (l1, l2), rate, torques = linkage.l, 10.0, []
    for crank in np.linspace(-1.0, 5.0, 601):
        rod = np.arcsin(-l1 / l2 * np.sin(crank))  # the piston stays on its line
        x = np.array([crank, rod, l1 * np.cos(crank) + l2 * np.cos(rod)])
        C = linkage.jacobian(x)
        k = np.concatenate(([1.0], -np.linalg.solve(C[:, 1:], C[:, 0])))
        kd = np.concatenate(([0.0], -np.linalg.solve(C[:, 1:], linkage.jacobian_rate(x, k * rate) @ k)))
        torques.append(k @ (linkage.mass(x) @ kd * rate + linkage.bias(x, k * rate)))
    return np.abs(torques).max()


def tension():
    """Two rods, a bar and a spring in their absolute angles, index 1, by scipy."""
    lengths, masses, pivots = np.array([1.0, 0.8]), np.array([2.0, 1.0]), np.array([[0, 0], [1.5, 0]])
    inertias, L = masses * lengths**2 / 3, 1.2

    def geometry(a):
        tips = pivots + np.array([length * zoo.e(angle) for length, angle in zip(lengths, a, strict=True)])
        turns = np.array([length * zoo.de(angle) for length, angle in zip(lengths, a, strict=True)])
        return tips, turns

    def loads(a, w):
        tips, turns = geometry(a)
        d = tips[1] - tips[0]
        J = np.array([-d @ turns[0], d @ turns[1]]) / L  # of (|d|² - L²) / (2 L)
        arm = np.array([0, 1.0]) - tips[0]  # the spring pulls the left tip towards (0, 1)
        n = np.linalg.norm(arm)
        speed = -arm @ turns[0] * w[0] / n  # at which it grows
        pull = 50.0 * (n - 0.5) + 2.0 * speed
        weight = G * masses * lengths / 2 * np.cos(a)
        push = weight + np.array([pull * arm @ turns[0] / n, 0.0])
        dd = turns[1] * w[1] - turns[0] * w[0]
        bend = -lengths[1] * zoo.e(a[1]) * w[1] ** 2 + lengths[0] * zoo.e(a[0]) * w[0] ** 2
        lam = -(J @ (push / inertias) + (dd @ dd + d @ bend) / L) / (J @ (J / inertias))
        return (push + J * lam) / inertias, lam

    _, sol = module("04_own_mechanism").run()
    start = np.concatenate((sol.q[0], [0.0, 0.0]))
    assert np.linalg.norm(np.subtract(*geometry(start[:2])[0])) == pytest.approx(L, abs=1e-13)
    end = solve_ivp(
        lambda t, y: np.concatenate((y[2:], loads(y[:2], y[2:])[0])), (0, 3), start, "DOP853", rtol=1e-12, atol=1e-12
    ).y[:, -1]
    return -loads(end[:2], end[2:])[1]


def ballistic_angle():
    """Angular momentum about the hinge through the catch, energy afterwards."""
    length, rod, ball, speed = 1.0, 2.0, 0.5, 6.0
    inertia = (rod / 3 + ball) * length**2
    spin = ball * speed * length / inertia
    return np.arccos(1 - inertia * spin**2 / 2 / ((rod / 2 + ball) * G * length))


def grip():
    """Virtual work: the motor's angle and the width between the pads, which two cranks share."""
    bar, palm, ball, torque = 0.06, 0.015, 0.05, 0.3
    lean = np.arcsin((ball / 2 - palm) / bar)
    return torque / (2 * bar * np.cos(lean))


def platform():
    """The platform's centre lies 0.6 m from three elbows (shifted by its radius): where three spheres meet."""
    reach = 0.0
    for t in np.linspace(0, 1, 101):
        centres = []
        for turn in (0, 2 * np.pi / 3, 4 * np.pi / 3):
            angle = 0.3 + 0.25 * np.sin(2 * np.pi * t + turn)
            out = 0.2 + 0.25 * np.cos(angle) - 0.05
            centres.append([out * np.cos(turn), out * np.sin(turn), -0.25 * np.sin(angle)])
        a, b, c = np.array(centres)
        normal = np.cross(b - a, c - a)
        foot = np.linalg.solve(
            [b - a, c - a, normal], [(b @ b - a @ a) / 2, (c @ c - a @ a) / 2, normal @ a]
        )  # equally far from all three, in their plane
        normal *= -np.sign(normal[2]) / np.linalg.norm(normal)  # the platform hangs below
        place = foot + normal * np.sqrt(0.6**2 - (foot - a) @ (foot - a))
        reach = max(reach, np.hypot(*place[:2]))
    return reach


def stride():
    """The foot by intersections of circles about known points, at the example's 121 times."""

    path, pivot = [], np.array([-0.38, -0.078])
    for turn in np.linspace(0, 2 * np.pi, 121):
        crank = 0.15 * np.array([np.cos(turn), np.sin(turn)])
        Q, S = circles_meet(crank, 0.5, pivot, 0.415, False), circles_meet(crank, 0.619, pivot, 0.393, True)
        T = circles_meet(circles_meet(pivot, 0.401, Q, 0.558, True), 0.394, S, 0.367, False)
        path.append(circles_meet(T, 0.657, S, 0.49, False))
    return np.ptp(np.array(path)[:, 0])


def mean_angle():
    """The pendulum's motion by elliptic functions: sin(a/2) = k cd(w t, k²), w² = 3 g / (2 L)."""
    k = np.sin(np.random.default_rng(0).normal(1.0, 0.3, 24) / 2)
    _, cn, dn, _ = ellipj(np.sqrt(1.5 * G) * 3.0 + 0 * k, k**2)
    return np.mean(2 * np.arcsin(k * cn / dn))


def parallelogram(torque, period, count):
    """(angle, speed) of two rods and one that they carry, 1 m and 1 kg each, under torques that are held."""
    inertia, angle, speed = 2 / 3 + 1.0, 0.0, 0.0
    for _ in range(count):
        rate = torque(angle, speed) / inertia
        angle, speed = angle + period * speed + 0.5 * period**2 * rate, speed + period * rate
    return angle, speed


def sampled_angle():
    return parallelogram(lambda angle, speed: 200.0 * (0.5 - angle) - 20.0 * speed, 1e-2, 50)[0]


def motor_speed():
    """The motor's current by the exact solution at constant speed, too."""
    currents = [0.0]

    def torque(angle, speed):
        final = (24.0 - speed) / 2.0
        currents.append(final + (currents[-1] - final) * np.exp(-2.0 / 5e-3 * 1e-3))
        return currents[-2]

    return parallelogram(torque, 1e-3, 200)[1]


def height_at_rest():
    """Where the weights of platform, barrels and rods and six springs have the least potential energy."""
    apart = np.hypot(0.4890738003669028 - 0.2007391819076575, 0.2229434476432182 - 0.1039558454088797)

    def energy(h):
        length = np.hypot(apart, h)
        legs = 6 * G * (0.2 + 0.5 * (length - 0.2)) * h / length
        return 6 * G * h + legs + 6 * 0.5 * 2e4 * (length - 0.676) ** 2

    return brentq(lambda h: energy(h + 1e-5) - energy(h - 1e-5), 0.5, 0.7, xtol=1e-14)


def sum_of_rewards():
    """The policy on the closed form; only the target is the environment's."""
    target, calls = module("23_gymnasium").run()[1][2], []

    def torque(angle, speed):
        calls.append((angle, speed))
        return 20.0 * np.clip(2.0 * (target - angle) - 0.5 * speed, -1.0, 1.0)

    calls.append(parallelogram(torque, 0.02, 50))
    return sum(-((target - angle) ** 2) - 0.01 * speed**2 for angle, speed in calls[1:])


def end_of_the_crank():
    """The left elbow is 0.25 m from its motor and 2 x 0.3 m from the right elbow, the distal links in line."""
    motor, right = np.array([-0.1, 0.0]), np.array([0.1 + 0.25 * np.cos(-0.8), 0.25 * np.sin(0.8)])
    elbow = circles_meet(motor, 0.25, right, 0.6, left=True)
    return -np.arctan2(*(elbow - motor)[::-1])  # angles are positive downwards


def mass_by_reference_runs():
    """Gauss and Newton's way from the true values, with DOP853 and differences of its runs."""
    example = module("19_identification")
    angles, x, times = example.measurements(), example.TRUE.copy(), np.append(0.0, example.TIMES)
    for _ in range(3):
        mech = example.MECH.with_parameters(dict(zip(example.NAMES, x, strict=True)))
        q = reference(mech, None, {"crank": 12.0}, times)[1][0]
        J = differences(mech, example.NAMES, times, None, {"crank": 12.0})[0]
        apart = (angles - q[1:, example.MEASURED]).ravel()
        x += np.linalg.lstsq(J[1:, example.MEASURED].reshape(len(apart), -1), apart, rcond=None)[0]
    return x[0]


def least_peak():
    """Forces of the motion that the motor gives are linear in the stiffness and in stiffness times rest."""
    example, springs = module("20_spring_size"), [(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)]
    lam = []
    for spring in springs:
        mech = example.MECH.with_parameters(dict(zip(example.NAMES, spring, strict=True)))
        lam.append(pc.inverse_dynamics(mech, example.TIMES).lam[:, example.PIN])

    def peak(x):
        forces = lam[0] + x[0] * (lam[1] - lam[0]) + x[1] * (lam[2] - lam[1])
        return np.linalg.norm(forces, axis=1).max()

    x = np.array([25.0, -45.0])
    for _ in range(4):
        x = minimize(peak, x, method="Nelder-Mead", options={"xatol": 1e-9, "fatol": 1e-10, "maxiter": 800}).x
    return peak(x)


def top_of_the_four_bar():
    """The crank angle where weight does no work on the closed linkage."""
    linkage, x = zoo.FourBar(), zoo.FourBar.T @ module("21_swing_up").ABOVE

    def work(angle):
        x[0] = angle
        for _ in range(50):
            x[1:] -= np.linalg.solve(linkage.jacobian(x)[:, 1:], linkage.constraint(x))
        C = linkage.jacobian(x)
        return linkage.bias(x, np.zeros(3)) @ np.append(1.0, -np.linalg.solve(C[:, 1:], C[:, 0]))

    return brentq(work, 4.6, 5.0, xtol=1e-12)


def spheres():
    """The same calibration with the closure by scipy: six rods of fixed length between balls, poses by Pinocchio."""
    example = module("26_kinematic_calibration")
    model, platform = example.MECH.model, [example.MECH.columns(f"platform_{each}").start for each in
                                           ("x", "y", "z", "yaw", "pitch", "roll")]  # fmt: skip
    data, rods = model.createData(), list(example.LOOPS)
    arms = [example.MECH.columns(f"leg{i}_arm").start for i in (1, 2, 3)]
    swings = [model.getJointId(f"{rod}_swing") for rod in rods]
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    tips = [data.oMi[swing].actInv(data.oMf[model.getFrameId(f"{rod}_tip")].translation)
            for swing, rod in zip(swings, rods, strict=True)]  # fmt: skip
    guess = example.closed(example.DRAWN)[1]

    def gaps(pose, q, tip, anchors, centres):
        q[platform] = pose
        pin.framesForwardKinematics(model, data, q)
        there = data.oMf[model.getFrameId("platform")]
        rods = zip(anchors, centres, tip, strict=True)
        return [np.linalg.norm(there.act(a) - centre) - np.linalg.norm(end) for a, centre, end in rods]

    def positions(x):
        ends = {rod: {"xyz1": np.zeros(3), "xyz2": np.array(example.LOOPS[rod].xyz2)} for rod in rods}
        for value, (rod, end, axis) in zip(x, example.ANCHORS, strict=True):
            ends[rod][end][axis] = value
        tip = [each + ends[rod]["xyz1"] for each, rod in zip(tips, rods, strict=True)]
        anchors, found = [ends[rod]["xyz2"] for rod in rods], []
        for start, motors in zip(guess, example.MOTORS, strict=True):
            q = start.copy()
            q[arms] = motors
            pin.framesForwardKinematics(model, data, q)
            centres = [data.oMi[swing].translation.copy() for swing in swings]
            pose = q[platform]
            for _ in range(6):  # Newton's method with differences
                at = np.array(gaps(pose, q, tip, anchors, centres))
                beside = [gaps(pose + unit, q, tip, anchors, centres) for unit in 1e-7 * np.eye(6)]
                pose = pose - np.linalg.solve((np.array(beside) - at).T / 1e-7, at)
            found.append(pose[:3])
        return np.array(found)

    exact = example.closed(example.BUILT)[1][:, example.PLATFORM]
    np.testing.assert_allclose(positions(example.BUILT), exact, rtol=0, atol=1e-10)
    measured = exact + example.NOISE * example.RNG.normal(size=exact.shape)
    fit = least_squares(lambda x: (positions(x) - measured).ravel() / example.NOISE, example.DRAWN, diff_step=1e-4,
                        x_scale=1e-3, max_nfev=4)  # fmt: skip
    deviations = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    return np.abs((fit.x - example.BUILT) / deviations).max()


def tip_of_the_five_bar():
    """The left elbow is where circles about the motor and the tip meet."""
    target, motor = module("29_pink").TARGET, np.array([-0.1, 0.0])
    elbow = circles_meet(motor, 0.25, target[[0, 2]], 0.35, left=True)
    return -np.arctan2(*(elbow - motor)[::-1])  # angles are positive downwards


def mean_of_returns():
    """The policy on the closed form of each linkage: the coupler moves in parallel, (1/3 + 1/3 + m) L² a'' = torque."""
    *_, targets, masses = module("30_vector_environment").run()[1]
    angle, speed, total = 0.0 * targets, 0.0 * targets, 0.0
    for _ in range(50):
        torque = 20.0 * np.clip(2.0 * (targets - angle) - 0.5 * speed, -1.0, 1.0)
        a = torque / (2.0 / 3.0 + masses)
        angle, speed = angle + 0.02 * speed + 0.5 * 0.02**2 * a, speed + 0.02 * a
        total = total - (targets - angle) ** 2 - 0.01 * speed**2
    return total.mean()


def end_of_the_boom():
    """Virtual work: the weights' potential by the length of the boom's cylinder, with that of the arm at its end."""
    at = module("34_excavator")
    bases = {part: complex(*place) for part, place in at.BASES.items()}

    def corner(part, hinge, length):
        """The angle at a hinge between the base of a cylinder and the pin of its rod, by their triangle."""
        base, lever = abs(bases[part] - hinge), abs(at.PINS[part])
        return np.arccos((base**2 + lever**2 - length**2) / (2 * base * lever))

    arm = np.angle(bases["arm"] - at.BOOM) - corner("arm", at.BOOM, at.ENDS["arm"][1]) - np.pi

    def energy(length):
        turned = np.exp(1j * (np.angle(bases["boom"]) + corner("boom", 0.0, length)))
        tip, along = at.BOOM * turned, turned * np.exp(1j * arm)
        weights = at.MASSES["boom"] * 0.5 * tip + at.MASSES["arm"] * (tip + 0.5 * at.ARM * along)
        cylinders = (bases["boom"], at.PINS["boom"] * turned), (bases["arm"] * turned, tip + at.PINS["arm"] * along)
        for base, end in cylinders:
            way = 0.4 * (end - base) / abs(end - base)
            weights += at.MASSES["barrel"] * (base + way) + at.MASSES["rod"] * (end - way)
        return G * weights.imag

    length, step = at.ENDS["boom"][0], 1e-5
    return (energy(length + step) - energy(length - step)) / (2 * step)


ANSWERS = {  # number or how it is found, relative tolerance: that of the run
    "01_exact_and_consistent": (8.0120e-3, 5e-5),  # Arévalo (2008), table 5.1, five digits
    "02_four_bar": (four_bar, 1e-7),
    "03_driven_slider_crank": (motor_torque, 1e-6),
    "04_own_mechanism": (tension, 1e-5),
    "05_events": (ballistic_angle, 1e-7),
    "06_pendulum": (-16.0, 1e-6),  # λ = -4 (1+t)²
    "07_andrews": (15.8107711, 1e-6),  # test set for IVP solvers
    "08_bricard": (-1.2212468949563, 1e-6),  # IFToMM, problem A04
    "09_delta_robot": (platform, 1e-6),
    "10_cassie": (-G, 1e-4),
    "11_gripper": (grip, 1e-6),
    "12_strandbeest": (stride, 1e-6),
    "13_own_dae": (0.3739110272652214, 1e-5),  # test set for IVP solvers
    "14_ensemble": (mean_angle, 1e-5),
    "15_linearisation": (np.sqrt(6 * G / 5), 1e-9),  # (1/3 + 1/3 + 1) L² a'' = -(1/2 + 1/2 + 1) g L a
    "16_sampled_pd": (sampled_angle, 1e-7),
    "17_cosimulation": (motor_speed, 1e-7),
    "18_five_bar_workspace": (end_of_the_crank, 1e-6),
    "19_identification": (mass_by_reference_runs, 1e-5),
    "20_spring_size": (least_peak, 1e-5),
    "21_swing_up": (top_of_the_four_bar, 1e-3),
    "22_stewart_control": (height_at_rest, 1e-6),
    "23_gymnasium": (sum_of_rewards, 1e-6),
    "24_fmu": (sum(5.0 * i / 200 for i in range(200)) * 1e-3 / (5 / 3), 1e-9),  # held torques; (1/3 + 1/3 + 1) L² a''
    "25_ilqr": (-np.pi, 1e-3),  # upright: the goal itself
    "26_kinematic_calibration": (spheres, 1e-2),
    "27_held_identification": (0.37, 1e-2),  # the true mass, three standard deviations
    "28_crocoddyl": (lambda: module("28_crocoddyl").GOAL[0], 1e-4),  # the goal itself
    "29_pink": (tip_of_the_five_bar, 1e-6),
    "30_vector_environment": (mean_of_returns, 1e-6),
    "31_standing_leg": ((4.0 + 4 * 0.2) * G, 1e-6),  # the weight
    "32_clutch": (100.0 / (10.0 / 0.2 + 10.0 / 0.5), 1e-9),  # both turn alike
    "33_cam": (np.arccos(-(8.0 + 400.0 * 0.01) / ((0.5 * 60.0**2 - 400.0) * 0.01)), 1e-7),  # m e Ω² cos φ = -spring
    "34_excavator": (end_of_the_boom, 1e-7),
    "35_grip_and_lift": (0.3 * G, 1e-6),  # the weight
    "36_hopping_leg": (-G, 1e-6),
    "37_biped": ((6.0 + 8 * 0.2) * G, 1e-6),  # the weight
}
LONGER = {"23_gymnasium": 100, "25_ilqr": 80, "28_crocoddyl": 80, "30_vector_environment": 80}  # lines


def test_all_examples_are_here():
    assert sorted(path.stem for path in EXAMPLES.glob("[0-9]*.py")) == sorted(ANSWERS)


@pytest.mark.parametrize("name", ANSWERS)
def test_example(name):
    with skips_missing_extras():
        number = module(name).main()
    answer, tolerance = ANSWERS[name]
    assert number == pytest.approx(answer() if callable(answer) else answer, rel=tolerance)


@pytest.mark.parametrize("name", ANSWERS)
def test_example_is_short_and_in_the_gallery(name):
    assert len((EXAMPLES / f"{name}.py").read_text().splitlines()) <= LONGER.get(name, 60)
    gallery, picture = (EXAMPLES / "README.md").read_text(), EXAMPLES / "pictures" / f"{name}.png"
    assert f"({name}.py)" in gallery and f"(pictures/{name}.png)" in gallery
    assert 2_000 < picture.stat().st_size < 60_000


def test_pictures_can_be_made(tmp_path):
    """One that needs no browser."""
    pytest.importorskip("matplotlib")
    picture = module("pictures").make("06_pendulum", tmp_path)
    assert picture == tmp_path / "06_pendulum.png" and picture.read_bytes().startswith(b"\x89PNG")


def test_the_notebook_runs_and_its_derivative_is_that_of_its_table(capsys):
    """As a reader runs it, cell by cell; it is kept without outputs, which would be megabytes."""
    cells = json.loads((EXAMPLES / "design_study.ipynb").read_text(encoding="utf-8"))["cells"]
    names = {}
    for cell in (cell for cell in cells if cell["cell_type"] == "code"):
        assert not cell["outputs"] and cell["execution_count"] is None
        exec("".join(cell["source"]), names)
    assert "ok" in capsys.readouterr().out
    below, above = (outcome.value for outcome in names["outcomes"][2:])
    assert names["by"][0] == pytest.approx((above - below) / 0.02, rel=1e-2)
    shown = names["sol"]._repr_mimebundle_()
    assert "<iframe srcdoc=" in shown["text/html"] and shown["text/plain"].startswith("Solution of crank_rocker")
