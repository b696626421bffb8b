"""Closed configurations from bad guesses, velocities on the constraints, and the refusals."""

import pickle
import warnings
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import frame_pose, mixed_tree, random_state
from helpers.held_bodies import own_fields
from helpers.zoo import FourBar

import pinconsist as pc

pytestmark = pytest.mark.filterwarnings("ignore:.* do not close with")
TIGHT = 1e-10


def rods(reach=3.0, lengths=(1.0, 1.0), kind="point", **fields):
    """Two rods in a plane on pivots `reach` apart, their tips held together by loop "tips"."""
    model = pin.Model()
    for name, x, length in zip("ab", (0.0, reach), lengths, strict=True):
        joint = model.addJoint(0, pin.JointModelRZ(), pin.SE3(np.eye(3), np.array([x, 0, 0])), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([length, 0, 0]))
        model.addFrame(pin.Frame(f"tip {name}", joint, 0, tip, pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, [pc.Loop("tips", kind, "tip a", "tip b", **fields)], guess={"a": 0.3, "b": 2.0})


def ball(kind, quaternion, **fields):
    """A body on a spherical joint, its frame "body" tied to the ground by loop "tie"."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.1, 0, 0]), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("body", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, [pc.Loop("tie", kind, "universe", "body", **fields)], guess={"ball": quaternion})


def gap_between(mech, q, loop):
    """Anchor 2 seen from anchor 1, by forward kinematics alone."""
    pose1 = frame_pose(mech.model, q, loop.frame1) * loop.placement1
    return pose1.actInv(frame_pose(mech.model, q, loop.frame2) * loop.placement2)


def tips_meet(q):
    x = FourBar.T @ q
    return np.abs(FourBar().constraint(x)).max()


@pytest.mark.parametrize("crank", np.linspace(-3.0, 3.0, 9))
def test_four_bar_from_anywhere_keeps_the_named_crank(crank):
    """It is a Grashof linkage whose crank turns fully: every crank angle closes."""
    rng = np.random.default_rng(int(10 * crank) + 100)
    rough = rng.uniform(-np.pi, np.pi, 3)
    result = pc.assemble(pc.load("four_bar"), rough)
    assert tips_meet(result.q) < TIGHT and result.largest_gap[1] < TIGHT
    assert result.moved == pytest.approx(np.abs(result.q - rough).max(), abs=1e-15)
    for result in (
        pc.assemble(pc.load("four_bar"), {"crank": crank, "rocker": rough[2]}, fixed={"crank": crank}),
        pc.assemble(pc.load("four_bar"), {"crank": crank}),
    ):
        assert result.q[0] == crank and tips_meet(result.q) < TIGHT


def test_named_joints_give_way_only_where_they_must():
    mech = pc.load("four_bar")
    soft = pc.assemble(mech, {"crank": 0.5, "rocker": 2.0})  # impossible together
    assert soft.q[0] != 0.5 and tips_meet(soft.q) < TIGHT
    hard = pc.assemble(mech, {"rocker": 2.0}, fixed={"crank": 0.5})
    assert hard.q[0] == 0.5 and hard.q[2] != 2.0 and tips_meet(hard.q) < TIGHT


def test_a_joint_that_cannot_keep_its_value_is_named_with_both_values():
    mech, q = pc.load("four_bar"), pc.assemble(pc.load("four_bar"), {"crank": 0.3}).q
    for run in (lambda q0: pc.simulate(mech, (0.0, 0.0), q0).q[0], lambda q0: pc.assemble(mech, q0).q):
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            run({"crank": 0.3, "rocker": q[2] + 1e-10})
            run(q + 0.1)  # a guess, of which nothing is kept
        with pytest.warns(UserWarning) as caught:
            reached = run({"rocker": 3.0})[2]
        assert len(caught) == 1 and caught[0].filename == __file__
        told = f"four_bar: the loops do not close with rocker = 3; they do at rocker = {reached:.6g}"
        assert str(caught[0].message) == told


def test_a_wheel_that_stores_cosine_and_sine_is_told_as_an_angle():
    model = pin.Model()
    for name in "ab":
        joint = model.addJoint(0, pin.JointModelRUBZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    mech = pc.Mechanism(model, [pc.Loop("stuck", "frame", "a", "universe")])
    with pytest.warns(UserWarning, match="do not close with a = 1; they do at a = -?[0-9e.-]+$"):
        pc.assemble(mech, {"a": 1.0})
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pc.assemble(mech, {"b": -3.0 + 2 * np.pi}).q[2:] == pytest.approx([np.cos(3.0), -np.sin(3.0)])


def test_a_drive_that_contradicts_a_start_is_an_error():
    mech = pc.load("four_bar")
    mech = mech.add_loops(pc.Drive("motor", "crank", lambda t: 0.2 + 3.0 * t))
    told = "joint 'crank' cannot start at 0.5: drive 'motor' holds it at 3.2 at t = 1 s"
    for start in ({"q0": {"crank": 0.5}}, {"q0": {"crank": 0.5, "rocker": 1.4}}):
        with pytest.raises(pc.AssemblyError, match=told):
            pc.simulate(mech, (1.0, 2.0), **start)
    with pytest.raises(pc.AssemblyError, match="motor"):
        pc.assemble(mech, fixed={"crank": 0.5})
    assert pc.simulate(mech, (0.0, 0.0), {"crank": 0.2 + 1e-9}, {"crank": 3.0}).v[0, 0] == pytest.approx(3.0)
    with pytest.warns(UserWarning, match="the loops and drives do not close with rocker = 1; they do at rocker = "):
        pc.assemble(mech, {"rocker": 1.0})
    with pytest.raises(pc.AssemblyError, match="drive 'motor' gives crank 3 at t = 0 s; leave out the driven joints"):
        pc.simulate(mech, (0.0, 1.0), v0={"crank": 0.0})


@pytest.mark.parametrize("nothing", [None, {}])
def test_without_a_guess_the_scenes_own_is_taken(nothing):
    mech = pc.load("four_bar")  # its guess is closed already
    result = pc.assemble(mech, nothing)
    np.testing.assert_allclose(result.q, mech.guess, atol=1e-12)


def test_report_of_a_planar_hinge():
    """Five rows: two act, one (along the axis) and both tilts are identically zero in the plane."""
    result = pc.assemble(pc.load("four_bar"))
    assert (result.rows, result.rank, result.mobility) == (5, 2, 1)
    assert result.redundant == {("coupler_rocker", row): {} for row in ("y", "tilt1", "tilt2")}
    assert set(result.gaps) == {"coupler_rocker"} and result.largest_gap[0] == "coupler_rocker"
    np.testing.assert_array_equal(result.v, 0.0)


def test_report_of_a_doubled_loop_names_the_copy():
    mech = pc.load("four_bar")
    (loop,) = mech.loops
    both = mech.with_loops(loop, pc.Loop("copy", "point", loop.frame1, loop.frame2))
    result = pc.assemble(both)
    assert (result.rows, result.rank, result.mobility) == (8, 2, 1)
    named = {frozenset(combination) for combination in result.redundant.values() if combination}
    assert len(result.redundant) == 6 and len(named) == 2
    for (_, row), combination in result.redundant.items():
        if combination:  # x of one loop is x of the other
            (((_, partner), factor),) = combination.items()
            assert partner == row and factor == pytest.approx(1.0, abs=1e-9)


def test_velocity_of_a_named_joint_leads_the_others():
    """Against the velocity ratios of the hand-derived linkage."""
    result = pc.assemble(pc.load("four_bar"), {"crank": 0.4}, {"crank": 2.5})
    C = FourBar().jacobian(FourBar.T @ result.q) @ FourBar.T
    expected = np.concatenate(([2.5], np.linalg.solve(C[:, 1:], -C[:, 0] * 2.5)))
    np.testing.assert_allclose(result.v, expected, rtol=1e-11)


def test_velocity_array_is_projected_in_the_mass_metric():
    """Against v - M⁻¹Jᵀ(J M⁻¹ Jᵀ)⁻¹ J v with M and J derived by hand."""
    given = np.array([1.0, 2.0, 3.0])
    result = pc.assemble(pc.load("four_bar"), v0=given)
    linkage, x = FourBar(), FourBar.T @ result.q
    M, J = FourBar.T.T @ linkage.mass(x) @ FourBar.T, linkage.jacobian(x) @ FourBar.T
    expected = given - np.linalg.solve(M, J.T @ np.linalg.solve(J @ np.linalg.solve(M, J.T), J @ given))
    np.testing.assert_allclose(result.v, expected, rtol=1e-9)
    np.testing.assert_allclose(J @ result.v, 0, atol=1e-12)
    euclidean = given - np.linalg.pinv(J) @ J @ given
    assert np.abs(result.v - euclidean).max() > 0.1  # the metric matters here


def test_a_velocity_on_the_constraints_stays():
    mech = pc.load("five_bar")
    first = pc.assemble(mech, v0={"left_crank": 1.0, "right_crank": -2.0})
    again = pc.assemble(mech, first.q, first.v)
    np.testing.assert_allclose(again.v, first.v, atol=1e-12)
    assert first.mobility == 2 and first.v[mech.model.idx_vs[mech.joint_index("right_crank")]] == pytest.approx(-2.0)


def test_least_energy_of_the_joints_not_named():
    """A double pendulum with one named velocity: the other minimises the kinetic energy."""
    mech = pc.load("double_pendulum")
    result = pc.assemble(mech, v0={"upper": 1.0})
    M = pin.crba(mech.model, mech.model.createData(), result.q)
    assert result.v == pytest.approx([1.0, -M[0, 1] / M[1, 1]])


@pytest.mark.parametrize("turn", np.linspace(-7.0, 7.0, 15))
def test_a_named_joint_is_led_there_in_the_mode_of_assembly_of_the_scene(turn):
    """Grashof four-bar: coupler and rocker are never in line, so that the sign of their angle is the mode."""
    mech = pc.load("four_bar")
    result = pc.assemble(mech, {"crank": turn})
    crank, coupler, rocker = result.q
    assert crank == turn and result.largest_gap[1] < TIGHT and np.sin(crank + coupler - rocker) > 0.5
    crossed = replace(mech, guess=pc.assemble(mech, {"crank": -1.0, "coupler": -2.4, "rocker": -2.5}).q)
    crank, coupler, rocker = pc.assemble(crossed, {"crank": turn}).q
    assert crank == turn and np.sin(crank + coupler - rocker) < -0.5


def test_an_orientation_is_led_too():
    """A ball joint of the Stewart platform's base turns by 0.4 rad; the legs follow, from their own side."""
    mech = pc.load("stewart_platform")
    pose = mech.guess[mech.model.idx_qs[mech.joint_index("platform_pose")] :][:7].copy()
    pose[3:] = pin.Quaternion(pin.exp3(np.array([0.2, 0.3, -0.1]))).coeffs()
    result = pc.assemble(mech, {"platform_pose": pose})
    np.testing.assert_allclose(result.q[-7:], pose, atol=1e-15)
    lengths = [result.q[mech.model.idx_qs[mech.joint_index(f"leg{k}_length")]] for k in range(1, 7)]
    assert result.largest_gap[1] < TIGHT and min(lengths) > 0.5


def test_where_the_way_is_blocked_the_loops_close_in_another_mode():
    """The four-bar's rocker stops short of 2 rad on its way from -1.4, and stands there in the crossed mode alone."""
    result = pc.assemble(pc.load("four_bar"), {"rocker": 2.0})
    crank, coupler, rocker = result.q
    assert rocker == 2.0 and result.largest_gap[1] < TIGHT and np.sin(crank + coupler - rocker) < 0


def test_contradictory_velocities_are_refused_by_name():
    with pytest.raises(pc.AssemblyError, match=r"four_bar.*velocities given for crank, rocker"):
        pc.assemble(pc.load("four_bar"), v0={"crank": 1.0, "rocker": 5.0})


def test_a_fixed_joint_out_of_reach():
    """Tip of rod a at distance √(1 + 1.5² - 3 cos 2) of pivot b: farther than rod b is long."""
    mech = rods(reach=1.5)
    with pytest.raises(
        pc.AssemblyError, match=r"loop 'tips' cannot close with a held: a gap of .* m remains in row [xy]\."
    ) as caught:
        pc.assemble(mech, fixed={"a": 2.0})
    error = pickle.loads(pickle.dumps(caught.value))
    for each in (caught.value, error):
        assert set(each.gaps) == {"tips"} and each.q.shape == (2,) and each.q[0] == 2.0
        assert str(each) == str(caught.value)
    missing = np.sqrt(1 + 1.5**2 - 3 * np.cos(2.0)) - 1.0
    assert np.linalg.norm(gap_between(mech, error.q, mech.loops[0]).translation) == pytest.approx(missing, abs=1e-6)
    assert pc.assemble(mech, {"a": 2.0}).largest_gap[1] < TIGHT  # not insisted upon


@pytest.mark.parametrize(("kind", "fields", "missing"), [("point", {}, 1.0), ("distance", {"length": 0.5}, 0.75)])
def test_a_link_too_short(kind, fields, missing):
    """Rods of 1 m on pivots 3 m apart leave 1 m; as a distance of 0.5 m, (1² - 0.5²)/(2·0.5)."""
    with pytest.raises(pc.AssemblyError, match="'tips'") as caught:
        pc.assemble(rods(kind=kind, **fields))
    assert caught.value.gaps == {"tips": pytest.approx(missing, abs=1e-6)}
    assert caught.value.q == pytest.approx([0.0, np.pi], abs=1e-3)


def test_only_the_loop_at_fault_is_named():
    model = rods(reach=1.5).model
    bad = pc.Loop("bad", "point", "tip a", "universe", xyz2=(0, 5.0, 0))
    with pytest.raises(pc.AssemblyError, match=r"1 of 2 loops cannot close.*'bad'") as caught:
        pc.assemble(pc.Mechanism(model, [pc.Loop("good", "point", "tip a", "tip b"), bad], guess=[0.3, 2.0]))
    assert set(caught.value.gaps) == {"bad"}


def test_loops_that_close_alone_but_not_together():
    model = rods(reach=1.5).model
    held = [pc.Loop("up", "point", "tip a", xyz2=(0, 1, 0)), pc.Loop("down", "point", "tip a", xyz2=(0, -1, 0))]
    with pytest.raises(pc.AssemblyError, match="cannot close together"):
        pc.assemble(pc.Mechanism(model, held))


@pytest.mark.parametrize("kind", ["point", "distance"])
def test_rods_just_long_enough(kind):
    """At full stretch the Jacobian loses rank; the answer stays closed."""
    fields = {"length": 1.0} if kind == "distance" else {}
    result = pc.assemble(rods(reach=3.0 if kind == "distance" else 2.0, kind=kind, **fields))
    assert result.largest_gap[1] < TIGHT
    assert np.sin(result.q) == pytest.approx([0.0, 0.0], abs=1e-4)


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-7, 1e-4, 0.1])
@pytest.mark.parametrize("axis", [(0, 0, 1), (0, 1, 0), (0.3, -0.5, 0.8), (0, 0, -3)])
def test_a_hinge_turned_over_closes_parallel(axis, tilt):
    """Antiparallel axes are no solution, not even exactly antiparallel ones, where sin(angle) is zero."""
    axis = np.array(axis, float)
    normal = np.cross(axis, [1.0, 0.2, 0.1])
    half = (np.pi - tilt) / 2
    turned = np.append(np.sin(half) * normal / np.linalg.norm(normal), np.cos(half))
    if tilt == 0.0:
        turned[3] = 0.0
    mech = ball("hinge", turned, axis=axis)
    R = frame_pose(mech.model, mech.guess, "body").rotation
    assert axis @ R @ axis < -0.9 * axis @ axis  # it is turned over
    result = pc.assemble(mech)
    R = frame_pose(mech.model, result.q, "body").rotation
    np.testing.assert_allclose(R @ axis, axis, atol=1e-10)
    assert result.mobility == 1


