"""SDF files that are wrong: each error names the file and the element, and nothing is printed."""

from functools import partial

import pytest
from helpers.sdf_texts import BAR, CHAIN, A, B, C, axis, joint, link, write

import pinconsist as pc


@pytest.fixture
def scene(tmp_path):
    return partial(write, tmp_path)


def shape(inside):
    return link("a", "", f'{BAR}<visual name="v"><geometry>{inside}</geometry></visual>') + B + joint()


def mesh(uri):
    return shape(f"<mesh><uri>{uri}</uri></mesh>")


def inertial(inside):
    return link("a", "", f"<inertial>{inside}</inertial>") + B + joint()


def frame(name, inside="", **attributes):
    given = "".join(f' {key}="{value}"' for key, value in attributes.items())
    return f'<frame name="{name}"{given}>{inside}</frame>'


def posed(text, attributes=""):
    return f'<link name="a"><pose{attributes}>{text}</pose></link>' + B + joint()


def gear(body="a", first="0 0 1"):
    inside = axis(first) + axis(tag="axis2") + f"<gearbox_reference_body>{body}</gearbox_reference_body>"
    return CHAIN + joint("g", "b", "c", "gearbox", inside)


def follows(inside, name="j"):
    return A + B + C + joint() + joint("k", "b", "c", inside=axis("0 0 1", f'<mimic joint="{name}"{inside}/>'))


