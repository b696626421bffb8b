"""`pinconsist sweep`: what can be varied, the table, and a sweep that is killed and goes on."""

from __future__ import annotations

import csv
import errno
import fcntl
import itertools
import json
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import partial
from math import pi
from pathlib import Path

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.cli import main
from pinconsist.cli.sweep import cases_of
from pinconsist.run.sweep_table import Run

SWEEP = ("crank_rocker", "--vary", "crank_speed=5:8:0.1", "--until", "0.3")
GEARED = """
loops:
  - {name: gear, kind: coupling, joint: crank, other: rocker, ratio: 2.0}
  - {name: motor, kind: drive, joint: coupler, speed: 3.0, start: 0.5}
forces:
  - {kind: damping, coefficients: {crank: 0.1, rocker: 0.2}}
  - {kind: spring, joint: crank, stiffness: 20.0}
  - {kind: torque, torques: {rocker: {amplitude: 1.0}}}
  - {kind: spring-damper, frame1: rocker_tip, stiffness: 5.0, length: 0.1, xyz2: [0, 0, 1]}
"""


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Run the command in an empty folder → exit code, stdout, stderr."""
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys, "sweep")


def table(file):
    with open(file, newline="") as stream:
        return list(csv.DictReader(stream))


def test_the_table_has_the_numbers_of_simulate_to_the_last_bit(run):
    code, out, err = run("crank_rocker", "--vary", "crank_speed=5:6:0.5", "--vary", "crank=0.1,pi/4", "--until", 0.2,
                         "--out", "table.csv")  # fmt: skip
    assert (code, err) == (0, "") and out == "6 cases: 6 done\nwritten: table.csv\n"
    assert [each.name for each in Path().iterdir()] == ["table.csv"]
    rows, mech = table("table.csv"), pc.load("crank_rocker")
    for k, (speed, crank) in enumerate(itertools.product((5.0, 5.5, 6.0), (0.1, pi / 4))):
        row, sol = rows[k], pc.simulate(mech, (0.0, 0.2), {"crank": crank}, {"crank": speed})
        certificate = sol.check(error=False)
        assert (row["case"], float(row["crank_speed"]), float(row["crank"])) == (str(k), speed, crank)
        assert (row["status"], float(row["t"]), int(row["steps"]), row["message"]) == ("done", 0.2, sol.nsteps, "")
        assert float(row["gap"]) == certificate.position and float(row["energy_error"]) == certificate.energy_error
        assert [float(row[f"q.{joint}"]) for joint in mech.joints] == sol.q[-1].tolist()
        assert [float(row[f"v.{joint}"]) for joint in mech.joints] == sol.v[-1].tolist()


def test_a_row_costs_no_certificate(run, monkeypatch):
    """The forces and what they are compared with, which no row tells, would take ten times as long as the run."""
    for name in ("certify.measured", "certify.certify"):
        monkeypatch.setattr(f"pinconsist.run.{name}", lambda *_: 1 / 0)
    monkeypatch.setattr(pc.Solution, "check", lambda *_: 1 / 0)
    code, out, _ = run("crank_rocker", "--vary", "crank_speed=5:6:0.5", "--until", 0.2, "--out", "table.csv")
    assert code == 0 and out.startswith("3 cases: 3 done\n")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The table of a sweep that nobody stopped, in one process."""
    file = tmp_path_factory.mktemp("whole") / "table.csv"
    with pytest.raises(SystemExit) as end:
        main(["sweep", *SWEEP, "--out", str(file)])
    assert end.value.code == 0
    return file.read_bytes()


