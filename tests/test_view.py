"""Replays and figures: what a page holds, that it moves in a browser, and that failures leave nothing behind."""

import json
import logging
import re
import subprocess
import sys
from itertools import combinations
from types import SimpleNamespace
from urllib.request import urlopen

import numpy as np
import pinocchio as pin
import pytest
from helpers.browser import needs_browser, opened

from pinconsist import assemble, export_html, load, replay
from pinconsist.errors import InputError, MissingExtraError
from pinconsist.mechanism.forces import SpringDamper
from pinconsist.mechanism.loops import Loop
from pinconsist.mechanism.mechanism import Geometry, Mechanism
from pinconsist.paper import plot_comparison
from pinconsist.view.commands import plane_normal
from pinconsist.view.motion import MAX_FRAMES, Run, body_poses, in_world, playing_times
from pinconsist.view.picture import picture
from pinconsist.view.plots import BOTH, pictures_of
from pinconsist.view.shapes import GROUND, JOINT, LOOP, RAIL, covering, link_ends, simple_shapes, skeleton
from pinconsist.view.visuals import visuals

LENGTH = 0.7

INERTIA = '<inertial><mass value="1"/><origin xyz=".3 0 0"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
MESHES = f"""<robot name="r"><link name="base"/>
<link name="arm">{INERTIA}</inertial>
<visual><geometry><mesh filename="package://parts/arm.stl" scale="2 2 2"/></geometry>
<material name="red"><color rgba="1 0 0 1"/></material></visual></link>
<link name="hand">{INERTIA}</inertial>
<visual><geometry><mesh filename="package://parts/HAND.stl"/></geometry></visual>
<visual><geometry><mesh filename="package://parts/HAND.dae"/></geometry></visual></link>
<joint name="shoulder" type="revolute"><parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>
<limit lower="-9" upper="9" effort="1" velocity="1"/></joint>
<joint name="elbow" type="revolute"><parent link="arm"/><child link="hand"/><axis xyz="0 1 0"/>
<origin xyz="0.7 0 0"/><limit lower="-9" upper="9" effort="1" velocity="1"/></joint></robot>"""
FACET = "facet normal 0 0 1\nouter loop\nvertex {}\nvertex {}\nvertex {}\nendloop\nendfacet\n"
STL = "solid s\n" + FACET.format("0 0 0", "1 0 0", "0 1 0") + FACET.format("0 1 0", "1 0 0", "1 1 0") + "endsolid s\n"


