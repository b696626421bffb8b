"""What files have besides loops: limits as stops, dry friction that holds, collision shapes on the ground."""

import numpy as np
import pytest

import pinconsist as pc

G = 9.81
PENDULUM = """<robot name="p"><link name="base"/>
<link name="arm"><inertial><origin xyz="0 0 -0.5"/><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<collision><geometry><cylinder radius="0.1" length="1"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-0.4" upper="0.5" effort="10" velocity="10"/><dynamics friction="3"/></joint></robot>"""
BOX = """<robot name="b"><link name="box"><inertial><mass value="2"/>
<inertia ixx="0.1" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>
<collision><origin xyz="0 0 0.1"/><geometry><box size="0.4 0.3 0.2"/></geometry></collision>
<collision><geometry><mesh filename="no.stl"/></geometry></collision></link></robot>"""
MJCF = """<mujoco><worldbody><geom type="plane" size="1 1 1" pos="0 0 0.1" friction="0.5" condim="1"/>
<body name="ball" pos="0 0 0.5"><freejoint/><geom type="sphere" size="0.2" mass="1" friction="0.3"/></body>
<body name="rod" pos="1 0 0.5"><freejoint/>
<geom type="capsule" size="0.1 0.2" mass="1" euler="0 90 0" condim="1"/></body>
<body name="ghost" pos="2 0 0.5"><freejoint/>
<geom type="box" size="0.1 0.1 0.1" mass="1" contype="0" conaffinity="0"/></body>
</worldbody></mujoco>"""


