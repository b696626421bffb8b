"""The shipped scenes: their data by hand formulas, their mobility, and their motion against geometry and benchmarks."""

import pickle
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import circles_meet
from helpers.scenes import ANDREWS_JOINTS, on_stage

import pinconsist as pc
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.run.scene_source import SceneSource

MODELS = Path(__file__).resolve().parents[1] / "models"
G = 9.81

SCENES = {  # name: (nv, rows, rank, mobility without drives)
    "andrews": (7, 9, 6, 1),
    "bricard": (5, 5, 4, 1),
    "crank_rocker": (3, 5, 2, 1),
    "delta_robot": (21, 18, 18, 3),
    "double_pendulum": (2, 0, 0, 2),
    "five_bar": (4, 5, 2, 2),
    "flyball_governor": (6, 11, 5, 2),
    "four_bar": (3, 5, 2, 1),
    "jansen_leg": (7, 16, 7, 1),
    "planar_pendulum": (1, 0, 0, 1),
    "slider_crank": (3, 5, 2, 1),
    "stewart_platform": (24, 18, 18, 6),
    "chain_2": (2, 5, 2, 0),
    "chain_3": (3, 5, 2, 1),
    "chain_16": (16, 5, 2, 14),
    "n_four_bar_1": (3, 5, 2, 1),
    "n_four_bar_2": (5, 10, 4, 1),
    "n_four_bar_7": (15, 35, 14, 1),
}
UNTIL = {"andrews": 0.03}


def frame(mech, q, name):
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    return data.oMf[mech.model.getFrameId(name)]


# --- all of them


def test_every_built_in_name_is_looked_at_here():
    forms = {name.rstrip("0123456789") for name in SCENES if name[-1].isdigit()}
    files = {name for name in SCENES if not name[-1].isdigit()}
    assert set(pc.models()) == files | {f"{form}<n>" for form in forms}
    assert files == {path.stem for path in MODELS.glob("*.urdf")} == {path.stem for path in MODELS.glob("*.yaml")}
    assert all(text and "\n" not in text and len(text) < 120 for text in pc.models().values())


@pytest.mark.parametrize("name", SCENES)
def test_assembles_where_it_is_and_has_the_known_mobility(name):
    mech = pc.load(name)
    found = pc.assemble(mech)
    assert found.moved < 1e-14 and found.largest_gap[1] < 1e-14
    nv, rows, rank, mobility = SCENES[name]
    assert (mech.nv, found.rows, found.rank) == (nv, rows, rank)
    assert pc.assemble(mech.with_loops(*mech.anchored_loops)).mobility == mobility
    again = pickle.loads(pickle.dumps(mech))
    assert (again.name, again.loops, again.geometry) == (name, mech.loops, mech.geometry) or name in (
        "flyball_governor", "jansen_leg",  # drives compare by identity
    )  # fmt: skip


@pytest.mark.parametrize("name", SCENES)
def test_runs_at_the_default_tolerances(name):
    v0 = {"crank0": 1.0} if name.startswith("n_four_bar") else None
    sol = pc.simulate(pc.load(name), (0.0, UNTIL.get(name, 1.0)), v0=v0)
    assert sol.success, sol.message
    certificate = sol.check(error=False)
    assert certificate.position < 1e-12 and certificate.velocity < 1e-6
    if name != "chain_2":  # that does not move
        assert sol.energy().balance_error < 1e-4 and certificate.energy_error < 1e-3 and certificate.force < 1e-3
        assert np.abs(sol.v).max() > 0.1 or name == "chain_3"  # in equilibrium by symmetry


# --- masses and inertias of the files, by hand


def rod(length, mass, radius, start=0.0):
    """Uniform and slender, along x from `start`."""
    across = mass * length**2 / 12
    return mass, (start + length / 2, 0, 0), (mass * radius**2 / 2, across, across)


def cylinder(radius, height, mass, com=(0, 0, 0)):
    """Solid, along z."""
    across = mass * (3 * radius**2 + height**2) / 12
    return mass, com, (across, across, mass * radius**2 / 2)


def three_rods(a, b, c):
    """1 kg/m along the sides of a triangle with corners at 0, (a, 0) and at distances b, c from these; in x, z."""
    x = (a**2 + b**2 - c**2) / (2 * a)
    corners = np.array([(0, 0), (a, 0), (x, np.sqrt(b**2 - x**2))])
    ends = [(corners[i], corners[j]) for i, j in ((0, 1), (0, 2), (1, 2))]
    masses = [np.linalg.norm(q - p) for p, q in ends]
    com = sum(m * (p + q) / 2 for m, (p, q) in zip(masses, ends, strict=True)) / sum(masses)
    # ∫ r rᵀ dm of a rod from p to q: m (p pᵀ + q qᵀ + (p+q)(p+q)ᵀ)/6
    second = sum(
        m * (np.outer(p, p) + np.outer(q, q) + np.outer(p + q, p + q)) / 6
        for m, (p, q) in zip(masses, ends - com, strict=True)
    )
    full = np.array([[second[1, 1], 0, -second[0, 1]], [0, np.trace(second), 0], [-second[0, 1], 0, second[0, 0]]])
    return sum(masses), (com[0], 0, com[1]), full


