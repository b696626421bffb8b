"""Commands found by guessing: plot, models, check at a position of one's own, and what every command has."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from base64 import b64decode
from functools import partial
from math import pi
from pathlib import Path

import numpy as np
import pytest
from helpers.browser import needs_browser, opened
from helpers.command_line import called
from helpers.pictures import arrow, drawn, stated

import pinconsist
import pinconsist as pc
from pinconsist.cli.app import OVERVIEW, app
from pinconsist.cli.scene import joint_values
from pinconsist.view.arrows import COLORS, RIGHT, WRONG

COMMANDS = [command.name for command in app.registered_commands]
MODELS = Path(__file__).resolve().parents[1] / "models"
KANGAROO = Path(__file__).resolve().parents[2] / "shared" / "robots" / "kangaroo_like"


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command line in an empty folder, 80 columns wide → exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "80")
    return partial(called, capsys)


def test_the_overview_names_every_command_and_fits_80_columns():
    assert max(map(len, OVERVIEW.splitlines())) <= 80
    assert set(re.findall(r"^  pinconsist (\w+)", OVERVIEW, re.MULTILINE)) == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_help_has_an_example_and_the_exit_codes(run, command):
    code, out, _ = run(command, "--help")
    assert code == 0 and f"Example: pinconsist {command}" in out and "Exit codes: 0 success" in out
    assert max(map(len, out.splitlines())) <= 80
    assert out.count("pinconsist ") >= 2 and ("--json" in out or command in ("replay", "render"))


@pytest.mark.parametrize(
    ("command", "one"),
    [("sweep", "a case failed (its row"), ("plot", "the integration of")],
)
def test_every_command_says_what_its_own_exit_code_1_is(run, command, one):
    assert f"Exit codes: 0 success; 1 {one}" in " ".join(run(command, "--help")[1].split())


def test_the_overall_help_has_the_exit_codes(run):
    assert "Exit codes: 0 success" in run("--help")[1]


def test_plot_of_a_saved_run(run):
    run("simulate", "four_bar", "--until", 0.2, "--out", "run.npz")
    code, out, err = run("plot", "run.npz", "--what", "multipliers, energy,drift", "--out", "lam.svg")
    assert (code, err) == (0, "") and out.startswith("four_bar: t = 0 … 0.2 s") and out.endswith("written: lam.svg\n")
    assert "<svg" in Path("lam.svg").read_text()


def test_plot_of_a_scene_simulates_it_and_names_the_file_after_it(run):
    code, out, _ = run("plot", "planar_pendulum", "--what", "phase", "--until", 0.5, "--json")
    told = json.loads(out)
    assert code == 0 and told["files"] == {"out": "planar_pendulum.png"} and told["t"] == [0, 0.5]
    assert Path("planar_pendulum.png").read_bytes().startswith(b"\x89PNG")


@pytest.fixture
def general(tmp_path, monkeypatch):
    """A saved general problem with the sizes of the one scene in its folder: a point on a circle, and a four-bar."""
    problem = pinconsist.HessenbergProblem(
        U=lambda t, p, v: v,
        F=lambda t, p, v: np.array([0.0, -9.81, 0.0]),
        G=lambda t, p, v: np.array([[p[0]], [p[1]], [0.0]]),
        R=lambda t, p: np.array([(p[0] ** 2 + p[1] ** 2 - 1.0) / 2]),
    )
    pinconsist.integrate(problem, (0.0, 0.1), [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]).save(tmp_path / "p.npz")
    for suffix in (".urdf", ".yaml"):
        shutil.copy(MODELS / f"four_bar{suffix}", tmp_path)


def test_a_general_problem_is_drawn_without_a_scene(run, general):
    """One URDF beside it must not be taken for its scene."""
    code, out, err = run("plot", "p.npz", "--what", "trajectory,multipliers,steps,phase", "--json")
    assert (code, err) == (0, "") and json.loads(out)["scene"] is None and Path("p.png").stat().st_size
    assert run("plot", "p.npz")[1].startswith("general problem: t = 0 … 0.1 s")
    code, _, err = run("plot", "p.npz", "--what", "energy", "--out", "e.png")
    assert code == 2 and "a general problem, which has no scene; available for it: trajectory" in err
    code, _, err = run("replay", "p.npz", "--html", "p.html")
    assert code == 2 and "a general problem, which has no scene to show" in err


def test_a_name_in_a_saved_run_is_no_folder(run):
    """A run of a mechanism called `arm`, saved in Python, is not one of what lies in a folder `arm`."""
    mech = dataclasses.replace(pinconsist.load("four_bar"), name="arm")
    pinconsist.simulate(mech, (0.0, 0.1)).save("run.npz")
    Path("arm").mkdir()
    shutil.copy(MODELS / "four_bar.urdf", "arm")
    code, _, err = run("plot", "run.npz")
    assert code == 2 and "only the name of its scene, 'arm'" in err and "with --scene" in err
    assert run("plot", "run.npz", "--scene", "four_bar")[0] == 0


@pytest.mark.parametrize("command", [("plot",), ("replay", "--html", "x.html")])
def test_a_scene_that_changed_since_the_run_is_told(run, command):
    for suffix in (".urdf", ".yaml"):
        shutil.copy(MODELS / f"four_bar{suffix}", f"bar{suffix}")
    run("simulate", "bar.urdf", "--until", 0.1, "--out", "run.npz")
    assert run(*command, "run.npz")[2] == ""
    Path("bar.yaml").write_text(Path("bar.yaml").read_text() + "\ngravity: [0, 0, -1.6]\n")
    code, _, err = run(*command, "run.npz")
    assert code == 0 and "(bar.yaml has changed); energies and forces are those of the changed scene" in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["four_bar", "--what", "forses"], "there is no picture 'forses'; available: trajectory, multipliers"),
        (["four_bar", "--what", ""], "there is no picture ''"),
        (["four_bar", "--out", "x.doc"], "must end in one of"),
        (["four_bar", "--out", "nowhere/x.png"], "there is no folder"),
        (["four_bar", "--scene", "five_bar"], "--scene"),
        (["run.npz", "--until", "1"], "--until"),
        (["nowhere.npz"], "nowhere.npz: no such file"),
        (["four_barr"], "four_bar"),
    ],
)
def test_plots_that_cannot_be(run, arguments, message):
    code, _, err = run("plot", *arguments)
    assert code == 2 and err.startswith("pinconsist: error: ") and message in err and not list(Path().iterdir())


def test_a_picture_that_a_run_does_not_have_leaves_no_file(run):
    code, _, err = run("plot", "planar_pendulum", "--what", "drift")
    assert code == 2 and "no constraints" in err and not list(Path().iterdir())


def test_a_plot_of_an_interrupted_run_is_drawn(run, monkeypatch):
    def interrupted(mech, span, **options):
        def stop(t, q, v, lam):
            if t > 0.5:
                raise KeyboardInterrupt

        return simulate(mech, span, **options | {"callback": stop})

    simulate = pinconsist.simulate
    monkeypatch.setattr("pinconsist.simulate", interrupted)
    code, out, _ = run("plot", "four_bar", "--out", "part.png")
    assert code == 130 and "interrupted at t = 0.5" in out and Path("part.png").stat().st_size


def test_compare_shows_exact_beside_consistent_and_the_truth(run):
    """The force of the page's first step, row 1, is the one whose error the table tells; the page says the same."""
    code, out, _ = run("compare", "problem51", "--rows", 3, "--html", "two.html")
    page = json.loads(re.search(r'<script id="replay".*?>(.*?)</script>', Path("two.html").read_text())[1])
    assert [each["text"] for each in page["titles"]] == ["from exact values", "from consistent values"]
    assert page["clock"][:3] == [0.0, 0.001, 3.0]  # a step of 0.001 s takes a second
    paths = [f"/{number} from {title} values/forces/circle" for number, title in ((1, "exact"), (2, "consistent"))]
    paths.append("/1 from exact values/forces/true: circle")
    exact, consistent, true = (np.linalg.norm(arrow(page, path)[1][50]) * stated(page) for path in paths)
    truth = np.abs(pc.paper.reference_problem("problem51").exact(0.001)[2])
    assert true == pytest.approx(truth.item(), rel=1e-4)
    told = f"{exact:.3g} N instead of {true:.3g} N"
    assert true - exact == pytest.approx(2.0080, abs=1e-3) and consistent - true == pytest.approx(-0.008, abs=1e-3)
    first = page["first"]
    assert first["stop"] == 1.0 and first["wrong"] == f"{100 * 2.008 / truth.item():.0f} % wrong: {told}"
    assert code == 0 and first["verdict"] in " ".join(out.split()) and told in first["verdict"]
    (forces,) = [group for group in page["panel"]["groups"] if group["name"] == "forces"]
    curves = {each["name"]: np.frombuffer(b64decode(each["y"]), "<f4")[1] for each in forces["curves"]}
    assert curves == pytest.approx(
        {
            "from exact values: rod circle": exact,
            "true: rod circle": true,
            "from consistent values: rod circle": consistent,
        },
        rel=1e-4,
    )
    parts = drawn(page, "/1 from exact values/forces")
    colors = {each["path"].split("/")[3]: each["object"]["materials"][0]["color"] for each in parts}
    assert colors == {"circle": WRONG, "true: circle": RIGHT}
    radii = {each["path"].split("/")[3]: each["object"]["geometries"][0]["radiusBottom"] for each in parts}
    assert radii["true: circle"] > 2 * radii["circle"]  # seen also where the other covers it


