"""Files that are wrong: each error names the file and the element, and nothing is printed."""

import os
from functools import partial

import pytest
from helpers.urdf_texts import CHAIN, A, B, C, joint, write

from pinconsist.errors import FormatError, InputError
from pinconsist.formats import load


@pytest.fixture
def robot(tmp_path):
    return partial(write, tmp_path)


BAD_URDF = {
    "not xml": ("<link", "not well-formed"),
    "entity": (None, "refused for safety"),
    "link without name": ("<link/>" + A, "link number 1: it has no name"),
    "same link": (A + A, "link 'a': two links"),
    "same joint": (CHAIN + joint(), "joint 'j': two joints"),
    "no link": ("", "there is no link"),
    "one link": ('<link name="a"/>', "nothing can move: all joints are fixed, and no link has a mass"),
    "all fixed": (
        A + '<link name="world"/>' + joint("j", "world", "a", kind="fixed"),
        "nothing can move.*is the ground",
    ),
    "universe": (A + '<link name="universe"/>', "link 'universe': .*name of the ground"),
    "type": (A + B + joint(kind="hinge"), "joint 'j': type 'hinge' is not one of revolute"),
    "parent": (CHAIN + '<link name="d"/>' + joint("l", "bb", "d"), "joint 'l': its parent link 'bb' does not exist"),
    "no child": (A + '<joint name="j" type="fixed"><parent link="a"/></joint>', "joint 'j': <child> is missing"),
    "itself": (CHAIN + joint("l", "a", "a"), "joint 'l': parent and child are the same"),
    "two roots": (A + B + C + joint(), "'a' and 'c' both have no parent"),
    "cycle": (A + B + C + joint("j", "b", "c") + joint("k", "c", "b"), "link 'b': .*cycle"),
    "cycle of all": (A + B + joint() + joint("k", "b", "a"), "link 'a': .*cycle"),
    "mimic": (
        A + B + joint(inside='<mimic joint="x"/>'),
        "mimic: there is no joint 'x' to follow.*ignore=.'mimic'",
    ),
    "zero axis": (A + B + joint(inside='<axis xyz="0 0 0"/>'), "joint 'j': the axis is the zero vector"),
    "axis count": (A + B + joint(inside='<axis xyz="0 1"/>'), "joint 'j': axis: xyz='0 1' is not 3 finite numbers"),
    "origin": (A + B + joint(inside='<origin xyz="0 nan 0"/>'), "joint 'j': origin: xyz='0 nan 0'"),
    "rpy": (A + B + joint(inside='<origin rpy="0 ${pi} 0"/>'), "joint 'j': origin: rpy="),
    "limit": (A + B + joint(inside='<limit lower="x"/>'), "joint 'j': limit: lower='x' is not a finite number"),
    "planar axis": (A + B + joint(kind="planar", inside=""), "joint 'j': planar joints .*0 0 1"),
    "mass": (A.replace('mass value="1"', 'mass value="-1"') + B + joint(), "link 'a': inertial: the mass is negative"),
    "mass text": (A.replace('mass value="1"', 'mass value="1e999"') + B + joint(), "link 'a': inertial: mass: value="),
    "no mass": (A.replace('<mass value="1"/>', "") + B + joint(), "link 'a': inertial: <mass> is missing"),
    "inertia": (A + B.replace('ixy="0"', 'ixy="0.5"') + joint(), "link 'b': inertial: a principal inertia is negative"),
    "no ixx": (A.replace('ixx="0.01"', "") + B + joint(), "link 'a': inertial: inertia: attribute 'ixx' is missing"),
    "shape": (
        '<link name="a"><visual><geometry><sphere radius="-1"/></geometry></visual></link>' + B + joint(),
        "link 'a': visual: sphere: a size is negative",
    ),
}


@pytest.mark.parametrize(("body", "message"), BAD_URDF.values(), ids=BAD_URDF)
def test_bad_urdf_is_named_and_nothing_is_printed(robot, capfd, body, message):
    head = '<!DOCTYPE r [<!ENTITY a "b">]><robot name="&a;">' if body is None else '<robot name="r">'
    path = robot(CHAIN if body is None else body, head=head)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert str(path) in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not well-formed"),
        (b"\xff\xfe\x00\x01\x02", "not well-formed"),
        (b'<?xml version="1.0" encoding="utf-7"?><robot/>', "not well-formed"),
        (b'<?xml version="1.0" encoding="klingon"?><robot/>', "not well-formed"),
        (b'<!DOCTYPE r SYSTEM "file:///etc/passwd"><robot/>', "refused for safety"),
        (b"<sdf/>", "<sdf> needs a version"),
        (b"<html/>", "the root element of a URDF is <robot>, this is <html>"),
        (b" " * 50_000_001, "more than 50 MB"),
    ],
)
def test_bad_file_contents(tmp_path, capfd, content, message):
    path = tmp_path / "x.urdf"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert caught.value.path == str(path)
    assert capfd.readouterr() == ("", "")


def test_sources_that_are_not_there(tmp_path, robot):
    with pytest.raises(InputError, match=r"four_bra.*similar: four_bar.*planar_pendulum"):
        load("four_bra")
    with pytest.raises(FormatError, match=r"missing\.urdf: no such file"):
        load(tmp_path / "missing.urdf")
    with pytest.raises(FormatError, match=r"'\.step' cannot be read; supported are URDF"):
        load("scene.step")
    with pytest.raises(FormatError, match=r"must contain one \.urdf file, it has 0"):
        load(tmp_path)
    with pytest.raises(InputError, match="got int"):
        load(3)
    with pytest.raises(InputError, match="loops= needs the path of a loop file, got list"):
        load("four_bar", loops=[])
    with pytest.raises(FormatError, match=r"nowhere\.yaml: no such file"):
        load(robot(CHAIN), loops=tmp_path / "nowhere.yaml")
    (tmp_path / "folder.urdf").mkdir()
    os.rename(robot(CHAIN), tmp_path / "folder.urdf" / "robot.urdf")
    assert load(tmp_path / "folder.urdf").name == "folder.urdf"


