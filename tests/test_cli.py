"""The command line, as a stranger meets it: printed numbers, exit codes, messages, files."""

from __future__ import annotations

import csv
import json
import os
import pty
import re
import select
import shutil
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist
import pinconsist as pc
from pinconsist.cli import main
from pinconsist.cli.app import spread

MODELS = Path(__file__).resolve().parents[1] / "models"
PROGRAM = (sys.executable, "-m", "pinconsist.cli")


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command line in an empty folder → exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


def numbers_after(text, *labels):
    """The first number after each label, as a float."""
    return [float(text.split(label, 1)[1].split()[0]) for label in labels]


def test_alone_it_says_what_can_be_done(run):
    code, out, err = run()
    assert (code, err) == (0, "")
    for command in ("models", "check", "simulate", "replay", "compare"):
        assert f"pinconsist {command}" in out


def test_every_example_of_the_overview_is_a_command(run):
    _, out, _ = run()
    for line in out.splitlines():
        if line.startswith("  pinconsist "):
            assert run(line.split()[1], "--help")[0] == 0


def test_version(run):
    assert run("--version") == (0, f"pinconsist {pinconsist.__version__}\n", "")


def test_help_documents_the_exit_codes(run):
    code, out, _ = run("simulate", "--help")
    words = " ".join(out.split())
    assert code == 0
    assert "Exit codes: 0 success; 1 the integration failed" in words and "130 interrupted" in words
    assert "--json then has run.interrupted = true" in words


def test_help_is_a_command_too(run):
    assert run("help") == run("--help")
    assert run("help", "rerun") == run("rerun", "--help") and "1 the numbers differ" in run("help", "rerun")[1]


def test_models(run):
    code, out, _ = run("models")
    assert code == 0
    for name, description in pinconsist.models().items():
        assert f"{name} {description}" in " ".join(out.split())
    assert "\x1b" not in out


def test_models_json(run):
    assert json.loads(run("models", "--json")[1])["models"] == pinconsist.models()


def test_simulate_prints_scene_summary_and_certificate(run):
    code, out, err = run("simulate", "four_bar", "--until", 0.5)
    assert (code, err) == (0, "")
    assert out.startswith("four_bar: 3 joints, 1 loop of 5 rows (2 independent), mobility 1\n")
    assert "t = 0 … 0.5 s in" in out and "\x1b" not in out
    gap, first, energy = numbers_after(out, "loops closed to", "at the first step", "energy balance")
    assert gap < 1e-9 and first < 1e-3 and energy < 1e-3


def test_simulate_is_the_python_call(run):
    options = (
        "--at",
        "crank=0.3",
        "--with-velocity",
        "crank=2",
        "--step",
        0.01,
        "--order",
        2,
        "--method",
        "BDF",
        "--from",
        1,
    )
    code, out, _ = run("simulate", "four_bar", "--until", 1.1, *options, "--json")
    told = json.loads(out)
    sol = pinconsist.simulate(
        pinconsist.load("four_bar"), (1, 1.1), {"crank": 0.3}, {"crank": 2}, step=0.01, order=2, method="BDF"
    )
    assert code == 0 and told["run"]["success"] and told["run"]["steps"] == 10
    assert list(told["end"]["q"].values()) == sol.q[-1].tolist()
    assert list(told["end"]["v"].values()) == sol.v[-1].tolist()
    assert told["certificate"]["force"] == sol.check(error=False).force
    assert (told["scene"]["rows"], told["scene"]["rank"], told["scene"]["mobility"]) == (5, 2, 1)


def test_terminal_json_page_and_file_have_one_verdict(run, tmp_path):
    """A chaotic motion: without its error estimate it would look right on the page."""
    at, saved = ("--at", "upper=2.5", "--at", "lower=2.5"), tmp_path / "run.npz"
    pages = [tmp_path / name for name in ("run.html", "replay.html")]
    words = ("double_pendulum", "--until", 20, *at, "--out", saved, "--html", pages[0])
    told = json.loads(run("simulate", *words, "--json")[1])["certificate"]
    assert not told["ok"] and told["verdict"].endswith(": look at error") and told["error"]["tolerances"] > 100
    assert " ".join(run("simulate", *words)[1].split()).count(told["verdict"]) == 1
    assert pinconsist.Solution.load(saved).check().verdict == told["verdict"]
    run("replay", saved, "--html", pages[1])
    for page in pages:
        shown = json.dumps({"text": told["verdict"], "ok": False}, separators=(",", ":"))
        assert shown in page.read_text("utf-8"), page.name


