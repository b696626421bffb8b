"""MJCF files against the same scene in URDF, hand calculation and MuJoCo's own reading (where it is installed)."""

import pickle
import re
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.bodies import frame_pose, loop_rows
from helpers.warned import told

import pinconsist as pc
from pinconsist.mechanism.motion import Motion
from pinconsist.view.visuals import visuals

FOUR_BAR = Path(__file__).parent / "data" / "four_bar.xml"
ROD = '<geom type="capsule" size="0.05" fromto="0 0 0 0.5 0.1 0.2"/>'


@pytest.fixture
def scene(tmp_path):
    """Load a text between <mujoco> tags."""

    def load(body, **options):
        path = tmp_path / "scene.xml"
        path.write_text(f"<mujoco>{body}</mujoco>")
        return pc.load(path, **options)

    return load


def world(*bodies, **rest):
    sections = "".join(f"<{tag}>{text}</{tag}>" for tag, text in rest.items())
    return f"<worldbody>{''.join(bodies)}</worldbody>{sections}"


def body(name, joints="<joint/>", inside="", pos="0 0 0"):
    return f'<body name="{name}" pos="{pos}">{joints}{ROD}{inside}</body>'


# The four-bar -----------------------------------------------------------------------------------------------------


def four_bar(tmp_path, *changes):
    text = FOUR_BAR.read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "changed.xml"
    path.write_text(text)
    return pc.load(path)


BY_BODY = '<connect name="coupler_rocker" body1="coupler_bar" body2="rocker_bar" anchor="2 0 0"/>'
BY_SITE = '<connect name="coupler_rocker" site1="coupler_tip" site2="rocker_tip"/>'
WELD = '<weld name="coupler_rocker" body1="coupler_bar" body2="rocker_bar" anchor="1.5 0 0" torquescale="0"/>'
ANGLES = ("-1", "0.6742791460587038", "-1.4133851241635729")
STRAIGHT = [(word.format(angle), "") for angle in ANGLES for word in ('euler="0 {} 0"', 'ref="{}"')]
KEY = f'<keyframe><key qpos="{" ".join(ANGLES)}"/></keyframe></mujoco>'
WAYS = {
    "connect by body": [],
    "connect by site": [*STRAIGHT, (BY_BODY, BY_SITE), ("</mujoco>", KEY)],
    "weld that leaves the angles": [(BY_BODY, WELD)],
}


@pytest.mark.parametrize("changes", WAYS.values(), ids=WAYS)
def test_four_bar_moves_like_the_urdf(tmp_path, changes):
    ours, urdf = four_bar(tmp_path, *changes), pc.load("four_bar")
    assert ours.joints == urdf.joints and ours.actuated == ("crank",)
    assert [(loop.name, loop.kind) for loop in ours.loops] == [("coupler_rocker", "point")]
    np.testing.assert_allclose(ours.guess, urdf.guess, atol=1e-15)
    times = np.linspace(0.0, 1.0, 6)
    runs = [pc.simulate(mech, (0.0, 1.0), rtol=1e-11, atol=1e-12, t_eval=times) for mech in (ours, urdf)]
    assert all(run.success for run in runs)
    np.testing.assert_allclose(runs[0].q, runs[1].q, rtol=0, atol=1e-9)
    np.testing.assert_allclose(runs[0].v, runs[1].v, rtol=0, atol=1e-9)


def test_a_mechanism_from_mjcf_pickles():
    mech = pc.load(FOUR_BAR)
    again = pickle.loads(pickle.dumps(mech))
    assert again.loops == mech.loops and again.geometry == mech.geometry and again.model == mech.model


# Where Pinocchio's reader goes wrong in silence ---------------------------------------------------------------------


def two_arms(equality, **rest):
    """Two arms of 0.5 m that turn about z, hinged at x = 0 and x = 1; sites at their tips."""
    sites = '<site name="tip_{0}" pos="0.5 0 0"/>'
    return world(
        body("left", '<joint name="l"/>', sites.format("left")),
        body("right", '<joint name="r"/>', sites.format("right"), pos="1 0 0"),
        equality=equality,
        **rest,
    )


