"""Mechanisms written as URDF and loop file and read back: the same equations; what has no word is refused."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import loop_rows, mixed_tree, random_state
from helpers.held_bodies import own_fields
from helpers.scenes import heavy_top, spherical_chain
from helpers.urdf_texts import A, B, joint
from helpers.urdf_texts import write as write_urdf

import pinconsist as pc
from pinconsist.mechanism.custom import Constraint
from pinconsist.mechanism.joint_constraints import Coupling
from pinconsist.mechanism.system import MechanismSystem

ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"
BARE = [lambda name=name: replace(pc.load(name), geometry=None) for name in ("andrews", "bricard", "n_four_bar_3")]
SCENES = (*BARE, heavy_top, spherical_chain, lambda: pc.Mechanism(mixed_tree()))


def equations(mech, t, q, v):
    """M, nle, Φ, J and the torques of all forces."""
    model, data = mech.model, mech.model.createData()
    M = np.triu(pin.crba(model, data, q))
    bias = np.array(pin.rnea(model, data, q, v, np.zeros(model.nv)))
    return M, bias, *loop_rows(mech, q, t), MechanismSystem(mech, mech.guess).torque(t, q, v)


def require_same(mech, back, seed=0):
    assert (back.joints, back.nq, back.actuated) == (mech.joints, mech.nq, mech.actuated)
    assert back.duration == mech.duration
    assert back.loops == mech.loops or any(loop.kind == "drive" for loop in mech.loops)  # drives compare by identity
    np.testing.assert_allclose(back.guess, mech.guess, atol=1e-15)
    rng = np.random.default_rng(seed)
    for _ in range(3):
        q = pin.integrate(mech.model, mech.guess, rng.uniform(-1, 1, mech.nv))
        v = rng.normal(size=mech.nv)
        for mine, theirs in zip(equations(mech, 0.3, q, v), equations(back, 0.3, q, v), strict=True):
            np.testing.assert_allclose(theirs, mine, rtol=0, atol=1e-12 * max(1.0, np.abs(mine).max(initial=0.0)))
    data, back_data = mech.model.createData(), back.model.createData()
    pin.framesForwardKinematics(mech.model, data, q)
    pin.framesForwardKinematics(back.model, back_data, q)
    for name in {frame.name for frame in mech.model.frames}:
        poses = [
            {tuple(np.round(d.oMf[i].homogeneous.ravel(), 9)) for i, f in enumerate(m.frames) if f.name == name}
            for m, d in ((mech.model, data), (back.model, back_data))
        ]
        assert {tuple(x + 0.0 for x in pose) for pose in poses[0]} <= {tuple(x + 0.0 for x in p) for p in poses[1]}


BUILT_IN = [name.replace("<n>", "3") for name in pc.models()]


@pytest.mark.parametrize("name", BUILT_IN)
def test_built_in_models(tmp_path, name):
    mech = pc.load(name)
    path = pc.write(mech, tmp_path / name)
    assert path == tmp_path / f"{name}.urdf" and path.with_suffix(".yaml").is_file()
    back = pc.load(path)
    require_same(mech, back)
    assert back.forces == mech.forces
    assert {frame.name for frame in back.model.frames} == {frame.name for frame in mech.model.frames}
    for key in ("lowerPositionLimit", "upperPositionLimit", "damping", "armature", "upperDryFrictionLimit"):
        np.testing.assert_array_equal(getattr(back.model, key), getattr(mech.model, key))


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="the public robots are not beside the repository")
@pytest.mark.parametrize("name", ["5bar_linkage", "5bar_linkage_iso6d", "robot_delta", "cassie_like", "kangaroo_like"])
def test_real_robots(tmp_path, name):
    mech = pc.load(ROBOTS / name)
    require_same(mech, pc.load(pc.write(mech, tmp_path / f"{name}.urdf")))


@pytest.mark.parametrize("make", SCENES)
def test_scenes_built_in_code(tmp_path, make):
    mech = make()
    require_same(mech, pc.load(pc.write(mech, tmp_path / "scene")))


def test_numbers_of_every_joint(tmp_path):
    model, rng = mixed_tree(3), np.random.default_rng(0)
    model.damping, model.armature, model.upperDryFrictionLimit = rng.uniform(1, 2, (3, model.nv))
    mech = pc.Mechanism(model, guess=random_state(model, rng)[0]).with_gravity([0.5, -1.5, 2.5])
    back = pc.load(pc.write(mech, tmp_path / "scene"))
    require_same(mech, back)
    for key in ("damping", "armature", "upperDryFrictionLimit"):
        np.testing.assert_array_equal(getattr(back.model, key), getattr(model, key))
    np.testing.assert_array_equal(back.model.gravity.linear, [0.5, -1.5, 2.5])


def chain(*joints):
    model, rng, last = pin.Model(), np.random.default_rng(1), 0
    for number, kind in enumerate(joints):
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.normal(size=3))
        last = model.addJoint(last, kind, place, f"joint{number}")
        model.inertias[last] = pin.Inertia.Random()
    return model


def test_every_joint_that_has_a_word(tmp_path):
    slant = np.array([0.36, 0.48, 0.8])
    mech = pc.Mechanism(
        chain(
            pin.JointModelRevoluteUnaligned(slant),
            pin.JointModelPrismaticUnaligned(-slant),
            pin.JointModelHY(0.25),
            pin.JointModelHelicalUnaligned(slant, -0.1),
            pin.JointModelTranslation(),
            pin.JointModelRUBZ(),
            pin.JointModelPY(),
            pin.JointModelSpherical(),
            pin.JointModelPlanar(),
            pin.JointModelFreeFlyer(),
        )
    )
    back = pc.load(pc.write(mech, tmp_path / "scene"))
    require_same(mech, back)
    kinds, back_kinds = ([each.shortname() for each in m.model.joints] for m in (mech, back))
    assert back_kinds == kinds


def test_unbounded_joint_about_a_slanted_axis(tmp_path):
    path = write_urdf(
        tmp_path,
        A + B + joint(inside='<axis xyz="0.36 0.48 0.8"/><dynamics damping="0.5"/>'),
        "joints: {j: {type: unbounded}}",
    )
    mech = pc.load(path)
    assert mech.model.joints[1].shortname() == "JointModelRevoluteUnboundedUnaligned"
    back = pc.load(pc.write(mech, tmp_path / "other"))
    require_same(mech, back)
    assert back.model.damping[0] == 0.5


def test_frames_keep_their_places_and_locked_joints_their_names(tmp_path):
    mech = pc.Mechanism(mixed_tree()).lock(["slide", "turn"], random_state(mixed_tree(), np.random.default_rng(4))[0])
    require_same(mech, pc.load(pc.write(mech, tmp_path / "scene")))
    five = pc.load("five_bar").lock("left_crank")
    back = pc.load(pc.write(five, tmp_path / "five"))
    require_same(five, back)
    assert [frame.name for frame in back.model.frames] == [frame.name for frame in five.model.frames]


def test_everything_that_may_stand_among_loops_and_forces(tmp_path):
    five = pc.load("five_bar")
    ends = dict(frame1="left_tip", frame2="right_tip", xyz1=(0.1, 0.2, 0.3), rpy2=(0.4, 1 / 3, 1e-7))
    mech = five.with_loops(
        *(
            pc.Loop(kind, kind, **ends, **own_fields(kind, (0, 1, 0), (1, 0, 0.1), 0.5))
            for kind in ("point", "frame", "hinge", "distance", "slider", "cylinder", "plane", "universal")
        ),
        pc.Loop("bare", "point", "left_tip"),
        Coupling("gear", "left_crank", "right_crank", -0.5, 0.1, (0.2, 0.3)),
        pc.Drive("motor", "left_distal", pc.Motion(0.1, 0.2, 0.3, 0.4, 0.5)),
        pc.Drive("still", "left_crank", pc.Motion()),
    ).add_forces(
        pc.JointDamping({"left_crank": 0.1}),
        pc.JointDamping([0.1, 0.0, 0.2, 0.0]),
        pc.JointFriction({"right_crank": 0.3}, width=0.05),
        pc.JointSpring("left_crank", 3.0, -0.2),
        pc.SpringDamper("left_tip", "right_crank_bar", 5.0, 0.2, 0.1, (0.1, 0, 0), (0, 0, 0.2)),
        {"left_crank": 2.0, "right_distal": pc.Motion(amplitude=1.0, frequency=2.0)},
        [0.0, 1.0, 2.0, 3.0],
        pc.Servo("right_crank", pc.Motion(speed=0.3), 10.0, 2.0),
        pc.Servo("right_distal", 0.25, 10.0),
        pc.Wrench("left_tip", (1.0, 2.0, 3.0), (0.1, 0.2, 0.3), "local", (0.01, 0, 0)),
    )
    back = pc.load(pc.write(mech, tmp_path / "scene"))
    require_same(mech, back)
    assert [loop for loop in back.loops if loop.kind != "drive"] == [
        loop for loop in mech.loops if loop.kind != "drive"
    ]
    assert [(loop.joint, loop.curve) for loop in back.loops[-2:]] == [
        (loop.joint, loop.curve) for loop in mech.loops[-2:]
    ]
    as_they_were = [i for i in range(len(mech.forces)) if i not in (1, 6)]  # those by number are now by name
    assert [back.forces[i] for i in as_they_were] == [mech.forces[i] for i in as_they_were]


def test_shapes_go_along(tmp_path):
    mech = pc.load("slider_crank")
    back = pc.load(pc.write(mech, tmp_path / "scene"))
    drawn = []
    for each in (mech, back):
        shapes = pin.buildGeomFromUrdfString(each.model, each.geometry.urdf, pin.GeometryType.VISUAL)
        drawn.append(
            [
                (s.name, s.parentJoint, s.placement.homogeneous.tolist(), s.meshColor.tolist())
                for s in shapes.geometryObjects
            ]
        )
    assert drawn[0] == drawn[1] and len(drawn[0]) > 3


def test_the_same_trajectory(tmp_path):
    mech = pc.load("crank_rocker")
    back = pc.load(pc.write(mech, tmp_path / "scene"))
    sols = [pc.simulate(each, (0.0, 0.5), step=1e-3, v0={"crank": 12.0}) for each in (mech, back)]
    np.testing.assert_allclose(sols[1].q, sols[0].q, atol=1e-11)
    np.testing.assert_allclose(sols[1].lam, sols[0].lam, atol=1e-6 * np.abs(sols[0].lam).max())


def twice_named():
    """A loop end on a frame that has the name of another body's joint."""
    model = chain(pin.JointModelRX(), pin.JointModelRY())
    model.addFrame(pin.Frame("joint0", 2, 0, pin.SE3.Random(), pin.FrameType.OP_FRAME), False)
    return pc.Mechanism(model, [pc.Loop("loop", "point", "joint0")])