@pytest.mark.parametrize("quaternion", [(1, 0, 0, 0), (0.6, 0.8, 0, 1e-5), (0, 0, 1, -1e-9), (0.5, 0.5, 0.5, -0.5)])
def test_a_frame_turned_by_half_a_turn_closes(quaternion):
    result = pc.assemble(ball("frame", quaternion))
    assert np.abs(result.q[:3]).max() < TIGHT and result.mobility == 0


def test_distance_from_coincident_anchors():
    """|d|² has no gradient at d = 0: the start must be left all the same."""
    mech = rods(reach=0.0, kind="distance", length=1.5)
    result = pc.assemble(mech, np.zeros(2))
    d = gap_between(mech, result.q, mech.loops[0]).translation
    assert np.linalg.norm(d) == pytest.approx(1.5, abs=TIGHT) and result.mobility == 1
    assert abs(np.sin((result.q[1] - result.q[0]) / 2)) == pytest.approx(0.75, abs=1e-9)  # chord of two unit rods


@pytest.mark.parametrize("kind", ["point", "frame", "hinge", "distance"])
@pytest.mark.parametrize("frames", [("arm", "wheel"), ("puck", "raft"), ("universe", "raft")], ids="-".join)
def test_every_kind_of_joint(kind, frames):
    """Free flyer, spherical, planar and unbounded joints, from random guesses; unit norms are kept."""
    model, rng = mixed_tree(), np.random.default_rng(11)
    own = own_fields(kind, (1, 2, 2), None, 0.4)
    loop = pc.Loop("tie", kind, *frames, xyz1=(0.1, 0.0, 0.2), rpy2=(0.3, -0.2, 0.5), **own)
    mech = pc.Mechanism(model, [loop])
    for _ in range(3):
        guess, v = random_state(model, rng)
        result = pc.assemble(mech, guess, v)
        gap = gap_between(mech, result.q, loop)
        if kind == "distance":
            assert np.linalg.norm(gap.translation) == pytest.approx(0.4, abs=TIGHT)
        else:
            assert np.linalg.norm(gap.translation) < TIGHT
        if kind == "frame":
            assert np.linalg.norm(pin.log3(gap.rotation)) < TIGHT
        if kind == "hinge":
            np.testing.assert_allclose(gap.rotation @ [1, 2, 2], [1, 2, 2], atol=TIGHT)
        np.testing.assert_allclose(pin.normalize(model, result.q), result.q, atol=1e-14)
        # one millisecond at the projected velocity opens the loop only to second order
        later = gap_between(mech, pin.integrate(model, result.q, 1e-6 * result.v), loop)
        moved = later.translation if kind != "distance" else np.linalg.norm(later.translation) - 0.4
        assert np.abs(moved).max() < 1e-9


