"""Bodies of AMBF: joints with an axis and a pivot in each of two bodies."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.warned import told

import pinconsist as pc


def xyz(values):
    return "{" + ", ".join(f"{key}: {float(value)!r}" for key, value in zip("xyz", values, strict=True)) + "}"


def body(name, mass=1.0, place=None, more=""):
    place = place or pin.SE3.Identity()
    roll, pitch, yaw = map(float, pin.rpy.matrixToRpy(place.rotation))
    turn = f"{{r: {roll!r}, p: {pitch!r}, y: {yaw!r}}}"
    return f"""BODY {name}: {{name: {name}, mass: {mass}, location: {{position: {xyz(place.translation)},
  orientation: {turn}}}, {more}}}"""


def joint(name, parent, child, kind="revolute", axes=((0, 1, 0), (0, 1, 0)), pivots=((0, 0, 0), (0, 0, 0)), more=""):
    return f"""JOINT {name}: {{name: {name}, parent: BODY {parent}, child: BODY {child}, type: {kind},
  parent axis: {xyz(axes[0])}, child axis: {xyz(axes[1])}, parent pivot: {xyz(pivots[0])},
  child pivot: {xyz(pivots[1])}, {more}}}"""


HEAVY = "inertia: {ix: 0.1, iy: 0.2, iz: 0.3}"


@pytest.fixture
def scene(tmp_path):
    def written(*parts, more=""):
        keys = [part.partition(":")[0] for part in parts]
        bodies, joints = (", ".join(key for key in keys if key.startswith(word)) for word in ("BODY", "JOINT"))
        lists = f"bodies: [{bodies}]\njoints: [{joints}]\n"
        path = tmp_path / "scene.yaml"
        path.write_text(lists + more + "\n".join(parts) + "\n")
        return path

    return written


def poses(mech, q=None):
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, mech.guess if q is None else q)
    return {frame.name: data.oMf[i] for i, frame in enumerate(mech.model.frames)}


def about(axis, angle):
    return pin.AngleAxis(angle, np.array(axis) / np.linalg.norm(axis)).toRotationMatrix()


ONE, TWO = np.array([0.36, 0.48, 0.8]), np.array([0.8, -0.6, 0.0])


@pytest.mark.parametrize("kind", ["revolute", "prismatic", "p2p"])
def test_bodies_stand_at_their_locations(scene, kind):
    """Two bodies whose axes agree: at the start both stand as the file says, and the joint counts from its offset."""
    first = pin.SE3(about((1, 2, 3), 0.7), np.array([0.1, 0.2, 0.3]))
    smallest = about(np.cross(TWO, ONE), np.arccos(TWO @ ONE))
    position, offset, pivots = 0.4, 0.25, (np.array([0.5, 0, 0]), np.array([0, 0.2, 0.1]))
    turn = about(ONE, offset + (position if kind == "revolute" else 0.0)) @ smallest
    if kind == "p2p":
        turn = about((3, 1, 2), 1.1)
    slid = pivots[0] + (position * ONE if kind == "prismatic" else 0.0)
    second = first * pin.SE3(turn, slid - turn @ pivots[1])
    path = scene(
        body("a", 0.0, first), body("b", 1.0, second, HEAVY),
        joint("j", "a", "b", kind, (ONE, TWO), pivots, f"offset: {offset}"),
    )  # fmt: skip
    mech = pc.load(path)
    np.testing.assert_allclose(poses(mech)["b"].homogeneous, second.homogeneous, atol=1e-12)
    assert mech.nv == (3 if kind == "p2p" else 1)
    if kind != "p2p":
        assert mech.guess == pytest.approx([position], abs=1e-12)
        assert mech.actuated == ("j",)


def test_opposite_axes_turn_as_in_ambf(scene):
    """The half turn from (0, 0, 1) to (0, 0, -1) is about the cross product of the child's axis and x, which is y."""
    path = scene(body("a", 0.0), body("b", 1.0, more=HEAVY), joint("j", "a", "b", axes=((0, 0, -1), (0, 0, 1))))
    mech = pc.load(path)
    np.testing.assert_allclose(poses(mech, np.zeros(1))["b"].rotation, about((0, 1, 0), np.pi), atol=1e-12)