def lamina(mass, x, y, inertia):
    return mass, (x, y, 0), (inertia / 2, inertia / 2, inertia)


def beam(axis, sign):
    """1 kg, 1 m along an axis, 0.1 m across."""
    along = np.arange(3) == "xyz".index(axis)
    return 1.0, sign * along / 2, np.where(along, 0.02, 1.01) / 12


BARS = [("x", 1), ("y", -1), ("z", 1), ("x", -1), ("y", 1)]
BODIES = {
    "andrews": {
        "K1": lamina(0.04325, 0.00092, 0, 2.194e-6),
        "K2": lamina(0.00365, -0.0115, 0, 4.410e-7),
        "K3": lamina(0.02373, 0.01043, -0.01874, 5.255e-6),
        "K4": lamina(0.00706, 0, 0.01421 - 0.02, 5.667e-7),
        "K5": lamina(0.07050, 0.02308, 0.00916, 1.169e-5),
        "K6": lamina(0.00706, 0.02 - 0.01421, 0, 5.667e-7),
        "K7": lamina(0.05498, -0.00449, -0.01228, 1.912e-5),
    },
    "bricard": {f"rod{i}": beam(axis, sign) for i, (axis, sign) in enumerate(BARS)},
    "delta_robot": {
        **{f"leg{i}_arm_bar": rod(0.25, 0.4, 0.015) for i in (1, 2, 3)},
        **{f"leg{i}_{side}_rod": rod(0.6, 0.06, 0.006) for i in (1, 2, 3) for side in ("left", "right")},
        "platform": cylinder(0.05, 0.02, 0.25),
    },
    "stewart_platform": {
        **{f"leg{i}_barrel": rod(0.4, 1.0, 0.02) for i in range(1, 7)},
        **{f"leg{i}_rod": rod(0.4, 0.5, 0.01, start=-0.4) for i in range(1, 7)},
        "platform": cylinder(0.32, 0.04, 6.0),
    },
    "flyball_governor": {
        **{f"{side}_{bar}_bar": rod(0.2, 0.05, 0.005) for side in ("left", "right") for bar in ("arm", "link")},
        **{f"{side}_ball": (0.5, (0, 0, 0), (0.4 * 0.5 * 0.03**2,) * 3) for side in ("left", "right")},
        "shaft_bar": cylinder(0.008, 0.5, 1.0, (0, 0, -0.2)),
        "collar_sleeve": cylinder(0.03, 0.05, 1.0),
    },
    "jansen_leg": {
        **{f"{bar}_bar": rod(l, l, 0.01) for bar, l in (("crank", 0.15), ("j", 0.5), ("k", 0.619))},
        **{f"{bar}_bar": rod(l, l, 0.01) for bar, l in (("c", 0.393), ("f", 0.394))},
        "upper_triangle": three_rods(0.415, 0.401, 0.558),
        "lower_triangle": three_rods(0.49, 0.367, 0.657),
    },
}  # fmt: skip


@pytest.mark.parametrize("name", BODIES)
def test_inertias_are_those_of_the_shapes(name):
    links = {link.get("name"): link for link in ElementTree.parse(MODELS / f"{name}.urdf").iter("link")}
    assert {link for link in links if links[link].find("inertial") is not None} == set(BODIES[name])
    for link, (mass, com, inertia) in BODIES[name].items():
        given = links[link].find("inertial")
        origin, tensor = given.find("origin"), given.find("inertia")
        place = np.zeros(3) if origin is None else np.array(origin.get("xyz").split(), float)
        xx, xy, xz, yy, yz, zz = (float(tensor.get(f"i{key}")) for key in ("xx", "xy", "xz", "yy", "yz", "zz"))
        found, expected = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]), np.array(inertia, float)
        if link == "lower_triangle":  # its third corner lies below its side i
            com, expected = np.array(com) * (1, 1, -1), expected * [[1, 1, -1], [1, 1, 1], [-1, 1, 1]]
        assert float(given.find("mass").get("value")) == pytest.approx(mass, rel=1e-14)
        np.testing.assert_allclose(place, com, atol=1e-15, err_msg=link)
        expected = np.diag(expected) if expected.ndim == 1 else expected
        np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-16, err_msg=link)


# --- one by one