def two_links(name="two links"):
    """A double pendulum in the x-z plane whose tip is tied to a point of the ground."""
    model = pin.Model()
    at, joint = pin.SE3.Identity(), 0
    for body in ("upper", "lower"):
        joint = model.addJoint(joint, pin.JointModelRY(), at, body)
        inertia = pin.Inertia(1.0, np.array([LENGTH / 2, 0, 0]), LENGTH**2 / 12 * np.diag([0.0, 1.0, 1.0]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        at = pin.SE3(np.eye(3), np.array([LENGTH, 0, 0]))
    model.addFrame(pin.Frame("tip", joint, 0, at, pin.FrameType.OP_FRAME))
    return Mechanism(model, (Loop("tie", "point", "tip", xyz2=(LENGTH, 0.0, 0.0)),), name=name)


def swing(times):
    """A made-up motion of two_links at any times."""
    times = np.asarray(times, float)
    return SimpleNamespace(t=times, q=np.column_stack((np.sin(2 * times), 0.5 - 0.8 * times)))


def resample(mech, sol, speed, fps):
    """Frames' times and configurations."""
    run = Run.of(mech, sol)
    clock = playing_times([run], speed, fps)
    return clock, run.at(clock * speed).q


def read(page):
    """The commands that a page holds."""
    text = page.read_text(encoding="utf-8")
    return json.loads(re.search(r'<script id="replay" type="application/json">(.*?)</script>', text, re.DOTALL)[1])


def tracks(commands, body):
    """Times, positions and quaternions of a body in the animation."""
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    (clip,) = [each["clip"] for each in animation["animations"] if each["path"] == f"/bodies/{body}"]
    place, turn = clip["tracks"]
    assert clip["fps"] == 1 and (place["name"], turn["name"]) == (".position", ".quaternion")
    return np.array(place["times"]), np.reshape(place["values"], (-1, 3)), np.reshape(turn["values"], (-1, 4))


def test_page_is_whole_and_needs_nothing_from_elsewhere(tmp_path, capfd):
    mech = two_links("tie & <swing>")
    page = export_html(mech, swing(np.linspace(0, 1, 30)), tmp_path / "swing.html", traces=["tip"])
    text = page.read_text(encoding="utf-8")
    assert list(tmp_path.iterdir()) == [page]
    assert "<title>tie &amp; &lt;swing&gt;</title>" in text
    assert not re.search(r"<script[^>]*\bsrc=|<link[^>]*\bhref=[\"']?https?:", text)
    commands = [(command["type"], command["path"]) for command in read(page)["commands"]]
    assert commands.count(("set_animation", "")) == commands.count(("set_object", "/traces/tip")) == 1
    assert capfd.readouterr() == ("", "")
    assert '"set_animation"' not in json.dumps(read(export_html(mech, swing([0.0]), page)))


def test_frames_are_the_forward_kinematics(tmp_path):
    mech, sol = two_links(), swing(np.linspace(0, 1, 41))
    commands = read(export_html(mech, sol, tmp_path / "a.html", fps=40))["commands"]
    data = mech.model.createData()
    for row in (0, 17, 40):
        pin.forwardKinematics(mech.model, data, sol.q[row])
        for joint, body in enumerate(mech.joints, 1):
            times, places, turns = tracks(commands, body)
            assert times[row] == pytest.approx(sol.t[row], abs=1e-6)
            np.testing.assert_allclose(places[row], data.oMi[joint].translation, atol=1e-6)
            rotation = pin.Quaternion(turns[row]).matrix()
            np.testing.assert_allclose(rotation, data.oMi[joint].rotation, atol=1e-6)


def test_resampling_follows_the_rows_forward_and_backward():
    mech = two_links()
    uneven = np.array([0.0, 1e-6, 1e-5, 0.3, 0.3, 0.32, 0.9, 1.0])
    straight = SimpleNamespace(t=uneven, q=np.column_stack((uneven, 2 * uneven)))
    clock, q = resample(mech, straight, speed=0.5, fps=25)
    assert clock[-1] == pytest.approx(2.0) and len(clock) == 51
    np.testing.assert_allclose(q, np.column_stack((clock / 2, clock)), atol=1e-12)
    clock, q = resample(mech, SimpleNamespace(t=uneven[::-1], q=straight.q[::-1]), speed=1.0, fps=50)
    np.testing.assert_allclose(q[:, 0], 1.0 - clock, atol=1e-12)


def test_resampling_stays_on_the_manifold_and_below_the_limit(caplog):
    model = pin.Model()
    ball = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(ball, pin.Inertia(1.0, np.array([0, 0, -1.0]), np.eye(3)), pin.SE3.Identity())
    turned = pin.Quaternion(pin.exp3(np.array([0, 2.0, 0]))).coeffs()
    sol = SimpleNamespace(t=np.array([0.0, 1000.0]), q=np.array([[0, 0, 0, 1.0], turned]))
    with caplog.at_level(logging.INFO, "pinconsist"):
        clock, q = resample(Mechanism(model), sol, speed=1.0, fps=50)
    assert len(clock) == MAX_FRAMES and len(caplog.records) == 1
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1.0, atol=1e-12)
    middle = pin.exp3(np.array([0, 2.0 * clock[1000] / 1000, 0]))
    np.testing.assert_allclose(pin.Quaternion(q[1000]).matrix(), middle, atol=1e-12)


UNUSABLE = [
    ({"q": np.zeros((3, 3))}, {}),
    ({"t": np.array([0.0, 2.0, 1.0])}, {}),
    ({"q": np.full((3, 2), np.nan)}, {}),
    *(({}, option) for option in ({"speed": 0}, {"fps": -1}, {"traces": ["nowhere"]})),
]


@pytest.mark.parametrize(("change", "options"), UNUSABLE)
def test_unusable_input_is_refused_and_leaves_no_file(tmp_path, change, options):
    sol = SimpleNamespace(**{"t": np.array([0.0, 1.0, 2.0]), "q": np.zeros((3, 2)), **change})
    with pytest.raises(InputError):
        export_html(two_links(), sol, tmp_path / "no.html", **options)
    assert not list(tmp_path.iterdir())


def test_failure_while_writing_keeps_the_old_file_alone(tmp_path, monkeypatch):
    page = tmp_path / "page.html"
    page.write_text("old")
    monkeypatch.setattr("os.replace", lambda *_: (_ for _ in ()).throw(OSError("disk full")))
    with pytest.raises(OSError, match="disk full"):
        export_html(two_links(), swing([0, 1]), page)
    with pytest.raises(OSError, match="disk full"):
        plot_comparison([SimpleNamespace(h=0.1, t=[1, 2], exact=[1, 0], consistent=[1, 2])], tmp_path / "figure.png")
    assert [path.name for path in tmp_path.iterdir()] == ["page.html"] and page.read_text() == "old"


def test_links_reach_from_joint_to_joint_and_anchor():
    mech, sol = two_links(), swing(np.linspace(0, 1, 20))
    poses = body_poses(mech.model, sol.q)
    shapes = simple_shapes(mech, poses, size=1.0)
    for joint in (1, 2):
        (link,) = [s for s in shapes if s.node == joint and s.geometry["type"] == "CylinderGeometry"]
        ends = [link.placement.act(np.array([0, y * LENGTH / 2, 0])) for y in (-1, 1)]
        np.testing.assert_allclose(ends, [[0, 0, 0], [LENGTH, 0, 0]], atol=1e-12)
    shell, core = (shape for shape in shapes if shape.on_top)
    assert (shell.node, core.node) == (2, 0) and shell.opacity < 1
    np.testing.assert_allclose(core.placement.translation, [LENGTH, 0, 0])
    np.testing.assert_allclose(np.abs(plane_normal(skeleton(mech, poses))), [0, 1, 0], atol=1e-9)


def test_bodies_too_thin_to_be_seen_have_bars():
    """Each of 32 rods of 4 cm in a picture of 20 m, where a pixel of a phone is 5 cm; none of a four-bar."""
    for name, bars in ("chain_32", 32), ("four_bar", 0):
        mech = load(name)
        poses = body_poses(mech.model, start(mech))
        size = float(np.linalg.norm(np.ptp(skeleton(mech, poses).reshape(-1, 3), axis=0)))
        shapes = simple_shapes(mech, poses, size, covering(visuals(mech)))
        found = [shape for shape in shapes if shape.node and not shape.loop]
        assert len(found) == len({shape.node for shape in found}) == bars
        for shape in found:
            assert shape.geometry["height"] == pytest.approx(1.0) and 2 * shape.geometry["radiusTop"] > size / 390
            np.testing.assert_allclose(shape.placement.translation, (0.5, 0.0, 0.0), atol=1e-12)


@pytest.mark.parametrize("carries", [False, True])
def test_a_leaf_with_a_shape_has_a_lever_only_to_a_point_that_there_is(tmp_path, carries):
    """Its inertia is that of a rod of 0.9 m, and its box ends at 0.3 m."""
    file = tmp_path / "leg.urdf"
    file.write_text("""<robot name="leg"><link name="base"/><link name="calf">
        <inertial><mass value="1"/><origin xyz=".45 0 0"/><inertia ixx="1e-3" iyy=".0675" izz=".0675" ixy="0" ixz="0"
        iyz="0"/></inertial><visual><origin xyz=".15 0 0"/><geometry><box size=".3 .1 .1"/></geometry></visual></link>
        <joint name="knee" type="continuous"><parent link="base"/><child link="calf"/><axis xyz="0 1 0"/></joint>
        </robot>""")
    mech = load(file)
    if carries:
        mech = mech.with_loops(Loop("toe", "distance", "calf", xyz1=(0.8, 0.0, 0.0), xyz2=(0.0, 1.0, 0.0), length=1.3))
    poses = body_poses(mech.model, np.zeros((1, 1)))
    shapes = simple_shapes(mech, poses, 1.0, covering(visuals(mech)))
    levers = [shape for shape in shapes if shape.node == 1 and not shape.loop]
    assert len(levers) == carries
    if carries:
        ends = levers[0].points @ (1.0, 0.0, 0.0)
        np.testing.assert_allclose((ends.min(), ends.max()), (0.3, 0.8), atol=1e-9)


COLOURED = ["andrews", "crank_rocker", "five_bar", "flyball_governor", "four_bar", "jansen_leg", "slider_crank"]


@pytest.mark.parametrize(
    "shapes", [visuals, lambda mech: simple_shapes(mech, body_poses(mech.model, start(mech)), 1.0)]
)
@pytest.mark.parametrize("name", COLOURED)
def test_bodies_that_meet_have_different_colours(name, shapes):
    mech = load(name)
    poses = body_poses(mech.model, start(mech))
    common = {JOINT, GROUND, RAIL, LOOP, 0x8C949E, 0x333840}  # and steel and dark of the files
    points = {joint: in_world(poses[:, joint], [np.zeros(3), *ends])[0] for joint, ends in link_ends(mech).items()}
    colors = {joint: {shape.color for shape in shapes(mech) if shape.node == joint} - common for joint in points}
    meeting = [
        pair for pair in combinations(points, 2)
        if min(np.linalg.norm(a - b) for a in points[pair[0]] for b in points[pair[1]]) < 1e-3
    ]  # fmt: skip
    assert meeting
    for first, second in meeting:
        assert not colors[first] & colors[second], (mech.joints[first - 1], mech.joints[second - 1])


def start(mech):
    return assemble(mech).q[None]


def test_a_distance_loop_shows_as_a_bar_between_its_anchors():
    mech = two_links().with_loops(Loop("bar", "distance", "tip", xyz2=(0.0, 0.0, -2.0), length=1.3))
    sol = swing(np.linspace(0, 1, 51))
    commands = picture(mech, sol, speed=1, fps=50, traces=(), forces=False, loop=False)["commands"]
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    (clip,) = [each["clip"] for each in animation["animations"] if each["path"] == "/loops/bar"]
    tip = LENGTH * sum(np.array([np.cos(angle), 0, -np.sin(angle)]) for angle in np.cumsum(sol.q[30]))
    centre, turn = (np.reshape(track["values"], (51, -1))[30] for track in clip["tracks"])
    np.testing.assert_allclose(centre, (tip + np.array([0, 0, -2])) / 2, atol=1e-6)
    along = np.array([0, 0, -2]) - tip
    np.testing.assert_allclose(pin.Quaternion(turn).matrix()[:, 1], along / np.linalg.norm(along), atol=1e-6)


def test_a_sliding_body_is_a_block_that_moves_and_its_rail_stays():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPX(), pin.SE3(np.eye(3), np.array([0.5, 0, 0])), "piston")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    q = np.array([[-0.2], [0.3]])
    shapes = simple_shapes(Mechanism(model), body_poses(model, q), size=1.0)
    (piston,) = [shape for shape in shapes if shape.node == joint]
    (rail,) = [shape for shape in shapes if shape.node == 0]
    along = piston.placement.rotation[:, 1]
    np.testing.assert_allclose(np.abs(along), [1, 0, 0], atol=1e-12)
    assert piston.geometry["type"] == "BoxGeometry" and piston.color != rail.color
    assert rail.geometry["height"] == pytest.approx(0.5) and rail.geometry["type"] == "CylinderGeometry"
    np.testing.assert_allclose(rail.placement.translation, [0.55, 0, 0], atol=1e-12)


