"""What a file has that has no effect here is told when it is loaded, and by the verdict if bodies would touch."""

import sys

import numpy as np
import pytest
from helpers.command_line import called
from helpers.warned import told

import pinconsist as pc

INERTIAL = """<inertial><origin xyz="0 0 -0.5"/><mass value="1"/>
<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/></inertial>"""
BOX = '<collision><geometry><box size="0.1 0.1 1"/></geometry></collision>'
URDF = f"""<robot name="probe" xmlns:drake="http://drake.mit.edu"><link name="base"/>
<link name="arm">{INERTIAL}{BOX}</link><joint name="pivot" type="revolute"><parent link="base"/><child link="arm"/>
<axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="100" velocity="50"/></joint>%s</robot>"""
SDF = """<sdf version="1.9"><world name="w"><model name="ground"><static>1</static><link name="l"><collision name="c">
<geometry><plane><normal>0 0 1</normal></plane></geometry></collision></link></model>
<model name="probe"><link name="arm">
<pose>0 0 2 0 0 0</pose><inertial><mass>1</mass></inertial>
<collision name="c"><geometry><box><size>1 1 1</size></box></geometry></collision></link>
<joint name="pivot" type="revolute"><parent>world</parent><child>arm</child><axis><xyz>0 1 0</xyz></axis></joint>
</model>%s</world></sdf>"""
MJCF = """<mujoco model="probe"><worldbody><geom name="floor" type="plane" size="5 5 0.1"/><body name="leg" pos="0 0 1">
<joint name="height" type="slide" axis="0 0 1" range="-0.5 1" limited="true"/><geom name="foot" size="0.1"/></body>
</worldbody></mujoco>"""


@pytest.fixture
def file(tmp_path):
    def write(text, name):
        (path := tmp_path / name).write_text(text)
        return path

    return write


@pytest.mark.parametrize(
    ("text", "name", "expected"),
    [
        (URDF % "", "a.urdf", ("1 collision shape", "limits of 1 joint (watched, not enforced)")),
        (
            URDF
            % '<gazebo reference="arm"><mu1>0.5</mu1><kp>1e6</kp></gazebo><gazebo><plugin name="force" filename="x"/>'
            '<plugin name="imu" filename="libimu.so"/></gazebo>',
            "b.urdf",
            (
                "1 collision shape",
                "limits of 1 joint (watched, not enforced)",
                "plugin 'force'",
                "2 contact parameters",
            ),
        ),
        (SDF % "", "c.sdf", ("1 floor", "1 collision shape")),
        (MJCF, "d.xml", ("1 floor", "1 colliding geom", "limits of 1 joint (watched, not enforced)")),
        (
            MJCF.replace("<worldbody>", '<option><flag contact="disable" limit="disable"/></option><worldbody>'),
            "e.xml",
            (),
        ),
    ],
    ids=["urdf", "gazebo", "sdf", "mjcf", "mjcf without contacts"],
)
def test_a_line_at_load_counts_what_has_no_effect(file, recwarn, text, name, expected):
    if name.endswith("xml"):
        pytest.importorskip("mujoco")
    mech = pc.load(path := file(text, name))
    assert sorted(mech.ignored) == sorted(expected)
    lines = [line for line in told(recwarn).splitlines() if "without effect" in line]
    assert lines == ([f"{path}: without effect here: {', '.join(mech.ignored)}"] if expected else [])
    assert all(what in str(mech) for what in mech.ignored[:1])


@pytest.mark.parametrize("method", ["BDF", "Radau"])
def test_a_leg_below_its_floor_is_no_bare_ok(file, method, tmp_path):
    """It falls from 1 m to -3.9 m in a second, since nothing holds it."""
    pytest.importorskip("mujoco")
    sol = pc.simulate(pc.load(file(MJCF, "leg.xml")), (0.0, 1.0), method=method)
    assert sol.q[-1, 0] == pytest.approx(-9.81 / 2, rel=1e-6)
    certificate = sol.check()
    assert certificate.verdict.endswith("not modelled: 1 floor, 1 colliding geom")
    assert "not modelled" in str(certificate) and "limits of 1 joint" in str(certificate)
    sol.save(tmp_path / "leg.npz")
    assert pc.Solution.load(tmp_path / "leg.npz").certificate.verdict == certificate.verdict