def test_several_values_after_one_option(run):
    assert spread(["compare", "--step", "0.1", "1e-2", "four_bar"]) == [
        "compare", "--step", "0.1", "--step", "1e-2", "four_bar",
    ]  # fmt: skip
    assert spread(["compare", "x", "--step=.1", "2"]) == ["compare", "x", "--step", ".1", "--step", "2"]
    assert spread(["--at", "a=1", "b=-2", "--until", "3"]) == ["--at", "a=1", "--at", "b=-2", "--until", "3"]
    code, out, _ = run(
        "simulate", "five_bar", "--with-velocity", "left_crank=1", "right_crank=-1", "--until", 0, "--json"
    )
    velocity = json.loads(out)["end"]["v"]
    assert code == 0 and np.allclose([velocity["left_crank"], velocity["right_crank"]], [1, -1])


def test_joints_that_cannot_stay_are_told(run):
    code, _, err = run("simulate", "four_bar", "--at", "rocker=-1", "--until", 0)
    assert code == 0 and re.search(r"the loops do not close with rocker = -1; they do at rocker = \S{1,8}$", err)
    assert err.count("do not close") == 1
    code, _, err = run("simulate", "four_bar", "--at", "rocker=-1", "coupler=-3", "--until", 0)
    assert code == 0 and err.count("do not close") == 1  # nothing of where each alone would be
    code, out, err = run("check", "four_bar", "--at", "crank=-1", "coupler=0.67", "rocker=-1.41")
    assert code == 0 and "they do at crank = -0.997491, coupler = 0.671199, rocker = -1.41221\n" in err
    assert "equations of motion: regular" in out


@pytest.mark.parametrize("command", ["simulate", "check"])
def test_joints_that_contradict_each_other_are_refused(run, command):
    """Each position is possible by itself; the rocker's for the crank's is that of `check --at crank=0.3`."""
    code, out, err = run(command, "four_bar", "--at", "crank=0.3", "rocker=2")
    rocker = json.loads(run("check", "four_bar", "--at", "crank=0.3", "--json")[1])["q"]["rocker"]
    assert code == 2 and not out
    assert "the loops do not allow the positions given for crank, rocker together: with crank = 0.3 they close " in err
    assert f"close at rocker = {rocker:.6g}. Give fewer joints with --at" in err


def test_simulate_writes_its_files(run):
    code, out, _ = run(
        "simulate", "four_bar", "--until", 0.2, "--out", "run", "--html", "run.html", "--plot", "run.png"
    )  # fmt: skip
    assert code == 0 and out.endswith("written: run.npz, run.html, run.png\n")
    assert pinconsist.Solution.load("run.npz").t[-1] == 0.2
    assert Path("run.html").read_text().startswith("<!DOCTYPE html>")
    assert Path("run.png").read_bytes().startswith(b"\x89PNG")


def test_a_failed_integration_is_saved_and_exits_with_1(run):
    code, out, _ = run("simulate", "four_bar", "--max-steps", 8, "--out", "run.npz")
    assert code == 1 and "--max-steps 8 used up" in out
    assert 0 < pinconsist.Solution.load("run.npz").t[-1] < 5


def test_json_is_all_there_is_on_stdout(run):
    code, out, _ = run("simulate", "double_pendulum", "--until", 0.1, "--json")
    assert code == 0 and out.count("\n") == 1
    assert json.loads(out)["scene"]["loops"] == []