def test_fixed_spherical_and_unbounded_joints():
    model = mixed_tree()
    mech = pc.Mechanism(model, [pc.Loop("tie", "point", "arm", "wheel")])
    result = pc.assemble(mech, fixed={"ball": [0.0, 3.0, 0.0, 4.0], "turn": 0.7})
    np.testing.assert_allclose(result.q[2:6], [0, 0.6, 0, 0.8], atol=1e-15)
    start = model.idx_qs[mech.joint_index("turn")]
    np.testing.assert_allclose(result.q[start : start + 2], [np.cos(0.7), np.sin(0.7)], atol=1e-15)
    with pytest.raises(pc.InputError, match=r"'ball'.*length zero"):
        pc.assemble(mech, {"ball": np.zeros(4)})
    for joint, turnless in (("float", [1.0, 2, 3, 0, 0, 0, 0]), ("glide", [1.0, 2, 0, 0]), ("turn", [0.0, 0.0])):
        with pytest.raises(pc.InputError, match=rf"'{joint}'.*length zero"):
            pc.assemble(mech, {joint: turnless})


def test_trees_and_empty_models():
    tree = pc.load("double_pendulum")
    result = pc.assemble(tree, {"upper": 0.3}, v0={"lower": 1.0})
    assert (result.rows, result.rank, result.mobility, result.gaps) == (0, 0, 2, {})
    assert result.largest_gap == ("", 0.0) and result.q[0] == 0.3 and result.v[1] == pytest.approx(1.0)
    with pytest.raises(pc.InputError, match="no joints"):
        pc.Mechanism(pin.Model())