@pytest.mark.parametrize(("workers", "number"), [(2, signal.SIGKILL), (1, signal.SIGINT)])
def test_a_stopped_sweep_goes_on_to_the_same_table_byte_for_byte(run, whole, workers, number):
    command = [sys.executable, "-m", "pinconsist.cli", "sweep", *SWEEP, "--workers", str(workers), "--out", "t.csv"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        journal, until = Path("t.csv.partial"), time.monotonic() + 60
        while not (journal.exists() and journal.read_bytes().count(b"\n") > 4) and time.monotonic() < until:
            time.sleep(0.005)
        process.send_signal(number)
        out, _ = process.communicate(timeout=60)  # at its end no worker lives that could still write to the pipe
    assert not Path("t.csv").exists()
    done = journal.read_bytes().count(b"\n") - 1
    assert 4 <= done < 31
    if number == signal.SIGKILL:
        assert process.returncode == -number
        with open(journal, "ab") as stream:
            stream.write(b'[30, {"status": "do')  # as a line is left that was being written
    else:
        assert process.returncode == 130 and out.endswith("the same command continues from t.csv.partial\n")
    code, out, err = run(*SWEEP, "--out", "t.csv")
    told = [int(line.removesuffix(" of 31 cases")) for line in err.splitlines()]  # for a log
    assert told == [k for k in (4, 7, 10, 13, 16, 19, 22, 25, 28, 31) if k > done]
    assert code == 0 and out.startswith(f"{done} of 31 cases are already in t.csv.partial\n")
    assert Path("t.csv").read_bytes() == whole and not journal.exists()


PENDULUM = ("planar_pendulum", "--vary", "pendulum=0:1:0.5", "--until", "0.1", "--out", "a.csv")


def full(*_):
    """As a full disk answers."""
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def journal(run, monkeypatch):
    """The journal of a sweep whose table found no room on the disk, with all three rows."""
    with monkeypatch.context() as patch:
        patch.setattr("pinconsist.run.sweep_table.write_table", full)
        code, _, err = run(*PENDULUM)
    assert code == 2 and "a.csv cannot be written: No space left on device. 3 rows" in err and "a.csv.partial" in err
    return Path("a.csv.partial")


def test_a_table_that_found_no_room_is_written_the_next_time(run, journal):
    code, out, err = run(*PENDULUM, "--workers", 2)
    assert (code, err) == (0, "") and out == (
        "3 of 3 cases are already in a.csv.partial\n3 cases: 3 done\nwritten: a.csv\n"
    )
    assert len(table("a.csv")) == 3 and not journal.exists()


@pytest.mark.parametrize(
    ("arguments", "different"),
    [
        (("double_pendulum", "--vary", "upper=0:1:0.5", *PENDULUM[3:]), "scene, varied"),
        ((*PENDULUM[:2], "pendulum=0:1:0.25", *PENDULUM[3:]), "cases"),
        ((*PENDULUM[:2], "pendulum_speed=0:1:0.5", *PENDULUM[3:]), "varied"),
        ((*PENDULUM, "--rtol", "1e-7"), "settings"),
        ((*PENDULUM, "--from", "0.05"), "start"),
        ((*PENDULUM, "--with-velocity", "pendulum=1"), "start"),
        ((*PENDULUM, "--free-flyer"), "scene"),
    ],
)
def test_the_journal_of_another_sweep_is_refused_and_kept(run, journal, arguments, different):
    before = journal.read_bytes()
    code, out, err = run(*arguments)
    assert (code, out) == (2, "") and f"holds 3 cases of another sweep, which differs in {different}. " in err
    assert journal.read_bytes() == before and not Path("a.csv").exists()


def test_the_journal_of_a_scene_whose_file_has_changed_is_refused(run):
    scene = Path("robot.urdf")
    pc.write(pc.load("planar_pendulum"), scene)
    arguments = (scene, *PENDULUM[1:])
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("pinconsist.run.sweep_table.write_table", lambda *_: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            run(*arguments)
    scene.write_text(re.sub(r'mass value="[^"]*"', 'mass value="3.5"', scene.read_text()))
    code, _, err = run(*arguments)
    assert code == 2 and "3 cases of another sweep, which differs in scene." in err


@pytest.mark.parametrize("content", [b"my notes", b"my notes\n", b"[1]\n", b'{"pinconsist sweep": 1, "about": 3}\n'])
def test_a_foreign_file_by_the_name_of_the_journal_is_kept(run, content):
    Path("a.csv.partial").write_bytes(content)
    code, _, err = run(*PENDULUM)
    assert code == 2 and "a.csv.partial: line 1: not the journal of a sweep" in err
    assert Path("a.csv.partial").read_bytes() == content


@pytest.mark.parametrize(
    "line", [b"[1, {\n", b"\0\0\0\n", b"[1]\n", b'[7, {"status": "", "message": ""}]\n', b'["a", {}]\n']
)
def test_a_journal_damaged_in_the_middle_is_refused(run, journal, line):
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join([*lines[:2], line, *lines[2:]]))
    code, _, err = run(*PENDULUM)
    assert code == 2 and "a.csv.partial: line 3: " in err and "damaged" in err


@pytest.mark.parametrize("length", [0, 1, 40, -1])
def test_a_journal_torn_anywhere_gives_the_same_table(run, journal, length, monkeypatch):
    content = journal.read_bytes()
    header = len(content.splitlines(keepends=True)[0])
    run(*PENDULUM)
    whole = Path("a.csv").read_bytes()
    journal.write_bytes(content[:length] if length in (0, 1) else content[: header + length])
    with monkeypatch.context() as patch:
        patch.setattr("pinconsist.run.sweep_table.write_table", full)  # so that the journal is read again
        assert run(*PENDULUM)[0] == 2
    code, out, _ = run(*PENDULUM)
    assert code == 0 and out.startswith("3 of 3 cases are already in")
    assert Path("a.csv").read_bytes() == whole


def test_two_commands_do_not_write_one_journal(run, journal):
    with open(journal, "rb") as stream:
        fcntl.flock(stream, fcntl.LOCK_EX)
        code, _, err = run(*PENDULUM)
    assert code == 2 and "is being written by another sweep" in err and journal.exists()


def test_a_full_disk_keeps_the_rows_before(run, monkeypatch):
    from pinconsist.run.sweep_table import Journal

    add = Journal.add

    def filling(self, case, row):
        (full if case == 2 else add)(self, case, row)

    monkeypatch.setattr(Journal, "add", filling)
    code, _, err = run(*PENDULUM)
    assert code == 2 and "No space left on device. 2 rows of the table are saved in a.csv.partial" in err


def test_cases_that_fail_are_rows(run):
    """A run out of steps; a tolerance that cannot be."""
    code, out, _ = run("four_bar", "--vary", "crank_speed=0,30", "--max-steps", 10, "--until", 0.3, "--out", "t.csv")
    short, long = table("t.csv")
    assert code == 1 and (short["status"], long["status"]) == ("done", "failed")
    assert "10" in long["message"] and 0.0 < float(long["t"]) < 0.3 and float(long["q.crank"])
    assert "2 cases: 1 done, 1 failed" in out and "case 1 (crank_speed = 30): " in out
    code, out, _ = run("crank_rocker", "--vary", "rtol=1e-6,-1,1e-4", "--until", 0.1, "--json")
    told = json.loads(out)
    assert code == 1 and told["counts"] == {"done": 2, "error": 1}
    row = dict(zip(told["columns"], told["rows"][1], strict=True))
    assert row["message"].startswith("InputError: rtol must be") and row["q.crank"] is None and row["status"] == "error"


def test_a_joint_that_cannot_start_where_it_was_put_is_told(run):
    told = json.loads(run("crank_rocker", "--vary", "rocker=1.5,0.5", "--until", "0.01", "--json")[1])
    near, far = (row[-1] for row in told["rows"])
    assert near == "" and far == "crank_rocker: the loops do not close with rocker = 0.5; they do at rocker = 2.24744"


def test_without_a_file_the_table_is_printed(run):
    code, out, err = run("planar_pendulum", "--vary", "pendulum=0,0.25", "--until", "0.1")
    lines = out.splitlines()
    assert (code, err) == (0, "") and lines[-1] == "2 cases: 2 done" and not list(Path().iterdir())
    assert lines[0].split() == ["case", "pendulum", "steps", "gap", "energy_error", "q.pendulum"]  # all are done
    assert lines[3].split()[:2] == ["1", "0.25"]


def test_an_interrupted_sweep_without_a_file_prints_what_was_reached(run, monkeypatch):
    simulate = pc.simulate

    def interrupted(mech, span, q0, *rest, **options):
        if q0["pendulum"] == 0.5 and span[1] > span[0]:
            os.kill(os.getpid(), signal.SIGINT)
        return simulate(mech, span, q0, *rest, **options, method="BDF")

    monkeypatch.setattr("pinconsist.run.sweep_table.simulate", interrupted)
    code, out, _ = run(*PENDULUM[:-2], "--json")
    told = json.loads(out)
    assert code == 130 and told["interrupted"] and [row[0] for row in told["rows"]] == [0]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "--vary is needed"),
        (["--vary", "pendulum"], "needs name=values"),
        (["--vary", "pendulum="], "needs name=values"),
        (["--vary", "pendulum=a"], "'a' is not a number"),
        (["--vary", "pendulum=1,nan"], "not a finite number"),
        (["--vary", "pendulum=0:1"], "needs FROM:TO:STEP"),
        (["--vary", "pendulum=0:1:0"], "must lead from"),
        (["--vary", "pendulum=0:1:-1"], "must lead from"),
        (["--vary", "pendulum=0:inf:1"], "must lead from"),
        (["--vary", "pendulum=0:1:1e-9"], "more than a million"),
        (["--vary", "pendulum=0:1:1e-4", "--vary", "pendulum_speed=0:1:1e-4"], "more than a million"),
        (["--vary", "pendulum=1,1"], "is given twice"),
        (["--vary", "pendulum=0,1", "--vary", "pendulum=3"], "twice"),
        (["--vary", "pendulm=0,1"], "similar: pendulum"),
        (["--vary", "pendulum=0,1", "--at", "pendulum=1"], "pendulum is varied"),
        (["--vary", "pendulum_speed=0,1", "--with-velocity", "pendulum=1"], "pendulum_speed is varied"),
        (["--vary", "pendulum=normal:0"], "normal:MEAN:DEVIATION"),
        (["--vary", "pendulum=normal:0:-1", "--count", "3"], "negative"),
        (["--vary", "pendulum=uniform:1:0", "--count", "3"], "below"),
        (["--vary", "pendulum=normal:0:1"], "--count"),
        (["--vary", "pendulum=0,1", "--count", "3"], "--count"),
        (["--vary", "pendulum=0,1", "--seed", "3"], "--seed"),
        (["--vary", "pendulum=normal:0:1", "--count", "0"], "--count"),
        (["--vary", "pendulum=0,1", "--rtol", "-1"], "rtol must be"),
        (["--vary", "pendulum=0,1", "--workers", "0"], "--workers"),
        (["--vary", "pendulum=0,1", "--out", "t.txt"], ".csv"),
        (["--vary", "pendulum=0,1", "--out", "nowhere/t.csv"], "no folder"),
    ],
)
def test_what_cannot_be_swept(run, arguments, message):
    code, out, err = run("planar_pendulum", *arguments)
    assert (code, out) == (2, "") and err.startswith("pinconsist: error: ") and message in err
    assert not list(Path().iterdir())