@needs_browser
def test_the_page_of_a_comparison_stops_at_the_first_step(run):
    run("compare", "crank_rocker", "--with-velocity", "crank=12", "--step", 0.001, "--html", "two.html")
    with opened(Path("two.html")) as tab:
        tab.wait("now > 0 && !running")
        assert tab.run("now") == 1.0 and tab.run("header.querySelector('strong').innerText") == tab.run("first.wrong")
        share, wrong, true = numbers = tab.run("first.wrong.match(/[0-9.]+(?= (%|N))/g).map(Number)")
        told = tab.run("group.curves.map(curve => [curve.name.split(':')[0], amount(curve, length / 6)])")
        told = {name: float(amount.split()[0]) for name, amount in told}
        assert (told["from exact values"], told["true"]) == (wrong, true) and share >= 100 * (wrong / true - 1), numbers
        colors = tab.run("group.curves.map(curve => curve.color)")
        assert colors == [f"#{color:06x}" for color in (WRONG, RIGHT, COLORS["force"])]
        assert (
            tab.run("[...svg.querySelectorAll('.dots')].map(each => each.getAttribute('d').split('M').length)")
            == [8] * 3
        )
        for key, rows in (("ArrowRight", (2, 3)), ("ArrowLeft", (2, 1, 0, 0))):  # from computed row to computed row
            for row in rows:
                tab.key(key)
                assert tab.run("now") == pytest.approx(row, abs=1e-6)
        tab.run("seek(1)")
        size = "parseFloat(getComputedStyle(header.querySelector('strong')).fontSize)"
        assert tab.run("header.querySelector('strong').className") == "look"
        assert tab.run(size) > 2 * tab.run("parseFloat(getComputedStyle(document.body).fontSize)")
        tab.key(" ")
        tab.wait("now > 1.5")  # and then goes on