def test_a_spring_is_a_coil_between_its_points():
    spring = SpringDamper("tip", xyz2=(0.0, 0.3, -2.0), stiffness=1.0)
    mech, sol = two_links().add_forces(spring), swing(np.linspace(0, 1, 51))
    commands = picture(mech, sol, speed=1, fps=50, traces=(), forces=False, loop=False)["commands"]
    (coil,) = [each["object"] for each in commands if each.get("object") and each["path"] == "/springs/1/coil"]
    points = np.reshape(coil["geometries"][0]["data"]["attributes"]["position"]["array"], (-1, 3))
    np.testing.assert_allclose(points[:6].mean(axis=0), [0, -0.5, 0], atol=1e-6)
    np.testing.assert_allclose(points[-6:].mean(axis=0), [0, 0.5, 0], atol=1e-6)
    assert 0.01 < np.abs(points[:, [0, 2]]).max() < 0.1  # it winds about the line
    (animation,) = [command for command in commands if command["type"] == "set_animation"]
    (clip,) = [each["clip"] for each in animation["animations"] if each["path"] == "/springs/1"]
    centre, turn, scale = (np.reshape(track["values"], (51, -1)) for track in clip["tracks"])
    for row in (0, 30):
        tip = LENGTH * sum(np.array([np.cos(a), 0, -np.sin(a)]) for a in np.cumsum(sol.q[row]))
        half = pin.Quaternion(turn[row]).matrix() @ [0, scale[row, 1] / 2, 0]
        np.testing.assert_allclose([centre[row] - half, centre[row] + half], [tip, [0, 0.3, -2]], atol=1e-5)