def test_ranges_are_decimal_and_hold_their_end():
    (name,), cases = cases_of(["a=b=5:15:0.1"])  # a name may have an equals sign
    assert name == "a=b" and len(cases) == 101 and cases[0] == (5.0,) and cases[3] == (5.3,) and cases[-1] == (15.0,)
    assert cases_of(["a=1:0:-0.25"])[1] == [(1.0,), (0.75,), (0.5,), (0.25,), (0.0,)]
    assert cases_of(["a=0:1:0.3"])[1] == [(0.0,), (0.3,), (0.6,), (0.9,)]
    assert [value for (value,) in cases_of(["a=0:pi:pi/4"])[1]] == [k * pi / 4 for k in range(5)]


def test_samples_stay_when_there_are_more_of_them_and_cross_with_lists():
    texts = ["a=normal:10:0.1", "b=uniform:-1:1", "c=1,2"]
    names, few = cases_of(texts, count=40, seed=3)
    assert names == ("c", "a", "b") and len(few) == 80
    assert [case[0] for case in few] == [1.0] * 40 + [2.0] * 40 and [case[1:] for case in few[:40]] == [
        case[1:] for case in few[40:]
    ]
    assert cases_of(texts, count=50, seed=3)[1][:40] == few[:40]
    assert cases_of(texts, count=40, seed=4)[1] != few
    a, b = np.array(few)[:40, 1:].T
    assert abs(a.mean() - 10) < 0.1 and 0.05 < a.std() < 0.2 and -1 <= b.min() < -0.5 and 0.5 < b.max() <= 1
    seeded = np.random.default_rng(np.random.SeedSequence(3).spawn(40)[7])
    assert few[7][1:] == (seeded.normal(10, 0.1), seeded.uniform(-1, 1))


