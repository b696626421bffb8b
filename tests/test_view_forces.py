"""What a replay says beside the motion: forces as arrows, paths, and several solutions side by side."""

import re
import subprocess
import sys
from base64 import b64decode
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers.browser import needs_browser, opened
from helpers.pictures import arrow, drawn, shown, stated, track

import pinconsist as pc
from pinconsist.mechanism.loops import Loop
from pinconsist.view.arrows import ARROW_LENGTHS, FORCE
from pinconsist.view.arrows import stated as stated_amount

WEIGHT = 3.0  # kg


def shift(page, path):
    """By how much all below a path is shifted."""
    (matrix,) = [each["matrix"] for each in page["commands"] if (each["type"], each["path"]) == ("set_transform", path)]
    return np.reshape(matrix, (4, 4))[3, :3]


def hanging(first=True):
    """A weight on a rope to the ceiling, of which it is body 1 or body 2."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "weight")
    model.appendBodyToJoint(joint, pin.Inertia(WEIGHT, np.array([0, 0, -0.1]), 0.01 * np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("hook", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    ends = ("hook", "universe") if first else ("universe", "hook")
    place = {"xyz2" if first else "xyz1": (0.2, 0.0, 1.0)}
    return pc.Mechanism(model, (Loop("rope", "distance", *ends, length=1.0, **place),), name="hanging")


@pytest.mark.parametrize("first", [True, False])
def test_the_arrow_of_a_hanging_weight_points_up_and_is_as_long_as_said(first):
    mech = hanging(first)
    sol = pc.simulate(mech, (0.0, 0.1), q0=np.array([0.2, 0, 0, 0, 0, 0, 1]))
    page = shown(mech, sol, forces=True)
    start, vector = arrow(page, "/forces/rope")
    np.testing.assert_allclose(vector * stated(page), [[0, 0, WEIGHT * 9.81]] * 6, rtol=1e-4, atol=1e-4)
    hook = [0.2, 0.0, 1.0 if first else 0.0]  # anchor 2, where reactions are given
    np.testing.assert_allclose(start, [hook] * 6, atol=1e-6)


def test_arrows_are_the_reactions_the_largest_too():
    """Also where the force is ten times what it mostly is, as every half turn of this crank."""
    mech = pc.load("crank_rocker")
    sol = pc.simulate(mech, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 51), v0={"crank": 12.0})
    page = shown(mech, sol, forces=True)
    force = -sol.reaction("rocker_ground").force  # on the rocker
    start, vector = arrow(page, "/forces/rocker_ground")
    np.testing.assert_allclose(vector * stated(page), force, rtol=5e-3, atol=1e-2)
    assert page["cuts"] == [] and "force on the rocker_bar" in [each["text"] for each in page["legend"]]
    longest = np.linalg.norm(vector, axis=1).max()
    assert longest == pytest.approx(page["view"]["size"] * ARROW_LENGTHS[FORCE], rel=0.3)
    data = mech.model.createData()
    for row in (0, 20, 50):
        pin.framesForwardKinematics(mech.model, data, sol.q[row])
        tip = data.oMf[mech.model.getFrameId("rocker_tip")].translation
        np.testing.assert_allclose(start[row], tip, atol=1e-6)


def test_forces_are_drawn_where_there_are_some():
    mech = pc.load("double_pendulum").with_loops()
    sol = SimpleNamespace(t=np.linspace(0, 1, 5), q=np.zeros((5, mech.nq)), lam=np.zeros((5, mech.nc)))
    page = shown(mech, sol, forces=True)
    assert not drawn(page, "/forces") and "no forces to draw" in [each["text"] for each in page["legend"]]
    four_bar = pc.load("four_bar")
    still = SimpleNamespace(t=np.zeros(1), q=np.zeros((1, 3)), lam=np.full((1, four_bar.nc), 7.0))
    assert len(drawn(shown(four_bar, still, forces=True), "/forces")) == 4  # a shaft, a ring, and their heads
    assert not drawn(shown(four_bar, still), "/forces")
    for lam in ({}, {"lam": np.zeros((1, 2))}, {"lam": np.full((1, four_bar.nc), np.nan)}):
        with pytest.raises(pc.InputError, match="lam"):
            shown(four_bar, SimpleNamespace(t=still.t, q=still.q, **lam), forces=True)


def test_forces_that_are_not_determined_are_not_drawn():
    """Two loops of Cassie with 1e5 to 1e6 N; the others carry a few hundred, of which the scale is made."""
    try:
        mech = pc.load("cassie")
    except pc.MissingExtraError as error:
        pytest.skip(str(error))
    sol = pc.simulate(mech, (0.0, 0.1))
    page = shown(mech, sol, forces=True)
    shins = {f"{side}-shin-spring-joint" for side in ("left", "right")}
    assert min(np.linalg.norm(sol.reaction(name).force, axis=1).max() for name in shins) > 5e4
    drawn_loops = {each["path"].split("/")[2].removesuffix(" moment") for each in drawn(page, "/forces/")}
    assert drawn_loops == {loop.name for loop in mech.anchored_loops} - shins
    assert max(np.linalg.norm(sol.reaction(name).force, axis=1).max() for name in drawn_loops) < 1000
    (note,) = [each["text"] for each in page["legend"] if each["text"].startswith("not drawn")]
    knees = [f"{side}-knee-{part}-joint" for side in ("left", "right") for part in ("spring", "shin")]
    assert all(name in note for name in shins) and "their rows depend on others to 3e-07 … 4e-06" in note
    assert note.endswith(f"; nor are those of {', '.join(knees)}, which share their loads")


def test_joints_that_share_a_load_that_is_not_determined_are_not_drawn_either():
    """They have 1e5 to 1e6 N, too, and would set the scale of those that carry a few hundred."""
    try:
        mech = pc.load("cassie")
    except pc.MissingExtraError as error:
        pytest.skip(str(error))
    sol = pc.simulate(mech, (0.0, 0.05))
    page = shown(mech, sol, forces=True, beside=True)
    found = {each["path"].split("/")[2].removeprefix("joint force ") for each in drawn(page, "/joint forces/")}
    (group,) = [each for each in page["panel"]["groups"] if each["name"] == "joint forces"]
    told = {each["of"].removeprefix("joint ") for each in group["curves"]}
    left_out = set(mech.joints) - found
    assert left_out == {f"{side}-knee-{part}-joint" for side in ("left", "right") for part in ("spring", "shin")}
    assert told <= found and "left-shin-tarsus-joint" in told
    sizes = {name: np.linalg.norm(sol.joint_force(name).force, axis=1).max() for name in mech.joints}
    assert min(sizes[name] for name in left_out) > 1e4 > 1e3 > max(sizes[name] for name in found)


def test_paths_follow_their_frames_each_in_its_color():
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.5))
    page = shown(mech, sol, traces=["coupler", "coupler_tip"])
    paths = [each["object"] for each in drawn(page, "/traces/")]
    assert [each["text"] for each in page["legend"][:2]] == ["path of coupler", "path of coupler_tip"]
    assert [each["color"] for each in page["legend"][:2]] == [each["materials"][0]["color"] for each in paths]
    points = np.reshape(paths[1]["geometries"][0]["data"]["attributes"]["position"]["array"], (-1, 3))
    data = mech.model.createData()
    pin.framesForwardKinematics(mech.model, data, sol.q[-1])
    np.testing.assert_allclose(points[-1], data.oMf[mech.model.getFrameId("coupler_tip")].translation, atol=1e-6)
    assert len(points) >= len(sol.t) > 10  # a point for each row of the solution, not only for each frame
    with pytest.raises(pc.InputError, match=r"no frame 'couplr' to trace; similar: .*coupler"):
        shown(mech, sol, traces=["couplr"])
    with pytest.raises(pc.InputError, match=re.escape("traces=['coupler']")):
        shown(mech, sol, traces="coupler")


def exact_and_consistent(until=0.1):
    mech = pc.load("four_bar")
    options = {"step": 0.005, "method": "ImplicitEuler", "v0": {"crank": 6.0}}
    return mech, [pc.simulate(mech, (0.0, until), consistency=mode, **options) for mode in ("exact", "every-step")]


def test_exact_stands_beside_consistent_in_one_scale():
    mech, sols = exact_and_consistent()
    page = shown(mech, sols, forces=True, speed=0.1)  # a frame every 2 ms
    assert [each["text"] for each in page["titles"]] == ["exact", "every-step"]
    per_metre = stated(page)
    for path, sol in zip(("/1 exact", "/2 every-step"), sols, strict=True):
        vector = arrow(page, f"{path}/forces/coupler_rocker")[1]
        force = sol.reaction("coupler_rocker").force
        for row, frame in ((0, 0), (2, 5), (4, 10)):
            np.testing.assert_allclose(vector[frame] * per_metre, force[row], rtol=1e-3, atol=1e-3)
    assert not shift(page, "/1 exact").any()
    right = shift(page, "/2 every-step")
    ends = [mech.model.frames[mech.model.getFrameId(name)] for name in ("coupler", "rocker")]
    assert len(ends) == 2 and right[0] > 2 * 0.5 and not right[1:].any()  # the scene moves in the x-z plane
    first, second = (np.array(each["at"]) for each in page["titles"])
    np.testing.assert_allclose(second - first, right, atol=0.1 * right[0])


def test_titles_tell_solutions_apart():
    mech, other = pc.load("four_bar"), pc.load("planar_pendulum")
    one, two = pc.simulate(mech, (0.0, 0.1)), pc.simulate(other, (0.0, 0.1))
    titles = lambda *pair: [each["text"] for each in shown(*pair)["titles"]]  # noqa: E731
    assert titles(mech, one) == titles([mech], one) == titles(mech, [one]) == []
    assert titles([mech, other], [one, two]) == ["four_bar", "planar_pendulum"]
    assert titles(mech, (one, one)) == ["1", "2"]
    assert titles(mech, {"before": one, "after/now": one}) == ["before", "after/now"]


def test_a_scene_in_space_beside_one_in_a_plane_is_seen_from_aside():
    scenes = [pc.load("four_bar"), pc.load("bricard")]
    sols = [pc.simulate(mech, (0.0, 0.1)) for mech in scenes]
    floors = [len(drawn(shown(*pair), "/floor")) for pair in ((scenes[0], sols[0]), (scenes, sols))]
    assert floors == [0, 1]


@pytest.mark.parametrize(
    ("mechs", "count", "message"),
    [(1, 0, "empty"), (2, 1, "2 mechanisms for 1 solution"), (2, 3, "2 mechanisms for 3")],
)
def test_lists_that_do_not_fit_are_refused(mechs, count, message):
    mech = pc.load("planar_pendulum")
    sol = SimpleNamespace(t=np.zeros(1), q=np.zeros((1, mech.nq)))
    with pytest.raises(pc.InputError, match=message):
        shown([mech] * mechs if mechs > 1 else mech, [sol] * count)
    with pytest.raises(pc.InputError, match="needs a Mechanism, got str"):
        shown("planar_pendulum", sol)
    with pytest.raises(pc.InputError, match="needs a solution; int has no t"):
        shown(mech, [sol, 3])


def test_the_shorter_of_two_rests_at_its_end():
    mech = pc.load("planar_pendulum")
    runs = [SimpleNamespace(t=np.array([0, end]), q=np.array([[0.0] * mech.nq, [end] * mech.nq])) for end in (0.4, 1.0)]
    page = shown(mech, runs)
    short, long = (track(page, f"/{k} {k}/bodies/{mech.joints[0]}", ".quaternion") for k in (1, 2))
    np.testing.assert_allclose(short[:21], long[:21], atol=1e-6)
    np.testing.assert_allclose(short[21:], np.tile(short[20], (30, 1)), atol=1e-6)
    assert np.abs(long[50] - long[20]).max() > 0.1


def test_what_a_loop_leaves_free_is_drawn_as_rail_or_plate():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.addFrame(pin.Frame("block", joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    q = np.zeros((3, 7))
    q[:, 6], q[:, 0] = 1.0, (-1.0, 0.0, 2.0)
    sol = SimpleNamespace(t=np.arange(3.0), q=q)
    for kind, axis, seat in (
        ("slider", (5, 0, 0), "rail"),
        ("cylinder", (5, 0, 0), "rail"),
        ("plane", (0, 0, 1), "plate"),
    ):
        mech = pc.Mechanism(model, (Loop("guide", kind, "universe", "block", axis=axis),))
        page = shown(mech, sol)
        (guide,) = [
            each["object"]
            for each in drawn(page, "/ground/")
            if each["object"]["geometries"][0]["type"] == "CylinderGeometry"
            and not each["object"]["materials"][0]["depthTest"]
        ]
        form, matrix = guide["geometries"][0], np.reshape(guide["object"]["matrix"], (4, 4)).T
        if seat == "rail":
            np.testing.assert_allclose(np.abs(matrix[:3, 1]), [1, 0, 0], atol=1e-9)
            assert matrix[0, 3] == pytest.approx(0.5) and 3.0 < form["height"] < 3.3
        else:
            np.testing.assert_allclose(np.abs(matrix[:3, 1]), [0, 0, 1], atol=1e-9)
            assert form["radiusTop"] == form["radiusBottom"] > 2.0
        assert any(seat in each["text"] for each in page["legend"])


def test_the_time_that_is_told_runs_with_the_rows():
    mech = pc.load("planar_pendulum")
    sol = SimpleNamespace(t=np.array([3.0, 1.0]), q=np.zeros((2, mech.nq)))
    assert shown(mech, sol, speed=0.5)["clock"] == [3.0, -0.5, 4.0, 201]


def test_nothing_of_the_view_is_loaded_by_a_simulation():
    code = """if True:
        import sys, pinconsist as pc
        sol = pc.simulate(pc.load("delta_robot"), (0.0, 0.01))
        sol.check()
        print([name for name in sys.modules if name.startswith(("pinconsist.view", "meshcat", "matplotlib"))])"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_a_machine_without_free_ports_is_told(monkeypatch):
    def refuse(*_):
        raise OSError("address already in use")

    mech = pc.load("planar_pendulum")
    sol = SimpleNamespace(t=np.zeros(1), q=np.zeros((1, mech.nq)))
    monkeypatch.setattr("http.server.ThreadingHTTPServer", refuse)
    with pytest.raises(pc.InputError, match=r"127\.0\.0\.1.*already in use.*export_html"):
        pc.replay(mech, sol, open_browser=False)