def gap(mech, q):
    return loop_rows(mech, q)[0]


def test_all_bodies_of_the_world_are_parsed(scene):
    mech = scene(two_arms(""))
    assert mech.joints == ("l", "r")
    np.testing.assert_allclose(frame_pose(mech.model, np.array([0.0, np.pi / 2]), "tip_right").translation, [1, 0.5, 0])


@pytest.mark.parametrize(
    "ends", ['body1="left" body2="right" anchor="0.5 0 0"', 'site1="tip_left" site2="tip_right"'], ids=["body", "site"]
)
def test_connect_joins_two_bodies_of_the_world(scene, ends):
    mech = scene(two_arms(f"<connect {ends}/>"))
    (loop,) = mech.loops
    assert "universe" not in (loop.frame1, loop.frame2) and loop.name == "connect1"
    if loop.frame1 == "left":  # the anchors meet in the reference configuration
        np.testing.assert_allclose(loop.xyz2, [-0.5, 0, 0], atol=1e-15)
        tip = [0.5, 0.5]  # of the left arm turned by 90°, the anchor of the right one rests at (0.5, 0)
        np.testing.assert_allclose(gap(mech, [np.pi / 2, 0.0]), [-tip[1], -tip[0], 0], atol=1e-15)
    else:  # the sites are pulled together from wherever they are
        np.testing.assert_allclose(gap(mech, [0.0, 0.0]), [1, 0, 0], atol=1e-15)
        np.testing.assert_allclose(gap(mech, [0.0, np.pi]), [0, 0, 0], atol=1e-15)


def test_what_is_not_active_is_left_out_and_told(scene, recwarn):
    off = '<connect name="off" active="false" site1="tip_left" site2="tip_right"/>'
    on = '<weld name="on" body1="left" body2="right"/>'
    assert [loop.name for loop in scene(two_arms(off + on)).loops] == ["on"]
    assert "equality 'off': left out, it is not active" in told(recwarn)
    assert scene('<option><flag equality="disable"/></option>' + two_arms(on)).loops == ()
    assert "equality 'on': left out" in told(recwarn)
    tendon = '<tendon tendon1="t" active="false"/>'
    cable = '<spatial name="t"><site site="tip_left"/><site site="tip_right"/></spatial>'
    assert [loop.name for loop in scene(two_arms(tendon + on, tendon=cable)).loops] == ["on"]
    by_default = '<default><equality active="false"/></default>'
    assert scene(by_default + two_arms(on)).loops == ()


def test_joint_equality_is_a_coupling(scene):
    arms = two_arms('<joint joint1="r" joint2="l" polycoef="0.1 2 0.3 0 -0.4"/>')
    mech = scene(arms.replace('name="l"', 'name="l" ref="30"').replace('name="r"', 'name="r" type="slide" ref="0.7"'))
    (coupling,) = mech.loops
    assert isinstance(coupling, pc.Coupling) and (coupling.joint, coupling.other) == ("r", "l")
    x0, y0 = np.pi / 6, 0.7
    np.testing.assert_allclose(mech.guess, [x0, y0])
    for x in (x0, 0.0, -1.3, 2.0):
        law = 0.1 + 2 * (x - x0) + 0.3 * (x - x0) ** 2 - 0.4 * (x - x0) ** 4
        np.testing.assert_allclose(gap(mech, [x, y0 + law]), 0.0, atol=1e-14)
    plain = scene(two_arms('<joint name="same" joint1="r" joint2="l"/>')).loops
    assert plain == (pc.Coupling("same", "r", "l", ratio=1.0),)


def test_joint_equality_with_one_joint_holds_it(scene):
    mech = scene(two_arms('<joint name="held" joint1="r" polycoef="0.25 7"/>').replace('"r"/>', '"r" ref="90"/>', 1))
    (hold,) = pickle.loads(pickle.dumps(mech)).loops
    assert isinstance(hold, pc.Drive)
    assert (hold.joint, hold.curve) == ("r", Motion(start=np.pi / 2 + 0.25))
    run = pc.simulate(mech, (0.0, 0.2))
    np.testing.assert_allclose(run.q[:, 1], np.pi / 2 + 0.25, atol=1e-12)