@pytest.fixture(scope="module")
def geared(tmp_path_factory):
    folder = tmp_path_factory.mktemp("geared")
    scene = folder / "robot.urdf"
    pc.write(pc.load("four_bar"), scene)
    (folder / "robot.yaml").write_text(GEARED)
    return pc.load(scene)


def put(mech, name, value):
    run = Run(mech, 5.0)
    run.put(name, value)
    return run


def test_what_can_be_varied(geared):
    assert put(geared, "crank", 0.5).q0 == {"crank": 0.5}
    assert put(geared, "crank_speed", 0.5).v0 == {"crank": 0.5}
    assert put(geared, "rocker_torque", 0.5).torques == {"rocker": 0.5}
    assert put(geared, "until", 2.0).until == 2.0 and put(geared, "atol", 1e-9).options == {"atol": 1e-9}
    assert put(geared, "gravity.y", 1.5).mechanism.model.gravity.linear.tolist() == [0.0, 1.5, -9.81]

    def loops(name, value):
        return put(geared, name, value).mechanism.loops

    def forces(name, value):
        return put(geared, name, value).mechanism.forces

    assert loops("gear.ratio", 3.0)[0].ratio == 3.0 and loops("gear.offset", 3.0)[0].offset == 3.0
    assert loops("motor.speed", 4.0)[1].curve == pc.Motion(start=0.5, speed=4.0)
    assert loops("motor.curve.start", 4.0)[1].curve == pc.Motion(start=4.0, speed=3.0)
    assert forces("damping crank, rocker.rocker", 0.7)[0].coefficients == {"crank": 0.1, "rocker": 0.7}
    assert forces("spring crank.stiffness", 7.0)[1].stiffness == 7.0
    assert forces("torque rocker.amplitude", 7.0)[2].torques["rocker"] == pc.Motion(amplitude=7.0)
    spring = forces("spring rocker_tip.xyz2.2", 2.0)[3]
    assert spring.xyz2 == (0.0, 0.0, 2.0) and spring.stiffness == 5.0
    assert geared.loops[0].ratio == 2.0 and geared.model.gravity.linear[1] == 0.0  # the mechanism itself stays