NESTED = '<model name="n">{}</model>'
BAD = {
    # names and structure
    "no link": ("", "model 'm': there is no link"),
    "link without name": ("<link/>", "a link has no name"),
    "same link": (A + A, "link 'a': link 'a' has the same name"),
    "link and joint": (CHAIN + joint("a", "b", "c"), "joint 'a': link 'a' has the same name"),
    "link and frame": (CHAIN + frame("b"), "frame 'b': link 'b' has the same name"),
    "reserved": (A + link("__model__"), "link '__model__': the name is reserved"),
    "world": (A + link("world"), "link 'world': the name is reserved"),
    "universe": (A + link("universe"), "link 'universe': the name is reserved"),
    "nothing moves": (A + joint(parent="world", child="a", kind="fixed"), "nothing can move"),
    "all fixed": (A + B + joint(kind="fixed") + joint("k", "world", "a", kind="fixed"), "nothing can move"),
    "include": (
        CHAIN + "<include><uri>model://x</uri></include>",
        "include 'model://x': there is no such model beside the file.*package_dirs=",
    ),
    "empty nested": (CHAIN + NESTED.format(""), "model 'n': there is no link"),
    "deep": (CHAIN + NESTED[:16] * 40 + A + "</model>" * 40, "nested more than 30 deep"),
    "static": (CHAIN + "<static>perhaps</static>", "model 'm': static: 'perhaps' is neither true nor false"),
    # joints
    "type": (A + B + joint(kind="hinge"), "joint 'j': type 'hinge' is not one of revolute"),
    "no type": (A + B + joint().replace(' type="revolute"', ""), "joint 'j': type '' is not one of"),
    "parent": (
        A + B + joint(parent="aa"),
        "joint 'j': parent: there is no link, joint, frame or model 'aa' here; similar",
    ),
    "child": (
        A + B + joint(child="bb"),
        r"joint 'j': child: there is no link, joint, frame or model 'bb' here; similar: b",
    ),
    "no child": (A + B + joint().replace("<child>b</child>", ""), "joint 'j': <child> is missing"),
    "empty parent": (A + B + joint(parent=""), "joint 'j': <parent> is empty"),
    "world child": (A + B + joint("j", "a", "world"), "joint 'j': the world cannot be a child"),
    "itself": (A + B + joint(child="a"), "joint 'j': parent and child are the same body 'a'"),
    "no axes": (A + B + joint(kind="universal", inside=""), "joint 'j': its two axes are parallel"),
    "no axis2": (A + B + joint(kind="universal"), "joint 'j': its two axes are parallel"),
    "zero axis": (A + B + joint(inside=axis("0 0 0")), "joint 'j': axis: the axis is the zero vector"),
    "axis count": (A + B + joint(inside=axis("0 1")), "joint 'j': axis: xyz: '0 1' is not 3 finite numbers"),
    "axis text": (A + B + joint(inside=axis("0 1 z")), "joint 'j': axis: xyz: '0 1 z' is not 3 finite numbers"),
    "parallel": (
        A + B + joint(kind="universal", inside=axis() + axis("0 0 -3", tag="axis2")),
        "joint 'j': its two axes are parallel",
    ),
    "expressed in": (
        A + B + joint(inside='<axis><xyz expressed_in="q">1 0 0</xyz></axis>'),
        "joint 'j': axis: xyz: there is no link, joint, frame or model 'q'",
    ),
    "limit": (
        A + B + joint(inside=axis("0 0 1", "<limit><lower>low</lower></limit>")),
        "joint 'j': axis: limit: lower: 'low' is not a number",
    ),
    "nan limit": (
        A + B + joint(inside=axis("0 0 1", "<limit><upper>nan</upper></limit>")),
        "joint 'j': axis: limit: upper: 'nan' is not a number",
    ),
    "limits": (
        A + B + joint(inside=axis("0 0 1", "<limit><lower>2</lower><upper>1</upper></limit>")),
        "joint 'j': axis: limit: lower 2 is above upper 1",
    ),
    "damping": (
        A + B + joint(inside=axis("0 0 1", "<dynamics><damping>-1</damping></dynamics>")),
        "joint 'j': axis: dynamics: damping: -1 is negative",
    ),
    "spring": (
        A + B + joint(inside=axis("0 0 1", "<dynamics><spring_stiffness>1e999</spring_stiffness></dynamics>")),
        "joint 'j': axis: dynamics: spring_stiffness: '1e999' is not a finite number",
    ),
    "ball spring": (
        A + B + joint(kind="ball", inside=axis("0 0 1", "<dynamics><spring_stiffness>1</spring_stiffness></dynamics>")),
        "joint 'j': axis: a ball joint has no axis about which a spring could act",
    ),
    "pitch": (
        A + B + joint(kind="screw", inside=axis() + "<thread_pitch>0</thread_pitch>"),
        "joint 'j': thread_pitch: zero means infinite travel",
    ),
    "universal names": (
        CHAIN
        + link("d")
        + joint("u", "a", "d", "universal", axis() + axis("1 0 0", tag="axis2"))
        + link("e")
        + joint("u_axis", "d", "e"),
        "joint 'u_axis': another joint has this name",
    ),
    "no gear body": (
        CHAIN + joint("g", "b", "c", "gearbox", axis() + axis(tag="axis2")),
        "joint 'g': <gearbox_reference_body> is missing",
    ),
    "gear body": (
        gear("b"),
        "joint 'g': it needs one revolute joint between its reference body 'b' and 'b', but there are 0",
    ),
    "gear ends": (gear("a"), "joint 'g': it needs one revolute joint between its reference body 'a' and 'c'"),
    "gear axis": (
        A + B + C + joint() + joint("k", "a", "c") + gear("a", "0 1 0")[len(CHAIN) :],
        "joint 'g': its axis is not parallel to that of joint 'j'",
    ),
    "mimic": (follows("", "i"), "joint 'k': mimic: there is no joint 'i'"),
    "mimic itself": (follows("", "k"), "joint 'k': mimic: a joint cannot follow itself"),
    "mimic axis": (follows(' axis="axis3"'), "joint 'k': axis: mimic: axis='axis3' is neither axis nor axis2"),
    "mimic axis2": (follows(' axis="axis2"'), "joint 'k': mimic: joint 'j' has no such axis"),
    # poses
    "pose": (posed("0 0 1"), r"link 'a': pose: '0 0 1' is not 6 finite numbers"),
    "pose text": (posed("0 0 nan 0 0 0"), r"link 'a': pose: '0 0 nan 0 0 0' is not 6 finite numbers"),
    "quaternion": (posed("0 0 0 0 0 0 0", ' rotation_format="quat_xyzw"'), "link 'a': pose: the quaternion is zero"),
    "format": (posed("0 0 0 0 0 0 0", ' rotation_format="wxyz"'), "link 'a': pose: the rotation_format 'wxyz'"),
    "degrees": (posed("0 0 0 0 0 0", ' degrees="deg"'), "link 'a': pose: 'deg' is neither true nor false"),
    "relative": (posed("0 0 0 0 0 0", ' relative_to="bb"'), "link 'a': there is no link, .* 'bb' here; similar: b"),
    "relative to itself": (posed("0 0 0 0 0 0", ' relative_to="a"'), "link 'a': the frames form a cycle: a → a"),
    "relative cycle": (
        CHAIN
        + frame("f", '<pose relative_to="g"/>')
        + frame("g", '<pose relative_to="h"/>')
        + frame("h", '<pose relative_to="f"/>'),
        "frame 'f': the frames form a cycle: f → g → h → f",
    ),
    "cycle over a joint": (
        posed("0 0 0 0 0 0", ' relative_to="b"').replace(B, '<link name="b"><pose relative_to="j"/></link>'),
        "the frames form a cycle: b → j → b",
    ),
    "attached cycle": (
        CHAIN
        + frame("f", '<pose relative_to="a"/>', attached_to="g")
        + frame("g", '<pose relative_to="a"/>', attached_to="f"),
        "frame 'f': the frames form a cycle: f → g → f",
    ),
    "attached to itself": (
        CHAIN + frame("f", '<pose relative_to="a"/>', attached_to="f"),
        "the frames form a cycle: f → f",
    ),
    "canonical itself": (
        CHAIN + '<model name="n" canonical_link="__model__">' + A + "</model>" + joint("x", "a", "n"),
        "model 'n': the frames form a cycle: n → n",
    ),
    "attached": (CHAIN + frame("f", attached_to="z"), "frame 'f': there is no link, joint, frame or model 'z'"),
    "frame text": (CHAIN + frame("f", "<pose>1 2</pose>"), "frame 'f': pose: '1 2' is not 6 finite numbers"),
    "huge places": (
        link("a", "-1e31 0 0 0 0 0") + link("b") + joint(),
        r"link 'a': pose: '-1e31 0 0 0 0 0' is not 6 finite numbers \(the largest is 1e\+30\)",
    ),
    # links
    "mass": (inertial("<mass>-1</mass>"), "link 'a': inertial: the mass is negative: -1 kg"),
    "mass text": (inertial("<mass>heavy</mass>"), "link 'a': inertial: mass: 'heavy' is not a finite number"),
    "huge mass": (inertial("<mass>1e999</mass>"), "link 'a': inertial: mass: '1e999' is not a finite number"),
    "inertia": (
        A + link("b", "", "<inertial><inertia><ixx>-1</ixx></inertia></inertial>") + joint(),
        "link 'b': inertial: a principal inertia is negative",
    ),
    "inertia text": (
        inertial("<inertia><iyy/></inertia>"),
        "link 'a': inertial: inertia: iyy: '' is not a finite number",
    ),
    "inertial pose": (inertial("<pose>0 0 0</pose>"), "link 'a': inertial: pose: '0 0 0' is not 6 finite numbers"),
    "auto": (
        inertial("").replace("<inertial", '<inertial auto="true"'),
        "link 'a': inertial: it is computed from the collision shapes, and the link has none",
    ),
    "added mass": (inertial("<fluid_added_mass/>"), "link 'a': inertial: fluid_added_mass is not supported"),
    # shapes
    "size": (shape("<sphere><radius>-1</radius></sphere>"), "link 'a': visual: sphere: a size is negative"),
    "size text": (
        shape("<box><size>1 1</size></box>"),
        "link 'a': visual 'v': box: size: '1 1' is not 3 finite numbers",
    ),
    "no uri": (shape("<mesh/>"), "link 'a': visual 'v': mesh: <uri> is missing"),
}