def meshed(tmp_path, hand):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.stl").write_text(STL)
    (tmp_path / "parts" / "broken.stl").write_text("nothing of use")
    text = MESHES.replace("HAND", hand)
    return Mechanism(pin.buildModelFromXML(text), name="meshed", geometry=Geometry(text, (str(tmp_path),)))


@pytest.mark.parametrize("hand", ["absent", "broken"])
def test_missing_meshes_fall_back_with_one_warning(tmp_path, caplog, hand):
    mech = meshed(tmp_path, hand)
    with caplog.at_level(logging.WARNING, "pinconsist"):
        commands = picture(mech, swing([0, 1]), speed=1, fps=50, traces=(), forces=False, loop=False)["commands"]
    (record,) = caplog.records
    assert "2 mesh" in record.getMessage() and f"{hand}.stl" in record.getMessage()
    drawn = [(command["path"], command["object"]) for command in commands if command["type"] == "set_object"]
    (arm,) = [thing for path, thing in drawn if path.startswith("/bodies/shoulder/")]
    hand_forms = {thing["geometries"][0]["type"] for path, thing in drawn if path.startswith("/bodies/elbow/")}
    assert arm["geometries"][0]["type"] == "BufferGeometry" and arm["materials"][0]["color"] == 0xFF0000
    assert max(arm["geometries"][0]["data"]["attributes"]["position"]["array"]) == 2.0  # the file's scale
    assert hand_forms == {"CylinderGeometry", "SphereGeometry"}