# What the words mean ------------------------------------------------------------------------------------------------


def test_weld_holds_the_pose_that_it_gives(scene):
    pose = 'relpose="0.1 0.2 0 0.5 0 0 0.5" anchor="0.3 0 0"'  # body2 turned by 90° about z
    mech = scene(two_arms(f'<weld body1="left" body2="right" {pose}/>').replace('"r"/>', '"r" ref="90"/>', 1))
    R = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    d = [1, 0, 0] + R @ [0.3, 0, 0] - [0.1, 0.2, 0]  # body2 stands turned at q = 180°, for its ref is 90°
    np.testing.assert_allclose(gap(mech, [0.0, np.pi]), [*(R.T @ d), 0, 0, 0], atol=1e-15)


def test_the_reference_is_where_joints_have_their_ref(scene):
    mech = scene(
        world(body("a", '<joint name="h" axis="0 1 0" ref="40"/><joint name="s" type="slide" axis="0 3 4" ref="0.2"/>'))
    )
    np.testing.assert_allclose(mech.guess, [np.radians(40), 0.2])
    np.testing.assert_allclose(frame_pose(mech.model, mech.guess, "a").homogeneous, np.eye(4), atol=1e-15)
    moved = frame_pose(mech.model, mech.guess + np.array([0.0, 0.5]), "a").translation
    np.testing.assert_allclose(moved, [0, 0.3, 0.4], atol=1e-15)


def test_the_first_keyframe_is_the_guess_in_pinocchios_order(scene):
    free = '<body name="f" pos="0 0 1"><freejoint name="f"/><geom size="0.1"/></body>'
    arm = (
        '<body name="b"><body name="c"><joint name="c" type="ball"/><geom size="0.1"/></body><joint name="b"/>{}</body>'
    )
    arm = arm.format(ROD)
    mech = scene(world(free, arm))
    np.testing.assert_allclose(mech.guess, [0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 0, 1])
    assert mech.joints == ("f", "b", "c")  # a body's joints come before its children's, wherever they stand
    key = '<key/><key qpos="1 2 3 0.6 0.8 0 0 0.5 0 0 0.6 -0.8"/><key qpos="1 2"/>'
    mech = scene(world(free, arm, keyframe=key))
    np.testing.assert_allclose(mech.guess, [1, 2, 3, 0.8, 0, 0, 0.6, 0.5, 0, 0.6, -0.8, 0])


def test_values_of_joints(scene):
    joints = '<joint name="h" range="-90 180" damping="0.3" frictionloss="0.2" armature="0.1"/>'
    joints += '<joint name="s" type="slide" range="-1 2" stiffness="5" springref="0.4" axis="1 0 0"/>'
    joints += '<joint name="u" type="slide" range="-1 2" limited="false" axis="0 1 0"/>'
    mech = scene(world(body("a", joints)))
    model = mech.model
    np.testing.assert_allclose(model.lowerPositionLimit, [-np.pi / 2, -1, -np.inf])
    np.testing.assert_allclose(model.upperPositionLimit, [np.pi, 2, np.inf])
    np.testing.assert_allclose(model.damping, [0.3, 0, 0])
    np.testing.assert_allclose(model.armature, [0.1, 0, 0])
    np.testing.assert_allclose([model.lowerDryFrictionLimit, model.upperDryFrictionLimit], [[-0.2, 0, 0], [0.2, 0, 0]])
    assert mech.forces == (pc.JointSpring("s", 5.0, 0.4),)
    mech = scene(
        '<option><flag spring="disable" damper="disable" frictionloss="disable"/></option>' + world(body("a", joints))
    )
    assert mech.forces == () and not mech.model.damping.any() and not mech.model.upperDryFrictionLimit.any()
    joints = joints.replace('range="-1 2" limited="false"', "").replace("range", 'limited="false" range')
    mech = scene('<compiler angle="radian" autolimits="false"/>' + world(body("a", joints)))
    assert not np.isfinite(mech.model.upperPositionLimit).any()