WORLD = b'<sdf version="1.7"><world name="w">%s<model name="m"><link name="a"/></model></world></sdf>'


@pytest.mark.parametrize(("body", "message"), BAD.values(), ids=BAD)
def test_bad_sdf_is_named_and_nothing_is_printed(scene, capfd, body, message):
    path = scene(body)
    with pytest.raises(pc.FormatError, match=message) as caught:
        pc.load(path)
    assert caught.value.path == str(path)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "not well-formed"),
        (b'<sdf version="1.7"><model name="m"><link name="a">', "not well-formed"),
        (b'<!DOCTYPE s [<!ENTITY a "b">]><sdf version="1.7"><model name="&a;"/></sdf>', "refused for safety"),
        (b"<robot/>", "there is no link"),
        (b"<html/>", "the root element of an SDF file is <sdf>, this is <html>"),
        (b"<sdf/>", "needs a version such as 1.7, not ''"),
        (b'<sdf version="new"/>', "needs a version such as 1.7, not 'new'"),
        (b'<sdf version="1.1"/>', "version 1.1 is too old: the oldest supported version is 1.2"),
        (b'<sdf version="1.7"/>', "there is no link"),
        (b'<sdf version="1.7"><world name="w"/><world name="v"/></sdf>', "this file has 2 worlds"),
        (WORLD % b"<include><uri>https://x.org/sun_model</uri></include>", "include 'https.*nothing is downloaded"),
        (WORLD % b"<gravity>9.81</gravity>", "world: gravity: '9.81' is not 3 finite numbers"),
        (b"<sdf>" + b" " * 50_000_000, "more than 50 MB"),
    ],
)
def test_bad_file_contents(tmp_path, capfd, content, message):
    path = tmp_path / "x.sdf"
    path.write_bytes(content)
    with pytest.raises(pc.FormatError, match=message) as caught:
        pc.load(path)
    assert caught.value.path == str(path)
    assert capfd.readouterr() == ("", "")