@pytest.mark.parametrize("material", ["", '<material name="w"><color rgba="1 1 1 1"/></material>'])
def test_white_shapes_and_those_without_a_colour_are_told_from_the_page(tmp_path, material):
    """The background is white above and 0xD8DDE3 below."""
    box = f'<visual><geometry><box size="1 1 1"/></geometry>{material}</visual>'
    text = re.sub(r"<visual>.*?</visual>", "", MESHES, flags=re.DOTALL).replace(
        '<link name="arm">', f'<link name="arm">{box}'
    )
    mech = Mechanism(pin.buildModelFromXML(text), name="boxed", geometry=Geometry(text, (str(tmp_path),)))
    (shape,) = visuals(mech)
    assert max(shape.color.to_bytes(3, "big")) < 0xC8


INERTIAL = "<inertial><mass>1</mass><inertia><ixx>1</ixx><iyy>1</iyy><izz>1</izz></inertia></inertial>"
BESIDE = {
    "robot.urdf": MESHES.replace("HAND.stl", "arm.stl").replace("HAND.dae", "arm.stl"),
    "relative.urdf": re.sub("package://parts/[A-Za-z]+.[a-z]+", "parts/arm.stl", MESHES),
    "robot.sdf": f"""<sdf version="1.7"><model name="m"><link name="arm">{INERTIAL}
<visual name="v"><geometry><mesh><uri>parts/arm.stl</uri></mesh></geometry></visual></link>
<joint name="j" type="revolute"><parent>world</parent><child>arm</child><axis><xyz>0 1 0</xyz></axis></joint>
</model></sdf>""",
    "robot.xml": """<mujoco><compiler meshdir="parts"/><asset><mesh name="arm" file="arm.stl"/></asset><worldbody>
<body><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/><joint type="hinge" axis="0 1 0"/>
<geom type="mesh" mesh="arm"/></body></worldbody></mujoco>""",
}


@pytest.mark.parametrize("name", BESIDE)
def test_meshes_beside_a_robots_file_are_shown(tmp_path, caplog, name):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "arm.stl").write_text(STL)
    (tmp_path / name).write_text(BESIDE[name])
    with caplog.at_level(logging.WARNING, "pinconsist"):
        shapes = visuals(load(tmp_path / name))
    assert not [each for each in caplog.records if "without effect here" not in each.getMessage()]
    assert {shape.geometry["type"] for shape in shapes} == {"BufferGeometry"}
    assert {shape.node for shape in shapes} == ({1, 2} if name.endswith("urdf") else {1})


def test_replay_serves_the_page_on_the_loopback_interface(monkeypatch):
    seen = []
    monkeypatch.setattr("webbrowser.open", lambda address: seen.append(urlopen(address).read()) or True)
    address = replay(two_links(), swing(np.linspace(0, 0.2, 5)), loop=False)
    assert address.startswith("http://127.0.0.1:") and b"<title>two links</title>" in seen[0]
    assert b'"loop":false' in seen[0]
    assert b'"loop":true' in urlopen(replay(two_links(), swing([0, 1]), open_browser=False)).read()


def test_what_is_missing_is_named(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "meshcat", None)
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match="pip install meshcat"):
        export_html(two_links(), swing([0, 1]), tmp_path / "no.html")
    with pytest.raises(MissingExtraError, match=re.escape("pip install 'pinconsist[plot]'")):
        plot_comparison([])
    assert not list(tmp_path.iterdir())