def test_gravity(scene):
    arm = world(body("a"))
    np.testing.assert_array_equal(scene(arm).model.gravity.linear, [0, 0, -9.81])
    np.testing.assert_array_equal(scene('<option gravity="1 2 3"/>' + arm).model.gravity.linear, [1, 2, 3])
    off = '<option gravity="1 2 3"><flag gravity="disable"/></option>'
    np.testing.assert_array_equal(scene(off + arm).model.gravity.linear, 0)


def test_names_that_joints_bodies_and_sites_share(scene):
    link = '<body name="arm" pos="1 0 0"><joint name="arm"/><geom size="0.1"/><site name="arm" pos="0 2 0"/>{}</body>'
    inner = '<body><joint/><joint axis="0 1 0"/><geom size="0.1"/></body>'
    mech = scene(world(link.format(inner), equality='<connect site1="arm" site2="w"/>', worldbody='<site name="w"/>'))
    assert mech.joints == ("arm", "body2_hinge1", "body2_hinge2")
    names = [frame.name for frame in mech.model.frames]
    assert len(set(names)) == len(names) and {"arm", "arm_body", "arm_site", "body2", "world"} <= set(names)
    np.testing.assert_allclose(frame_pose(mech.model, mech.guess, "arm_site").translation, [1, 2, 0])
    assert (mech.loops[0].frame1, mech.loops[0].frame2) == ("arm_site", "w")


def test_actuators_give_names(scene):
    actuator = '<position joint="r" kp="3"/><motor joint="l"/><general jointinparent="r"/><motor site="tip_left"/>'
    with pytest.warns(UserWarning, match="actuator 4: it acts on no joint"):
        assert scene(two_arms("", actuator=actuator)).actuated == ("r", "l")


def test_options_of_load(scene, tmp_path):
    arms = two_arms('<connect name="c" body1="left" body2="right" anchor="0.5 0 0"/>')
    assert scene(arms, closure="frame").loops[0].kind == "frame"
    np.testing.assert_allclose(gap(scene(arms, closure="frame"), [0.0, 0.0]), 0.0, atol=1e-15)
    with pytest.raises(pc.InputError, match="a hinge needs its axis"):
        scene(arms, closure="hinge")
    with pytest.raises(pc.InputError, match="freejoint"):
        scene(arms, free_flyer=True)
    (tmp_path / "scene.yaml").write_text(
        "loops: [{name: more, kind: distance, frame1: left, frame2: right, length: 1}]"
    )
    assert [loop.name for loop in scene(arms).loops] == ["c"]  # a loop file counts only if it is named
    assert [loop.name for loop in scene(arms, loops=tmp_path / "scene.yaml").loops] == ["c", "more"]


# Includes and shapes ------------------------------------------------------------------------------------------------


def test_includes_stand_where_they_are_named(scene, tmp_path):
    (tmp_path / "parts").mkdir()
    arms = [body(name, f'<joint name="{name}"/>') for name in "ab"]
    (tmp_path / "parts" / "arms.xml").write_text(f'<mujocoinclude>{arms[0]}<include file="more.xml"/></mujocoinclude>')
    (tmp_path / "parts" / "more.xml").write_text(f"<x>{arms[1]}</x>")
    (tmp_path / "common.xml").write_text('<mujoco><compiler angle="radian"/></mujoco>')
    mech = scene(
        '<include file="common.xml"/>'
        + world(body("first", '<joint name="first" ref="1"/>'), '<include file="parts/arms.xml"/>', body("last"))
    )
    assert mech.joints == ("first", "a", "b", "last_hinge")
    assert mech.guess[0] == 1.0