@pytest.mark.parametrize(
    "arguments, message",
    [
        (["simulate", "four_barr"], "four_bar"),
        (["simulate", "nowhere.urdf"], "no such file"),
        (["simulate", "four_bar", "--at", "crnk=1"], "no joint 'crnk'; the joints are crank, coupler, rocker"),
        (["simulate", "four_bar", "--at", "crank"], "--at needs joint=value, got 'crank'"),
        (["simulate", "four_bar", "--at", "crank=x"], "'x' is not a number"),
        (
            ["simulate", "four_bar", "--with-velocity", "crank=1,rocker=3"],
            "not a number; separate joints by spaces",
        ),
        (["simulate", "four_bar", "--at", "crank=1", "crank=2"], "names joint 'crank' twice"),
        (["simulate", "four_bar", "--at", "crank=nan"], "not finite"),
        (["simulate", "four_bar", "--until", "soon"], "--until"),
        (["simulate", "four_bar", "--until", "nan"], "not finite"),
        (["simulate", "four_bar", "--step", "0.1", "0.2"], "0.2"),
        (["simulate", "four_bar", "--step", "-1"], "step must be a positive number"),
        (["simulate", "four_bar", "--method", "BDF", "--order", "9"], "1 to 5"),
        (["simulate", "four_bar", "--method", "Euler"], "unknown method 'Euler'"),
        (["simulate", "four_bar", "--consistency", "never"], "unknown consistency 'never'"),
        (["simulate", "four_bar", "--closure", "weld"], "--closure weld is not one of"),
        (["simulate", "four_bar", "--loops", "nowhere.yaml"], "nowhere.yaml: no such file"),
        (["simulate", "four_bar", "--out", "nowhere/run.npz"], "nowhere/run.npz cannot be written: there is no folder"),
        (["simulate", "four_bar", "--html", "."], "it is a folder"),
        (["simulate", "four_bar", "--out", "run.txt"], "a run is saved as .npz"),
        (["simulate", "four_bar", "--plot", "run.doc"], "must end in one of"),
        (["simulate", "four_bar", "--out", "a.npz", "--html", "a.npz"], "the same file"),
        (["simulate"], "SCENE"),
        (["simulate", "four_bar", "--fast"], "--fast"),
        (["invent"], "invent"),
        (["compare", "problem53"], "problem53"),
        (["compare", "problem51", "--step", "0"], "positive"),
        (["compare", "problem51", "--step", "0.1", "x"], "(x)"),
        (["compare", "problem51", "--at", "x=1"], "its own loops and initial values"),
        (["compare", "double_pendulum"], "no loops"),
        (["check", "four_bar", "--at", "nobody=1"], "no joint 'nobody'"),
        (["replay", "nowhere.npz"], "nowhere.npz: no such file"),
        (["replay", "four_bar", "--scene", "five_bar"], "--scene"),
        (["replay", "four_bar", "--trace", "couple"], "no frame 'couple' to trace; similar: coupler"),
        (["replay", "four_bar", "--trace", "tip"], "to trace; available: coupler, coupler_bar, coupler_tip"),
        (["replay", "four_bar", "--speed", "0"], "--speed 0.0"),
        (["simulate", "four_bar", "--forces"], "add --html"),
        (["replay", "four_bar", "--html", "nowhere/x.html"], "there is no folder"),
    ],
)
def test_mistakes_get_one_message_and_exit_code_2(run, arguments, message):
    code, _, err = run(*arguments)
    assert code == 2
    assert err.startswith("pinconsist: error: ") and message in err
    assert "Traceback" not in err


def test_errors_are_json_too(run):
    code, out, err = run("simulate", "four_barr", "--json")
    assert code == 2 and json.loads(out)["error"] in err


def test_files_are_checked_before_the_scene_is_loaded(run):
    assert "nowhere/run.npz" in run("simulate", "no_scene", "--out", "nowhere/run.npz")[2]


def test_a_bug_keeps_its_traceback(run, monkeypatch):
    def broken(*_, **__):
        raise ZeroDivisionError

    monkeypatch.setattr("pinconsist.models", broken)
    with pytest.raises(ZeroDivisionError):
        main(["models"])


def table_rows(text, title):
    """Rows of numbers below a title, without the table's heads."""
    lines = text.split(title, 1)[1].split("\n\n")[0].splitlines()
    return [line.split() for line in lines if line.strip()[:1].isdigit()]


