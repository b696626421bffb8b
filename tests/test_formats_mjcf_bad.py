"""MJCF files that are wrong, or say what is not computed: each error names the file and the element."""

import logging
import re
from pathlib import Path

import numpy as np
import pytest
from helpers.mjcf_zoo import BRICK, ROD, ZOO, body, chain, world
from helpers.mutations import mutated_xml
from hypothesis import HealthCheck, given, settings, strategies

import pinconsist as pc

FOUR_BAR = Path(__file__).parent / "data" / "four_bar.xml"
ARM = world(body('<joint name="j"/>' + ROD, 'name="a"'), body('<joint name="k"/>' + ROD, 'name="b"'))


def hinged(inside, attributes=""):
    return world(body("<joint/>" + inside, attributes))


def closing(text):
    return f"{ARM}<equality>{text}</equality>"


@pytest.fixture
def refused(tmp_path, capfd):
    """What is said of a text between <mujoco> tags; nothing is printed."""

    def error(text):
        path = tmp_path / "scene.xml"
        path.write_text(text if text.startswith("<mujoco") else f"<mujoco>{text}</mujoco>")
        with pytest.raises(pc.FormatError) as caught:
            pc.load(path)
        assert str(caught.value).startswith(str(path)) and caught.value.path == str(path)
        assert capfd.readouterr() == ("", "")
        return str(caught.value)

    return error