def test_the_steps_of_a_comparison_follow_the_duration_of_the_scene(run):
    assert [each["h"] for each in json.loads(run("compare", "andrews", "--json")[1])["runs"]] == [6e-5, 6e-6]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["problem52", "--html", "x.html"], "--html shows bodies, but problem52 has none"),
        (["problem51", "--html", "x.svg", "--plot", "./x.svg"], "--html and --plot name the same file"),
        (["problem51", "--html", "nowhere/x.html"], "there is no folder"),
    ],
)
def test_comparisons_that_cannot_be_shown(run, arguments, message):
    code, _, err = run("compare", *arguments)
    assert code == 2 and message in err and not list(Path().iterdir())


def test_models_lists_families_and_the_robots_that_are_installed(run, monkeypatch):
    told = json.loads(run("models", "--json")[1])
    assert {"chain_<n>", "four_bar"} <= told["models"].keys()
    for robot in told["robots"]:
        assert pinconsist.load(robot).nv > 0

    def missing(name):
        raise pinconsist.MissingExtraError(name)

    monkeypatch.setattr("pinconsist.formats.catalogue.robot_file", missing)
    assert json.loads(run("models", "--json")[1])["robots"] == []
    out = run("models")[1]
    assert (
        "robots that are available after: pip install 'pinconsist[robots]'\n  cassie, " in out and "which is" not in out
    )


