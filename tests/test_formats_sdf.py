"""SDF files against hand calculation, closed forms and the same scene in URDF."""

import pickle
import warnings
from functools import partial
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import frame_pose, loop_rows
from helpers.extras import skips_missing_extras
from helpers.sdf_texts import BAR, CHAIN, A, B, C, axis, joint, link, write
from helpers.warned import told

import pinconsist as pc
from pinconsist.formats.catalogue import ROBOTS, robot_file
from pinconsist.view.visuals import visuals

FOUR_BAR = Path(__file__).parent / "data" / "four_bar.sdf"
CUT = "<physics><simbody><must_be_loop_joint>true</must_be_loop_joint></simbody></physics>"


@pytest.fixture
def scene(tmp_path):
    return partial(write, tmp_path)


def turn(r, p, y):
    """Rz(y) Ry(p) Rx(r), by hand."""
    (cr, cp, cy), (sr, sp, sy) = np.cos([r, p, y]), np.sin([r, p, y])
    x = np.array([[1, 0, 0], [0, cr, -sr], [0, sr, cr]])
    y = np.array([[cp, 0, sp], [0, 1, 0], [-sp, 0, cp]])
    return np.array([[cy, -sy, 0], [sy, cy, 0], [0, 0, 1]]) @ y @ x


def place(*numbers):
    """A homogeneous matrix from x y z r p y."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = numbers[:3], turn(*numbers[3:])
    return T


def about(direction, angle):
    """Rodrigues' rotation as a homogeneous matrix."""
    a, T = np.array(direction) / np.linalg.norm(direction), np.eye(4)
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    T[:3, :3] = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    return T


def along(direction, length):
    T = np.eye(4)
    T[:3, 3] = length * np.array(direction) / np.linalg.norm(direction)
    return T


def at(mech, frame, q=None):
    q = mech.guess if q is None else mech.configuration(q, base=pin.neutral(mech.model))
    return frame_pose(mech.model, q, frame).homogeneous


def gap(mech, q):
    return np.max(np.abs(loop_rows(mech, q)[0]), initial=0.0)


# The four-bar ---------------------------------------------------------------------------------------------------------


def test_four_bar_moves_as_the_urdf_one_does():
    sdf, urdf = pc.load(FOUR_BAR), pc.load("four_bar")
    assert sdf.joints == urdf.joints and [loop.kind for loop in sdf.loops] == ["hinge"]
    assert gap(sdf, sdf.guess) < 1e-14
    times = np.linspace(0.0, 2.0, 21)
    for options in ({"step": 1e-3, "order": 4}, {"rtol": 1e-11, "atol": 1e-11, "t_eval": times}):
        ours, theirs = (pc.simulate(each, (0.0, 2.0), **options, method="BDF") for each in (sdf, urdf))
        assert np.abs(ours.q - (theirs.q - urdf.guess)).max() < 1e-9
        assert np.abs(theirs.v).max() > 3 and np.abs(ours.v - theirs.v).max() < 1e-8
        forces = [np.linalg.norm(each.lam[:, :3], axis=1) for each in (ours, theirs)]  # other axes, one size
        assert np.abs(forces[0] - forces[1]).max() < 1e-6 * forces[1].max()
    assert pickle.loads(pickle.dumps(sdf)).geometry == sdf.geometry


@pytest.mark.parametrize("where", ["crank", "coupler", "rocker"])
def test_four_bar_cut_elsewhere_moves_the_same(tmp_path, where):
    text = FOUR_BAR.read_text()
    head = f'<joint name="{where}" type='
    at_end = text.index("</joint>", text.index(head))
    path = tmp_path / "cut.sdf"
    path.write_text(text[:at_end] + CUT + text[at_end:])
    whole, cut = pc.load(FOUR_BAR), pc.load(path)
    assert [loop.name for loop in cut.loops] == [where] and where not in cut.joints
    options = {"step": 1e-3, "order": 4}
    ours, theirs = (pc.simulate(each, (0.0, 0.5), **options, method="BDF") for each in (cut, whole))
    assert np.abs(theirs.q).max() > 0.3
    for bar in ("crank_bar", "coupler_bar", "rocker_bar"):
        poses = [frame_pose(mech.model, sol.q[-1], bar).homogeneous for mech, sol in ((cut, ours), (whole, theirs))]
        np.testing.assert_allclose(*poses, atol=1e-9)


