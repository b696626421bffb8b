"""What a terminal of few columns shows: a verdict first, tables that fit, whole words, and colour."""

from __future__ import annotations

import os
import pty
import re
import subprocess
import sys
from functools import partial

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.cli import output

PROGRAM = (sys.executable, "-m", "pinconsist.cli")


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command line in an empty folder → exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


def shown_on_a_terminal(*arguments, columns=80, **environment):
    """What a terminal of so many columns gets."""
    pid, terminal = pty.fork()
    if pid == 0:
        for name in ("NO_COLOR", "FORCE_COLOR"):
            os.environ.pop(name, None)
        os.environ.update(COLUMNS=str(columns), TERM="xterm", **environment)
        os.execv(PROGRAM[0], [*PROGRAM, *arguments])
    seen = b""
    while True:
        try:
            part = os.read(terminal, 65536)
        except OSError:  # how Linux says that the other end is closed
            break
        if not part:
            break
        seen += part
    os.close(terminal)
    os.waitpid(pid, 0)
    return seen.decode()


def plain(text):
    """The lines that stay, without colours."""
    text = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", text)
    return [line.rsplit("\r", 1)[-1] for line in text.replace("\r\n", "\n").split("\n")]


def test_a_run_begins_with_how_it_ended_and_its_verdict(run):
    out = run("simulate", "four_bar", "--until", 0.2)[1]
    _, empty, ended, verdict, *details = out.splitlines()
    assert empty == "" and re.fullmatch(
        r"four_bar: t = 0 … 0.2 s, \d+ rows; the end of the interval was reached", ended
    )
    assert re.fullmatch(r"closed to \S+ m, forces good to \S+, error of q about \S+ rad: ok", verdict)
    figures = [
        line for line in details[1 : details.index("", 1)] if line[:40].strip()
    ]  # others go on with the one above
    assert len(figures) > 7 and all(" ok " in f"{line} " for line in figures) and "\x1b" not in out