BAD = {
    "truncated": ("<mujoco><worldbody>", "not well-formed"),
    "entity": ('<mujoco a="&b;"/>', "not well-formed"),
    "no body": ("", "nothing can move"),
    "no joint": (world(body(ROD)), "nothing can move"),
    "section": ("<worldbdy/>", "worldbdy: this element is not known; near it: worldbody"),
    "body elsewhere": ("<asset><body/></asset>", "asset: <body> belongs in <worldbody>"),
    "connect elsewhere": (f"{ARM}<contact><connect/></contact>", "contact: <connect> belongs in <equality>"),
    "element": (world(body("<jiont/>")), "body 1: jiont: this element is not known; near it: joint"),
    "element inside": (world(body("<joint><geom/></joint>")), "body 1: joint 1: no element 'geom' can stand in it"),
    "attribute": (world(body('<joint dampping="1"/>')), "joint 1: the attribute 'dampping' is not .* near it: damping"),
    "body attribute": (world(body("", 'position="1 2 3"')), "body 1: the attribute 'position' is not known"),
    "compiler attribute": (
        '<compiler angel="radian"/>',
        "compiler: the attribute 'angel' is not known; near it: angle",
    ),
    "angle": ('<compiler angle="deg"/>', "compiler: angle='deg' is not one of degree, radian"),
    "coordinate": ('<compiler coordinate="global"/>', "compiler: global coordinates cannot be read"),
    "eulerseq": ('<compiler eulerseq="xy"/>', "compiler: eulerseq='xy' is not three letters"),
    "flag": ('<compiler balanceinertia="yes"/>', "balanceinertia='yes' is not one of false, true"),
    "same body": (world(body("", 'name="a"'), body("", 'name="a"')), "body 'a': another body has this name"),
    "same joint": (world(*[body('<joint name="j"/>' + ROD)] * 2), "body 2: joint 'j': another joint has this name"),
    "same site": (hinged(ROD + '<site name="s"/><site name="s"/>'), "site 's': another site has this name"),
    "same class": ("<default><default class='a'/><default class='a'/></default>", "default 'a': another class"),
    "same equality": (closing('<joint name="e" joint1="j"/>' * 2), "equality 'e': another equality has this name"),
    "world": (world(body("", 'name="world"')), "body 'world': another body has this name"),
    "universe": (world(body("", 'name="universe"')), "body 'universe': .*name of the ground"),
    "class": (world(body('<joint class="x"/>')), "body 1: joint 1: there is no class 'x'"),
    "childclass": (world(body("", 'childclass="x"')), "body 1: there is no class 'x'"),
    "class without name": ("<default><default/></default>", "default in class 'main': it has no class"),
    "outer class": ("<default class='x'/>", "default 'x': the outermost class can only be called 'main'"),
    "in defaults": ("<default><jiont/></default>", "default 'main': jiont: this element is not known"),
    "number": (world(body("", 'pos="1 2 x"')), "body 1: pos='1 2 x' is not 3 finite numbers"),
    "count": (world(body("", 'pos="1 2"')), "body 1: pos='1 2' is not 3 finite numbers"),
    "nan": (world(body("", 'quat="nan 0 0 0"')), "body 1: quat='nan 0 0 0' is not 4 finite numbers"),
    "huge": (hinged('<inertial pos="1e60 0 0" mass="1"/>'), "body 1: inertial: pos='1e60 0 0' is not 3 finite"),
    "zero quaternion": (world(body("", 'quat="0 0 0 0"')), "body 1: quat: the quaternion is the zero vector"),
    "two turns": (world(body("", 'quat="1 0 0 0" euler="1 2 3"')), "several orientations are given: euler, quat"),
    "zero axis": (world(body('<joint axis="0 0 0"/>')), "joint 1: the axis is the zero vector"),
    "joint type": (world(body('<joint type="revolute"/>')), "type='revolute' is not one of hinge, slide, ball, free"),
    "range": (world(body('<joint range="2 1"/>')), "joint 1: the range from 2 to 1 is empty"),
    "damping": (world(body('<joint damping="-1"/>')), "joint 1: damping=-1 is negative"),
    "joint of the world": (world("<joint/>"), "worldbody: joint 1: the world has no joints"),
    "inner free": (world(body(body("<freejoint/>"))), "body 2: joint 1: a free joint stands alone"),
    "free and hinge": (world(body("<freejoint/><joint/>")), "body 1: joint 2: a free joint stands alone"),
    "ball and hinge": (hinged('<joint type="ball"/><joint/>'), "joint 3: no rotation may follow a ball joint"),
    "mass": (hinged('<inertial pos="0 0 0" mass="-1"/>'), "body 1: the mass is negative: -1 kg"),
    "no mass": (hinged('<inertial pos="0 0 0"/>'), "body 1: inertial: attribute 'mass' is missing"),
    "no pos": (hinged('<inertial mass="1"/>'), "body 1: inertial: attribute 'pos' is missing"),
    "two inertials": (hinged(BRICK * 2), "body 1: inertial: it stands twice"),
    "inertia": (hinged(BRICK.replace("0.1 0.2 0.25", "-0.1 0.2 0.2")), "a principal inertia is negative: -0.1"),
    "triangle": (hinged(BRICK.replace("0.25", "0.5")), "body 1: no body has the principal inertias 0.1, 0.2, 0.5"),
    "full and diagonal": (
        hinged(BRICK.replace("mass", 'fullinertia="1 1 1 0 0 0" mass')),
        "fullinertia and diaginertia",
    ),
    "geom mass": (hinged('<geom size="1" mass="-2"/>'), "geom 1: mass=-2 is less than 0"),
    "geom type": (hinged('<geom type="ball"/>'), "geom 1: type='ball' is not one of sphere"),
    "geom size": (hinged('<geom type="box" size="1 2"/>'), r"geom 1: a box needs 3 positive number\(s\)"),
    "fromto": (hinged('<geom size="1" fromto="0 0 0 1 0 0"/>'), "fromto goes with capsule"),
    "ends": (hinged('<geom type="capsule" size="1" fromto="1 0 0 1 0 0"/>'), "way between the ends is the zero vector"),
    "total mass": (f'<compiler settotalmass="1"/>{hinged("")}', "settotalmass: no body has a mass"),
    "key": (f'{ARM}<keyframe><key name="k" qpos="1"/></keyframe>', "key 'k': qpos='1' is not 2 finite numbers"),
    "actuator": (f'{ARM}<actuator><motor name="m" joint="jj"/></actuator>', "actuator 'm': there is no joint 'jj'"),
    "actuator kind": (f'{ARM}<actuator><moter joint="j"/></actuator>', "'moter' is not known; near it: motor"),
    "equality": (closing("<conect/>"), "equality 'conect1': 'conect' is not known; near it: connect"),
    "ends of connect": (closing('<connect body1="a" body2="b"/>'), "equality 'connect1': body1 and anchor, or site1"),
    "body of connect": (closing('<connect body1="a" body2="c" anchor="0 0 0"/>'), "there is no body 'c'"),
    "site of connect": (closing('<connect site1="a" site2="b"/>'), "there is no site 'a'"),
    "one body": (closing('<connect body1="a" body2="a" anchor="0 0 0"/>'), "loop 'connect1': .*sit on the same body"),
    "joint of equality": (closing('<joint joint1="j" joint2="x"/>'), "equality 'joint1': there is no joint 'x'"),
    "itself": (closing('<joint joint1="j" joint2="j"/>'), "joint 'j' cannot follow itself"),
    "mesh": (hinged('<geom type="mesh" mesh="m" mass="0"/>' + ROD), "body 1: geom 1: there is no mesh 'm'"),
}
NOT_COMPUTED = {
    "tendon equality": (closing('<tendon tendon1="t"/>'), "equality 'tendon1': equality of tendons is not computed"),
    "flex equality": (closing('<flex flex="f"/>'), "equality of flex is not computed"),
    "spring tendon": (f'{ARM}<tendon><fixed name="t" stiffness="1"/></tendon>', "tendon 't': stiffness of a tendon"),
    "damped actuator": (f'{ARM}<actuator><motor joint="j" damping="1"/></actuator>', "damping of an actuator"),
    "fluid": (f'<option density="1.2"/>{ARM}', "option: lift and drag of a fluid are not computed here"),
    "replicate": (world('<replicate count="2"/>'), "worldbody: replicate: copies are not made here"),
    "composite": (world(body("<composite/>")), "body 1: composite: composite objects are not made here"),
    "attach": (world("<attach/>"), "worldbody: attach: other models are not attached here"),
    "plugin": (world(body("<plugin/>")), "body 1: plugin: what a plugin does is not known here"),
    "aligned": (world(body('<freejoint align="true"/>')), "joint 1: a body is not aligned with its principal axes"),
    "all aligned": (
        '<compiler alignfree="true"/>' + world(body('<joint type="free"/>')),
        "joint 1: a body is not aligned with its principal axes",
    ),
    "spring of a ball": (world(body('<joint type="ball" stiffness="1"/>')), "springs of ball joints"),
    "free armature": (world(body('<joint type="free" armature="1"/>')), "armature and frictionloss of a free joint"),
    "springdamper": (world(body('<joint springdamper="1 1"/>')), "springdamper is not computed"),
    "nonlinear": (world(body('<joint damping="1 2"/>')), "nonlinear damping is not computed here: '1 2'"),
    "mesh mass": (hinged('<geom type="mesh" mesh="m"/>'), "geom 1: the mass of its body would follow from a mesh"),
    "fitted": (hinged('<geom type="box" mesh="m"/>'), "geom 1: the mass of its body would follow from a mesh"),
    "shell": (hinged('<geom size="1" shellinertia="true"/>'), "the inertia of a shell is not computed"),
    "inertial in a frame": (hinged(f'<frame pos="1 0 0">{BRICK}</frame>'), "differs among versions of MuJoCo"),
    "quat over euler": (
        '<default><geom euler="1 2 3"/></default>' + hinged('<geom size="1" quat="1 0 0 0"/>'),
        "geom 1: whether its quat or the euler of its class counts differs among versions of MuJoCo",
    ),
}