def test_free_flyer_name_clash(robot):
    with pytest.raises(FormatError, match="joint 'root_joint'"):
        load(robot(A + B + joint("root_joint")), free_flyer=True)


ROW = "{name: n, kind: point, frame1: c}"
BAD_LOOPS = {
    "not yaml": ("loops: [", "line 1: not usable YAML"),
    "not text": ("\x01", "not usable YAML"),
    "empty": ("", "not a loop file, which has keys"),
    "list": ("[1, 2]", "not a loop file, which has keys"),
    "object": ("loops: !!python/object/apply:os.getcwd []", "not usable YAML: could not determine a constructor"),
    "alias": (f"loops: [&x {ROW}, *x]", "aliases"),
    "key twice": ("description: a\ndescription: b", "'description' is given twice"),
    "deep": ("loops: " + "[" * 5000, "not usable YAML"),
    "key": ("loop: []", "'loop' is not known; similar: loops"),
    "forces": ("forces: {}", "forces: a list is needed, not {}"),
    "loop key": (
        "loops: [{name: n, kind: point, frame: c}]",
        "loop 1 'n': the key 'frame' is not known; similar: frame2, frame1",
    ),
    "no kind": ("loops: [{name: n, frame1: c}]", "loop 1 'n': 'kind' is missing"),
    "kind": (f"loops: [{ROW.replace('point', 'weld')}]", "loop 1 'n': unknown kind 'weld'; choose from point"),
    "frame": (
        f"loops: [{ROW}, {{name: m, kind: point, frame1: jj}}]",
        "loop 2 'm': the model has no frame 'jj'; similar: j",
    ),
    "same name": (f"loops: [{ROW}, {ROW}]", "loop 2 'n': another loop has this name"),
    "same body": (f"loops: [{ROW[:-1]}, frame2: k}}]", "are on the same body"),
    "number": (f"loops: [{ROW[:-1]}, xyz1: [0, .nan, 0]}}]", "loop 1 'n': xyz1: a finite number is needed, not nan"),
    "yes": (f"loops: [{ROW[:-1]}, xyz1: [0, yes, 0]}}]", "loop 1 'n': xyz1: a finite number is needed, not True"),
    "three": (f"loops: [{ROW[:-1]}, xyz1: '123'}}]", "loop 1 'n': xyz1: three numbers are needed, not '123'"),
    "axis": (
        f"loops: [{ROW[:-1].replace('point', 'hinge')}, axis: [0, 0, 0]}}]",
        "loop 1 'n': the hinge axis is the zero",
    ),
    "length": ("loops: [{name: n, kind: distance, frame1: c}]", "loop 1 'n': the length of a distance, in m, must be"),
    "name": ("loops: [{name: 12, kind: point, frame1: c}]", "loop 1: name: a name is needed, not 12"),
    "no duration": ("duration: 0", "duration: a positive number of seconds is needed, not 0"),
    "durations": ("duration: [1, 2]", r"duration: a positive number of seconds is needed, not \[1, 2\]"),
    "guess": ("guess: {jk: 1}", "guess: the model has no joint 'jk'"),
    "guess value": ("guess: {j: up}", "guess: j: a finite number is needed, not 'up'"),
    "guess size": ("guess: {j: [1, 2]}", r"configuration of joint 'j' needs 1 number\(s\), got 2"),
    "actuated": ("actuated: [l]", "actuated joints: the model has no joint 'l'; available: j, k"),
    "mixed": ("closed_loop: []\nloops: []", "'loops' cannot be combined"),
    "pair": ("closed_loop: [[c]]", r"loop 1: a pair of frame names is needed, not \['c'\]"),
    "type": ("closed_loop: [[a, c]]\ntype: [5d]", "loop 1 'a-c': the type '5d' is neither 3d nor 6d"),
    "types": ("closed_loop: [[a, c]]\ntype: [6d, 6d]", "type: 2 types for 1 loops"),
    "robot frame": ("closed_loop: [[a, d]]", "loop 1 'a-d': the model has no frame 'd'"),
    "joint type": ("joint_name: [j]\njoint_type: [UJOINT_XX]", "the joint type 'UJOINT_XX' is not one of SPHERICAL"),
    "joint types": ("joint_name: [j, j]\njoint_type: [FIXED, FIXED]", "joint_type: 2 types for 1 different joints"),
    "joint": (
        "joint_name: [i]\njoint_type: [FIXED]",
        "joint 'i': there is no joint of this name to replace; available: j, k",
    ),
    "joint 2": ("joint_name: [i]\njoint_type: [SPHERICAL]", "joint 'i': there is no movable joint of this name"),
}


@pytest.mark.parametrize(("text", "message"), BAD_LOOPS.values(), ids=BAD_LOOPS)
def test_bad_loop_file_is_named_and_nothing_is_printed(robot, capfd, text, message):
    path = robot(CHAIN, text)
    with pytest.raises(FormatError, match=message) as caught:
        load(path)
    assert str(path.with_suffix("")) in str(caught.value)
    assert capfd.readouterr() == ("", "")


def test_frame_name_of_a_link_and_a_joint_elsewhere_is_ambiguous(robot):
    with pytest.raises(FormatError, match="loop 1 'n': the name 'c' belongs to a link and to a joint that is else"):
        load(robot(A + B + C + joint("c") + joint("k", "b", "c"), "loops: [{name: n, kind: point, frame1: c}]"))