@pytest.mark.parametrize(
    ("text", "value"),
    [("pi", pi), ("-pi/2", -pi / 2), ("2pi/3", 2 * pi / 3), ("+.5*pi", pi / 2), ("1e-3", 1e-3)],
)
def test_joint_values_may_be_parts_of_pi(text, value):
    assert joint_values([f"a={text}"], "--at") == {"a": [value]}
    assert joint_values([f"a=1,{text}"], "--at") == {"a": [1.0, value]}


@pytest.mark.parametrize("text", ["pie", "pi/0", "pi/", "pi pi", "2**pi", ""])
def test_other_words_are_no_joint_values(text):
    with pytest.raises(pinconsist.InputError, match="is not a number"):
        joint_values([f"a={text}"], "--at")


def test_a_number_that_a_loop_does_not_have_cannot_vary(run):
    code, _, err = run("sweep", "four_bar", "--vary", "coupler_rocker.length=1,2")
    assert code == 2 and "a loop of kind 'hinge' has no length" in err


LEVEL = ("--at", "crank0=pi/2", "crank1=pi/2", "crank2=pi/2")


def test_check_at_a_singular_position(run):
    """All bars in line: no loop row but those along z is left, and the bars can fold three ways."""
    code, out, err = run("check", "n_four_bar_2", *LEVEL)
    assert code == 2 and "rank 2 here and 4 nearby" in err
    assert "rows: 10, 2 of them independent and 8 redundant\nmobility: 3\n" in out
    assert "redundant: (B1 x, y, tilt1, tilt2) = 0 for every motion" in out
    told = json.loads(run("check", "n_four_bar_2", *LEVEL, "--json")[1])
    assert (told["rank"], told["mobility"], told["regular"]) == (2, 3, False)
    assert np.isclose(told["q"]["crank0"], pi / 2)


def test_check_names_the_rows_a_redundant_row_depends_on(run):
    """Bricard: five rows of rank four, so that one row is a combination of the others; the factors are the columns'."""
    told = json.loads(run("check", "bricard", "--json")[1])
    assert (told["rows"], told["rank"], told["mobility"]) == (5, 4, 1)
    (redundant,) = told["redundant"]
    mech = pinconsist.load("bricard")
    names = [row for _, row in mech.row_labels]
    q = pinconsist.assemble(mech).q
    J = finite_differences(mech, q)
    combined = sum(term["factor"] * J[names.index(term["row"])] for term in redundant["depends_on"])
    np.testing.assert_allclose(J[names.index(redundant["row"])], combined, atol=1e-7)


def finite_differences(mech, q, step=1e-6):
    from pinconsist.mechanism.system import MechanismSystem

    system = MechanismSystem(mech, q)
    columns = [
        (system.loop_rows(q + step * e)[0] - system.loop_rows(q - step * e)[0]) / (2 * step) for e in np.eye(mech.nv)
    ]
    return np.array(columns).T


def test_check_says_what_it_read(run):
    """Forces, gravity, duration, how each loop holds, and the guess beside the closed values."""
    out = run("check", "flyball_governor")[1]
    assert "\nforces: damping\ngravity: 0 0 -9.81 m/s²; duration: 5 s\n" in out
    rows = [line.split() for line in out.splitlines()]
    assert "right_pin hinge 5 right_tip collar_sleeve axis 0 1 0".split() in rows
    assert "motor drive 1 shaft along a curve speed 16".split() in rows
    out = run("check", "four_bar", "--at", "coupler=0.5")[1]
    assert "\nforces: none\n" in out
    assert re.search(r"^coupler +0\.5 +0\.5$", out, re.M) and re.search(r"^crank +-1 +-0\.8", out, re.M)
    told = json.loads(run("check", "four_bar", "--at", "coupler=0.5", "--json")[1])
    assert told["guess"]["coupler"] == 0.5 and told["loops"][0]["axis"] == [0, 1, 0]
    assert (told["forces"], told["gravity"], told["duration"]) == ([], [0, 0, -9.81], 5)


@pytest.fixture
def bar(tmp_path):
    """A four-bar in files of its own, `bar.urdf` and `bar.yaml`; changed by a word and what stands instead."""

    def write(urdf=("", ""), loops=("", "")):
        for suffix, words in ((".urdf", urdf), (".yaml", loops)):
            text = (MODELS / f"four_bar{suffix}").read_text()
            assert words[0] in text
            (tmp_path / f"bar{suffix}").write_text(text.replace(*words) if words[0] else text)
        return tmp_path / "bar.urdf"

    return write