def test_springs_damping_limits(scene):
    spring = "stiffness: 3.0, damping: 0.5, joint limits: {low: -0.2, high: 0.6}"
    path = scene(body("a", 0.0), body("b", 1.0, more=HEAVY), joint("j", "a", "b", "torsion spring", more=spring))
    mech = pc.load(path)
    (found,) = (force for force in mech.forces if isinstance(force, pc.JointSpring))
    assert (found.stiffness, found.rest) == (3.0, pytest.approx(0.2)), "in the middle of the limits"
    assert mech.model.damping == pytest.approx([0.5]) and mech.actuated == ()
    assert (mech.model.lowerPositionLimit, mech.model.upperPositionLimit) == (-0.2, 0.6)


def test_an_inertia_of_the_collision_shape(scene):
    box = "collision shape: Box, collision geometry: {x: 0.2, y: 0.4, z: 0.6}"
    path = scene(body("a", 0.0), body("b", 3.0, more=box), joint("j", "a", "b"))
    inertia = pc.load(path).model.inertias[1].inertia
    np.testing.assert_allclose(np.diag(inertia), 3.0 / 12.0 * np.array([0.52, 0.4, 0.2]), rtol=1e-12)


def test_an_inertia_of_the_mesh(scene, tmp_path):
    corners = [(x, y, z) for x in (0.0, 0.2) for y in (0.0, 0.4) for z in (0.0, 0.6)]
    faces = [(1, 2, 4), (1, 4, 3), (5, 7, 8), (5, 8, 6), (1, 5, 6), (1, 6, 2), (3, 4, 8), (3, 8, 7), (1, 3, 7),
             (1, 7, 5), (2, 6, 8), (2, 8, 4)]  # fmt: skip
    lines = [f"v {x} {y} {z}" for x, y, z in corners] + [f"f {a} {b} {c}" for a, b, c in faces]
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "box.obj").write_text("\n".join(lines) + "\n")
    place = pin.SE3(np.eye(3), np.array([1.0, 0, 0]))
    parts = body("a", 0.0), body("b", 3.0, place, "mesh: box.obj"), joint("j", "a", "b", pivots=((1, 0, 0), (0, 0, 0)))
    inertia = pc.load(scene(*parts, more="high resolution path: meshes/\n")).model.inertias[1]
    np.testing.assert_allclose(np.diag(inertia.inertia), 3.0 / 12.0 * np.array([0.52, 0.4, 0.2]), rtol=1e-6)
    np.testing.assert_allclose(inertia.lever, [0.1, 0.2, 0.3], rtol=1e-6)


def test_without_a_shape_it_is_a_point(scene, recwarn):
    offset = "inertial offset: {position: {x: 0.5, y: 0, z: 0}}"
    inertia = pc.load(scene(body("a", 0.0), body("b", 3.0, more=offset), joint("j", "a", "b"))).model.inertias[1]
    assert "body 'b': it has neither an inertia nor a shape that can be read, and is a point of 3 kg" in told(recwarn)
    assert not inertia.inertia.any()
    np.testing.assert_allclose(inertia.lever, [0.5, 0, 0])


def test_gravity_of_one_body(scene):
    """Two bodies side by side, of which one is not pulled: only the other one falls."""
    path = scene(
        body("a", 0.0), body("b", 1.0, more=f"{HEAVY}, gravity: {xyz((0, 0, 0))}"), body("c", 2.0, more=HEAVY),
        joint("b slide", "a", "b", "prismatic", ((0, 0, 1),) * 2),
        joint("c slide", "a", "c", "slider", ((0, 0, 1),) * 2), more="gravity: {x: 0, y: 0, z: -2}\n",
    )  # fmt: skip
    sol = pc.simulate(pc.load(path), (0.0, 1.0))
    assert sol.position("b slide")[-1] == pytest.approx(0.0, abs=1e-9)
    assert sol.position("c slide")[-1] == pytest.approx(-1.0, abs=1e-6)


