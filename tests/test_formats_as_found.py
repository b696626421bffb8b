"""What public files have that their own programs read: it is read here, or refused with a cure that works."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from helpers.urdf_texts import CHAIN, A, B, joint

import pinconsist as pc

POINT = '<link name="d"><inertial><mass value="2"/></inertial></link>' + joint("l", "c", "d")
MASS = '<inertial pos="0 0 -1" mass="1" diaginertia="1 1 1"/>'
BODY = f'<body name="{{}}"><joint name="{{}}_hinge" axis="0 1 0"/>{MASS}{{}}</body>'


def urdf(folder, text, name="r.urdf"):
    path = folder / name
    path.write_text(f'<robot name="r">{text}</robot>')
    return path


def test_a_mass_without_inertia_is_a_point(tmp_path):
    with pytest.warns(UserWarning, match="link 'd': inertial: <inertia> is missing, and it is a point of 2 kg"):
        model = pc.load(urdf(tmp_path, CHAIN + POINT)).model
    assert model.inertias[model.getJointId("l")].mass == 2.0
    assert not model.inertias[model.getJointId("l")].inertia.any()


def test_what_is_not_joined_to_the_world_floats(tmp_path):
    with pytest.warns(UserWarning, match="the link 'a' is not joined to the link 'world', and floats"):
        mech = pc.load(urdf(tmp_path, '<link name="world"/>' + A + B + joint()))
    assert mech.joints == ("root_joint", "j") and mech.nv == 7


def test_a_reduction_that_is_no_number_is_told(tmp_path):
    motor = """<transmission name="t"><type>SimpleTransmission</type><joint name="j"/>
      <actuator name="m"><mechanicalReduction>reduction</mechanicalReduction></actuator></transmission>"""
    with pytest.warns(UserWarning, match="it exerts no force here: .*mechanicalReduction 'reduction' is no number"):
        assert not pc.load(urdf(tmp_path, CHAIN + motor)).forces


def test_a_part_of_a_xacro_robot_says_what_to_load(tmp_path):
    pytest.importorskip("xacro")
    head = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    macro = f'{head}<xacro:macro name="arm" params="n"><link name="${{n}}"/></xacro:macro></robot>'
    (tmp_path / "arm.xacro").write_text(macro)
    robot = f'{head}<xacro:include filename="arm.xacro"/>{CHAIN}</robot>'
    (tmp_path / "robot.xacro").write_text(robot)
    with pytest.raises(pc.FormatError, match=r"it has only macros \(arm\); load robot.xacro, which includes it"):
        pc.load(tmp_path / "arm.xacro")
    assert pc.load(tmp_path / "robot.xacro").nv == 2
    (tmp_path / "sub").mkdir()
    inner = tmp_path / "sub" / "robot.xacro"
    inner.write_text(robot.replace("arm.xacro", "../arm.xacro").replace("<xacro:include", "<xacro:include", 1))
    assert pc.load(inner, package_dirs=[tmp_path]).nv == 2


@pytest.mark.parametrize("mesh", ["/somewhere/x.stl", "../x.stl", "package:///etc/x.stl"])
def test_a_shape_that_is_elsewhere_is_only_not_shown(tmp_path, caplog, mesh):
    links = ""
    for name in "ab":
        links += (
            f'<link name="{name}"><inertial><mass>1</mass></inertial><visual name="v"><geometry><mesh><uri>{mesh}</uri>'
        )
        links += "</mesh></geometry></visual></link>"
    text = (
        f'<sdf version="1.7"><model name="m">{links}<joint name="j" type="revolute"><parent>a</parent><child>b</child>'
    )
    (tmp_path / "m.sdf").write_text(text + "<axis><xyz>0 0 1</xyz></axis></joint></model></sdf>")
    caplog.set_level(logging.WARNING, "pinconsist")
    assert pc.load(tmp_path / "m.sdf").nv == 1
    assert "left out" in caplog.text and "outside the folder of the scene" in caplog.text


def mjcf(folder, text, name="m.xml"):
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text(f"<mujoco>{text}</mujoco>")
    return path


def test_includes_and_meshes_from_folders_that_were_named(tmp_path):
    pytest.importorskip("mujoco")
    home = tmp_path / "a" / "robots" / "arm"  # deep enough that the folder above may be proposed
    home.mkdir(parents=True)
    corners = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    (tmp_path / "a" / "robots" / "t.obj").write_text(corners)
    mjcf(home.parent / "scene", '<asset><mesh name="t" file="../t.obj"/></asset>', "s.xml")
    world = '<worldbody><body name="b"><joint name="h"/><geom type="mesh" mesh="t" density="6"/></body></worldbody>'
    path = mjcf(home, f'<include file="../scene/s.xml"/>{world}')
    with pytest.raises(pc.FormatError, match=r"outside the folder of the scene; .*package_dirs=\[.*robots'\]"):
        pc.load(path)
    mass = pc.load(path, package_dirs=[home.parent]).model.inertias[1].mass
    np.testing.assert_allclose(mass, 1.0, rtol=1e-12)  # a sixth of a cube
    path = mjcf(home, f'<asset><mesh name="t" file="../t.obj"/></asset>{world}')
    with pytest.raises(pc.FormatError, match=r"its inertia depends on meshes .*package_dirs=\[.*robots'\]"):
        pc.load(path)


def test_elements_of_mjcf_may_be_left_out(tmp_path):
    pytest.importorskip("mujoco")
    flex = """<flexcomp name="cloth" type="grid" count="3 3 1" spacing="1 1 1" mass="1" radius="0.01"/>"""
    site = '<site name="s{0}"/><site name="t{0}" pos="{0} 0 1"/>'
    bodies = BODY.format("a", "a", BODY.format("b", "b", site.format(1)) + site.format(0))
    rope = """<tendon><spatial name="rope" stiffness="3"><site site="s0"/><site site="t1"/><site site="s1"/></spatial>
      </tendon>      <actuator><motor tendon="rope"/></actuator>"""
    path = mjcf(tmp_path, f"<worldbody>{bodies}{flex}</worldbody>{rope}")
    for cure in ("flexcomp", "rope"):
        with pytest.raises(pc.FormatError, match=rf"ignore=\['{cure}'\] loads the scene without"):
            pc.load(path, ignore=() if cure == "flexcomp" else ["flexcomp"])
    mech = pc.load(path, ignore=["flexcomp", "rope"])
    assert mech.nv == 2 and not mech.forces


def test_an_equality_of_bodies_that_do_not_move_is_told(tmp_path):
    pytest.importorskip("mujoco")
    fixed = "<body name='x'><geom size='1' mass='1'/></body><body name='y'><geom size='1' mass='1'/></body>"
    path = mjcf(
        tmp_path,
        f"<worldbody>{fixed}{BODY.format(*'aa', '')}</worldbody><equality><weld body1='x' body2='y'/></equality>",
    )
    with pytest.warns(UserWarning, match="equality 'weld1': left out, its bodies do not move"):
        assert not pc.load(path).loops
