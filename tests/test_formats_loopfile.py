"""Loop files in both conventions, and the joints they replace."""

import pickle
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers.urdf_texts import BAR, CHAIN, A, B, C, joint, write
from helpers.warned import told

import pinconsist as pc
from pinconsist.errors import FormatError
from pinconsist.formats import load
from pinconsist.mechanism.closing import LoopSolver


@pytest.fixture
def robot(tmp_path):
    return partial(write, tmp_path)


@pytest.mark.parametrize("key", ["actuated", "name_mot"])
def test_motors_are_named_beside_loops(robot, tmp_path, key):
    path = robot(CHAIN)
    (tmp_path / "robot.yml").write_text(f"loops: [{{name: far, kind: point, frame1: c}}]\n{key}: [k]")
    mech = load(path)
    assert mech.actuated == ("k",) and [loop.name for loop in mech.loops] == ["far"]


# Loop files -----------------------------------------------------------------------------------------------------------


def test_loop_file_lies_beside_the_robot_or_is_given(robot, tmp_path):
    path = robot(CHAIN)
    assert load(path).loops == ()
    (tmp_path / "robot.yml").write_text("loops: [{name: far, kind: point, frame1: c}]")
    assert [loop.name for loop in load(path).loops] == ["far"]
    (tmp_path / "scene.yaml").write_text("loops: [{name: beside, kind: point, frame1: c}]")
    assert [loop.name for loop in load(tmp_path).loops] == ["beside"]
    assert [loop.name for loop in load(path, loops=str(tmp_path / "robot.yml")).loops] == ["far"]


def test_every_field_of_a_loop_reaches_the_loop(robot):
    text = """{name: n, kind: hinge, frame1: c, frame2: a, xyz1: [1, 2, 3e-1], rpy1: [4, 5, 6], xyz2: [7, 8, 9],
      rpy2: [1, 0, 1], axis: [0, 2, 0]}"""
    (loop,) = load(robot(CHAIN, f"loops:\n  - {text}\nguess: {{j: 1.5}}\nactuated: [k]")).loops
    assert (loop.frame1, loop.frame2, loop.kind, loop.axis) == ("c", "a", "hinge", (0, 2, 0))
    assert (loop.xyz1, loop.rpy1, loop.xyz2, loop.rpy2) == ((1, 2, 0.3), (4, 5, 6), (7, 8, 9), (1, 0, 1))


@pytest.mark.parametrize("kind", ["revolute", "fixed"])
def test_a_link_and_its_joint_may_share_a_name(robot, kind):
    """As in exported files: both stand in one place, so that the name means it, in loops and in forces."""
    inside = '<origin xyz="1 0.1 0.2" rpy="0.3 0 0.2"/><axis xyz="0 1 1"/>'
    loops = "loops: [{{name: n, kind: point, frame1: {0}}}]\nforces: [{{kind: wrench, frame: {0}, force: [0, 0, 1]}}]"
    chain = A + B + C + joint()
    named, other = (load(robot(chain + joint(name, "b", "c", kind, inside), loops.format("c"))) for name in ("c", "k"))
    for mech in (named, other):
        assert mech.loops[0].frame1 == "c" and len(mech.forces) == 1
    q = np.full(other.nq, 0.3)
    systems = [LoopSolver(mech) for mech in (named, other)]
    np.testing.assert_array_equal(*(solver.rows(q)[1] for solver in systems))


def test_a_field_of_another_kind_is_refused(robot):
    text = "{name: n, kind: hinge, frame1: c, axis: [0, 1, 0], length: 0.3}"
    with pytest.raises(FormatError, match="loop 1 'n': a loop of kind 'hinge' has no length, which is for distance"):
        load(robot(CHAIN, f"loops: [{text}]"))


def test_duration(robot):
    assert load(robot(CHAIN, "duration: 0.03")).duration == 0.03
    assert load(robot(CHAIN, "guess: {k: 1.5}")).duration == load("four_bar").duration == 5.0
    assert load("andrews").duration == 0.03