AT = """path => {
  const thing = object(path);
  thing.updateWorldMatrix(true, false);
  return thing.matrixWorld.toArray();
}"""
PIXELS = """(() => {
  const pixel = path => {
    const seen = object(path).getWorldPosition(new Vector3()).project(camera);
    return [(1 + seen.x) / 2 * pane.clientWidth, (1 - seen.y) / 2 * pane.clientHeight];
  };
  const [top, left] = [pane.getBoundingClientRect().top, pane.getBoundingClientRect().left];
  return ["1 exact", "2 every-step"].map((run, k) => {
    const box = document.querySelectorAll(".label.title")[k].getBoundingClientRect();
    const feet = ["crank", "rocker"].flatMap(name => pixel(`${run}/bodies/${name}`));
    return [(box.left + box.right) / 2 - left, box.top - top, ...feet];
  });
})()"""


@needs_browser
def test_forces_paths_and_two_runs_move_in_a_browser(tmp_path):
    mech, sols = exact_and_consistent(0.2)
    options = {"forces": True, "traces": ["coupler_tip"], "speed": 0.1}
    page = shown(mech, sols, **options)
    with opened(pc.export_html(mech, sols, tmp_path / "two.html", **options)) as tab:
        tab.wait("now > 0")
        assert tab.run('object("/1 exact/traces/coupler_tip/<object>").type') == "Line"
        assert "path of coupler_tip" in tab.run('element("legend").innerText')
        assert tab.run('[...document.querySelectorAll(".label.title")].map(each => each.innerText)') == [
            "exact",
            "every-step",
        ]
        for seconds, row in ((0, 0), (0.5, 10)):
            tab.run(f"running = false; seek({seconds})")
            tab.wait(f"parseFloat(element('time').innerText.split(' ')[2]) == {0.1 * seconds}")
            for run, sol in zip(("1 exact", "2 every-step"), sols, strict=True):
                matrix = np.reshape(tab.run(f"({AT})('/{run}/forces/coupler_rocker/shaft')"), (4, 4)).T
                pull = sol.reaction("coupler_rocker").force[row]
                matrix[:3] = matrix[[0, 2, 1]] * [[1], [-1], [1]]  # from axes with y up
                along = matrix[:3, 1] / np.linalg.norm(matrix[:3, 1])
                np.testing.assert_allclose(along, pull / np.linalg.norm(pull), atol=1e-3)
                start, _ = arrow(page, f"/{run}/forces/coupler_rocker")
                placed = start[round(50 * seconds)] + shift(page, f"/{run}")
                np.testing.assert_allclose(matrix[:3, 3], placed, atol=1e-4)
        for x, y, x1, y1, x2, y2 in tab.run(PIXELS):
            assert x1 < x < x2 and max(y1, y2) < y < max(y1, y2) + 100  # each under its own linkage