@pytest.mark.parametrize(
    ("kind", "fields", "told"),
    [
        ("point", {}, "'tips' by 1 m"),
        ("distance", {"length": 0.5}, r"\+0.5 m of length"),
        ("frame", {}, "m and .* rad"),
    ],
)
def test_reanchored_closes_what_cannot_close(kind, fields, told):
    mech = rods(kind=kind, **fields)
    with pytest.raises(pc.AssemblyError):
        pc.assemble(mech)
    with pytest.warns(UserWarning, match=told) as caught:
        moved = mech.reanchored()
    assert len(caught) == 1 and caught[0].filename == __file__
    result = pc.assemble(moved)
    assert result.largest_gap[1] < TIGHT and mech.loops[0] != moved.loops[0]
    gap = gap_between(moved, result.q, moved.loops[0])
    reached = abs(np.linalg.norm(gap.translation) - (moved.loops[0].length or 0.0))
    assert reached < TIGHT


@pytest.mark.parametrize("name", ["four_bar", "five_bar", "double_pendulum"])
def test_reanchored_leaves_what_closes(name):
    mech = pc.load(name)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert mech.reanchored().loops == mech.loops


BAD = {
    "no mechanism": (lambda m: pc.assemble("four_bar"), "needs a Mechanism, got str"),
    "unknown joint": (lambda m: pc.assemble(m, {"crnk": 1.0}), "no joint 'crnk'; the joints are crank"),
    "unknown fixed": (lambda m: pc.assemble(m, fixed={"crnk": 1.0}), "no joint 'crnk'"),
    "unknown velocity": (lambda m: pc.assemble(m, v0={"crnk": 1.0}), "no joint 'crnk'"),
    "q size": (lambda m: pc.assemble(m, np.zeros(4)), r"configuration needs shape \(3,\).*\(4,\)"),
    "v size": (lambda m: pc.assemble(m, v0=np.zeros((3, 1))), r"velocity needs shape \(3,\)"),
    "q NaN": (lambda m: pc.assemble(m, [0, np.nan, 0]), "configuration has a number that is not finite"),
    "v inf": (lambda m: pc.assemble(m, v0={"crank": np.inf}), "velocity of joint 'crank'.*not finite"),
    "two numbers": (lambda m: pc.assemble(m, {"crank": [1, 2]}), r"'crank' needs 1 number\(s\), got 2"),
    "text": (lambda m: pc.assemble(m, {"crank": "0.1"}), "'crank': expected numbers, got '0.1'"),
    "fixed list": (lambda m: pc.assemble(m, fixed=[1.0]), "fixed= needs a mapping"),
    "tolerance": (lambda m: pc.assemble(m, tolerance=-1e-9), "tolerance must be positive"),
    "tolerance NaN": (lambda m: pc.assemble(m, tolerance=np.nan), "tolerance"),
}