def test_a_damped_net_of_hinges_loses_no_damping(tmp_path):
    """All four hinges are damped: the cut one keeps its coordinate on a massless copy of its child."""
    damping = 0.7
    path = tmp_path / "damped.sdf"
    acting = f"</xyz><dynamics><damping>{damping}</damping></dynamics></axis>"
    path.write_text(FOUR_BAR.read_text().replace("</xyz></axis>", acting))
    ours, urdf = pc.load(path), pc.load("four_bar")
    assert ours.joints == ("crank", "coupler", "coupler_rocker", "rocker")
    loop = ours.loops[0]
    assert (loop.kind, loop.frame1, loop.frame2) == ("frame", "coupler_rocker_end", "rocker_bar")
    relative = np.array([-1.0, -1.0, 1.0])  # rate of the fourth hinge
    brakes = pc.Torque(lambda t, q, v: -damping * (v + relative * (relative @ v)))
    sol = pc.simulate(ours, (0.0, 1.0), step=1e-3, order=4, method="BDF")
    reference = pc.simulate(urdf.add_forces(brakes), (0.0, 1.0), step=1e-3, order=4, method="BDF")
    assert np.abs(sol.q[:, [0, 1, 3]] - (reference.q - urdf.guess)).max() < 1e-9
    free = pc.simulate(urdf, (0.0, 1.0), step=1e-3, order=4, method="BDF")
    assert np.abs(free.q[-1] - reference.q[-1]).max() > 0.1


# Joints ---------------------------------------------------------------------------------------------------------------

PLACE_A, PLACE_B, PLACE_J = (
    (0.1, -0.2, 0.3, 0.4, -0.5, 0.6),
    (0.7, 0.2, -0.1, 0.3, 0.2, -1.0),
    (0.2, 0.3, 0.1, 0.5, 0.4, 0.3),
)
DIRECTION, SECOND = (1.0, -2.0, 0.5), (0.3, 0.4, 2.0)


def words(numbers):
    return " ".join(map(repr, numbers))


def one_joint(kind, inside="", backwards=False, second=SECOND):
    """Bodies a (tied to the ground) and b with a joint of a kind at an odd place; b may be the joint's parent."""
    two = axis(words(second), tag="axis2") if kind in ("universal", "revolute2") else ""
    ends = ("b", "a") if backwards else ("a", "b")
    inside = f"<pose>{words(PLACE_J)}</pose>{axis(words(DIRECTION))}{two}{inside}"
    held = joint("ground", "world", "a", "fixed", "")
    return link("a", words(PLACE_A)) + link("b", words(PLACE_B)) + held + joint("j", *ends, kind, inside)


MOTIONS = {
    "revolute": ("", {"j": 0.8}, about(DIRECTION, 0.8)),
    "continuous": ("", {"j": 7.0}, about(DIRECTION, 7.0)),
    "prismatic": ("", {"j": 0.8}, along(DIRECTION, 0.8)),
    "universal": ("", {"j_axis": 0.8, "j_axis2": -1.1}, about(DIRECTION, 0.8) @ about(SECOND, -1.1)),
    "revolute2": ("", {"j_axis": 0.8, "j_axis2": -1.1}, about(DIRECTION, 0.8) @ about(SECOND, -1.1)),
    "screw": (  # right-handed, metres per turn
        "<screw_thread_pitch>0.3</screw_thread_pitch>",
        {"j": 0.8},
        about(DIRECTION, 0.8) @ along(DIRECTION, 0.3 * 0.8 / (2 * np.pi)),
    ),
    "Screw": ("", {"j": 0.8}, about(DIRECTION, 0.8) @ along(DIRECTION, 0.8 / (2 * np.pi))),  # 1 m per turn
    "SCREW": (  # left-handed, radians per metre
        "<thread_pitch>5</thread_pitch>",
        {"j": 0.8},
        about(DIRECTION, 0.8) @ along(DIRECTION, -0.8 / 5),
    ),
}


@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("kind", MOTIONS)
def test_joint_moves_its_child_as_the_words_say(scene, kind, backwards):
    inside, q, motion = MOTIONS[kind]
    mech = pc.load(scene(one_joint(kind, inside, backwards)))
    a, b = place(*PLACE_A), place(*PLACE_B)
    np.testing.assert_allclose(at(mech, "a"), a, atol=1e-15)
    np.testing.assert_allclose(at(mech, "b"), b, atol=1e-15)
    # child_J = parent_J motion, with the joint's frame on the child; the poses of the file belong to zero
    child, parent = (a, b) if backwards else (b, a)
    frame = child @ place(*PLACE_J)
    moved = np.linalg.inv(parent) @ frame @ motion @ np.linalg.inv(frame) @ child  # child in the parent
    expected = a @ (np.linalg.inv(moved) if backwards else moved)
    np.testing.assert_allclose(at(mech, "b", q), expected, atol=1e-14)


@pytest.mark.parametrize("backwards", [False, True])
def test_ball_turns_about_the_frame_of_the_joint(scene, backwards):
    mech = pc.load(scene(one_joint("ball", backwards=backwards)))
    a, b = place(*PLACE_A), place(*PLACE_B)
    frame = (a if backwards else b) @ place(*PLACE_J)
    half = 0.4  # angle 0.8
    q = {"j": [*(np.sin(half) * np.array(DIRECTION) / np.linalg.norm(DIRECTION)), np.cos(half)]}
    expected = frame @ about(DIRECTION, 0.8) @ np.linalg.inv(frame) @ b
    np.testing.assert_allclose(at(mech, "b", q), expected, atol=1e-14)