def test_compare_prints_the_tables_of_the_paper(run):
    code, out, _ = run("compare", "problem51", "--step", "0.01", "0.001")
    assert code == 0
    first = table_rows(out, "step size h = 0.01 s: error of the force in circle, N\n")
    assert len(first) == 6
    assert first[0][:4] == ["1", "0.01", "2.0808e+00", "8.1200e-02"]
    assert table_rows(out, "step size h = 0.001 s: error of the force in circle, N\n")[0][2:4] == [
        "2.0080e+00",
        "8.0120e-03",
    ]
    assert " 1.7041e-02" in out and " 1.0462e-02" in out  # changes of the initial velocity for h = 0.01


def test_compare_as_json_and_figure(run):
    code, out, _ = run("compare", "four_bar", "--step", 0.02, "--order", 2, "--rows", 3, "--plot", "c.png", "--json")
    told = json.loads(out)
    errors = told["runs"][0]
    assert code == 0 and (told["order"], errors["h"], len(errors["t"])) == (2, 0.02, 5)
    assert errors["consistent"][2] < errors["exact"][2]
    assert Path("c.png").read_bytes().startswith(b"\x89PNG")


def test_compare_names_the_joints_and_where_a_higher_order_starts(run):
    code, out, _ = run("compare", "four_bar", "--step", 0.02, "--order", 2, "--rows", 1)
    assert code == 0 and "rows 0 to 1 are its exact start" in out
    assert re.search(r"^crank .*\ncoupler .*\nrocker ", out, re.M)
    assert "at rest" in out and "--with-velocity" in out


def test_check(run):
    code, out, _ = run("check", "five_bar", "--at", "left_crank=-2")
    assert code == 0
    assert "4 moving bodies, 1.2 kg in all, nq = 4, nv = 4" in out
    assert "motors: left_crank, right_crank" in out
    assert "rows: 5, 2 of them independent and 3 redundant\nmobility: 2\n" in out
    assert "redundant: (tip y, tilt1, tilt2) = 0 for every motion" in out
    assert "equations of motion: regular" in out
    assert numbers_after(out, "largest gap at the guess:")[0] > 1e-2
    assert numbers_after(out, "largest gap when closed:")[0] < 1e-10
    assert any(line.split() == ["left_crank", "-2", "-2"] for line in out.splitlines())


def test_check_json(run):
    told = json.loads(run("check", "five_bar", "--closure", "point", "--json")[1])
    assert (told["rows"], told["rank"], told["mobility"], told["regular"], told["closed"]) == (3, 2, 2, True, True)
    assert told["redundant"] == [{"loop": "tip", "row": "y", "depends_on": []}]
    assert told["gaps"]["tip"] < 1e-10 and set(told["q"]) == set(pinconsist.load("five_bar").joints)


@pytest.fixture
def torn(tmp_path):
    """A four-bar that gapes by 0.5 m across its plane, whatever it does; in a folder of its own."""
    folder = tmp_path / "torn"
    folder.mkdir()
    shutil.copy(MODELS / "four_bar.urdf", folder / "bars.urdf")
    hinge = "{name: coupler_rocker, kind: hinge, frame1: coupler_tip, frame2: rocker_tip, axis: [0, 1, 0]"
    (folder / "bars.yaml").write_text(
        f"loops:\n  - {hinge}, xyz2: [0, 0.5, 0]}}\nguess: {{crank: -1, coupler: 0.7, rocker: -1.4}}\n"
    )
    return folder / "bars.urdf"


@pytest.mark.parametrize("command", ["check", "simulate"])
def test_loops_that_cannot_close(run, torn, command):
    code, out, err = run(command, torn)
    assert code == 2 and "bars: loop 'coupler_rocker' cannot close: a gap of 0.5 m remains in row y. Check" in err
    assert "Traceback" not in err and "all others" not in err
    assert "on the command line: --at JOINT=VALUE, --closure point, --reanchor" in err
    if command == "check":
        row = next(line.split() for line in out.split("remaining gap")[1].splitlines() if "coupler_rocker" in line)
        assert float(row[-1]) == pytest.approx(0.5)


def test_loops_that_cannot_close_as_json(run, torn):
    code, out, _ = run("check", torn, "--json")
    told = json.loads(out)
    assert code == 2 and not told["closed"] and told["gaps"]["coupler_rocker"] == pytest.approx(0.5)