def test_shapes_are_shown_where_they_are(scene, tmp_path, caplog):
    (tmp_path / "meshes").mkdir()
    corners = ["0 0 0", "1 0 0", "0 1 0", "0 0 1"]
    faces = "1 3 2", "1 2 4", "1 4 3", "2 3 4"
    lines = [f"v {corner}" for corner in corners] + [f"f {face}" for face in faces]
    (tmp_path / "meshes" / "corner.obj").write_text("\n".join(lines))
    assets = (
        '<mesh file="corner.obj" scale="2 1 1" refpos="0.5 0 0"/><material name="red" rgba="1 0 0 1"/>'
        '<mesh name="far" file="../../elsewhere.obj"/>'
    )
    geoms = (
        '<geom type="box" size="0.1 0.2 0.3" pos="1 0 0" material="red"/><geom size="0.3" group="3"/>'
        '<geom type="capsule" size="0.1" fromto="0 0 1 0 0 2" rgba="0 0 1 0.5"/>'
        '<geom type="mesh" mesh="corner" pos="0 3 0" mass="0"/><geom type="mesh" mesh="far" mass="0"/>'
    )
    mech = scene(
        '<compiler meshdir="meshes"/>'
        + world('<geom type="plane" size="1 1 1"/>', body("a", inside=geoms).replace(ROD, ""), asset=assets)
    )
    shapes = visuals(mech)
    assert [shape.node for shape in shapes] == [1] * 5
    assert [shape.color for shape in shapes] == [0xFF0000, *[0x0000FF] * 3, 0x808080]
    low, high = np.min([s.points.min(0) for s in shapes], 0), np.max([s.points.max(0) for s in shapes], 0)
    np.testing.assert_allclose([low, high], [[-1, -0.2, -0.3], [1.1, 4, 2.1]], atol=1e-6)
    assert "mesh 'far': not shown" in caplog.text


def test_meshes_that_are_missing(scene, tmp_path, caplog, monkeypatch):
    """They matter only where an inertia depends on them; nothing is written, and MuJoCo's warnings are left as set."""
    import mujoco

    monkeypatch.chdir(tmp_path)
    mujoco.set_mju_user_warning(print)
    asset = '<mesh name="m" file="gone.stl"/><texture name="t" type="2d" file="gone.png"/>'
    asset += '<material name="red" texture="t" rgba="1 0 0 1"/><hfield name="h" file="gone.png" size="1 1 1 1"/>'
    shown = '<geom type="mesh" mesh="m" mass="0" material="red"/><geom type="box" mesh="m" mass="0"/>'
    mech = scene(world('<geom type="hfield" hfield="h"/>', body("a", inside=shown), asset=asset))
    alone = scene(world(body("a")))
    theirs, ours = (each.model.inertias[1].toDynamicParameters() for each in (alone, mech))
    np.testing.assert_allclose(ours, theirs, rtol=1e-13)
    assert len(visuals(mech)) == len(visuals(alone)) == 3 and "gone.stl" in caplog.text
    with pytest.raises(pc.FormatError, match=r"scene.xml: body 'a': its inertia depends on meshes .*: gone.stl"):
        scene(world(body("a", inside='<geom type="mesh" mesh="m"/>'), asset=asset))
    (tmp_path / "gone.stl").write_text("solid s\nendsolid s\n" + " " * 80)
    with pytest.raises(pc.FormatError, match=r"scene.xml: asset: mesh 'm': .*perhaps this is an ASCII file"):
        scene(world(body("a", inside='<geom type="mesh" mesh="m"/>'), asset=asset))
    assert mujoco.get_mju_user_warning() is print
    mujoco.set_mju_user_warning(None)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["gone.stl", "scene.xml"]


def test_attached_models_come_from_the_folder(scene, tmp_path):
    model = '<asset><model name="m" file="{}"/></asset>'
    for file, reason in (
        ("../m.xml", "is outside the folder"),
        ("scene.xml", "it includes itself"),
        ("m", "no such"),
    ):
        with pytest.raises(pc.FormatError, match=reason):
            scene(model.format(file) + world(body("a")))