def test_meshes_within_named_folders_are_no_climbing(scene, tmp_path):
    (tmp_path / "robots").mkdir()
    path = write(tmp_path / "robots", mesh("../meshes/x.stl"))
    assert "../meshes/x.stl" in pc.load(path, package_dirs=[tmp_path]).geometry.urdf
    assert "meshes" in pc.load(scene(mesh(f"{tmp_path}/meshes/x.stl"))).geometry.urdf


def test_nothing_floats_where_all_is_tied_to_the_world(scene):
    path = scene(CHAIN + joint("w", "world", "a"))
    with pytest.raises(pc.FormatError, match="nothing can float: all links are connected to the world"):
        pc.load(path, free_flyer=True)
    path = scene(A + B + joint("root_joint"))
    with pytest.raises(pc.FormatError, match="joint 'root_joint': another joint has this name"):
        pc.load(path, free_flyer=True)


def test_long_chains_and_cycles_of_frames_are_no_trouble(scene):
    n = 2000
    frames = "".join(frame(f"f{i}", f'<pose relative_to="f{i + 1}">1 0 0 0 0 0</pose>') for i in range(n))
    assert pc.load(scene(CHAIN + frames + frame(f"f{n}"))).nv == 2
    with pytest.raises(pc.FormatError, match="the frames form a cycle"):
        pc.load(scene(CHAIN + frames + frame(f"f{n}", '<pose relative_to="f0"/>')))


def test_the_loop_file_of_an_sdf_scene(scene, tmp_path):
    loops = tmp_path / "more.yaml"
    loops.write_text("loops: [{name: n, kind: point, frame1: c, xyz2: [2, 0, 0]}]\nguess: {j: 0.1}\nactuated: [k]")
    mech = pc.load(scene(CHAIN), loops=loops)
    assert [loop.name for loop in mech.loops] == ["n"] and mech.actuated == ("k",) and mech.guess[0] == 0.1
    loops.write_text("joint_name: [j]\njoint_type: [SPHERICAL]")
    with pytest.raises(pc.FormatError, match=r"more\.yaml: joints can be replaced only in URDF scenes"):
        pc.load(scene(CHAIN), loops=loops)


@pytest.mark.parametrize("place", ["model", "axis"])
def test_what_closes_loops_elsewhere_is_refused_unless_it_is_ignored(scene, place):
    foreign = '<drake:coupler name="l"/>' if place == "axis" else "<drake:other_constraint/>"
    body = A + B + joint(inside=axis(inside=foreign)) if place == "axis" else CHAIN + "\n" + foreign
    path, tag = scene(body), foreign[1:].split("/")[0].split()[0]
    line = 3 if place == "axis" else 5
    with pytest.raises(pc.FormatError, match=f"line {line}, {tag}.*: the extension <{tag}> is not supported") as caught:
        pc.load(path)
    assert caught.value.path == str(path)
    assert pc.load(path, ignore=[tag]).loops == ()