def test_a_body_held_by_two_others_closes_a_loop(scene):
    """A parallelogram of 1 m × 2 m: the coupler stays level, and its mobility is 1."""
    links = [("crank", 0.0), ("rocker", 2.0)]
    bars = [body(name, 1.0, pin.SE3(np.eye(3), np.array([x, 0, 0])), HEAVY) for name, x in links]
    path = scene(
        body("ground", 0.0), *bars, body("coupler", 1.0, pin.SE3(np.eye(3), np.array([0, 0, 1.0])), HEAVY),
        joint("j1", "ground", "crank"), joint("j2", "ground", "rocker", pivots=((2, 0, 0), (0, 0, 0))),
        joint("j3", "crank", "coupler", pivots=((0, 0, 1), (0, 0, 0))),
        joint("j4", "rocker", "coupler", pivots=((0, 0, 1), (2, 0, 0)), more="redundant: true"),
    )  # fmt: skip
    mech = pc.load(path)
    assert [loop.kind for loop in mech.loops] == ["hinge"] and pc.assemble(mech).mobility == 1
    sol = pc.simulate(mech, (0.0, 0.3), {"j1": 0.5, "j2": 0.5, "j3": -0.5})
    place = sol.frame("coupler")
    np.testing.assert_allclose(place.rotation[-1], np.eye(3), atol=1e-7)


def test_what_has_no_effect_is_said(scene):
    heavy = f"{HEAVY}, damping: {{linear: 0.1, angular: 0.1}}, mesh: b.stl, zgadget: 1"
    path = scene(body("a", 0.0), body("b", more=heavy), joint("j", "a", "b", more="zjoint: 2"), more="zfile: 3\n")
    unknown = {"1 <zgadget> of BODY", "1 <zjoint> of JOINT", "1 <zfile>"}
    assert {"1 body damping", "1 collision shape", *unknown} <= {*pc.load(path).ignored}


WRONG = {
    "soft bodies": ("soft bodies: [SOFT BODY s]\n", r"SOFT BODY s: soft bodies are not .*ignore=\['soft bodies'\]"),
    "a type": (joint("k", "a", "b", "six dof"), r"joint 'k': the type 'six dof' is not one of .*ignore=\['k'\] loads"),
    "a body": (joint("k", "a", "c"), "joint 'k': there is no child 'BODY c'"),
    "an axis": (joint("k", "a", "b", axes=((0, 0, 0), (0, 0, 1))), "joint 'k': parent axis: it is the zero vector"),
    "itself": (joint("k", "a", "a"), "joint 'k': parent and child are the same body 'a'"),
    "no mapping": ("JOINT k: 3", "JOINT k: it is listed, but there is no mapping 'JOINT k'"),
    "a mass": (body("d", -1.0), "body 'd': the mass is negative: -1 kg"),
    "a place": ("BODY d: {name: d, mass: 1, location: {position: 3}}", "body 'd': location: position: 3 is not {x:"),
}


@pytest.mark.parametrize("case", WRONG)
def test_wrong_files(scene, case):
    part, message = WRONG[case]
    parts = (body("a", 0.0), body("b", more=HEAVY), joint("j", "a", "b"))
    path = scene(*parts, more=part) if part.startswith("soft") else scene(*parts, part)
    with pytest.raises(pc.FormatError, match=rf"scene\.yaml: {message}"):
        pc.load(path)
    if part.startswith("soft"):
        assert pc.load(path, ignore=["soft bodies"]).joints == ("j",)


def test_a_joint_between_bodies_that_are_fixed_to_each_other(scene, recwarn):
    path = scene(
        body("a", 0.0), body("b", more=HEAVY), body("c", more=HEAVY), joint("j", "a", "b"),
        joint("f", "b", "c", "fixed"), joint("g", "c", "b", "fixed"),
    )  # fmt: skip
    assert pc.load(path).loops == ()
    assert "joint 'g' has no effect: 'c' and 'b' do not move relatively" in told(recwarn)


def test_other_yaml_files_are_no_scenes(tmp_path):
    (tmp_path / "robot.yaml").write_text("loops: []\n")
    with pytest.raises(pc.FormatError, match=r"A loop file is read with its robot.*--loops robot\.yaml"):
        pc.load(tmp_path / "robot.yaml")