def test_without_mujoco(scene, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(pc.MissingExtraError, match=re.escape("pip install 'pinconsist[mjcf]'")):
        scene(world(body("a")))


def test_a_tendon_with_inertia_moves_as_in_mujoco(tmp_path):
    """Two joints of one arm (of two arms MuJoCo's mass matrix has no room for the coupling of their inertias)."""
    import mujoco

    bar = '<geom type="box" size="0.1 0.2 0.3" pos="0.2 0 0"/>'
    inner = f'<body pos="0.4 0 0"><joint name="j1" axis="0 1 0"/>{bar}</body>'
    arm = f'<body><joint name="j0" axis="0 1 0"/>{bar}{inner}</body>'
    tendon = '<tendon><fixed name="t" armature="0.7"><joint joint="j0" coef="2"/><joint joint="j1" coef="-3"/></fixed>'
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco><worldbody>{arm}</worldbody>{tendon}</tendon></mujoco>")
    mech = pc.load(path)
    assert mech.joints == ("j0", "j1", "t") and mech.nc == 1
    sol = pc.simulate(mech, (0.0, 0.2), {"j0": 0.3, "j1": -0.2}, rtol=1e-9, atol=1e-11)
    peer = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(peer)
    data.qpos[:] = 0.3, -0.2
    mujoco.mj_forward(peer, data)
    found = [sol.acceleration(joint)[0] for joint in ("j0", "j1")]
    np.testing.assert_allclose(found, data.qacc, rtol=1e-8)
    np.testing.assert_allclose(sol.q[:, 2], 2 * sol.q[:, 0] - 3 * sol.q[:, 1], atol=1e-10)


def test_what_refers_to_an_element_that_is_left_out_may_come_before_it(tmp_path):
    text = """<mujoco><actuator><motor name="m" tendon="t"/></actuator>
    <tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon>
    <worldbody><body><joint name="j"/><geom size="0.1"/></body></worldbody></mujoco>"""
    (tmp_path / "r.xml").write_text(text)
    assert pc.load(tmp_path / "r.xml", ignore=["t"]).joints == ("j",)


def test_options_that_mujoco_no_longer_has(scene):
    """Of old files, on contacts and solvers: counted, and without them the file is compiled."""
    mech = scene('<option apirate="50" collision="predefined" timestep="0.01"/>' + world(body("a")))
    assert mech.nv == 1
    assert {"1 <apirate=> of option", "1 <collision=> of option"} <= {*mech.ignored}


def test_a_fixed_joint_of_bullet_is_no_joint(scene):
    """Its body is welded to that above it, as a body without joints is."""
    bullet, plain = (
        scene(world(body("a", "<joint name='j'/>", body("b", fixed)))) for fixed in ('<joint type="fixed"/>', "")
    )
    assert bullet.joints == plain.joints == ("j",)
    np.testing.assert_allclose(bullet.model.inertias[1].inertia, plain.model.inertias[1].inertia, atol=1e-15)


def test_frictionloss_of_a_free_joint_is_told(scene):
    """A default of all joints reaches the free one in public files, where it would brake a body in the air."""
    free = '<joint name="base" type="free"/>'
    mech = scene('<default><joint frictionloss="0.1"/></default>' + world(body("a", free, body("b"))))
    assert "1 free joint with frictionloss" in mech.ignored
    np.testing.assert_array_equal(mech.model.upperDryFrictionLimit, [0.0] * 6 + [0.1])
    assert "not modelled: 1 free joint with frictionloss" in pc.simulate(mech, (0.0, 0.01)).check(error=False).verdict


PARTS = {
    "include": "<mujocoinclude><geom size='1'/></mujocoinclude>",
    "body": "<mujoco><body/></mujoco>",
    "reference": "<mujoco><equality><weld body1='a'/></equality></mujoco>",
}


@pytest.mark.parametrize("part", PARTS)
def test_a_part_of_other_files_names_them(tmp_path, part):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.xml").write_text(PARTS[part])
    (tmp_path / "scene.xml").write_text('<mujoco><include file="parts/arm.xml"/></mujoco>')
    with pytest.raises(pc.FormatError, match=r"; load \.\./scene\.xml, which includes it"):
        pc.load(tmp_path / "parts" / "arm.xml")