def test_andrews_starts_with_the_benchmarks_multipliers():
    mech = pc.load("andrews")
    assert not mech.model.gravity.linear.any() and set(mech.joints) == set(ANDREWS_JOINTS)
    lam = pc.simulate(mech, (0.0, 1e-6)).lam[0].reshape(3, 3)
    rotation = on_stage(mech.model, mech.guess, "E2").rotation
    on_bodies = np.array([(rotation @ force)[:2] for force in lam]).ravel()
    np.testing.assert_allclose(on_bodies, [98.5668703962410896, -6.12268834425566266, 0, 0, 0, 0], atol=1e-9)


def test_bricard_starts_with_the_benchmarks_energy_and_singular_values():
    mech = pc.load("bricard")
    J = MechanismSystem(mech, mech.guess).loop_rows(mech.guess)[1]
    np.testing.assert_allclose(np.linalg.svd(J, compute_uv=False), [1.902, 1.902, 1.176, 1.176, 0], atol=5e-4)
    energy = pin.computePotentialEnergy(mech.model, mech.model.createData(), mech.guess)
    assert energy == pytest.approx(-29.43, abs=1e-12)
    points = [(1, 0, 0), (1, -1, 0), (1, -1, 1), (0, -1, 1), (0, 0, 1)]
    for i, point in enumerate(points, start=1):
        np.testing.assert_allclose(on_stage(mech.model, mech.guess, f"P{i}").translation, point, atol=1e-15)


def test_delta_platform_stays_level_and_is_where_three_spheres_meet():
    mech = pc.load("delta_robot")
    sol = pc.simulate(mech, (0.0, 1.0))
    axes = [mech.columns(f"platform_{axis}").start for axis in ("x", "y", "z", "yaw", "pitch", "roll")]
    assert np.abs(sol.q[:, axes[3:]]).max() < 1e-12 and np.ptp(sol.q[:, axes[0]]) > 0.1
    for q in sol.q[::10]:
        for leg, turn in enumerate((0, 2 * np.pi / 3, 4 * np.pi / 3), start=1):
            angle = q[mech.columns(f"leg{leg}_arm")][0]
            out = np.array([np.cos(turn), np.sin(turn), 0])
            elbow = (0.2 + 0.25 * np.cos(angle) - 0.05) * out - (0, 0, 0.25 * np.sin(angle))
            assert np.linalg.norm(q[axes[:3]] - elbow) == pytest.approx(0.6, abs=1e-12)