def test_a_small_force_is_seen_before_its_loop():
    """One of a thirtieth of the largest: drawn later than the loop's core, out of which it reaches, and not a hair."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 51))
    sol = replace(sol, lam=sol.lam / np.linalg.norm(sol.reaction("coupler_rocker").force, axis=1)[:, None])
    sol.lam[10:] *= 30.0
    page = shown(mech, sol, forces=True)
    _, vector = arrow(page, "/forces/coupler_rocker")
    objects = {each["path"]: each["object"] for each in drawn(page, "/")}
    core = min(
        each["geometries"][0]["radius"] for each in objects.values() if each["object"]["userData"].get("part") == "loop"
    )
    (tip,) = [each["object"] for each in drawn(page, "/forces/coupler_rocker/head")]
    assert np.linalg.norm(vector[0]) > core and tip["object"]["renderOrder"] == 2
    width = tip["geometries"][0]["radiusBottom"] * track(page, "/forces/coupler_rocker/head", ".scale")[0, 0]
    assert width > 0.5 * core


def test_bodies_and_forces_between_long_steps():
    """At the frames of a run of Radau, whose rows are far apart, against a tight run."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 1.0), method="Radau", rtol=1e-8)
    page = shown(mech, sol, fps=50, forces=True)
    exact = pc.simulate(mech, (0.0, 1.0), method="Radau", rtol=1e-12, atol=1e-13, t_eval=np.linspace(0.0, 1.0, 51))
    assert len(sol.t) < 40
    data, force = mech.model.createData(), exact.reaction("coupler_rocker").force
    vectors = arrow(page, "/forces/coupler_rocker")[1] * stated(page)
    for k in range(51):
        pin.forwardKinematics(mech.model, data, exact.q[k])
        for joint, name in enumerate(mech.joints, start=1):
            at = track(page, f"/bodies/{name}", ".position")[k]
            np.testing.assert_allclose(at, data.oMi[joint].translation, atol=1e-6)
    np.testing.assert_allclose(vectors, force, atol=2e-3 * np.linalg.norm(force, axis=1).max())


