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
    "namespace": ('<mujoco xmlns:x="y"><x:worldbody/></mujoco>', "unrecognized"),
    "no body": ("", "nothing can move"),
    "no joint": (world(body(ROD)), "nothing can move"),
    "section": ("<worldbdy/>", "worldbdy: unrecognized element"),
    "body elsewhere": ("<asset><body/></asset>", "body 1: unrecognized element"),
    "connect elsewhere": (f"{ARM}<contact><connect/></contact>", "contact: connect 1: unrecognized element"),
    "element": (world(body("<jiont/>")), "body 1: jiont 1: unrecognized element"),
    "element inside": (world(body("<joint><geom/></joint>")), "body 1: joint 1: geom 1: unrecognized element"),
    "attribute": (world(body('<joint dampping="1"/>')), "body 1: joint 1: unrecognized attribute: 'dampping'"),
    "body attribute": (world(body("", 'position="1 2 3"')), "body 1: unrecognized attribute: 'position'"),
    "compiler attribute": ('<compiler angel="radian"/>', "compiler: unrecognized attribute: 'angel'"),
    "angle": ('<compiler angle="deg"/>', "compiler: invalid keyword: 'deg'"),
    "coordinate": ('<compiler coordinate="global"/>', "compiler: global coordinates no longer supported"),
    "eulerseq": ('<compiler eulerseq="xy"/>', "compiler: .*'eulerseq' must have exactly 3 characters"),
    "flag": ('<compiler balanceinertia="yes"/>', "compiler: invalid keyword: 'yes'"),
    "same body": (world(body("", 'name="a"'), body("", 'name="a"')), "repeated name 'a' in body"),
    "same joint": (world(*[body('<joint name="j"/>' + ROD)] * 2), "repeated name 'j' in joint"),
    "same site": (hinged(ROD + '<site name="s"/><site name="s"/>'), "repeated name 's' in site"),
    "same class": ("<default><default class='a'/><default class='a'/></default>", "repeated default class name"),
    "same equality": (closing('<joint name="e" joint1="j"/>' * 2), "repeated name 'e' in equality"),
    "world": (world(body("", 'name="world"')), "repeated name 'world' in body"),
    "universe": (hinged(ROD, 'name="universe"'), "'universe' is the name of the ground"),
    "class": (world(body('<joint class="x"/>')), "body 1: joint 1: unknown default class name 'x'"),
    "childclass": (world(body("", 'childclass="x"')), "body 1: unknown default childclass"),
    "class without name": ("<default><default/></default>", "default: default 1: empty class name"),
    "outer class": ("<default class='x'/>", "default: top-level default class 'main' cannot be renamed"),
    "in defaults": ("<default><jiont/></default>", "default: jiont 1: unrecognized element"),
    "number": (world(body("", 'pos="1 2 x"')), "body 1: .*'pos'"),
    "count": (world(body("", 'pos="1 2"')), "body 1: attribute 'pos' does not have enough data"),
    "nan": (hinged(ROD, 'quat="nan 0 0 0"'), "body 1: quat is not finite"),
    "huge": (hinged('<inertial pos="1e60 0 0" mass="1" diaginertia="1 1 1"/>'), "body 1: ipos is not finite, or above"),
    "immense": (hinged('<inertial pos="0 0 0" mass="1e200" diaginertia="1 1 1"/>'), "body 1: mass is not finite"),
    "zero quaternion": (world(body("", 'quat="0 0 0 0"')), "body 1: zero quaternion is not allowed"),
    "two turns": (world(body("", 'quat="1 0 0 0" euler="1 2 3"')), "multiple orientation specifiers are not allowed"),
    "zero axis": (world(body('<joint axis="0 0 0"/>')), "body 1: joint 1: axis too small"),
    "joint type": (world(body('<joint type="revolute"/>')), "body 1: joint 1: invalid keyword: 'revolute'"),
    "damping": (world(body('<joint name="j" damping="-1"/>' + ROD)), "joint 'j': damping is negative"),
    "spring": (world(body('<joint stiffness="-1"/>' + ROD)), "joint 1: stiffness is negative"),
    "joint of the world": (world("<joint/>"), "worldbody: joint 1: World body cannot have joints"),
    "inner free": (world(body(ROD + body(ROD + "<freejoint/>"))), "free joint can only be used on top level"),
    "free and hinge": (world(body("<freejoint/><joint/>" + ROD)), "body 1.*: .*6 dofs"),
    "ball and hinge": (hinged('<joint type="ball"/><joint/>'), "body 1.*: ball followed by rotation in body"),
    "mass": (hinged('<inertial pos="0 0 0" mass="-1"/>'), "body 1: mass and inertia of moving bodies must be larger"),
    "massless": (hinged(""), "body 1: mass and inertia of moving bodies must be larger"),
    "no mass": (hinged('<inertial pos="0 0 0"/>'), "body 1: inertial 1: required attribute missing: 'mass'"),
    "no pos": (hinged('<inertial mass="1"/>'), "body 1: inertial 1: required attribute missing: 'pos'"),
    "two inertials": (hinged(BRICK * 2), "body 1: .*unique element 'inertial' found 2 times"),
    "inertia": (hinged(BRICK.replace("0.1 0.2 0.25", "-0.1 0.2 0.2")), "mass and inertia of moving bodies"),
    "triangle": (
        hinged(BRICK.replace("0.25", "0.5")),
        r"body 1: inertia must satisfy A \+ B >= C; use 'balanceinertia'",
    ),
    "full and diagonal": (
        hinged(BRICK.replace("mass", 'fullinertia="1 1 1 0 0 0" mass')),
        "body 1: inertial 1: .*full",
    ),
    "geom mass": (hinged('<geom size="1" mass="-2"/>'), "body 1: geom 1: mass.* negative"),
    "geom type": (hinged('<geom type="ball"/>'), "body 1: geom 1: invalid keyword: 'ball'"),
    "geom size": (hinged('<geom type="box" size="1 2"/>'), "body 1: geom 1: size 2 must be positive"),
    "fromto": (hinged('<geom size="1" fromto="0 0 0 1 0 0"/>'), "body 1: geom 1: fromto requires capsule"),
    "ends": (hinged('<geom type="capsule" size="1" fromto="1 0 0 1 0 0"/>'), "geom 1: fromto points too close"),
    "key": (f'{ARM}<keyframe><key name="k" qpos="1 2 3"/></keyframe>', "invalid qpos size"),
    "actuator": (
        f'{ARM}<actuator><motor name="m" joint="jj"/></actuator>',
        "motor 'm': unknown transmission target 'jj'",
    ),
    "actuator kind": (f'{ARM}<actuator><moter joint="j"/></actuator>', "actuator: moter 1: unrecognized element"),
    "equality": (closing("<conect/>"), "equality: conect 1: unrecognized element"),
    "ends of connect": (closing('<connect body1="a" body2="b"/>'), "equality: connect 1: .*anchor.* must be"),
    "body of connect": (closing('<connect body1="a" body2="c" anchor="0 0 0"/>'), "connect 1: unknown element 'c'"),
    "site of connect": (closing('<connect site1="a" site2="b"/>'), "connect 1: unknown element 'a'"),
    "one body": (closing('<connect body1="a" body2="a" anchor="0 0 0"/>'), "connect 1: element 'a' is repeated"),
    "joint of equality": (closing('<joint joint1="j" joint2="x"/>'), "equality: joint 1: unknown element 'x'"),
    "itself": (closing('<joint joint1="j" joint2="j"/>'), "equality: joint 1: element 'j' is repeated"),
    "mesh": (hinged('<geom type="mesh" mesh="m" mass="0"/>' + ROD), "body 1: geom 1: mesh 'm' not found"),
    "plane": (hinged('<geom type="plane" size="1 1 1"/>' + ROD), "body 1: geom 1: plane only allowed in static bodies"),
    "many copies": (
        world('<replicate count="1e5"><replicate count="1000"><body/></replicate></replicate>'),
        "more than 100,000 elements",
    ),
    "fine mesh": ('<asset><mesh name="m" builtin="sphere" params="1e7"/></asset>', "more than 100,000 elements"),
}
CABLE = "<tendon><spatial name='t' {}><site site='s'/><site site='w'/></spatial></tendon>"
CABLED = world('<site name="w"/>', body('<joint/><site name="s" pos="1 0 0"/>' + ROD), rest=CABLE)
NOT_COMPUTED = {
    "rope": (CABLED.format('stiffness="1" springlength="0 1"'), "tendon 't': a rope that is slack is not supported"),
    "rough tendon": (
        CABLED.format('frictionloss="1"'),
        "tendon 't': an armature or frictionloss is supported for fixed",
    ),
    "flex equality": (closing('<flex flex="f"/>'), "flex: flexible bodies are not supported"),
    "flex": (f"{ARM}<deformable><flex name='f'/></deformable>", "flex: flexible bodies are not supported"),
    "flexcomp": (world("<flexcomp/>"), "flexcomp: flexible bodies are not supported"),
    "damped actuator": (
        f'{ARM}<actuator><motor name="m" joint="j" damping="1"/></actuator>',
        "actuator 'm': damping is not supported",
    ),
    "composite": (world(body("<composite/>")), "body 1: composite 1: unrecognized element"),
    "attach": (world("<attach/>"), "worldbody: attach 1: required attribute missing"),
    "plugin": (world(body("<plugin/>")), "body 1.*: neither 'plugin' nor 'instance' is specified"),
    "carried by limited motors": (
        world(body('<joint name="j" actuatorgravcomp="true" actuatorfrcrange="-1 1"/>' + ROD, 'gravcomp="1"')),
        "joint 'j': actgravcomp is not supported with an actuatorfrcrange",
    ),
    "nonlinear": (world(body('<joint damping="1 2"/>' + ROD)), "joint 1: nonlinear damping is not supported"),
    "nonlinear spring": (
        world(body('<joint stiffness="1 2"/>' + ROD)),
        "joint 1: nonlinear stiffness is not",
    ),
    "yielding": (world(body('<joint stiffness="1" springyield="1"/>' + ROD)), "joint 1: springyield is not supported"),
}