LIMITED = ('<joint name="rocker" type="continuous">', '<joint name="rocker" type="revolute">'
           '<limit lower="-1" upper="1" effort="1" velocity="1"/>')  # fmt: skip


def test_a_coordinate_outside_of_its_limits_is_told(run, bar):
    """The closed rocker stands at -1.413; by whole turns it may be elsewhere."""
    wrong = "rocker = -1.41339 is outside the limits of its file, -1 … 1: a wrong anchor or guess? "
    wrong += "--at rocker=0 starts within them"
    path = bar(LIMITED)
    without = f"{path}: without effect here: limits of 1 joint (watched, not enforced)"
    code, _, err = run("check", path)
    assert code == 0 and err == f"pinconsist: warning: {without}\npinconsist: warning: {wrong}\n"
    found = json.loads(run("check", path, "--json")[1])
    assert found["warnings"] == [wrong] and found["ignored"] == ["limits of 1 joint (watched, not enforced)"]
    assert run("simulate", path, "--until", 0)[2] == err
    path.write_text(path.read_text().replace('lower="-1" upper="1"', 'lower="4" upper="5"'))
    assert run("check", path)[2] == f"pinconsist: warning: {without}\n"


def test_a_loop_file_that_is_overlooked_is_told_with_the_option_that_names_it(run, bar):
    bar().with_suffix(".yaml").rename("closed.yaml")
    err = run("check", "bar.urdf")[2]
    assert "closed.yaml next to it describes loops" in err and 'pass it as --loops "closed.yaml"' in err


def test_loops_that_leave_no_motion_are_told(run, bar):
    """A hinge whose axis lies in the plane of the bars holds a turn that a planar hinge would leave."""
    turned = "axis: [1, 0, 0], rpy2: [0, 1.0876642702222767, 0]"
    code, _, err = run("check", bar(loops=("axis: [0, 1, 0]", turned)))
    assert code == 0
    assert "nothing can move: the loops lock all 3 velocities, and there are no drives" in err
    assert "without rows tilt1, tilt2, loop 'coupler_rocker' would leave 1 motion, as a planar hinge does" in err


@pytest.mark.skipif(not KANGAROO.is_dir(), reason="the robots are not here")
def test_check_of_a_leg_with_many_redundant_rows(run):
    code, out, _ = run("check", KANGAROO, "--reanchor")
    assert code == 0 and "rows: 66, 53 of them independent and 13 redundant\nmobility: 10\n" in out
    assert max(map(len, out.splitlines())) <= 80


def test_arguments_of_a_xacro_file(run):
    """NAME=VALUE or NAME:=VALUE as ROS has it; several after one --arg."""
    pytest.importorskip("xacro")
    text = pc.write(pc.load("four_bar"), "plain.urdf").read_text()
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"'
    inside = """<xacro:arg name="mass" default="1"/>
    <xacro:arg name="tip" default="tool"/><link name="$(arg tip)"><inertial>
    <mass value="${2 * $(arg mass)}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/></inertial></link>
    <joint name="spin" type="continuous"><parent link="ground"/><child link="$(arg tip)"/><axis xyz="0 1 0"/></joint>
    </robot>"""
    Path("bar.xacro").write_text(text.replace("<robot", head, 1).replace("</robot>", inside))
    Path("bar.yaml").write_text(Path("plain.yaml").read_text())

    def masses(*arguments):
        code, out, err = run("check", "bar.xacro", *arguments)
        assert code == 0, err
        return float(re.search(r"([\d.]+) kg in all", out)[1])

    plain = masses()
    assert masses("--arg", "mass=2.5") == pytest.approx(plain + 3.0, abs=2e-3)
    assert masses("--arg", "mass:=2.5", "tip=hook") == masses("--arg", "tip=hook", "--arg", "mass=2.5")
    for wrong, told in (("mass", "--arg needs NAME=VALUE"), ("=3", "--arg needs NAME=VALUE")):
        code, _, err = run("check", "bar.xacro", "--arg", wrong)
        assert code == 2 and told in err
    code, _, err = run("check", "four_bar", "--arg", "mass=1")
    assert code == 2 and "xacro" in err