def written(tmp_path, text, name="scene.urdf"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def test_limits_are_watched_stops_or_off(tmp_path):
    """A pendulum that swings from 0.45 rad against its lower limit."""
    file = written(tmp_path, PENDULUM)
    start = {"hinge": 0.45}
    watched = pc.load(file)
    assert "limits of 1 joint (watched, not enforced)" in watched.ignored
    kick = {"hinge": -4.0}
    through = pc.simulate(watched, (0.0, 1.0), start, kick)
    assert through.q.min() < -0.5 and through.check().beyond_limits
    for sol in (
        pc.simulate(pc.load(file, limits="stops"), (0.0, 1.0), start, kick),
        pc.simulate(watched, (0.0, 1.0), start, kick, limits="stops"),
    ):
        assert sol.q.min() == pytest.approx(-0.4, abs=1e-9) and len(sol.impacts) >= 1
        assert not sol.check().beyond_limits
    stopped = pc.load(file, limits="stops")
    assert not any("limits" in line for line in stopped.ignored)
    off = pc.load(file, limits="off")
    assert not pc.simulate(off, (0.0, 1.0), start, kick).check().beyond_limits
    with pytest.raises(pc.InputError, match="limits='hard' is not one of 'watch', 'stops', 'off'"):
        pc.load(file, limits="hard")


def test_stops_of_files_do_not_replace_those_that_were_named(tmp_path):
    mech = pc.load(written(tmp_path, PENDULUM)).add_contacts(pc.Stop("hinge", upper=0.1))
    sol = pc.simulate(mech, (0.0, 0.1), {"hinge": 0.0}, limits="stops")
    assert [each.name for each in sol.mechanism.contacts] == ["hinge"]


def test_dry_friction_of_a_file_holds_exactly(tmp_path):
    """3 N·m hold 2 kg at 0.5 m up to an angle of 0.31 rad."""
    file = written(tmp_path, PENDULUM)
    angle = np.arcsin(3.0 / (2.0 * G * 0.5))
    held = pc.simulate(pc.load(file, dry_friction="exact"), (0.0, 100.0), {"hinge": 0.95 * angle})
    assert held.q[-1, 0] == pytest.approx(0.95 * angle, abs=1e-12)
    slips = pc.simulate(pc.load(file), (0.0, 1.0), {"hinge": 1.1 * angle}, dry_friction="exact")
    assert slips.modes[0].mode == "slip"
    assert slips.contact("hinge friction").force[0] == pytest.approx(3.0, rel=1e-9)


def test_a_box_of_a_file_falls_on_the_ground(tmp_path):
    file = written(tmp_path, BOX)
    mech = pc.load(file, free_flyer=True, ground=True)
    assert len(mech.contacts) == 8 and mech.ignored == ("1 collision shape of kind mesh",)
    sol = pc.simulate(mech, (0.0, 0.5), {"root_joint": [0, 0, 0.1, 0, 0, 0]})
    assert sol.impacts[0].t == pytest.approx(np.sqrt(0.2 / G), rel=1e-9)
    assert sum(sol.contact(each.name).force[-1, 2] for each in mech.contacts) == pytest.approx(2.0 * G)
    assert pc.load(file, free_flyer=True, ground=0.3).contacts[0].friction == (0.3, 0.3)
    assert pc.load(file, free_flyer=True).ignored == ("2 collision shapes",)


def test_what_a_file_has_that_cannot_touch_the_ground_is_told(tmp_path):
    mech = pc.load(written(tmp_path, PENDULUM), ground=True)
    assert "1 collision shape of kind cylinder" in mech.ignored and not mech.contacts


def test_floors_of_mjcf_carry_spheres_and_capsules(tmp_path):
    pytest.importorskip("mujoco")
    file = written(tmp_path, MJCF, "scene.xml")
    assert any("floor" in line for line in pc.load(file).ignored)
    mech = pc.load(file, ground=True)
    assert not any("floor" in line or "geom" in line for line in mech.ignored)
    friction = {each.frame: each.friction[0] for each in mech.contacts}
    assert friction == {"ball": 0.5, "rod": 0.0} and len(mech.contacts) == 3
    sol = pc.simulate(mech, (0.0, 0.5))
    heights = {name: sol.frame(name).position[-1, 2] for name in ("ball", "rod", "ghost")}
    assert heights["ball"] == pytest.approx(0.3, abs=1e-9) and heights["rod"] == pytest.approx(0.2, abs=1e-9)
    assert heights["ghost"] == pytest.approx(0.5 - 0.5 * G * 0.25, abs=1e-6)


def test_floors_and_friction_of_sdf(tmp_path):
    text = """<sdf version="1.9"><world name="w"><model name="floor"><static>true</static><link name="l">
    <collision name="c"><geometry><plane><normal>0 0 1</normal></plane></geometry>
    <surface><friction><ode><mu>0.4</mu></ode></friction></surface></collision></link></model>
    <model name="m"><pose>0 0 0.3 0 0 0</pose><link name="ball"><inertial><mass>1</mass></inertial>
    <collision name="c"><geometry><sphere><radius>0.1</radius></sphere></geometry></collision></link></model>
    </world></sdf>"""
    mech = pc.load(written(tmp_path, text, "scene.sdf"), free_flyer=True, ground=True)
    assert mech.contacts[0].friction == (0.4, 0.4)
    sol = pc.simulate(mech, (0.0, 0.5))
    assert sol.impacts[0].t == pytest.approx(np.sqrt(2 * 0.2 / 9.8), rel=1e-6)  # SDF's gravity


def test_a_model_in_memory_has_no_ground():
    import pinocchio as pin

    with pytest.raises(pc.InputError, match="ground= is for files"):
        pc.load(pin.buildSampleModelManipulator(), ground=True)


BALL = """<mujoco><worldbody>{}<body name="ball" pos="0 0 1"><freejoint/><geom type="sphere" size="0.1"/></body>
</worldbody></mujoco>"""


@pytest.mark.parametrize(
    ("floor", "height"),
    [
        ("", 0.0),
        ('<body pos="0 0 0.1"><body pos="0 0 0.2"><geom type="plane" size="1 1 1"/></body></body>', 0.3),
    ],
)
def test_the_ground_of_mjcf_is_its_plane_wherever_it_stands_or_zero(tmp_path, floor, height):
    pytest.importorskip("mujoco")
    mech = pc.load(written(tmp_path, BALL.format(floor), "scene.xml"), ground=True)
    (contact,) = mech.contacts
    assert contact.offset == pytest.approx(height + 0.1) and not mech.ignored


def test_files_whose_shapes_are_not_read_have_no_ground(tmp_path):
    text = "format: ChoreonoidBody\nname: b\nlinks:\n  - {name: base, jointType: free, mass: 1.0}\n"
    with pytest.raises(pc.InputError, match=r"ground= is not for scene\.body"):
        pc.load(written(tmp_path, text, "scene.body"), ground=True)


def test_shapes_of_what_stands_still_are_told_once(tmp_path):
    text = """<sdf version="1.9"><world name="w"><model name="wall"><static>true</static><link name="l">
    <collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision></link></model>
    <model name="m"><link name="ball"><inertial><mass>1</mass></inertial></link></model></world></sdf>"""
    mech = pc.load(written(tmp_path, text, "scene.sdf"), free_flyer=True, ground=True)
    assert [line for line in mech.ignored if "collision" in line] == ["1 static collision shape"]