@pytest.mark.parametrize(("text", "message"), (BAD | NOT_COMPUTED).values(), ids=BAD | NOT_COMPUTED)
def test_what_is_refused_is_named(refused, text, message):
    said = refused(text)
    assert re.search(message, said), said


CONTENTS = [b"", b"\xff\xfe\x00\x01", b'<!DOCTYPE r [<!ENTITY a "b">]><mujoco/>', b"<html/>"]


@pytest.mark.parametrize("content", CONTENTS)
def test_contents_that_are_no_mjcf(tmp_path, content):
    path = tmp_path / "x.mjcf"
    path.write_bytes(content)
    with pytest.raises(
        pc.FormatError, match=r"not well-formed|refused for safety|root element of an MJCF|no link|<sdf> needs"
    ) as caught:
        pc.load(path)
    assert caught.value.path == str(path)


INCLUDES = {
    "cycle": (
        {"b.xml": '<x><include file="c.xml"/></x>', "c.xml": '<x><include file="b.xml"/></x>'},
        "c.xml: include 'b",
    ),
    "itself": ({"b.xml": '<x><include file="a.xml"/></x>'}, r"b.xml: include 'a.xml': it includes itself"),
    "missing": ({}, r"a.xml: include 'b.xml': there is no such file"),
    "broken": ({"b.xml": "<x>"}, r"b.xml: not well-formed"),
    "outside": ({"b.xml": '<x><include file="../../a.xml"/></x>'}, r"b.xml: include '../../a.xml': it is outside"),
    "absolute": ({"b.xml": '<x><include file="/etc/passwd"/></x>'}, r"b.xml: include '/etc/passwd': it is outside"),
    "nameless": ({"b.xml": "<x><include/></x>"}, r"b.xml: include '': attribute 'file' is missing"),
    "in it": (
        {"b.xml": "<x><worldbody><body><jiont/></body></worldbody></x>"},
        "b.xml: body 1: jiont 1: unrecognized element",
    ),
    "wrong": ({"b.xml": "<x><body/></x>"}, r"a.xml: <body> belongs in <worldbody>"),
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
    deep = chain(*[("", "<joint/>" + ROD)] * 450)
    path.write_text(f"<mujoco>{deep}{world(*[body('<joint/>' + ROD)] * 150)}</mujoco>")
    assert pc.load(path).nv == 600
    path.write_text(f"<mujoco>{chain(*[('', '<joint/>' + ROD)] * 600)}</mujoco>")
    with pytest.raises(pc.FormatError, match="Element nesting is too deep"):
        pc.load(path)


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