@pytest.mark.parametrize("case", BAD)
def test_bad_input(case):
    call, message = BAD[case]
    with pytest.raises(pc.InputError, match=message):
        call(pc.load("four_bar"))


def test_loops_that_contradict_a_little_close_with_a_warning():
    """The same point twice, 6 nm apart, as rounded numbers of files have it; 60 nm is refused."""
    mech = pc.load("four_bar")
    (loop,) = mech.loops

    def doubled(gap):
        return mech.with_loops(loop, replace(loop, name="again", xyz2=(loop.xyz2[0] + gap, *loop.xyz2[1:])))

    with pytest.warns(UserWarning, match=r"'(again|coupler_rocker)' closes only to 2\.\de-09"):
        assembly = pc.assemble(doubled(6e-9))
    assert 2e-9 < assembly.largest_gap[1] <= 3e-9 and assembly.mobility == 1  # half of it each, along skewed axes
    with pytest.raises(pc.AssemblyError, match="cannot close together"):
        pc.assemble(doubled(6e-8))


def test_two_drives_that_contradict_each_other_are_both_named():
    drives = [pc.Drive(name, "crank", pc.Motion(start=start)) for name, start in (("one", 0.3), ("other", 0.5))]
    mech = pc.load("four_bar").add_loops(*drives)
    with pytest.raises(pc.AssemblyError, match=r"two drives move the joint 'crank'.*'one' to 0\.3, 'other' to 0\.5"):
        pc.assemble(mech)


def test_an_assembly_is_printed_in_a_few_lines():
    text = str(pc.assemble(pc.load("stewart_platform")))
    assert "mobility 6" in text and "rank" in text and len(text.splitlines()) < 10
    assert "array" not in text


def test_an_assembly_is_its_caller_s_own():
    mech = pc.load("four_bar")
    pc.assemble(mech).gaps.clear()
    assert pc.assemble(mech).gaps