def test_what_is_doubtful_is_in_the_verdict():
    arguments = ["simulate", "four_bar", "--until", "0.5", "--step", "0.1", "--method", "ImplicitEuler"]
    done = subprocess.run([*PROGRAM, *arguments], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    (doubts,) = re.findall(r"^closed to [^:]*: look\s+at\s+([^:]*?)\n\n", done.stdout, re.M)
    assert "forces" in re.split(r",\s", doubts)
    assert re.search(r"^constraint forces .* look ", done.stdout, re.M) and "\nnote: the constraint" in done.stdout


def test_warnings_come_before_results(tmp_path):
    """Of a joint that starts outside of its limits."""
    file = tmp_path / "rotor.urdf"
    limit = '<limit lower="0.5" upper="1" effort="1" velocity="1"/>'
    mass = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    file.write_text(
        f'<robot name="rotor"><link name="base"/><link name="arm">{mass}</link><joint name="turn" type="revolute">'
        f'<parent link="base"/><child link="arm"/><axis xyz="0 1 0"/>{limit}</joint></robot>'
    )
    shown = plain(shown_on_a_terminal("check", str(file)))
    told, separator, results = "\n".join(shown).partition("rotor: 1 moving body")
    assert "pinconsist: warning: turn = 0 is outside" in told and "anchor or guess?" in told
    assert "without effect here: limits of 1 joint" in " ".join(told.split())
    assert separator and "warning" not in results and all(len(line) <= 80 or str(file) in line for line in shown)


@pytest.mark.parametrize("environment", [{}, {"NO_COLOR": "1"}])
def test_the_verdict_is_coloured_where_there_is_colour(environment):
    shown = shown_on_a_terminal("simulate", "four_bar", "--until", "0.2", **environment)
    coloured = re.search(r"\x1b\[32mclosed to [^\x1b]*: ok\x1b\[0m", shown)
    assert bool(coloured) is not bool(environment) and "closed to" in shown


SWEEP = ("sweep", "crank_rocker", "--vary", "crank_speed=5,6", "--vary", "rtol=1e-6,1e-7", "--until", "0.05")


@pytest.mark.parametrize("columns", [50, 80, 120])
def test_tables_fit_and_no_number_is_broken(run, columns):
    shown = plain(shown_on_a_terminal(*SWEEP, columns=columns))
    table = shown[next(k for k, line in enumerate(shown) if line.startswith("case")) :]
    assert max(map(len, table)) <= columns
    parts = [block.split("\n") for block in "\n".join(table).split("\n\n")[:-1]]
    assert all(len({len(line.split()) for k, line in enumerate(part) if k != 1}) == 1 for part in parts)
    told = {}
    for heads, _, *rows in parts:
        told |= dict(zip(heads.split(), np.array([row.split() for row in rows], float).T, strict=True))
    mech = pc.load("crank_rocker")
    sol = pc.simulate(mech, (0.0, 0.05), v0={"crank": 5.0})
    assert told["q.rocker"][0] == pytest.approx(sol.q[-1, 2], rel=1e-5) and told["steps"][0] == sol.nsteps
    assert told["gap"].tolist() == [0.0] * 4  # rounding
    assert "status" not in told  # all are done


def test_texts_of_tables_go_on_in_lines_of_whole_words(capsys):
    names, text = ["a-name-that-has-no-space", "b"], "some words that do not fit " * 6
    output.table(("name", "count>", "what it is"), [(name, 12345, text) for name in names])
    out = capsys.readouterr().out
    assert max(map(len, out.splitlines())) <= 80 and out.split().count("words") == 12
    assert names[0] in out and out.count("12345") == 2


def test_rounding_is_zero_in_tables(run):
    out = run("sensitivity", "four_bar", "--of", "crank", "--to", "gravity.y", "--until", 0.1)[1]
    assert out.splitlines()[-2].split()[-1] == "0"  # across the plane
    assert "e-1" not in run("check", "stewart_platform")[1]


def test_a_film_shows_how_far_it_is(tmp_path):
    pytest.importorskip("PIL")
    shown = shown_on_a_terminal("render", "four_bar", str(tmp_path / "run.gif"), "--until", "0.3", "--speed", "1")
    assert re.search(r"100 % ━+ \S+ left, 7 of 7 frames", re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", shown))


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        (["--method", "BDF", "--order", 7], "--order must be a whole number from 1 to 5, got 7"),
        (["--order", 7], "--order must be one of 1, 3, 5, 9, 13 with Radau"),
        (["--rtol", 2], "--rtol 2.0 allows errors as large as the solution"),
        (["--max-step", -1], "--max-step must be a positive number"),
        (["--consistency", "initial"], "--consistency initial is for a fixed step (give --step)"),
    ],
)
def test_errors_are_in_terms_of_the_command_line(run, arguments, told):
    code, _, err = run("simulate", "four_bar", *arguments)
    assert code == 2 and told in err


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("take load(…, precision=1e-6), or", "take --precision 1e-6, or"),
        ("tighten rtol, or give package_dirs=", "tighten --rtol, or give --package-dir"),
        ("ignore=['plugin Detach'] loads the file", "--ignore 'plugin Detach' loads the file"),
        ("ignore=['drake:ball_constraint'] loads", "--ignore drake:ball_constraint loads"),
        ("the first step, a method of order 3", "the first step, a method of order 3"),
        ("step = 1e-300 s is too small", "--step 1e-300 s is too small"),
    ],
)
def test_arguments_become_options(text, shown):
    assert output.in_options(text) == shown


def test_compare_refuses_an_order_that_there_is_not(run):
    code, _, err = run("compare", "four_bar", "--order", 7)
    assert code == 2 and "'--order'" in err and "6" in err


def test_the_shell_completes_commands_options_and_scenes():
    def completed(words):
        about = {"COMP_WORDS": words, "COMP_CWORD": str(len(words.split()) - 1)}
        environment = os.environ | about | {"_PINCONSIST_COMPLETE": "complete_bash"}
        command = [sys.executable, "-c", "from pinconsist.cli import main; main()"]
        return subprocess.run(command, capture_output=True, text=True, env=environment).stdout.split()

    assert completed("pinconsist sim") == ["simulate"]
    assert completed("pinconsist simulate four_bar --consis") == ["--consistency"]