@pytest.mark.parametrize(("text", "message"), (BAD | NOT_COMPUTED).values(), ids=BAD | NOT_COMPUTED)
def test_what_is_refused_is_named(refused, text, message):
    said = refused(text)
    assert re.search(message, said), said


CONTENTS = [b"", b"\xff\xfe\x00\x01", b'<!DOCTYPE r [<!ENTITY a "b">]><mujoco/>', b"<robot/>", b"<sdf/>"]


@pytest.mark.parametrize("content", CONTENTS)
def test_contents_that_are_no_mjcf(tmp_path, content):
    path = tmp_path / "x.mjcf"
    path.write_bytes(content)
    with pytest.raises(pc.FormatError, match=r"not well-formed|refused for safety|root element of an MJCF") as caught:
        pc.load(path)
    assert caught.value.path == str(path)


INCLUDES = {
    "cycle": (
        {"b.xml": '<x><include file="c.xml"/></x>', "c.xml": '<x><include file="b.xml"/></x>'},
        "c.xml: include 'b",
    ),
    "itself": ({"b.xml": '<x><include file="a.xml"/></x>'}, r"b.xml: include 'a.xml': the file is included twice"),
    "missing": ({}, r"a.xml: include 'b.xml': there is no such file"),
    "broken": ({"b.xml": "<x>"}, r"b.xml: not well-formed"),
    "outside": ({"b.xml": '<x><include file="../../a.xml"/></x>'}, r"b.xml: include '../../a.xml': it climbs out"),
    "absolute": ({"b.xml": '<x><include file="/etc/passwd"/></x>'}, r"b.xml: include '/etc/passwd': it climbs out"),
    "nameless": ({"b.xml": "<x><include/></x>"}, r"b.xml: include '': attribute 'file' is missing"),
    "wrong": ({"b.xml": "<x><body/></x>"}, r"a.xml: body: this element is not known"),
}