def test_stewart_legs_are_as_long_as_they_say():
    mech = pc.load("stewart_platform")
    sol = pc.simulate(mech, (0.0, 1.0))
    poses = [frame(mech, q, "platform") for q in sol.q]
    assert max(np.linalg.norm(pin.log3(pose.rotation)) for pose in poses) > 0.05  # it wobbles
    for leg in range(6):
        base = 2 * np.pi * (leg // 2) / 3 + np.radians((-12, 12)[leg % 2])
        top = 2 * np.pi * (leg // 2) / 3 + np.radians((-48, 48)[leg % 2])
        foot, ball = 0.5 * np.array([np.cos(base), np.sin(base), 0]), 0.3 * np.array([np.cos(top), np.sin(top), 0])
        lengths = [np.linalg.norm(pose.act(ball) - foot) for pose in poses]
        column = mech.model.idx_qs[mech.joint_index(f"leg{leg + 1}_length")]
        np.testing.assert_allclose(sol.q[:, column], lengths, atol=1e-12)


@pytest.mark.parametrize("speed", [14.0, 16.0, 20.0])
def test_governor_settles_at_porters_angle(speed):
    """Where weight and spin balance: d/da of g Σ m z - speed²/2 I vanishes, I being the inertia about the shaft.

    At the angle a below the horizontal Σ m z = -l sin a (4 bar + 2 ball + 2 collar) and
    I = l² cos² a (4 bar/3 + 2 ball) + 2 bar radius² sin² a and what does not depend on a.
    """
    mech = pc.load("flyball_governor")
    drive = pc.Drive("motor", "shaft", pc.Motion(speed=speed))
    mech = mech.with_loops(*mech.anchored_loops, drive)
    sol = pc.simulate(mech, (0.0, 6.0), rtol=1e-8, atol=1e-8)
    l, bar, ball, collar, radius = 0.2, 0.05, 0.5, 1.0, 0.005
    spin = l**2 * (4 * bar / 3 + 2 * ball) - 2 * bar * radius**2
    angle = np.arcsin(G * l * (4 * bar + 2 * ball + 2 * collar) / (speed**2 * spin))
    found = sol.q[-1, mech.columns("left_arm")][0]
    assert np.abs(sol.v[-1, mech.columns("collar")]).max() < 1e-7  # settled
    assert found == pytest.approx(angle, abs=1e-7)
    assert sol.q[-1, mech.columns("collar")][0] == pytest.approx(-2 * l * np.sin(found), abs=1e-12)


def jansen_foot(phi):
    """The foot for a crank angle from x to z, by circles about known points (numbers in m)."""

    pivot, pin_ = np.array([-0.38, -0.078]), 0.15 * np.array([np.cos(phi), np.sin(phi)])
    Q, S = circles_meet(pin_, 0.5, pivot, 0.415, False), circles_meet(pin_, 0.619, pivot, 0.393, True)
    R = circles_meet(pivot, 0.401, Q, 0.558, True)
    T = circles_meet(R, 0.394, S, 0.367, False)
    return circles_meet(T, 0.657, S, 0.49, False)


def test_jansen_walks():
    mech, times = pc.load("jansen_leg"), np.linspace(0, 1, 121)
    for run in (pc.simulate(mech, (0.0, 1.0)), pc.inverse_dynamics(mech, times)):
        foot = np.array([frame(mech, q, "foot").translation for q in run.q])
        expected = np.array([jansen_foot(-2 * np.pi * t) for t in run.t])
        np.testing.assert_allclose(foot[:, [0, 2]], expected, atol=1e-13)
        np.testing.assert_allclose(foot[:, 1], 0, atol=1e-14)
    stride, lift = np.ptp(foot[:, 0]), np.ptp(foot[:, 2])
    ground = foot[:, 2] < foot[:, 2].min() + 0.1 * lift
    assert stride == pytest.approx(0.679, abs=1e-3) and lift == pytest.approx(0.225, abs=1e-3)
    assert ground.mean() > 0.5  # it stands for more than half of a turn, and moves evenly then:
    speed = np.abs(np.gradient(foot[:, 0], times))[ground][3:-3]
    assert np.median(speed) == pytest.approx(2 * stride, rel=0.1)


# --- families


def test_chains_hang_in_an_arc_of_any_size():
    for n in (2, 3, 10, 101):
        mech = pc.load(f"chain_{n}")
        data = mech.model.createData()
        pin.forwardKinematics(mech.model, data, mech.guess)
        ends = np.vstack(([pose.translation for pose in data.oMi[1:]], [0.6 * n, 0, 0]))
        np.testing.assert_allclose(np.linalg.norm(np.diff(ends, axis=0), axis=1), 1.0, atol=1e-13 * n)
        middle = np.array([0.3 * n, 0, 0])
        centre = np.linalg.lstsq(2 * (ends[1:] - ends[0])[:, [0, 2]], np.sum(ends[1:] ** 2, axis=1), rcond=None)[0]
        assert centre[0] == pytest.approx(middle[0]) and ends[n // 2][2] < 0
        np.testing.assert_allclose(np.hypot(*(ends[:, [0, 2]] - centre).T), np.hypot(*centre), rtol=1e-12)


def test_double_four_bar_keeps_its_branch():
    """The full test over ten seconds stands in test_adaptive.py."""
    mech = pc.load("n_four_bar_2")
    sol = pc.simulate(mech, (0.0, 2.0), v0={"crank0": 1.0}, rtol=1e-9, atol=1e-9)
    b0 = frame(mech, sol.q[0], "coupler0_bar").translation
    np.testing.assert_allclose(b0, (0, 0, 1), atol=1e-15)
    assert sol.q[-1, 0] == pytest.approx(6.341033361312, abs=1e-7)


def test_options_of_files_hold_for_families(tmp_path):
    assert pc.load("n_four_bar_2", closure="point").loops[0].kind == "point"
    assert pc.load("chain_3", free_flyer=True).joints[0] == "root_joint"
    other = tmp_path / "other.yaml"
    other.write_text("loops: [{name: high, kind: point, frame1: rod2, frame2: universe, xyz2: [1, 0, 1]}]\n")
    assert [loop.name for loop in pc.load("chain_3", loops=other).loops] == ["high"]
    assert pc.load("chain_3").geometry.urdf.count("<visual>") == 2 + 2 * 3


@pytest.mark.parametrize(
    ("name", "says"),
    {
        "chain_1": "chain_<n> needs a number from 2 to",
        "n_four_bar_0": "n_four_bar_<n> needs a number from 1 to",
        "chain_99999999999999999999": "needs a number from 2 to",
        "chain": "similar: chain_<n>",
        "chain_x": "Built-in models: .*chain_<n>",
        "chian_16": "similar: chain_<n>",
        "chain_٣": "neither a built-in model",
    }.items(),
)
def test_numbers_that_a_family_does_not_have(name, says):
    with pytest.raises(pc.InputError, match=says):
        pc.load(name)


def test_a_run_remembers_a_family_by_its_name(tmp_path):
    recorded = SceneSource("chain_5").record(tmp_path / "run.npz")
    assert recorded["source"] == "chain_5"
    assert SceneSource.recorded(recorded, tmp_path / "run.npz").load().name == "chain_5"