def test_reanchoring_closes_them_and_says_so(run, torn):
    code, out, err = run("simulate", torn, "--reanchor", "--until", 0.1)
    assert code == 0 and err.startswith("pinconsist: warning: bars: anchor 2") and "'coupler_rocker'" in err
    assert err.count("\n") == 1
    assert numbers_after(out, "loops closed to")[0] < 1e-9


def test_massless_joints_are_told_by_check(run, torn):
    text = torn.read_text()
    torn.write_text(re.sub("<inertial>.*?</inertial>", "", text, flags=re.DOTALL))
    torn.with_suffix(".yaml").unlink()
    code, out, err = run("check", torn)
    assert code == 2 and "equations of motion: singular" in out and "without any inertia" in err


def test_replay_of_a_saved_run(run):
    run("simulate", "four_bar", "--until", 0.2, "--out", "run.npz")
    code, out, _ = run("replay", "run.npz", "--html", "play.html")
    assert code == 0 and out.startswith("four_bar: t = 0 … 0.2 s") and out.endswith("written: play.html\n")
    assert Path("play.html").stat().st_size > 100_000


def test_replay_finds_the_scene_of_a_run_again(run, torn, monkeypatch):
    run("simulate", torn, "--reanchor", "--until", 0.1, "--out", "torn/run.npz")
    torn.parent.rename("moved")
    assert run("replay", "moved/run.npz", "--html", "play.html")[0] == 0
    Path("moved/run.npz").rename("run.npz")
    code, _, err = run("replay", "run.npz", "--html", "play.html")
    assert code == 2 and "give its location with --scene" in err
    assert run("replay", "run.npz", "--scene", "moved/bars.urdf", "--html", "play.html")[0] == 0
    assert "run.npz has 3 position numbers" in run("replay", "run.npz", "--scene", "five_bar")[2]


def test_a_page_shows_forces_and_paths_that_are_asked_for(run):
    look = ("--forces", "--trace", "coupler_tip", "--trace", "crank", "--speed", 0.5)
    assert run("simulate", "four_bar", "--until", 0.2, "--out", "run.npz", "--html", "page.html", *look)[0] == 0
    assert run("replay", "run.npz", "--html", "again.html", *look)[0] == 0
    pages = [Path(name).read_text(encoding="utf-8") for name in ("page.html", "again.html")]
    for text in pages:
        assert "path of coupler_tip" in text and "path of crank" in text and "force on the rocker" in text
        assert '"clock":[0.0,0.5,0.4,21]' in text
    assert pages[0] == pages[1]


def test_replay_of_a_scene_simulates_it(run):
    code, out, _ = run("replay", "planar_pendulum", "--html", "play.html", "--speed", 2)
    assert code == 0 and "t = 0 … 5 s" in out


def test_replay_opens_the_browser(run, monkeypatch):
    shown = []
    monkeypatch.setattr("webbrowser.get", lambda: None)
    monkeypatch.setattr("pinconsist.replay", lambda mech, sol, **options: shown.append(options))
    code, out, _ = run("replay", "planar_pendulum", "--once", "--forces", "--trace", "pendulum_tip")
    assert code == 0 and "open in your browser" in out
    assert shown == [{"speed": 1.0, "traces": ["pendulum_tip"], "forces": True, "loop": False, "open_browser": True}]


def test_commands_run_for_the_duration_of_the_scene(run):
    assert json.loads(run("simulate", "andrews", "--json")[1])["run"]["t"] == [0.0, 0.03]
    assert json.loads(run("simulate", "andrews", "--from", 1, "--json")[1])["run"]["t"] == [1.0, 1.03]
    assert json.loads(run("plot", "andrews", "--json")[1])["t"] == [0.0, 0.03]
    assert "t = 0 … 0.03 s" in run("replay", "andrews", "--html", "page.html")[1]
    assert '"clock":[0.0,0.01,3.0,151]' in Path("page.html").read_text()  # slowed, to last three seconds