def test_forces_in_the_joints_of_a_tree_are_arrows():
    """At each joint, what it transmits to its child; they are seen at first where there are no others."""
    mech = pc.load("double_pendulum")
    sol = pc.simulate(mech, (0.0, 1.0), method="Radau")
    page = shown(mech, sol, forces=True)
    at = sol.at(np.linspace(0.0, 1.0, 51))
    bar = stated(page)
    for joint in mech.joints:
        start, vector = arrow(page, f"/joint forces/joint force {joint}")
        exact = at.joint_force(joint).force
        np.testing.assert_allclose(vector * bar, exact, atol=1e-3 * np.abs(exact).max())
        np.testing.assert_allclose(start, at.frame(joint).position, atol=1e-6)
    (entry,) = [each for each in page["legend"] if "bar" in each]
    assert "force in joints upper and lower" in entry["text"]
    parts = {each["object"]["object"]["userData"]["part"] for each in drawn(page, "/joint forces")}
    assert parts == {"joint force"} and not drawn(shown(mech, sol), "/joint forces")


def test_forces_in_joints_beside_those_of_loops_change_nothing_else():
    """They are on the page, not in films, have a bar of their own, and the camera does not make room for them."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.5))
    film, page = shown(mech, sol, forces=True), shown(mech, sol, forces=True, beside=True)
    assert not drawn(film, "/joint forces") and len(drawn(page, "/joint forces")) == 2 * len(mech.joints)
    assert page["view"] == film["view"]
    for each, other in zip(film["legend"], page["legend"], strict=False):
        assert each == other
    assert len(page["legend"]) == len(film["legend"]) + 1


def test_large_forces_have_prefixes():
    mech = pc.load("double_pendulum").with_gravity((0, 0, -1e4))
    texts = [
        each["bar"]["text"]
        for each in shown(mech, pc.simulate(mech, (0.0, 0.02)), forces=True)["legend"]
        if "bar" in each
    ]
    assert texts == ["10 kN"]
    assert [stated_amount(each, "N") for each in (9999.0, 2e4, 5e7)] == ["9999 N", "20 kN", "50 MN"]


def group_of(page, name):
    """The largest values of the curves of a group, by their names."""
    found = [group for group in page["panel"]["groups"] if group["name"] == name]
    return {
        each["name"]: np.abs(np.frombuffer(b64decode(each["y"]), "<f4")).max() for g in found for each in g["curves"]
    }


def test_forces_given_to_a_run_act_on_its_page():
    """Whether the page is written for the mechanism with them or for the one without; joint forces hold both."""
    mech = pc.load("four_bar")
    push = pc.Wrench("rocker_bar", force=(300.0, 0.0, 0.0), xyz=(0.8, 0.0, 0.0))
    sol = pc.simulate(mech, (0.0, 1.0), forces=[push])
    page = shown(mech, sol, forces=True, beside=True)
    assert group_of(page, "forces")["wrench rocker_bar"] == pytest.approx(300.0)
    for joint, most in group_of(page, "joint forces").items():
        assert most == pytest.approx(abs(sol.joint_force(joint).peak().value), rel=5e-3), joint
    film = shown(mech, sol, forces=True)
    _, vector = arrow(film, "/forces/wrench rocker_bar")
    np.testing.assert_allclose(vector[0] * stated(film), (300.0, 0.0, 0.0), rtol=5e-3, atol=1e-3)


def test_of_a_saved_run_nothing_is_told_that_needs_forces_that_are_missing(tmp_path):
    mech = pc.load("four_bar")
    push = pc.Wrench("rocker_bar", force=(300.0, 0.0, 0.0))
    sol = pc.simulate(mech, (0.0, 0.2), forces=[push])
    read = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    with pytest.raises(pc.InputError, match="the run had 1 forces"):
        read.acceleration("rocker", mech)
    with pytest.raises(pc.InputError, match="the run had 1 forces"):
        sol.acceleration("rocker", mech)
    page = shown(mech, read, forces=True, beside=True)
    (note,) = page["panel"]["notes"]
    assert note.startswith("joint forces and energies are missing: the run had 1 forces besides the model's own, but")
    assert not group_of(page, "joint forces") and not drawn(page, "/joint forces") and group_of(page, "forces")
    whole = shown(mech.add_forces(push), read, forces=True, beside=True)
    assert whole["panel"]["notes"] == []
    assert group_of(whole, "joint forces")["rocker"] == pytest.approx(sol.joint_force("rocker").peak().value, rel=5e-3)


def test_forces_that_are_not_unique_are_marked():
    """Of Bricard's six hinges none has a unique force; of a four-bar all have."""
    for name, unique in ("bricard", False), ("four_bar", True):
        mech = pc.load(name)
        panel = shown(mech, pc.simulate(mech, (0.0, 0.5)), forces=True, beside=True)["panel"]
        curves = [each for g in panel["groups"] if g["name"] in ("forces", "joint forces") for each in g["curves"]]
        assert len(curves) == len(mech.joints) + len(mech.loops)
        assert all(each.get("shared", False) != unique == (not each["name"].endswith(" *")) for each in curves)


def test_bodies_are_named_by_their_links():
    mech = pc.load("stewart_platform")
    page = shown(mech, pc.simulate(mech, (0.0, 0.1)), forces=True, beside=True)
    names = {each["object"]["object"]["userData"]["name"] for each in drawn(page, "/bodies/")}
    assert {"platform", "leg1_barrel", "leg1_rod"} <= names and "platform_pose" not in names
    text = next(each["text"] for each in page["legend"] if "bar" in each)
    assert text.startswith("force on the platform; drive force in joints leg1_length, leg2_length and 4 more")
    (forces,) = [group for group in page["panel"]["groups"] if group["name"] == "forces"]
    assert [each["bodies"] for each in forces["curves"] if each["of"] == "leg1"] == [("platform", "leg1_rod")]