def test_guess_and_actuated(robot):
    mech = load(robot(CHAIN, "guess: {k: 1.5}\nactuated: [k]"))
    assert mech.actuated == ("k",)
    np.testing.assert_array_equal(mech.guess, [0, 1.5])


@pytest.mark.parametrize(
    ("pair", "name"),
    [
        (("closedloop1_A", "closedloop1_B"), "closedloop1"),
        (("closedloop6D_1B", "closedloop6D_1A"), "closedloop6D_1"),
        (("left_foot", "left_toe"), "left_foot-left_toe"),
        (("A", "B"), "A-B"),
    ],
)
def test_loops_of_robot_yaml_are_named_after_their_frames(robot, pair, name):
    body = A + "".join(f'<link name="{frame}"/>' + joint(f"j{frame}", "a", frame) for frame in pair)
    (loop,) = load(robot(body, f"closed_loop: [{list(pair)}]\ntype: [3D]")).loops
    assert (loop.name, loop.kind) == (name, "point")
    twice = load(robot(body, f"closed_loop: [{list(pair)}, {list(pair)}, {list(pair)}]")).loops
    assert len({loop.name for loop in twice}) == 3 and {loop.kind for loop in twice} == {"frame"}


def test_unknown_keys_of_robot_yaml_are_logged(robot, recwarn):
    load(robot(CHAIN, "closed_loop: []\nrotule_name: to_rotule"))
    assert "rotule_name" in told(recwarn)


# Replaced joints ------------------------------------------------------------------------------------------------------

THREE = (
    CHAIN
    + f'<link name="d">{BAR}</link><link name="e">{BAR}</link>'
    + joint("l", "c", "d", inside='<origin xyz="0.5 0.5 0" rpy="1 0 0"/><axis xyz="1 0 0"/>')
    + joint("m", "b", "e", inside='<origin xyz="0 0.2 0.4"/><axis xyz="0 1 0"/>')
).replace('<axis xyz="0 1 1"/>', '<axis xyz="0 1 1"/><dynamics damping="0.5" friction="0.25"/>')


def by_hand(kinds):
    """The tree THREE with joint k made of the given Pinocchio joints."""
    model, rpy = pin.Model(), pin.rpy.rpyToMatrix
    inertia = pin.Inertia(1.0, np.array([0.5, 0, 0]), np.diag([0.01, 0.09, 0.08]))
    j = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "j")
    last, place = j, pin.SE3(rpy(0.3, 0, 0.2), np.array([1, 0.1, 0.2]))
    for kind in kinds:
        last, place = model.addJoint(last, kind, place, f"k{last}"), pin.SE3.Identity()
    l = model.addJoint(last, pin.JointModelRX(), pin.SE3(rpy(1, 0, 0), np.array([0.5, 0.5, 0])), "l")
    m = model.addJoint(j, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0, 0.2, 0.4])), "m")
    for body in (j, last, l, m):
        model.inertias[body] = inertia
    return model


