"""What a user reads after a mistake: the thing that was wrong by its name, and what to use instead."""

from functools import partial

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.view.plots import PICTURES, pictures_of


@pytest.fixture(scope="module")
def sol():
    return pc.simulate(pc.load("four_bar"), (0.0, 0.1))


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


@pytest.mark.parametrize("picture", PICTURES)
@pytest.mark.parametrize("wrong", [None, "run", 3.0, [1, 2]], ids=repr)
def test_figures_say_what_they_need(picture, wrong):
    pytest.importorskip("matplotlib")
    with pytest.raises(pc.InputError, match=f"needs a Solution.* got {type(wrong).__name__}"):
        pictures_of(wrong, [picture])


def test_a_figure_of_several_runs_is_plot(sol):
    pytest.importorskip("matplotlib")
    with pytest.raises(pc.InputError, match=r"got dict; pc.plot\(\{name: run, …\}, quantity\) draws several runs"):
        pictures_of({"a": sol}, ["trajectory"])


@pytest.mark.parametrize("wrong", [[3], ["text"], {"a": None}, [{"h": 0.1}]], ids=repr)
def test_a_comparison_needs_its_rows(wrong):
    pytest.importorskip("matplotlib")
    with pytest.raises(pc.InputError, match=r"needs rows of paper.compare.* has no (h|t)"):
        pc.paper.plot_comparison(wrong)


def test_a_frame_is_no_joint(sol):
    with pytest.raises(pc.InputError, match=r"no joint 'rocker_tip'.*is a frame.*sol.frame\('rocker_tip'\)"):
        sol.position("rocker_tip")
    assert sol.frame("rocker_tip").t is not None


def test_a_linearization_is_readable():
    text = str(pc.linearize(pc.load("four_bar")))
    assert text.splitlines()[0].endswith("for y of crank")
    assert [line.split()[0] for line in text.splitlines()[1:]] == ["mass", "damping", "stiffness"]
    assert "_about" not in text and "mechanism" not in text.lower()


def test_options_are_spelt_as_they_are_typed(run):
    code, _, err = run("simulate", "four_bar", "--rtoll", "1e-3")
    assert code == 2 and "--rtoll" in err and "--rtol)" in err and "----" not in err


@pytest.mark.parametrize(("name", "told"), [
    ("run.html", "a page is opened in a browser, and the run in it is kept by --out run.npz"),
    ("run.npz", "this is a saved run, not a scene"),
])  # fmt: skip
def test_files_of_another_kind_say_what_they_are(run, name, told):
    with open(name, "w") as file:
        file.write("x")
    code, _, err = run("check", name)
    assert code == 2 and told in " ".join(err.split()) and "Traceback" not in err


COMMANDS = {
    "check": ("check",), "simulate": ("simulate",), "sweep": ("sweep", "--vary", "mass:crank=1,2"),
    "sensitivity": ("sensitivity", "--of", "crank", "--to", "mass"), "replay": ("replay",), "plot": ("plot",),
}  # fmt: skip
FILES = {
    "missing.urdf": None, "folder.urdf": "folder", "empty.urdf": "", "text.urdf": "no XML", "other.urdf": "<a/>",
    "text.xml": "no XML", "text.sdf": "<sdf>", "text.npz": "no zip",
}  # fmt: skip


@pytest.mark.parametrize("file", FILES)
@pytest.mark.parametrize("command", COMMANDS)
def test_wrong_files_are_one_message_and_code_2(run, tmp_path, command, file):
    content = FILES[file]
    if content == "folder":
        (tmp_path / file).mkdir()
    elif content is not None:
        (tmp_path / file).write_text(content)
    first, *rest = COMMANDS[command]
    code, _, err = run(first, file, *rest)
    assert code == 2 and err.startswith("pinconsist: error:") and "Traceback" not in err
    assert file.split(".")[0] in err


@pytest.mark.parametrize("wrong", [
    ("--at", "nothing=1"), ("--with-velocity", "nothing=1"), ("--until", "soon"), ("--until", "nan"), ("--rtol", "-1"),
    ("--method", "Euler"), ("--at", "crank=x"), ("--order", "99"), ("--closure", "glue"), ("--force", "x"),
], ids=" ".join)  # fmt: skip
def test_wrong_options_are_one_message_and_code_2(run, wrong):
    code, _, err = run("simulate", "four_bar", *wrong)
    assert code == 2 and err.startswith("pinconsist: error:") and "Traceback" not in err


def test_lengths_say_whose_they_are(run):
    """The length of the crank is where the coupler sits on it; it has no other."""
    code, out, err = run("sensitivity", "four_bar", "--of", "coupler_tip", "--to", "length", "anchor", "--until", 0.1)
    assert code == 0, err
    text = " ".join(out.split())
    assert "(crank to" in text and "anchor:coupler_rocker.xyz1[0]" in text
    with pytest.raises(pc.InputError, match=r"'length:crank'.* is zero.*body that it carries are length:coupler"):
        pc.load("four_bar").with_parameters({"length:crank": 1.0})