@pytest.mark.parametrize(("files", "message"), INCLUDES.values(), ids=INCLUDES)
def test_bad_includes(tmp_path, files, message):
    files = {"a.xml": '<mujoco><include file="b.xml"/></mujoco>', **files}
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(pc.FormatError, match=message):
        pc.load(tmp_path / "a.xml")


def test_meshes_that_climb_out_are_not_shown(tmp_path, caplog):
    path = tmp_path / "a.xml"
    files = [f'<mesh name="m{i}" file="{file}"/>' for i, file in enumerate(("../x.stl", "/etc/x.stl", "a/../../x.stl"))]
    geoms = "".join(f'<geom type="mesh" mesh="m{i}" mass="0"/>' for i in range(3))
    path.write_text(f"<mujoco><asset>{''.join(files)}</asset>{hinged(ROD + geoms)}</mujoco>")
    assert "x.stl" not in pc.load(path).geometry.urdf
    assert all(f"mesh 'm{i}': not shown" in caplog.text for i in range(3))


def test_deep_and_wide_files_are_read(tmp_path):
    path = tmp_path / "a.xml"
    path.write_text(f"<mujoco>{chain(*[('', '<joint/>' + ROD)] * 600)}</mujoco>")
    assert pc.load(path).nv == 600


EVERYTHING = [f"<mujoco>{text}</mujoco>" for text in ZOO.values()] + [FOUR_BAR.read_text()]
QUIET = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow)


@settings(max_examples=400, deadline=None, derandomize=True, database=None, suppress_health_check=QUIET)
@given(strategies.randoms(use_true_random=False))
def test_spoilt_files_are_read_or_refused(tmp_path, rng):
    logging.getLogger("pinconsist").setLevel(logging.CRITICAL)
    path = tmp_path / "scene.xml"
    path.write_bytes(mutated_xml(rng.choice(EVERYTHING), rng))
    try:
        mech = pc.load(path)
    except pc.FormatError as error:
        assert str(path) in str(error)
    else:
        assert np.isfinite(mech.guess).all()
    finally:
        logging.getLogger("pinconsist").setLevel(logging.NOTSET)