@pytest.mark.parametrize(
    ("kind", "joints", "nq"),
    [
        ("SPHERICAL", [pin.JointModelSpherical()], 7),
        ("ujoint_xy", [pin.JointModelRX(), pin.JointModelRY()], 5),
        ("UJOINT_ZX", [pin.JointModelRZ(), pin.JointModelRX()], 5),
        ("CARDAN", [pin.JointModelRX(), pin.JointModelRY()], 5),
    ],
)
def test_replaced_joint_has_the_right_dynamics(robot, kind, joints, nq):
    loops = f"closed_loop: [[k, l]]\njoint_name: [k]\njoint_type: [{kind}]\nname_mot: [k]"
    mech = load(robot(THREE, loops))
    plain = load(robot(THREE, name="plain"))
    model, hand = mech.model, by_hand(joints)
    assert model.nq == nq
    assert mech.actuated == (("k",) if kind == "SPHERICAL" else tuple(f"k_{joint.shortname()[-1]}" for joint in joints))
    before = [frame.name for frame in plain.model.frames]
    assert [frame.name for frame in model.frames][: len(before)] == before  # those of the new joints follow
    own = slice(1, model.nv - 2)  # velocities of k: j comes before, l and m after
    np.testing.assert_array_equal(model.damping[own], 0.5)
    np.testing.assert_array_equal(model.upperDryFrictionLimit[own], 0.25)
    assert not model.damping[own.stop :].any()

    rng = np.random.default_rng(5)
    q = pin.integrate(model, pin.neutral(model), rng.normal(size=model.nv))
    v, a = rng.normal(size=(2, model.nv))
    data, zero = model.createData(), np.zeros(model.nv)
    np.testing.assert_allclose(pin.rnea(model, data, q, v, a), pin.rnea(hand, hand.createData(), q, v, a), atol=1e-12)

    rest = pin.rnea(model, data, q, zero, zero)
    columns = np.column_stack([pin.rnea(model, data, q, zero, e) - rest for e in np.eye(model.nv)])
    mass = np.triu(pin.crba(model, data, q))
    np.testing.assert_allclose(mass + np.triu(mass, 1).T, columns, atol=1e-12)

    by_q, by_v, _ = (part.copy() for part in pin.computeRNEADerivatives(model, data, q, v, a))
    for i, e in enumerate(1e-6 * np.eye(model.nv)):
        forth, back = (pin.rnea(model, data, pin.integrate(model, q, s * e), v, a) for s in (1, -1))
        np.testing.assert_allclose(by_q[:, i], (forth - back) / 2e-6, atol=1e-7)
        forth, back = (pin.rnea(model, data, q, v + s * e, a) for s in (1, -1))
        np.testing.assert_allclose(by_v[:, i], (forth - back) / 2e-6, atol=1e-7)


def test_fixed_joint_is_the_tree_held_at_zero(robot):
    mech = load(robot(THREE, "joint_name: [k]\njoint_type: [FIXED]"))
    whole = load(robot(THREE, name="plain")).model
    held = pin.buildReducedModel(whole, [whole.getJointId("k")], pin.neutral(whole))
    assert mech.joints == ("j", "l", "m")
    q, v, a = np.random.default_rng(1).normal(size=(3, 3))
    expected = pin.rnea(held, held.createData(), q, v, a)
    np.testing.assert_allclose(pin.rnea(mech.model, mech.model.createData(), q, v, a), expected, atol=1e-12)


def test_replacement_that_clashes_or_does_not_apply(robot):
    with pytest.raises(FormatError, match="joint 'k': only hinges and sliders"):
        load(
            robot(
                THREE.replace('"k" type="revolute"', '"k" type="floating"'), "joint_name: [k]\njoint_type: [SPHERICAL]"
            )
        )
    with pytest.raises(FormatError, match="joint 'k_X': a new joint has the name of an existing"):
        load(robot(THREE.replace('"m"', '"k_X"'), "joint_name: [k]\njoint_type: [UJOINT_XY]"))


# Records of the project's own convention ------------------------------------------------------------------------------

LOOPS = """
loops:
  - {name: hinge, kind: hinge, frame1: c, axis: [0, 1, 0]}
  - {name: slider, kind: slider, frame1: c, frame2: a, axis: [0, 0, 2], rpy2: [0.1, 0, 0]}
  - {name: cylinder, kind: cylinder, frame1: c, axis: [1, 0, 0]}
  - {name: plane, kind: plane, frame1: c, axis: [1, 0, 1], xyz1: [0, 0, 0.5]}
  - {name: universal, kind: universal, frame1: c, axis: [1, 0, 0], axis2: [0, 1, 0]}
  - {name: rod, kind: distance, frame1: c, length: 1.5}
  - {name: gears, kind: coupling, joint: k, other: j, ratio: -2, offset: 0.1, higher: [0.5, 1e-2]}
  - {name: motor, kind: drive, joint: j, start: -1, speed: 3.0, amplitude: 0.2, frequency: 1.5, phase: 0.3}
"""