def test_importing_the_view_loads_no_viewer():
    code = """if True:
        import sys, pinconsist.view.page, pinconsist.view.plots
        print({"meshcat", "coal", "matplotlib", "defusedxml"} & set(sys.modules))"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() in ("set()", "{'coal'}")  # Pinocchio itself may bring coal


POSE = """{const {position, quaternion} = object("/bodies/lower"); [...position.toArray(), ...quaternion.toArray()]}"""


@needs_browser
def test_page_moves_in_a_browser(tmp_path):
    mech, sol = two_links(), swing(np.linspace(0, 5, 501))
    with opened(export_html(mech, sol, tmp_path / "swing.html", fps=50)) as tab:
        tab.wait("now > 0.1")
        moved = tab.run(POSE)
        sought = {time: tab.run(f"running = false; seek({time}); {POSE}") for time in (0, 0.4, 0.8)}
    assert not np.allclose(moved, sought[0], atol=1e-3)
    data = mech.model.createData()
    for time, pose in sought.items():
        pin.forwardKinematics(mech.model, data, swing([time]).q[0])
        np.testing.assert_allclose(pose[:3], data.oMi[2].translation, atol=2e-4)
        np.testing.assert_allclose(pin.Quaternion(np.array(pose[3:])).matrix(), data.oMi[2].rotation, atol=2e-4)


def test_figure_of_a_solution(tmp_path):
    pytest.importorskip("matplotlib")
    mech, sol = two_links(), swing(np.linspace(0, 1, 60))
    sol.v, sol.lam = np.gradient(sol.q, sol.t, axis=0), np.column_stack([np.cos(k * sol.t) for k in range(3)])
    figure = pictures_of(sol, BOTH, tmp_path / "figure.pdf", mech)
    assert [path.name for path in tmp_path.iterdir()] == ["figure.pdf"]
    q, v, lam, first = figure.axes
    assert [line.get_label() for line in q.lines] == [line.get_label() for line in v.lines] == ["upper", "lower"]
    assert [line.get_label() for line in lam.lines] == ["tie x", "tie y", "tie z"]
    assert len(first.lines[0].get_xdata()) == 21
    many = SimpleNamespace(t=sol.t, q=np.outer(sol.t, range(40)), v=np.outer(sol.t, range(40)), lam=np.zeros((60, 0)))
    q, _ = pictures_of(many, BOTH).axes
    assert len(texts := q.get_legend().get_texts()) == 12 and len(q.lines) == 40
    assert "29 more" in [text.get_text() for text in texts]


def test_figure_of_a_comparison():
    pytest.importorskip("matplotlib")
    t = np.linspace(1, 1.5, 11)
    rows = [{"h": h, "t": t, "exact": h + (t == 1.0), "consistent": h * (t - 1)} for h in (0.1, 0.01)]
    figure = plot_comparison(rows)
    assert [axis.get_yscale() for axis in figure.axes] == ["log", "log"]
    exact, consistent = figure.axes[0].lines
    assert exact.get_linestyle() != consistent.get_linestyle()
    assert np.isnan(consistent.get_ydata()[0]) and np.isfinite(exact.get_ydata()).all()
    with pytest.raises(InputError, match="shape"):
        plot_comparison([{**rows[0], "exact": t[:3]}])


def test_a_joint_that_slides_between_bodies_is_a_barrel_with_a_rod():
    """Also where its origin is that of the barrel, and the way from there to the shortest length is never taken."""
    model = pin.Model()
    barrel = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "barrel")
    rod = model.addJoint(barrel, pin.JointModelPX(), pin.SE3.Identity(), "rod")
    for joint in (barrel, rod):
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    q = np.column_stack((np.zeros(5), np.linspace(2.0, 2.4, 5)))
    shapes = [shape for shape in simple_shapes(Mechanism(model), body_poses(model, q), 1.0) if shape.node]
    assert not any(shape.geometry["type"] == "BoxGeometry" for shape in shapes)
    outer, inner = (next(s for s in shapes if s.node == node and "height" in s.geometry) for node in (barrel, rod))
    ends = [
        shape.placement.translation[0] + np.array([-0.5, 0.5]) * shape.geometry["height"] for shape in (outer, inner)
    ]
    assert ends[0][0] == pytest.approx(0.0)
    for length in (2.0, 2.4):  # the rod begins in the barrel and ends outside of it
        assert 0.0 <= ends[1][0] + length < ends[0][1] < ends[1][1] + length