def test_replay_without_a_browser_serves_the_page_until_interrupted(run, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    monkeypatch.setattr("time.sleep", interrupt)
    monkeypatch.setattr("pinconsist.replay", lambda *_, **options: f"address {options['open_browser']}")
    code, out, _ = run("replay", "planar_pendulum", "--no-browser")
    assert code == 0 and "served at address False until Ctrl-C" in out


def test_a_pipe_gets_plain_text_and_the_program_its_exit_code():
    done = subprocess.run([*PROGRAM, "check", "four_bar"], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "") and "\x1b" not in done.stdout


def test_an_ascii_terminal_still_gets_its_numbers():
    encoding = os.environ | {"PYTHONIOENCODING": "ascii"}
    arguments = ("simulate", "four_bar", "--until", "0.1")
    done = subprocess.run([*PROGRAM, *arguments], capture_output=True, text=True, env=encoding)
    assert done.returncode == 0 and "t = 0 ? 0.1 s" in done.stdout


def on_a_terminal(arguments, columns=80, interrupt_after=None):
    """Exit code and everything a terminal would have shown; Ctrl-C is typed once some text has been seen."""
    pid, terminal = pty.fork()
    if pid == 0:
        os.environ.update(COLUMNS=str(columns), TERM="xterm")
        os.execv(PROGRAM[0], [*PROGRAM, *arguments])
    seen, deadline = b"", time.monotonic() + 60
    while time.monotonic() < deadline:
        if select.select([terminal], [], [], 0.1)[0]:
            try:
                seen += os.read(terminal, 65536)
            except OSError:  # how Linux says that the other end is closed
                break
        if interrupt_after and interrupt_after in seen:
            os.write(terminal, b"\x03")
            interrupt_after = None
    os.close(terminal)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), seen.decode()


def test_a_narrow_terminal_loses_no_digits():
    code, shown = on_a_terminal(["compare", "problem51", "--step", "0.01", "--rows", "1"], columns=30)
    assert code == 0 and "2.0808e+00" in shown and "8.1200e-02" in shown and "v1" in shown


def test_a_comparison_says_at_which_run_it_is():
    code, shown = on_a_terminal(["compare", "problem51", "--step", "0.01", "0.001"])
    assert code == 0 and "step size 0.01 s, 1 of 2" in shown and "step size 0.001 s, 2 of 2" in shown


def test_checking_and_writing_are_told_on_a_terminal(tmp_path):
    file = tmp_path / "run.png"
    code, shown = on_a_terminal(["simulate", "four_bar", "--until", "0.1", "--plot", str(file)], columns=200)
    assert code == 0 and "checking (Ctrl-C skips) …" in shown and f"writing {file} …" in shown
    assert f"writing {file}" not in shown.split("loops closed to")[1]


@pytest.fixture
def cut_short(monkeypatch):
    """Let Ctrl-C come when a run has passed half a second."""

    def interrupted(mech, span, *start, **options):
        def stop(t, q, v, lam):
            if t > 0.5:
                raise KeyboardInterrupt

        return simulate(mech, span, *start, **options | {"callback": stop}, method="BDF")

    simulate = pinconsist.simulate
    monkeypatch.setattr("pinconsist.run.checkpoints.simulate", interrupted)
    monkeypatch.setattr("pinconsist.run.checkpoints.integrate", partial(interrupted_integrate, pinconsist.integrate))


def interrupted_integrate(integrate, mech, span, q, v, **options):
    def stop(t, q, v, lam):
        raise KeyboardInterrupt

    return integrate(mech, span, q, v, **options | {"callback": stop}, method="BDF")


def test_an_interrupted_run_says_what_resume_will_do(run, cut_short):
    code, out, _ = run("simulate", "four_bar", "--until", 2, "--out", "run.npz")
    assert code == 130 and "interrupted at t = 0.5" in out
    assert out.endswith(
        "pinconsist resume run.npz starts again at t = 0 s: without --save-every there are no checkpoints\n"
    )
    code, out, _ = run("resume", "run.npz")
    assert code == 130 and out.startswith("run.npz has no checkpoint (simulate --save-every), so it starts again\n")
    assert "\nstarted again from t = 0 s\n" in out and "starts again at t = 0 s" in out
    code, out, _ = run("simulate", "four_bar", "--until", 2, "--out", "run.npz", "--save-every", 0.25)
    assert code == 130 and out.endswith("pinconsist resume run.npz continues it from t = 0.25 s, its last checkpoint\n")
    told = json.loads(run("resume", "run.npz", "--json")[1])
    assert (told["success"], told["interrupted"], told["from"]) == (True, True, 0.25)