def test_records_of_every_kind_of_loop(robot):
    assert load(robot(CHAIN, LOOPS)).loops == (
        pc.Loop("hinge", "hinge", "c", axis=(0, 1, 0)),
        pc.Loop("slider", "slider", "c", "a", axis=(0, 0, 2), rpy2=(0.1, 0, 0)),
        pc.Loop("cylinder", "cylinder", "c", axis=(1, 0, 0)),
        pc.Loop("plane", "plane", "c", axis=(1, 0, 1), xyz1=(0, 0, 0.5)),
        pc.Loop("universal", "universal", "c", axis=(1, 0, 0), axis2=(0, 1, 0)),
        pc.Loop("rod", "distance", "c", length=1.5),
        pc.Coupling("gears", "k", "j", -2, 0.1, (0.5, 0.01)),
        pc.Drive("motor", "j", pc.Motion(-1, 3, 0.2, 1.5, 0.3)),
    )


def test_a_motion_has_its_derivatives():
    motion, h = pc.Motion(-1.0, 3.0, 0.2, 1.5, 0.3), 1e-5
    assert motion(0.7) == -1.0 + 3.0 * 0.7 + 0.2 * np.sin(3 * np.pi * 0.7 + 0.3)
    for t in (0.0, 0.7):
        assert (motion(t + h) - motion(t - h)) / (2 * h) == pytest.approx(motion.rate(t), abs=1e-8)
        assert (motion.rate(t + h) - motion.rate(t - h)) / (2 * h) == pytest.approx(motion.acceleration(t), abs=1e-7)


FORCES = """
forces:
  - {kind: damping, coefficients: {j: 0.4, k: [0.2]}}
  - {kind: friction, coefficients: {k: 0.5}, width: 5e-1}
  - {kind: spring, joint: k, stiffness: 6, rest: -1.0}
  - {kind: spring-damper, frame1: c, frame2: a, stiffness: 20, length: 0.8, damping: 1.5, xyz1: [0.5, 0, 0],
     xyz2: [1, 0, 1]}
  - {kind: torque, torques: {j: 3.0, k: {start: 0.5, amplitude: 2, frequency: 0.5}}}
  - {kind: servo, joint: k, target: {start: 0.6, speed: 0.2}, stiffness: 12.0, damping: 0.7}
  - {kind: servo, joint: j, target: 0.25, stiffness: 2.0}
  - {kind: wrench, frame: c, force: [3, 0, -2], moment: [0, 0.4, 0]}
  - {kind: wrench, frame: b, force: [2, 0, 1], axes: local, xyz: [-1, 0, 0.1]}
"""


def test_forces_of_a_file_are_those_of_code(robot):
    """Wave and ramp as functions in code: the same motion to rounding."""
    by_file = load(robot(CHAIN, FORCES))
    forces = [
        pc.JointDamping({"j": 0.4, "k": (0.2,)}),
        pc.JointFriction({"k": 0.5}, 0.5),
        pc.JointSpring("k", 6.0, -1.0),
        pc.SpringDamper("c", "a", 20.0, 0.8, 1.5, (0.5, 0.0, 0.0), (1.0, 0.0, 1.0)),
        {"j": 3.0, "k": lambda t: 0.5 + 2 * np.sin(np.pi * t)},
        pc.Servo("k", lambda t: 0.6 + 0.2 * t, 12.0, 0.7, lambda t: 0.2),
        pc.Servo("j", 0.25, 2.0),
        pc.Wrench("c", (3, 0, -2), (0, 0.4, 0)),
        pc.Wrench("b", (2, 0, 1), axes="local", xyz=(-1, 0, 0.1)),
    ]
    assert by_file.forces[:4] == tuple(forces[:4]) and by_file.forces[6:] == tuple(forces[6:])
    by_code = load(robot(CHAIN, "loops: []", name="plain")).add_forces(*forces)
    runs = [pc.simulate(mech, (0.0, 0.5), step=0.005, order=3) for mech in (by_file, by_code)]
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=1e-12, atol=1e-12)
    assert runs[0].success and np.ptp(runs[0].q) > 0.1
    assert pickle.loads(pickle.dumps(by_file)).forces == by_file.forces  # all of it is plain data