def of_joint(kind):
    return lambda: pc.Mechanism(chain(pin.JointModelRX(), kind, pin.JointModelRX()), name="scene")


def composite():
    joint = pin.JointModelComposite()
    joint.addJoint(pin.JointModelRX())
    joint.addJoint(pin.JointModelRY())
    return pc.Mechanism(chain(joint))


def with_loop(loop):
    return lambda: pc.load("four_bar").with_loops(loop)


def with_force(force):
    return lambda: pc.load("four_bar").add_forces(force)


def turning_gravity():
    model = pc.load("four_bar").model
    model.gravity = pin.Motion(np.array([0, 0, -9.81, 0.1, 0, 0]))
    return pc.Mechanism(model)


REFUSED = {
    "drive": (with_loop(pc.Drive("motor", "crank", np.sin)), "drive 'motor': curve is a user-defined function"),
    "drive with rate": (
        with_loop(pc.Drive("motor", "crank", pc.Motion(), np.cos)),
        "drive 'motor': rate is a user-defined function",
    ),
    "constraint": (with_loop(Constraint("own", lambda t, q: q[:1], 1)), "constraint 'own' is a user-defined function"),
    "law": (with_force(lambda t, q, v: -v), "the force .*lambda.* is a user-defined function"),
    "torque": (with_force({"crank": np.sin}), "force 'torque crank': torques: crank is a user-defined function"),
    "servo": (with_force(pc.Servo("crank", np.sin, 1.0)), "force 'servo crank': target is a user-defined function"),
    "wrench": (
        with_force(pc.Wrench("coupler_tip", lambda t: (0, 0, t))),
        "wrench coupler_tip': force is a user-defined function",
    ),
    "universal": (
        of_joint(pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[1])),
        "scene: joint 'joint1' is a Universal",
    ),
    "euler": (of_joint(pin.JointModelSphericalZYX()), "joint 'joint1' is a SphericalZYX joint"),
    "composite": (composite, "joint 'joint0' is a Composite joint"),
    "gravity": (turning_gravity, "gravity has an angular part"),
    "names": (twice_named, "cannot be written.*the name 'joint0' belongs to a link and to a joint"),
}