def test_a_name_with_a_dot_is_no_number_of_a_shorter_one(geared):
    gear = geared.loops[0]
    mech = geared.with_loops(gear, replace(gear, name="gear.two", joint="coupler"))
    assert [loop.ratio for loop in put(mech, "gear.two.ratio", 5.0).mechanism.loops] == [2.0, 5.0]
    assert [loop.ratio for loop in put(mech, "gear.ratio", 5.0).mechanism.loops] == [5.0, 2.0]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("gear.teeth", "'gear' has no number 'teeth'; it has ratio, offset"),
        ("spring rocker_tip.2", "several numbers '2'; it has xyz1.2, xyz2.2"),
        ("gears.ratio", "similar: gear.ratio"),
        ("rocker_tork", "similar: rocker"),
        ("gravity", "gravity.x"),
    ],
)
def test_what_cannot_be_varied(geared, name, message):
    with pytest.raises(pc.InputError, match=re.escape(message)):
        put(geared, name, 1.0)


def test_a_joint_of_several_degrees_of_freedom_cannot_be_varied():
    floating = pc.load("planar_pendulum", free_flyer=True)
    with pytest.raises(pc.InputError, match="several degrees of freedom"):
        put(floating, floating.joints[0], 1.0)


def test_what_a_file_loses_is_told_once_and_not_by_each_process(tmp_path):
    text = (Path(__file__).parents[1] / "models" / "planar_pendulum.urdf").read_text()
    assert '<joint name="pendulum" type="continuous">' in text
    limit = '<joint name="pendulum" type="revolute"><limit lower="-9" upper="9" effort="1" velocity="1"/>'
    (tmp_path / "arm.urdf").write_text(text.replace('<joint name="pendulum" type="continuous">', limit))
    command = [sys.executable, "-m", "pinconsist.cli", "sweep", "arm.urdf", "--vary", "pendulum=0:0.3:0.1"]
    told = subprocess.run(
        [*command, "--until", "0.1", "--workers", "2"], cwd=tmp_path, capture_output=True, text=True, check=True
    )
    assert told.stderr.count("without effect here: limits of 1 joint") == 1