def test_anchors_that_a_command_names_are_those_that_move(run):
    """The derivative by an anchor is that of assembled and simulated differences."""
    code, out, err = run("sensitivity", "four_bar", "--of", "crank", "--to", "anchor", "--until", 0.2, "--json")
    assert code == 0, err
    import json

    found, mech = json.loads(out), pc.load("four_bar")
    row = next(row for row in found["rows"] if row["parameter"] == "anchor:coupler_rocker.xyz1[0]")

    def crank(change):
        shifted = mech.with_parameters({"anchor:coupler_rocker.xyz1[0]": row["value"] + change})
        return pc.simulate(shifted, (0.0, 0.2), method="Radau", rtol=1e-11, atol=1e-13).position("crank")[-1]

    step = 1e-4
    assert np.ravel(row["derivatives"])[0] == pytest.approx((crank(step) - crank(-step)) / (2 * step), rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (("simulate", "four_bar", "page.html"), "a .html file is written by --html page.html"),
        (("simulate", "four_bar", "--csv", "a.csv", "--csv-force", "crank", "rocker"),
         "--csv-force may be repeated: --csv-force crank --csv-force rocker"),
        (("plot", "four_bar", "run.png"), "a .png file is written by --out run.png"),
        (("plot", "four_bar", "--of", "reaction coupler_rocker", "torque motor"),
         "--of may be repeated: --of 'reaction coupler_rocker' --of 'torque motor'"),
        (("check", "four_bar", "run.html"), "(run.html) (see"),
        (("simulate", "four_bar", "five_bar"), "(five_bar) (see"),
    ],
)  # fmt: skip
def test_one_argument_too_many_is_told_with_its_option(run, arguments, told):
    code, _, err = run(*arguments)
    assert code == 2 and told in err and "unexpected extra argument" in err


def test_a_file_that_lacks_its_suffix_is_named(run, tmp_path):
    (tmp_path / "arm.urdf").write_text("<robot/>")
    assert "neither a built-in model nor a file 'arm'; there is arm.urdf." in run("simulate", "arm")[2]


def test_velocities_that_drives_determine_are_told():
    mech = pc.load("four_bar").add_loops(pc.Drive("motor", "crank", pc.Motion(speed=1.0)))
    with pytest.raises(pc.AssemblyError, match="loops and drives determine all velocities; leave them out"):
        pc.assemble(mech, v0={"rocker": 5.0})


def test_user_defined_forces_on_bodies_are_missing_in_joints_and_that_is_told():
    """A pendulum held by its tip: of the same force by a wrench and by a function, only the joint knows the first."""
    mech = pc.load("planar_pendulum")
    held = {"q0": {"pendulum": 0.3}, "t_eval": [0.0, 0.1]}
    force = pc.Wrench("pendulum_tip", (5.0, 0.0, 2.0))
    exact = pc.simulate(mech, (0.0, 0.1), forces=[force], **held).joint_force("pendulum")
    bound = force.bind(mech.model)
    taken = pc.simulate(mech, (0.0, 0.1), forces=[lambda t, q, v: bound.torque(t, q, v)], **held)
    taken = taken.joint_force("pendulum")
    np.testing.assert_allclose(taken.force - exact.force, [[5.0, 0.0, 2.0]] * 2, atol=1e-6)
    (label,) = taken.taken_as_torques
    assert label.startswith("torque ") and exact.taken_as_torques == ()
    assert f"{label}: taken for torques in joints, not for forces on bodies" in str(taken)
    assert "taken" not in str(exact)


def test_degrees_at_the_start_are_told(run, recwarn):
    mech = pc.load("planar_pendulum")
    pc.simulate(mech, (0.0, 0.01), {"pendulum": 45})
    assert "pendulum = 45 is read in rad, 7.2 turns. For 45 degrees write numpy.radians(45)" in str(recwarn[-1].message)
    before = len(recwarn)
    for value in (31.4, np.radians(45), 7.0, -6, 4.0 * np.pi, 720.0):  # some of them after several turns
        pc.simulate(mech, (0.0, 0.01), {"pendulum": value})
    pc.simulate(pc.load("slider_crank"), (0.0, 0.01), {"crank": 0.5})
    assert len(recwarn) == before
    assert "--at pendulum=45deg" in run("simulate", "planar_pendulum", "--at", "pendulum=45", "--until", "0.01")[2]


def test_a_joint_that_is_held_is_a_motion():
    with pytest.raises(pc.InputError, match=r"to hold the joint there: pinconsist.Motion\(start=3.0\)"):
        pc.Drive("hold", "crank", 3.0)