def test_a_drive_of_a_file_moves_its_joint(robot):
    mech = load(robot(CHAIN, "loops: [{name: motor, kind: drive, joint: j, start: 0.1, speed: 2}]"))
    sol = pc.simulate(mech, (0.0, 0.5))
    np.testing.assert_allclose(sol.q[:, 0], 0.1 + 2.0 * sol.t, atol=1e-11)


def test_another_closure_leaves_drives_and_couplings(robot):
    changed = load(robot(CHAIN, LOOPS), closure="point").loops
    assert changed[0].kind == "point"
    assert changed[1:] == load(robot(CHAIN, LOOPS)).loops[1:]


BAD_RECORDS = {
    "forces": ("forces: 3", "forces: a list is needed, not 3"),
    "beside": ("forces: []\nclosed_loop: []", "'forces' cannot be combined with those of robot.yaml"),
    "no record": ("forces: [push]", "force 1: keys such as kind, joint, stiffness are needed, not 'push'"),
    "no kind": ("forces: [{joint: j}]", "force 1: 'kind' is missing"),
    "kind": (
        "forces: [{kind: sprung}]",
        "force 1: unknown kind 'sprung'; choose from damping, friction, spring, spring-",
    ),
    "kind list": ("forces: [{kind: [spring]}]", r"force 1: unknown kind \['spring'\]"),
    "key": (
        "forces: [{kind: damping, coefficients: {j: 1}}, {kind: spring, joint: j, stifness: 2}]",
        r"force 2 \(spring\): the key 'stifness' is not known; similar: stiffness",
    ),
    "key of code": ("forces: [{kind: servo, joint: j, rate: 3}]", r"force 1 \(servo\): the key 'rate' is not known"),
    "missing": ("forces: [{kind: spring, joint: j}]", r"force 1 \(spring\): 'stiffness' is missing"),
    "empty": ("forces: [{kind: spring, joint: j, stiffness: }]", r"force 1 \(spring\): 'stiffness' is missing"),
    "number": (
        "forces: [{kind: spring, joint: j, stiffness: stiff}]",
        r"force 1 \(spring\): stiffness: a finite number is needed, not 'stiff'",
    ),
    "infinite": (
        "forces: [{kind: spring, joint: j, stiffness: 1, rest: .inf}]",
        r"force 1 \(spring\): rest: a finite number is needed, not inf",
    ),
    "name": (
        "forces: [{kind: servo, joint: 3, target: 0, stiffness: 1}]",
        r"force 1 \(servo\): joint: a name is needed, not 3",
    ),
    "no joints": (
        "forces: [{kind: damping, coefficients: 0.3}]",
        r"force 1 \(damping\): coefficients: a mapping of joint names to numbers is needed, not 0.3",
    ),
    "empty joints": (
        "forces: [{kind: damping, coefficients: {}}]",
        r"force 1 \(damping\): coefficients: a mapping of joint names to numbers is needed, not {}",
    ),
    "joint's number": (
        "forces: [{kind: friction, coefficients: {j: [1, x]}}]",
        r"force 1 \(friction\): coefficients: j: a finite number is needed, not 'x'",
    ),
    "joint's name": (
        "forces: [{kind: torque, torques: {2: 1}}]",
        r"force 1 \(torque\): torques: a name is needed, not 2",
    ),
    "negative": (
        "forces: [{kind: friction, coefficients: {j: -1}}]",
        r"force 1 \(friction\): JointFriction of joint 'j' must be at least 0, got -1",
    ),
    "width": (
        "forces: [{kind: friction, coefficients: {j: 1}, width: 0}]",
        r"force 1 \(friction\): JointFriction: width must be greater than 0",
    ),
    "no motion": (
        "forces: [{kind: torque, torques: {j: {}}}]",
        r"force 1 \(torque\): torques: j: a motion needs one or more of start, speed, amplitude, frequency, phase",
    ),
    "motion": (
        "forces: [{kind: servo, joint: j, target: {sped: 1}, stiffness: 1}]",
        r"force 1 \(servo\): target: the key 'sped' is not known; similar: speed",
    ),
    "motion number": (
        "forces: [{kind: servo, joint: j, target: {speed: fast}, stiffness: 1}]",
        r"force 1 \(servo\): target: speed: a finite number is needed, not 'fast'",
    ),
    "triple": (
        "forces: [{kind: wrench, frame: c, force: [1, 2]}]",
        r"force 1 \(wrench\): force: three numbers are needed, not \[1, 2\]",
    ),
    "axes": (
        "forces: [{kind: wrench, frame: c, axes: body}]",
        r"force 1 \(wrench\): wrench on 'c': axes must be 'world' or 'local', got 'body'",
    ),
    "spring frame": (
        "forces: [{kind: spring-damper, frame1: cc}]",
        r"force 1 \(spring-damper\): spring between 'cc' and 'universe': the model has no frame 'cc'; similar: c",
    ),
    "length": ("forces: [{kind: spring-damper, frame1: c, length: -1}]", "length must be at least 0, got -1"),
    "unknown joint": (
        "forces: [{kind: damping, coefficients: {j: 1}}, {kind: servo, joint: jj, target: 0, stiffness: 1}]",
        r"force 2 \(servo\): servo 'jj': the model has no joint 'jj'",
    ),
    "size": (
        "forces: [{kind: torque, torques: {j: [1, 2]}}]",
        r"force 1 \(torque\): JointTorque: joint 'j' needs 1 number\(s\), got 2",
    ),
    "loop": ("loops: [tip]", "loop 1: keys such as name, kind, frame1 are needed, not 'tip'"),
    "coupling key": (
        "loops: [{name: g, kind: coupling, joint: j, other: k, rato: 2}]",
        "loop 1 'g': the key 'rato' is not known; similar: ratio",
    ),
    "coupling joint": (
        "loops: [{name: g, kind: coupling, joint: j, other: kk}]",
        "loop 1 'g': the model has no joint 'kk'; similar: k",
    ),
    "coupling itself": (
        "loops: [{name: g, kind: coupling, joint: j, other: j}]",
        "loop 1 'g': joint 'j' cannot follow itself",
    ),
    "coupling number": (
        "loops: [{name: g, kind: coupling, joint: j, other: k, higher: 2}]",
        "loop 1 'g': higher: a list of numbers is needed, not 2",
    ),
    "drive joint": ("loops: [{name: m, kind: drive, start: 1}]", "loop 1 'm': 'joint' is missing"),
    "drive unknown": ("loops: [{name: m, kind: drive, joint: l, start: 1}]", "loop 1 'm': the model has no joint 'l'"),
    "drive where": ("loops: [{name: m, kind: drive, joint: j}]", "loop 1 'm': a motion needs one or more of start"),
    "drive key": (
        "loops: [{name: m, kind: drive, joint: j, velocity: 2}]",
        "loop 1 'm': the key 'velocity' is not known; available: amplitude, curve, frequency, joint, name",
    ),
    "drive number": (
        "loops: [{name: m, kind: drive, joint: j, speed: .nan}]",
        "loop 1 'm': speed: a finite number is needed, not nan",
    ),
    "universal": (
        "loops: [{name: u, kind: universal, frame1: c, axis: [1, 0, 0]}]",
        "loop 1 'u': a universal needs its axis2",
    ),
    "axis2": (
        "loops: [{name: u, kind: universal, frame1: c, axis: [1, 0, 0], axis2: x}]",
        "loop 1 'u': axis2: three numbers are needed, not 'x'",
    ),
}


@pytest.mark.parametrize("case", BAD_RECORDS)
def test_bad_records_are_named(robot, case):
    text, message = BAD_RECORDS[case]
    path = robot(CHAIN, text)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert str(path.with_suffix(".yaml")) in str(caught.value)