@pytest.mark.parametrize("kind", [*MOTIONS, "ball"])
def test_inertia_and_derivatives_of_a_joint(scene, kind):
    """Kinetic energy from differences of the body's poses by hand; Pinocchio's derivatives, which Newton relies on."""
    mech = pc.load(scene(one_joint(kind, MOTIONS.get(kind, ("",))[0])))
    model, data, h = mech.model, mech.model.createData(), 1e-5
    rng = np.random.default_rng(0)
    q = pin.integrate(model, pin.neutral(model), rng.uniform(-1, 1, mech.nv))
    v, a = rng.uniform(-1, 1, (2, mech.nv))
    before, middle, after = (frame_pose(model, pin.integrate(model, q, s * h * v), "b").homogeneous for s in (-1, 0, 1))
    rate = (after - before) / (2 * h)
    centre = rate @ [0.5, 0, 0, 1]
    spin = rate[:3, :3] @ middle[:3, :3].T
    omega = middle[:3, :3].T @ [spin[2, 1], spin[0, 2], spin[1, 0]]
    energy = 0.5 * centre[:3] @ centre[:3] + 0.5 * omega @ (np.array([0.01, 0.09, 0.08]) * omega)
    assert pin.computeKineticEnergy(model, data, q, v) == pytest.approx(energy, rel=1e-8)
    pin.computeRNEADerivatives(model, data, q, v, a)
    by_q, by_v = np.array(data.dtau_dq), np.array(data.dtau_dv)

    def force(dq, dv):
        return np.array(pin.rnea(model, data, pin.integrate(model, q, dq), v + dv, a))

    zero, steps = np.zeros(mech.nv), 1e-5 * np.eye(mech.nv)
    np.testing.assert_allclose(by_q, np.transpose([force(e, zero) - force(-e, zero) for e in steps]) / 2e-5, atol=1e-8)
    np.testing.assert_allclose(by_v, np.transpose([force(zero, e) - force(zero, -e) for e in steps]) / 2e-5, atol=1e-8)
    mass = np.transpose(
        [pin.rnea(model, data, q, zero, e) - pin.rnea(model, data, q, zero, zero) for e in np.eye(mech.nv)]
    )
    np.testing.assert_allclose(np.triu(pin.crba(model, data, q)), np.triu(mass), atol=1e-13)


def test_falling_on_a_screw(scene):
    """m (1 + I / (m h²)) z'' = -m g: z(t) of the nut by hand."""
    body = link("nut", "", BAR.replace("0.5 0 0", "0 0 0"))
    body += joint("thread", "world", "nut", "screw", axis() + "<screw_thread_pitch>0.5</screw_thread_pitch>")
    sol = pc.simulate(pc.load(scene(body)), (0.0, 1.0), rtol=1e-9, atol=1e-9)
    h = 0.5 / (2 * np.pi)
    np.testing.assert_allclose(sol.q[-1, 0] * h, -0.5 * 9.81 / (1 + 0.08 / h**2), rtol=1e-7)