@pytest.mark.parametrize(("make", "message"), REFUSED.values(), ids=REFUSED)
def test_what_a_file_cannot_hold_is_refused_and_nothing_is_written(tmp_path, make, message):
    (tmp_path / "scene.yaml").write_text("old")
    with pytest.raises(pc.InputError, match=message):
        pc.write(make(), tmp_path / "scene.urdf")
    assert [path.name for path in tmp_path.iterdir()] == ["scene.yaml"]
    assert (tmp_path / "scene.yaml").read_text() == "old"


def test_what_reads_back_as_another_mechanism_is_not_written(tmp_path, monkeypatch):
    mech = pc.load("four_bar")
    monkeypatch.setattr("pinconsist.formats.write._STANDARD_GRAVITY", (0.0, 0.0, -1.62))
    with pytest.raises(pc.InputError, match="it reads back differently"):
        pc.write(mech.with_gravity([0, 0, -1.62]), tmp_path / "scene")
    assert not list(tmp_path.iterdir())


def test_wrong_arguments(tmp_path):
    with pytest.raises(pc.InputError, match="needs a Mechanism, got str"):
        pc.write("four_bar", tmp_path / "x.urdf")
    with pytest.raises(pc.InputError, match="there is no folder"):
        pc.write(pc.load("four_bar"), tmp_path / "none" / "x.urdf")