def test_a_check_that_is_interrupted_leaves_all_files(run, monkeypatch):
    def interrupted(sol, **options):
        raise KeyboardInterrupt

    monkeypatch.setattr("pinconsist.Solution.check", interrupted)
    arguments = ("simulate", "four_bar", "--until", 0.1, "--out", "run.npz", "--plot", "run.svg")
    code, out, _ = run(*arguments)
    assert code == 130 and "\nnot checked: interrupted\n" in out and out.endswith("\nwritten: run.npz, run.svg\n")
    assert Path("run.svg").stat().st_size and pinconsist.Solution.load("run.npz").t[-1] == 0.1
    assert json.loads(run(*arguments, "--json")[1])["certificate"] is None


def test_ctrl_c_while_files_are_written_waits_for_them(run, monkeypatch):
    def drawn(*arguments, **options):
        os.kill(os.getpid(), signal.SIGINT)
        return draw(*arguments, **options)

    draw = pinconsist.Solution.plot
    monkeypatch.setattr(pinconsist.Solution, "plot", drawn)
    code, out, err = run("simulate", "four_bar", "--until", 0.1, "--plot", "run.svg")
    assert code == 130 and out.endswith("\nwritten: run.svg\n") and "pinconsist: interrupted" in err
    assert Path("run.svg").stat().st_size


@pytest.mark.slow
def test_a_long_run_shows_progress_and_keeps_what_was_reached_when_interrupted(tmp_path):
    file = tmp_path / "run.npz"
    arguments = ["simulate", "four_bar", "--until", "100000", "--out", str(file)]
    code, shown = on_a_terminal(arguments, interrupt_after=b"of 100000 s")
    assert (
        code == 130
        and re.search(r" 0 % .* left, t = \S+ of 100000 s, \d+ steps", shown)
        and f"written: {file}" in shown
    )
    sol = pinconsist.Solution.load(file)
    assert sol.status == 1 and 0 < sol.t[-1] < 100000


def test_rows_of_a_table_at_even_times_with_forces(run, tmp_path):
    """As accurate as the run, though the steps of Radau are long."""
    name = "crank_rocker"
    options = ("--method", "Radau", "--with-velocity", "crank=9", "--until", "0.5", "--csv", tmp_path / "run.csv")
    code, _, err = run(
        "simulate", name, *options, "--every", "0.01", "--csv-force", "rocker_ground", "--csv-force", "crank"
    )
    assert code == 0, err
    with open(tmp_path / "run.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    t = np.array([float(row["t [s]"]) for row in rows])
    np.testing.assert_allclose(t, np.arange(51) * 0.01, atol=1e-12)
    tight = pc.simulate(pc.load(name), (0, 0.5), v0={"crank": 9.0}, rtol=1e-9, atol=1e-11, t_eval=t)
    for column, exact in {
        "q.rocker [rad]": tight.position("rocker"),
        "force.rocker_ground.x [N]": tight.reaction("rocker_ground").force[:, 0],
        "force.crank.z [N]": tight.joint_force("crank").force[:, 2],
    }.items():  # fmt: skip
        values = np.array([float(row[column]) for row in rows])
        np.testing.assert_allclose(values, exact, atol=1e-4 * np.abs(exact).max(), err_msg=column)
    for wrong, words in (
        (("--every", "0.1"), "add --csv"), (("--csv", "a.csv", "--every", "0"), "above 0"),
        (("--csv", "a.csv", "--csv-force", "pin"), "no force 'pin'"),
    ):  # fmt: skip
        code, _, err = run("simulate", name, *wrong)
        assert code == 2 and words in err


def test_a_plot_of_quantities(run, tmp_path):
    file = tmp_path / "a.svg"
    code, _, err = run("plot", "crank_rocker", "--until", "0.2", "--of", "reaction rocker_ground", "--of", "v rocker",
                         "--out", file)  # fmt: skip
    assert code == 0 and file.is_file(), err
    code, _, err = run("plot", "crank_rocker", "--until", "0.2", "--of", "reaction pin", "--out", file)
    assert code == 2 and "no loop or joint 'pin'" in err