def test_damping_of_a_ball_acts_about_every_axis(scene):
    """A sphere on a ball joint: ω' = -d/I ω."""
    sphere = "<inertial><inertia><ixx>0.5</ixx><iyy>0.5</iyy><izz>0.5</izz></inertia></inertial>"
    inside = axis("0 0 1", "<dynamics><damping>0.2</damping></dynamics>")
    mech = pc.load(scene(link("b", "", sphere) + joint("j", "world", "b", "ball", inside)))
    sol = pc.simulate(mech, (0.0, 2.0), v0=np.array([1.0, -2.0, 0.5]), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(sol.v[-1], np.exp(-0.4 * 2.0) * np.array([1.0, -2.0, 0.5]), atol=1e-7)


def test_what_a_joint_says_of_its_motion(scene):
    def said(lower, upper, effort):
        limits = f"<lower>{lower}</lower><upper>{upper}</upper><effort>{effort}</effort><velocity>3</velocity>"
        acting = "<dynamics><damping>0.1</damping><friction>0.2</friction></dynamics>"
        return axis("0 0 1", f"<limit>{limits}</limit>{acting}")

    body = A + B + C + joint(inside=said(-1, 2, 4)) + joint("k", "b", "c", "continuous", said(-1, 2, -1))
    model = pc.load(scene(body + link("d") + joint("l", "c", "d", inside=said("-inf", 1e16, "inf")))).model
    np.testing.assert_array_equal(model.lowerPositionLimit, [-1, -np.inf, -np.inf])
    np.testing.assert_array_equal(model.upperPositionLimit, [2, np.inf, np.inf])
    np.testing.assert_array_equal(model.upperEffortLimit, [4, np.inf, np.inf])
    np.testing.assert_array_equal(model.upperVelocityLimit, [3, 3, 3])
    np.testing.assert_array_equal(model.damping, [0.1] * 3)
    np.testing.assert_array_equal(model.upperDryFrictionLimit, [0.2] * 3)


INERTIA = 0.08 + 0.25  # of a bar about its end


def wheels(second):
    """Bars a, b that turn about upright axes on g: a against a spring, b by a joint of its own."""
    spring = "<dynamics><spring_stiffness>2</spring_stiffness><spring_reference>0.3</spring_reference></dynamics>"
    held = joint("fix", "world", "g", "fixed", "")
    return A + B + link("g") + held + joint("ja", "g", "a", inside=axis("0 0 1", spring)) + second


@pytest.mark.parametrize(
    ("ends", "direction", "sign"),
    [(("g", "b"), "0 0 1", 1), (("g", "b"), "0 0 -1", -1), (("b", "g"), "0 0 1", -1), (("b", "g"), "0 0 -1", 1)],
)
def test_a_gearbox_gears_a_sprung_wheel(scene, ends, direction, sign):
    """θ₂ = -r θ₁, so (I₁ + r² I₂) θ₁'' = -k (θ₁ - 0.3); both angles about +z against the reference body."""
    second = joint("jb", *ends, inside='<pose relative_to="b"/>' + axis(direction))
    gear = axis() + axis(tag="axis2") + "<gearbox_ratio>0.5</gearbox_ratio>"
    gear += "<gearbox_reference_body>g</gearbox_reference_body>"
    mech = pc.load(scene(wheels(second) + joint("gear", "a", "b", "gearbox", gear))).with_gravity([0, 0, 0])
    sol = pc.simulate(mech, (0.0, 1.0), rtol=1e-10, atol=1e-10)
    angle = 0.3 * (1 - np.cos(np.sqrt(2 / (INERTIA * (1 + 0.25)))))
    assert sol.q[-1, mech.columns("ja")] == pytest.approx(angle, abs=1e-8)
    assert sol.q[-1, mech.columns("jb")] == pytest.approx(-0.5 * sign * angle, abs=1e-8)
    turned = at(mech, "b", dict(zip(mech.joints, sol.q[-1], strict=True)))
    np.testing.assert_allclose(turned, place(1, 0, 0, 0, 0, -0.5 * angle), atol=1e-8)


def test_a_joint_follows_another(scene):
    """position = multiplier (leader - reference) + offset."""
    mimic = '<mimic joint="ja"><multiplier>-2</multiplier><offset>0.2</offset><reference>0.1</reference></mimic>'
    body = wheels(joint("jb", "g", "b", inside=axis("0 0 1", mimic)))
    mech = pc.load(scene(body, version="1.11")).with_gravity([0, 0, 0])
    sol = pc.simulate(mech, (0.0, 1.0), q0={"ja": 0.1, "jb": 0.2}, rtol=1e-10, atol=1e-10)
    first, second = sol.q[-1, mech.columns("ja")], sol.q[-1, mech.columns("jb")]
    assert first == pytest.approx(0.3 - 0.2 * np.cos(np.sqrt(2 / (INERTIA * 5))), abs=1e-8)
    assert second == pytest.approx(-2 * (first - 0.1) + 0.2, abs=1e-12)


# Loops ----------------------------------------------------------------------------------------------------------------

CLOSED_BY = {  # what the cut joint becomes: kind and rows
    "revolute": ("hinge", 5),
    "continuous": ("hinge", 5),
    "prismatic": ("slider", 5),
    "ball": ("point", 3),
    "universal": ("universal", 4),
    "fixed": ("frame", 6),
    "screw": ("frame", 6),  # a copy of the child keeps the screw
    "revolute2": ("frame", 6),  # so it does where the axes are not perpendicular
}


@pytest.mark.parametrize("kind", CLOSED_BY)
def test_a_loop_is_the_same_wherever_it_is_cut(scene, kind):
    """world – ball – a – ball – b – ball – c – `kind` – world, cut at the last joint or at the second."""
    loop, rows = CLOSED_BY[kind]
    two = axis("0 2 1" if kind == "universal" else "1 2 3", tag="axis2")
    last = f"<pose>0.4 0.1 0 0.3 0.2 0.1</pose>{axis('2 0 0')}{two}<screw_thread_pitch>0.4</screw_thread_pitch>"
    bodies = link("a", "0 0 0 0 0.5 0") + link("b", "0.6 0.1 0 0.2 0 1") + link("c", "0.9 0.4 0.2 0.1 0.2 0.3")

    def made(cut):
        inside = {name: CUT if name == cut else "" for name in "pqrs"}
        chain = [("p", "world", "a"), ("q", "a", "b"), ("r", "b", "c")]
        joints = "".join(joint(name, parent, child, "ball", inside[name]) for name, parent, child in chain)
        return pc.load(scene(bodies + joints + joint("s", "world", "c", kind, last + inside["s"])))

    ours, other = made("s"), made("q")
    assert [(each.kind, len(each.rows)) for each in ours.loops] == [(loop, rows)]
    assert [each.kind for each in other.loops] == ["point"]
    assert gap(ours, ours.guess) < 1e-14 and gap(other, other.guess) < 1e-14
    poses = []
    for mech in (ours, other):
        sol = pc.simulate(mech, (0.0, 0.3), rtol=1e-9, atol=1e-9)
        poses.append([frame_pose(mech.model, sol.q[-1], name).homogeneous for name in "abc"])
    np.testing.assert_allclose(*poses, atol=1e-7)
    assert np.abs(np.subtract(poses[0], [at(ours, name) for name in "abc"])).max() > 0.1  # it does move


DAMPED = "<dynamics><damping>1</damping></dynamics>"


@pytest.mark.parametrize(
    ("joints", "cut"),
    [
        ("rb rc rd cd", "cd"),  # the shortest chains
        ("rb bc cd rd", "cd"),
        ("rb bc dc rd", "dc"),
        ("rb bc cd dr", "dr"),  # from parent to child before shorter chains
        ("rb rc rd cd:ball", "cd"),  # a ball before a hinge
        ("rb:ball rc rd bc", "rb"),
        ("rb:fixed rc:screw bc", "bc"),
        ("rb* bc* cd rd*", "cd"),  # what acts stays
        ("rb bc* cd* rd*", "rb"),
    ],
)
def test_where_a_net_is_cut(scene, joints, cut):
    body = "".join(link(name) for name in "rbcd")
    for each in joints.split():
        name, _, kind = each.rstrip("*").partition(":")
        body += joint(name, *name, kind or "revolute", axis(inside=DAMPED if each.endswith("*") else ""))
    assert [loop.name for loop in pc.load(scene(body)).loops] == [cut]


def test_loops_that_share_bodies_are_each_cut_once(scene):
    body = "".join(link(name, f"{i} 0 0 0 0 {i}") for i, name in enumerate("rbcde"))
    body += "".join(joint(name, *name) for name in ("rb", "bc", "cd", "rd", "de", "ce"))
    mech = pc.load(scene(body))
    assert [loop.name for loop in mech.loops] == ["cd", "ce"] and mech.nv == 4
    assert gap(mech, mech.guess) < 1e-14


# Frames ---------------------------------------------------------------------------------------------------------------


def test_poses_relative_to_frames_links_joints_and_models(scene):
    """Quarter turns, so that every number can be checked by hand."""
    q = "0 0 1.5707963267948966"  # about z: x → y, y → -x
    body = (
        f"<pose>10 0 0 {q}</pose>"
        + link("a", f"1 0 0 {q}")  # in the model: (10, 1), x along -x
        + f'<link name="b"><pose relative_to="a">2 0 0 {q}</pose>{BAR}</link>'  # (8, 1), x along -y
        + f'<link name="c"><pose relative_to="k">0 0 3 0 0 0</pose>{BAR}</link>'
        + f'<frame name="f" attached_to="b"><pose>0 5 0 {q}</pose></frame>'  # default: relative to b: (13, 1)
        + '<frame name="g"><pose relative_to="f">1 0 0 0 0 0</pose></frame>'  # (14, 1)
        + '<frame name="h" attached_to="k"/>'
        + joint("j", "a", "f", inside="<pose>0 0 1 0 0 0</pose>" + axis())  # child is a frame: pose relative to f
        + joint("k", "b", "c", inside='<pose relative_to="__model__">0 0 7 0 0 0</pose>' + axis("1 0 0"))
        + '<model name="n"><pose relative_to="b">0 0 1 0 0 0</pose>'
        + link("d", "0 0 1 0 0 0")
        + '<frame name="deep"><pose>1 0 0 0 0 0</pose></frame></model>'
        + '<frame name="from_below"><pose relative_to="n::deep">0 0 0 0 0 0</pose></frame>'
        + joint("nested", "b", "n::d", "fixed", "")
    )
    mech = pc.load(scene(body, version="1.8"))
    expected = {
        "a": place(10, 1, 0, 0, 0, np.pi),
        "b": place(8, 1, 0, 0, 0, -np.pi / 2),
        "f": place(13, 1, 0, 0, 0, 0),
        "g": place(14, 1, 0, 0, 0, 0),
        "j": place(13, 1, 1, 0, 0, 0),
        "k": place(10, 0, 7, 0, 0, np.pi / 2),
        "c": place(10, 0, 10, 0, 0, np.pi / 2),
        "h": place(10, 0, 7, 0, 0, np.pi / 2),
        "n::d": place(8, 1, 2, 0, 0, -np.pi / 2),
        "n::deep": place(8, 0, 1, 0, 0, -np.pi / 2),
        "from_below": place(8, 0, 1, 0, 0, -np.pi / 2),
    }
    for frame, pose in expected.items():
        np.testing.assert_allclose(at(mech, frame), pose, atol=1e-14, err_msg=frame)
    carried = {frame.name: mech.model.names[frame.parentJoint] for frame in mech.model.frames}
    assert {carried[name] for name in ("b", "f", "j", "n::d")} == {"j"}
    assert {carried[name] for name in ("c", "h", "k")} == {"k"}
    assert {carried[name] for name in ("a", "g", "from_below")} == {"universe"}  # attached to the model


def test_rotations_in_degrees_and_quaternions(scene):
    body = (
        f'<link name="a"><pose degrees="true">1 2 3 90 0 45</pose>{BAR}</link>'
        + f'<link name="b"><pose rotation_format="quat_xyzw">1 2 3 0 0 2 2</pose>{BAR}</link>'
        + joint()
    )
    mech = pc.load(scene(body, version="1.9"))
    np.testing.assert_allclose(at(mech, "a"), place(1, 2, 3, np.pi / 2, 0, np.pi / 4), atol=1e-15)
    np.testing.assert_allclose(at(mech, "b"), place(1, 2, 3, 0, 0, np.pi / 2), atol=1e-15)


def test_a_model_is_placed_by_one_of_its_frames(scene):
    inner = (
        link("d", "0 0 1 0 0 0") + '<frame name="p"><pose relative_to="d">2 0 0 0 0 1.5707963267948966</pose></frame>'
    )
    body = A + f'<model name="n" placement_frame="p"><pose>5 0 0 0 0 0</pose>{inner}</model>' + joint(child="n::d")
    mech = pc.load(scene(body, version="1.8"))
    np.testing.assert_allclose(at(mech, "n::p"), place(5, 0, 0, 0, 0, 0), atol=1e-15)
    np.testing.assert_allclose(at(mech, "n::d"), place(5, 2, 0, 0, 0, -np.pi / 2), atol=1e-15)


@pytest.mark.parametrize(
    ("version", "inside", "model_frame"),
    [
        ("1.4", "", True),
        ("1.4", "<use_parent_model_frame>0</use_parent_model_frame>", True),
        ("1.5", "", False),
        ("1.6", "<use_parent_model_frame>0</use_parent_model_frame>", False),
        ("1.6", "<use_parent_model_frame>true</use_parent_model_frame>", True),
        ("1.7", "", False),
        ("1.7", "expressed_in", True),
    ],
)
def test_in_which_frame_an_axis_is_expressed(scene, version, inside, model_frame):
    axes = f"<axis><xyz>1 0 0</xyz>{inside}</axis>"
    if inside == "expressed_in":
        axes = '<axis><xyz expressed_in="__model__">1 0 0</xyz></axis>'
    body = A + link("b", "0 0 0 0 0 1.5707963267948966") + joint(inside=axes)
    model_pose = "<pose>0 0 0 0 0.3 0</pose>"
    mech = pc.load(scene(model_pose + body, version=version))
    start = place(0, 0, 0, 0, 0.3, 0)
    local = (1, 0, 0) if model_frame else (0, 1, 0)  # x of the model, or x of b
    expected = start @ about(local, 0.5) @ place(0, 0, 0, 0, 0, np.pi / 2)
    np.testing.assert_allclose(at(mech, "b", {"j": 0.5}), expected, atol=1e-15)


def test_poses_of_old_versions(scene):
    """Before 1.7, `frame` is what `relative_to` is now, and a link and a joint may have one name."""
    body = A + f'<link name="b"><pose frame="a">1 0 0 0 0 0</pose>{BAR}</link>'
    body += '<link name="c"><pose frame="">3 0 0 0 0 0</pose></link>'
    mech = pc.load(scene("<pose>0 0 1 0 0 0</pose>" + body + joint("b") + joint("c", "b", "c"), version="1.6"))
    np.testing.assert_allclose(at(mech, "b")[:3, 3], [1, 0, 1])
    np.testing.assert_allclose(at(mech, "c")[:3, 3], [3, 0, 1])
    assert mech.joints == ("b_joint", "c_joint")


# Bodies and worlds ----------------------------------------------------------------------------------------------------


def test_inertia_stands_in_its_own_frame(scene):
    inertial = (
        "<inertial><pose>0.1 0.2 0.3 0 0 1.5707963267948966</pose><mass>2</mass>"
        "<inertia><ixx>1</ixx><iyy>2</iyy><izz>2.5</izz><ixy>0.1</ixy></inertia></inertial>"
    )
    model = pc.load(scene(link("b", "", inertial) + joint("j", "world", "b"))).model
    assert model.inertias[1].mass == 2
    np.testing.assert_allclose(model.inertias[1].lever, [0.1, 0.2, 0.3])
    np.testing.assert_allclose(model.inertias[1].inertia, [[2, -0.1, 0], [-0.1, 1, 0], [0, 0, 2.5]], atol=1e-15)


def test_a_link_without_inertial_has_the_mass_of_the_specification(scene):
    model = pc.load(scene(link("b", "", "") + joint("j", "world", "b"))).model
    assert model.inertias[1].mass == 1
    np.testing.assert_array_equal(model.inertias[1].inertia, np.eye(3))


def test_fixed_where_it_stands_or_floating(scene):
    path = scene("<pose>0 0 2 0 0 0</pose>" + link("a", "1 0 0 0 0 0.5") + B + joint(inside=axis("0 1 0")))
    fixed, floating = pc.load(path), pc.load(path, free_flyer=True)
    assert (fixed.nv, floating.nv, floating.joints) == (1, 7, ("root_joint", "j"))
    for mech in (fixed, floating):
        np.testing.assert_allclose(at(mech, "a"), place(1, 0, 2, 0, 0, 0.5), atol=1e-15)
        np.testing.assert_allclose(at(mech, "b"), place(1, 0, 2, 0, 0, 0), atol=1e-15)
    np.testing.assert_allclose(floating.guess[:3], [1, 0, 2])
    sol = pc.simulate(floating, (0.0, 0.5), rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(sol.q[-1, :3] - [1, 0, 2], [0, 0, -0.5 * 9.81 * 0.25], atol=1e-6)


def test_the_root_is_the_canonical_link_or_one_that_is_no_child(scene):
    body = B + A + C + joint() + joint("k", "b", "c")
    assert at(pc.load(scene(body)), "a", {"j": 1.0})[0, 3] == 0  # a holds, though b comes first
    named = pc.load(scene(body, head='<model name="m" canonical_link="c">'))
    frames = [named.model.frames[named.model.getFrameId(name)] for name in "abc"]
    assert [named.model.names[frame.parentJoint] for frame in frames] == ["j", "k", "universe"]


def test_worlds_gravity_static_models_and_several_models(scene, caplog):
    models = (
        f'<gravity>0 1 -2</gravity><model name="floor"><static>true</static>{link("plate", "0 0 -1 0 0 0")}'
        + joint("ignored", "world", "plate", "revolute", axis())
        + f'</model><model name="r"><pose>3 0 0 0 0 0</pose>{CHAIN}</model><model name="s">{CHAIN}</model>'
        + joint("tie", "floor::plate", "s::c", "fixed", "")
    )
    path = scene(models, head="<world name='w'>", tail="</world>", version="1.11")
    mech = pc.load(path)
    assert sorted(mech.joints) == ["r::j", "r::k", "s::j", "s::k"] and not mech.loops
    np.testing.assert_array_equal(mech.model.gravity.linear, [0, 1, -2])
    np.testing.assert_allclose(at(mech, "r::b")[:3, 3], [4, 0, 0])
    np.testing.assert_allclose(at(mech, "floor::plate")[:3, 3], [0, 0, -1])
    floating = pc.load(path, free_flyer=True)
    assert set(floating.joints) - set(mech.joints) == {"root_joint"}  # s hangs on the floor
    np.testing.assert_allclose(at(floating, "r::b")[:3, 3], [4, 0, 0])


def test_a_world_alone_has_the_gravity_of_the_specification(scene):
    def gravity(body, version="1.6"):
        path = scene(body + f'<model name="m">{CHAIN}</model>', version, "<world name='w'>", "</world>")
        mech = pc.load(path)
        assert mech.joints == ("j", "k")  # the only model's name is left away
        return list(mech.model.gravity.linear)

    assert gravity("") == [0, 0, -9.8]
    assert gravity("<physics><gravity>0 0 -1</gravity></physics>", "1.5") == [0, 0, -1]
    assert gravity("<physics><gravity>0 0 -1</gravity></physics><gravity>0 0 -3</gravity>") == [0, 0, -3]


def test_links_without_gravity(scene):
    off = BAR + "<gravity>false</gravity>"
    mech = pc.load(scene(link("a", "", off) + link("b", "", off) + joint()))
    assert not np.any(mech.model.gravity.linear)


def test_unconnected_models_are_told_of(scene, recwarn):
    mech = pc.load(scene(CHAIN + link("d", "9 0 0 0 0 0")), free_flyer=True)
    assert "'a', 'd'" in told(recwarn)
    assert mech.joints == ("a_root_joint", "j", "k", "d_root_joint")
    np.testing.assert_allclose(at(mech, "d")[:3, 3], [9, 0, 0])


def test_springs_and_first_positions(scene):
    spring = "<dynamics><spring_stiffness>3</spring_stiffness></dynamics><initial_position>0.4</initial_position>"
    mech = pc.load(scene(A + B + joint(inside=axis("0 0 1", spring)), version="1.6"))
    assert mech.forces == (pc.JointSpring("j", 3.0, 0.0),)
    assert mech.guess == [0.4]


def test_elements_that_mean_nothing_here_pass_and_misspelt_ones_are_told(scene, recwarn):
    quiet = '<plugin name="camera" filename="x.so"><anything/></plugin><self_collide>1</self_collide>'
    pc.load(scene(CHAIN + quiet))
    assert not told(recwarn)
    pc.load(
        scene(CHAIN.replace("<mass>", "<inertia_/><mass>").replace("<inertial>", "<inertail/><inertial>") + "<joints/>")
    )
    assert "link 'a': the element <inertail>" in told(recwarn) and "<joints> is not known" in told(recwarn)


VISUAL = """<visual name="v"><pose relative_to="f">0 0 1 0 0 0</pose><geometry>{}</geometry>
<material><ambient>1 0 0 1</ambient></material></visual>"""


def test_what_has_no_effect_is_told(scene, recwarn):
    slow = link("d", "", BAR + "<velocity_decay><linear>0.1</linear></velocity_decay>")
    state = '<state world_name="w"/>'
    pc.load(scene(f'{state}<model name="m">{CHAIN}{slow}</model>', head='<world name="w">', tail="</world>"))
    assert "<state> has no effect" in told(recwarn) and "link 'd': velocity_decay has no effect" in told(recwarn)


def test_shapes_stand_on_their_links(scene, tmp_path):
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / "x.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    sphere = BAR + VISUAL.format("<sphere><radius>0.2</radius></sphere>")
    mesh = BAR + VISUAL.format(f"<mesh><uri>model://{tmp_path.name}/meshes/x.obj</uri><scale>2 2 2</scale></mesh>")
    gone = BAR + VISUAL.format("<mesh><uri>https://somewhere/x.obj</uri></mesh>")
    body = A + link("b", "1 0 0 0 0 0", sphere) + link("c", "", mesh) + link("d", "", gone)
    body += joint() + joint("k", "b", "c", "fixed", "") + joint("l", "b", "d", "fixed", "")
    mech = pc.load(scene(body + '<frame name="f"><pose>0 5 0 0 0 0</pose></frame>'))
    ball, triangle = visuals(mech)
    assert mech.model.names[ball.node] == mech.model.names[triangle.node] == "j"
    np.testing.assert_allclose(ball.placement.translation, [-1, 5, 1])  # joint j stands at b
    np.testing.assert_allclose(triangle.points.max(axis=0), [1, 7, 1], atol=1e-15)
    assert ball.color == 0xFF0000


# Cassie ---------------------------------------------------------------------------------------------------------------

CASSIE = {  # rows and rank of its loops, degrees of freedom left
    "cassie": (36, 28, 10),
    "cassie_reduced": (16, 16, 11),
    "cassie_simple": (16, 16, 11),
    "cassie_v2": (16, 14, 12),
    "cassie_wo_gearbox_spring": (16, 14, 13),
}


def cassie(name, **options):
    with skips_missing_extras():
        robot_file(name)
    return pc.load(name, **options)


@pytest.mark.parametrize("name", CASSIE)
def test_cassie_is_closed_as_it_comes_and_closes_again(name):
    mech = cassie(name)
    assert gap(mech, mech.guess) < 1e-14
    result = pc.assemble(mech)
    assert (result.rows, result.rank, result.mobility) == CASSIE[name]
    rng = np.random.default_rng(0)
    # The right foot of cassie_v2 is a four-bar whose axes the file rounds to five digits, 1e-6 rad from parallel:
    # elsewhere it closes to a few nm only.
    gaps = []
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=".*contradict each other a little")
        for _ in range(5):
            guess = pin.integrate(mech.model, mech.guess, rng.uniform(-1, 1, mech.nv))
            gaps.append(pc.assemble(mech, guess).largest_gap[1])
    assert max(gaps) < (1e-8 if name == "cassie_v2" else 1e-10)


@pytest.mark.parametrize(("name", "speed"), [("cassie", 5.0), ("cassie_v2", 0.5)])
def test_cassie_swings_from_a_fixed_pelvis(name, speed):
    mech = cassie(name)
    assert len([force for force in mech.forces if isinstance(force, pc.JointSpring)]) == 4
    sol = pc.simulate(mech, (0.0, 0.4), rtol=1e-5, atol=1e-5)
    assert sol.success and sol.t[-1] == 0.4 and np.abs(sol.v).max() > speed
    certificate = sol.check(error=False)
    assert certificate.position < 1e-10 and certificate.energy_error < 1e-3
    assert max(gap(mech, q) for q in sol.q) < 1e-8


def test_cassie_floats_and_falls():
    mech = cassie("cassie_v2", free_flyer=True)
    sol = pc.simulate(mech, (0.0, 0.5), rtol=1e-6, atol=1e-6)
    centre = [pin.centerOfMass(mech.model, mech.model.createData(), q).copy() for q in (sol.q[0], sol.q[-1])]
    np.testing.assert_allclose(centre[1] - centre[0], [0, 0, -0.5 * 9.81 * 0.25], atol=1e-6)


def test_robots_that_are_not_installed_name_their_package(monkeypatch, tmp_path):
    import importlib.metadata
    from importlib.metadata import PackageNotFoundError

    def missing(name):
        raise PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", missing)
    with pytest.raises(pc.MissingExtraError, match=r"example-robot-data.*pip install 'pinconsist\[robots\]'"):
        pc.load("cassie")

    class Empty:
        def locate_file(self, path):
            return tmp_path / path

    monkeypatch.setattr(importlib.metadata, "distribution", lambda name: Empty())
    with pytest.raises(pc.MissingExtraError, match="does not contain"):
        pc.load(next(iter(ROBOTS)))