@pytest.mark.parametrize("shape", ["<plane/>", "<box><size>9 9 1</size></box>", "<mesh><uri>hill.stl</uri></mesh>"])
def test_what_stands_still_in_the_world_is_in_the_verdict(file, shape):
    world = SDF.replace("<plane><normal>0 0 1</normal></plane>", shape) % ""
    certificate = pc.simulate(pc.load(file(world, "a.sdf")), (0.0, 0.2)).check()
    what = "1 floor" if "plane" in shape else "1 static collision shape"
    assert certificate.verdict.endswith(f"; not modelled: {what}")


def test_the_name_of_a_file_does_not_reach_the_terminal_raw(file, capsys):
    for text in (URDF % "", "no XML"):
        _, out, err = called(capsys, "check", file(text, "name\x1b[31mX.urdf"))
        shown = out + err
        assert "name?[31mX" in shown and "\x1b" not in shown


def test_collision_shapes_alone_are_not_in_the_verdict(file):
    certificate = pc.simulate(pc.load(file(URDF % "", "a.urdf")), (0.0, 0.1)).check()
    assert certificate.verdict.endswith(": ok") and "1 collision shape" in str(certificate)


def test_rotors_of_drake_add_to_the_armature(file):
    """The inertia of the rotor, as the joint feels it, is that times the gear ratio squared."""
    rotor = '<drake:rotor_inertia value="0.01"/><drake:gear_ratio value="10"/>'
    motor = f'<type>SimpleTransmission</type><joint name="pivot"/><actuator name="m">{rotor}</actuator>'
    mech = pc.load(file(URDF % f'<transmission name="t">{motor}</transmission>', "a.urdf"))
    np.testing.assert_allclose(mech.model.armature, 0.01 * 10.0**2)
    assert mech.actuated == ("pivot",)


def test_springs_and_weightless_links_of_gazebo_act(file):
    """Without gravity the arm swings as its spring and inertia say: ω² = k / (m l² + I)."""
    extra = (
        '<gazebo reference="pivot"><springStiffness>20</springStiffness><springReference>0.1</springReference></gazebo>'
    )
    extra += '<gazebo reference="arm"><turnGravityOff>true</turnGravityOff></gazebo>'
    sol = pc.simulate(pc.load(file(URDF % extra, "a.urdf")), (0.0, 2.0), [0.3], rtol=1e-9, atol=1e-11)
    expected = 0.1 + 0.2 * np.cos(np.sqrt(20.0 / 0.26) * sol.t)
    np.testing.assert_allclose(sol.q[:, 0], expected, atol=1e-7)


def test_plugins_that_join_bodies_are_refused(file):
    plugin = '<plugin name="gz::sim::systems::DetachableJoint" filename="x"><child_link>arm2</child_link></plugin>'
    with pytest.raises(pc.FormatError, match=r"line 7, plugin DetachableJoint.*joins bodies.*ignore="):
        pc.load(file(SDF % plugin, "a.sdf"))


def test_too_many_links_in_a_row_are_refused_and_not_the_end_of_the_process(file):
    def chain(n):
        links = "".join(f'<link name="l{i}">{INERTIAL}</link>' for i in range(n))
        joints = "".join(
            f'<joint name="j{i}" type="revolute"><parent link="l{i - 1}"/><child link="l{i}"/><axis xyz="0 1 0"/>'
            '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
            for i in range(1, n)
        )
        return f'<robot name="r">{links}{joints}</robot>'

    assert sys.getrecursionlimit() < 5000
    with pytest.raises(pc.FormatError, match="more than 2,000 links hang on each other in a row"):
        pc.load(file(chain(5000), "deep.urdf"))


@pytest.mark.parametrize("name", ["\u009b31mred", "\u202eabc"], ids=["terminal", "direction"])
@pytest.mark.parametrize(("text", "suffix"), [(URDF % "", "urdf"), (MJCF, "xml"), (SDF % "", "sdf")])
def test_names_with_control_characters_are_refused(file, name, text, suffix):
    for old in ("pivot", "height", '"arm"'):
        text = text.replace(old, f'"{name}"' if old.startswith('"') else name)
    with pytest.raises(pc.FormatError, match="has control characters") as caught:
        pc.load(file(text, f"a.{suffix}"))
    assert str(caught.value).replace("\n", "").isprintable()