# What a loop file says of the tree ------------------------------------------------------------------------------------

BAD_SETTINGS = {
    "joints: {j: {armature: -1}}": "joints: j: armature: -1 is negative",
    "joints: {j: {armature: [1, 2]}}": "joints: j: armature: it needs one number or 1",
    "joints: {j: {armature: x}}": "joints: j: armature: a finite number is needed",
    "joints: {i: {armature: 1}}": "joints: i: the model has no joint 'i'",
    "joints: {j: {stiffness: 1}}": "joints: j: the key 'stiffness' is not known",
    "joints: [j]": "joints: keys such as a joint's name are needed",
    "joints: {j: 3}": "joints: j: keys such as type, armature are needed",
    "joints: {j: {type: ball}}": "joints: j: the joint type 'ball' is not one of SPHERICAL",
    "joints: {j: {type: helical}}": "joints: j: the joint type 'helical' is not one of",
    "joints: {j: {type: helical 0}}": "joints: j: the joint type 'helical 0' is not one of",
    "joints: {j: {type: helical nan}}": "joints: j: the joint type 'helical nan' is not one of",
    "joints: {k: {type: helical 0.1}}": "joint 'k': only a revolute joint can be made helical",
    "joints: {k: {type: unbounded}}": "joint 'k': only a revolute joint can be made unbounded",
    "joints: {i: {type: unbounded}}": "joint 'i': there is no joint of this name to replace",
    "gravity: [0, 0]": "gravity: three numbers are needed",
    "gravity: down": "gravity: three numbers are needed",
    "joint_order: j": "joint_order: a list is needed",
    "joint_order: [j]": r"joint_order: it must contain each joint once; unknown or repeated: \[\], missing: \['k'\]",
    "joint_order: [j, j]": "joint_order: it must contain each joint once",
    "joint_order: [k, j]": "joint_order: joint 'k' comes before its parent 'j'",
}


@pytest.mark.parametrize("text", BAD_SETTINGS)
def test_bad_settings_are_named(tmp_path, text):
    from helpers.urdf_texts import CHAIN

    path = write_urdf(tmp_path, CHAIN.replace('"k" type="revolute"', '"k" type="prismatic"'), text)
    with pytest.raises(pc.FormatError, match=BAD_SETTINGS[text]) as caught:
        pc.load(path)
    assert caught.value.path.startswith(str(tmp_path / "scene"))


def test_settings_change_what_they_name(tmp_path):
    text = "joints: {j: {armature: 0.5, damping: 0.25, friction: 2}}\ngravity: [0, -1, 0]"
    body = A + B + joint(inside='<axis xyz="0 0 1"/><dynamics damping="7" friction="9"/>')
    model = pc.load(write_urdf(tmp_path, body, text)).model
    assert (model.armature[0], model.damping[0], model.upperDryFrictionLimit[0]) == (0.5, 0.25, 2)
    np.testing.assert_array_equal(model.gravity.linear, [0, -1, 0])
    assert replace(pc.Mechanism(model), name="x").name == "x"


def test_the_path_is_a_path():
    with pytest.raises(pc.InputError, match="needs the path of a file, got 3"):
        pc.write(pc.load("four_bar"), 3)
