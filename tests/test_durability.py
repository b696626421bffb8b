"""Runs that are kept: saved as they go, continued and made again with the same numbers, bit for bit."""

from __future__ import annotations

import dataclasses
import json
import logging
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

import pinconsist as pc
from pinconsist.run import solution_file

ARRAYS = ("t", "q", "v", "lam", "h", "order")
COUNTERS = ("nsteps", "nfev", "njev", "nlu", "rejected")
MODELS = Path(__file__).resolve().parents[1] / "models"
SLOW = pytest.mark.slow
PROGRAM = (sys.executable, "-m", "pinconsist.cli")


class Boom(Exception):
    pass


def same(a, b):
    return all(getattr(a, name).tobytes() == getattr(b, name).tobytes() for name in ARRAYS) and all(
        getattr(a, name) == getattr(b, name) for name in (*COUNTERS, "status", "message")
    )


def until(end):
    """A callback that fails at the first row after `end`."""

    def callback(t, q, v, lam):
        if abs(t) > abs(end):
            raise Boom("the lamp went out")

    return callback


@pytest.fixture
def scene(tmp_path):
    """A scene in files of its own."""
    for suffix in (".urdf", ".yaml"):
        shutil.copy(MODELS / f"four_bar{suffix}", tmp_path / f"bar{suffix}")
    return tmp_path / "bar.urdf"


def test_a_run_without_checkpoints_is_that_of_simulate(tmp_path):
    options = {"v0": {"crank": 2.0}, "forces": [{"crank": 0.3}], "rtol": (1e-7, 1e-5)}
    kept = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", **options)
    assert same(kept, pc.simulate(pc.load("four_bar"), (0.0, 1.0), **options))
    assert same(pc.Solution.load(tmp_path / "run.npz"), kept) and kept.check(error=False).position < 1e-12


def test_at_checkpoints_the_integration_begins_anew(tmp_path):
    """The chain by hand: simulate, then integrate from the last state of each stretch."""
    mech = pc.load("four_bar")
    parts = [pc.simulate(mech, (0.0, 0.4), v0={"crank": 2.0})]
    for span in ((0.4, 0.8), (0.8, 1.0)):
        parts.append(pc.integrate(mech, span, parts[-1].q[-1], parts[-1].v[-1]))
    kept = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", v0={"crank": 2.0}, save_every=0.4)
    for name in ("t", "q", "v", "lam"):
        rows = [getattr(part, name)[k > 0 :] for k, part in enumerate(parts)]
        np.testing.assert_array_equal(getattr(kept, name), np.concatenate(rows))
    assert kept.nsteps == sum(part.nsteps for part in parts) == len(kept.h)
    np.testing.assert_allclose(np.cumsum(kept.h), kept.t[1:], atol=1e-14)
    assert kept.check(error=False).force < 1e-3


CASES = {
    "variable": ("four_bar", (0.0, 2.0), 0.5, {"v0": {"crank": 3.0}}),
    "fixed": ("four_bar", (0.0, 2.0), 0.5, {"v0": {"crank": 3.0}, "step": 0.01, "order": 3}),
    "backwards": ("four_bar", (1.0, -1.0), 0.5, {"v0": {"crank": 3.0}}),
    "rotations": ("delta_robot", (0.0, 0.4), 0.1, {}),
    "asked times": ("four_bar", (0.0, 2.0), 0.5, {"t_eval": np.linspace(0.0, 2.0, 9)}),
    "few times": ("four_bar", (0.0, 2.0), 0.5, {"t_eval": [0.1, 1.9]}),
    "steps": ("four_bar", (0.0, 2.0), 0.5, {"max_steps": 700, "first_step": 1e-4}),
}


@pytest.mark.parametrize("case", CASES)
def test_what_was_cut_short_goes_on_bit_for_bit(tmp_path, case):
    name, span, period, options = CASES[case]
    whole = pc.record(name, span, tmp_path / "whole", save_every=period, **options)
    for share in (0.1, 0.55, 0.8):  # before the first checkpoint, and after others
        file = tmp_path / "cut.npz"
        cut = pc.record(name, span, file, save_every=period, callback=until(share * 2.0), **options) if share else None
        if cut.status != -1:  # the span ends first
            continue
        assert "the callback raised Boom: the lamp went out" in cut.message
        assert same(pc.Solution.load(file), cut)
        assert same(pc.resume(file), whole) and same(pc.Solution.load(file), whole)
    assert str(pc.rerun(tmp_path / "whole.npz")).startswith("the same numbers, bit for bit")


def test_kill_9_again_and_again_and_the_numbers_are_the_same(tmp_path):
    arguments = ("four_bar", "--until", 20, "--with-velocity", "crank=3", "--save-every", 1)
    whole, cut = tmp_path / "whole.npz", tmp_path / "cut.npz"
    pc.record("four_bar", (0.0, 20.0), whole, v0={"crank": 3.0}, save_every=1.0)
    command, found = [*PROGRAM, "simulate", *map(str, arguments), "--out", str(cut)], []
    for _ in range(2):
        before = cut.stat().st_mtime_ns if cut.exists() else 0
        process = subprocess.Popen(command, stdout=subprocess.DEVNULL)
        while process.poll() is None and (not cut.exists() or cut.stat().st_mtime_ns == before):
            time.sleep(0.001)
        process.kill()
        process.wait()
        found.append(pc.Solution.load(cut))
        command = [*PROGRAM, "resume", str(cut)]
    assert 0 < found[0].t[-1] and found[0].status == 1
    assert "continue it with pinconsist resume" in found[0].message
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    assert same(pc.Solution.load(cut), pc.Solution.load(whole))


@pytest.mark.parametrize(
    "number", [signal.SIGTERM, *(pytest.param(n, marks=SLOW) for n in (signal.SIGINT, signal.SIGHUP))]
)
def test_signals_save_what_was_reached(tmp_path, number):
    """Also when a supervisor or an impatient finger sends several."""
    file = tmp_path / "run.npz"
    command = [*PROGRAM, "simulate", "four_bar", "--until", "1e5", "--out", str(file), "--save-every", "2"]
    signal.signal(signal.SIGHUP, signal.SIG_DFL)  # nohup hands on that it is ignored
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    while process.poll() is None and not file.exists():
        time.sleep(0.01)
    for _ in range(5):
        process.send_signal(number)
        time.sleep(0.01)
    try:
        out, err = process.communicate(timeout=60)
    finally:
        process.kill()
    sol = pc.Solution.load(file)
    assert process.returncode == 130 and "Traceback" not in err
    assert (
        sol.status == 1
        and f"interrupted at t = {sol.t[-1]:.6g}" in " ".join(out.split())
        and sol.message in " ".join(out.split())
    )
    assert pc.rerun(file).same  # up to where it was interrupted
    assert [each.name for each in tmp_path.iterdir()] == ["run.npz"]


def test_a_run_that_nobody_cut_short_is_not_made_again(tmp_path):
    kept = pc.record("four_bar", (0.0, 0.2), tmp_path / "run", save_every=0.1)
    before = (tmp_path / "run.npz").stat().st_mtime_ns
    assert same(pc.resume(tmp_path / "run.npz"), kept) and (tmp_path / "run.npz").stat().st_mtime_ns == before


def test_what_has_changed_is_said(tmp_path, scene):
    file = tmp_path / "run.npz"
    pc.record(scene, (0.0, 0.5), file, save_every=0.1, callback=until(0.3))
    again = pc.rerun(file)
    assert again.same and again.differences == ()
    scene.write_text(scene.read_text() + "<!-- a remark -->")
    again = pc.rerun(file)
    assert again.same and again.differences == ("bar.urdf has changed",)
    with pytest.raises(pc.InputError, match=r"because its scene has changed: bar.urdf has changed"):
        pc.resume(file)
    loops = scene.with_suffix(".yaml")
    loops.write_text(loops.read_text() + "\ngravity: [0, 0, -5]\n")
    again = pc.rerun(file)
    assert not again.same and "bar.yaml has changed" in again.differences
    assert any(each.startswith("q: ") for each in again.differences) and str(again).endswith("the numbers differ")
    loops.unlink()
    with pytest.raises(pc.InputError, match="not the one that was simulated"):
        pc.rerun(file)
    scene.unlink()
    with pytest.raises(pc.InputError, match=r"the scene of .*run.npz cannot be loaded; .*--scene.*no such file"):
        pc.rerun(file)


def test_other_versions_are_said(tmp_path, monkeypatch, caplog):
    file = tmp_path / "run.npz"
    pc.record("four_bar", (0.0, 0.5), file, save_every=0.1, callback=until(0.3))
    now = solution_file.versions()
    with np.load(file) as stored:
        parts = dict(stored)
    about = json.loads(str(parts["about"]))
    about["versions"] |= {"pinconsist": "0.0.9", "numpy": "1.26.0"}
    np.savez(file, **parts | {"about": np.array(json.dumps(about))})
    wanted = (f"pinconsist was 0.0.9, now it is {pc.__version__}", f"numpy was 1.26.0, now it is {now['numpy']}")
    assert pc.rerun(file).differences == wanted and pc.rerun(file).same
    with caplog.at_level(logging.WARNING, "pinconsist"):
        pc.resume(file)
    assert "was started with other versions (pinconsist was 0.0.9" in caplog.text


def test_file_and_scene_may_move_together(tmp_path, scene):
    home = tmp_path / "here"
    home.mkdir()
    for each in (scene, scene.with_suffix(".yaml")):
        each.rename(home / each.name)
    pc.record(home / scene.name, (0.0, 0.1), home / "run.npz", load={"loops": home / "bar.yaml"})
    home.rename(tmp_path / "there")
    assert pc.rerun(tmp_path / "there" / "run.npz").same
    (tmp_path / "there" / "run.npz").rename(tmp_path / "run.npz")
    with pytest.raises(pc.InputError, match="give its location with --scene"):
        pc.rerun(tmp_path / "run.npz")


def test_the_scene_of_a_run_may_be_told(tmp_path, scene):
    pc.record(scene, (0.0, 0.1), tmp_path / "run.npz")
    (tmp_path / "there").mkdir()
    for each in (scene, scene.with_suffix(".yaml")):
        each.rename(tmp_path / "there" / each.name)
    assert pc.rerun(tmp_path / "run.npz", scene=tmp_path / "there" / scene.name).same


def test_forces_that_are_records_are_kept(tmp_path):
    forces = [
        {"crank": pc.Motion(amplitude=2.0, frequency=3.0)},
        pc.JointDamping({"rocker": 0.1}),
        np.array([0.1, 0, 0]),
    ]
    pc.record("four_bar", (0.0, 0.5), tmp_path / "run", forces=forces, save_every=0.2)
    plain = pc.record("four_bar", (0.0, 0.5), tmp_path / "plain", save_every=0.2)
    again = pc.rerun(tmp_path / "run.npz")
    assert again.same and not np.array_equal(again.solution.q, plain.q)


def push(t, q, v):
    return np.array([np.sin(5 * t), 0.0, 0.0])


def test_forces_that_are_functions_have_to_be_given_again(tmp_path):
    file = tmp_path / "run.npz"
    pc.record("four_bar", (0.0, 0.5), file, forces=push, save_every=0.2, callback=until(0.3))
    for call in (pc.rerun, pc.resume):
        with pytest.raises(pc.InputError, match=r"a force that is a Python function.*forces="):
            call(file)
    assert pc.rerun(file, forces=push).same and not pc.rerun(file, forces=[]).same
    assert same(pc.resume(file, forces=[push]), pc.record("four_bar", (0, 0.5), file, forces=push, save_every=0.2))


def test_a_mechanism_in_memory_has_to_be_given_again(tmp_path):
    mech, file = pc.load("four_bar").with_gravity([0, 0, -3.0]), tmp_path / "run.npz"
    pc.record(mech, (0.0, 0.5), file, {"crank": 0.2}, save_every=0.2, callback=until(0.3))
    with pytest.raises(pc.InputError, match=r"mechanism in memory.*scene="):
        pc.rerun(file)
    assert pc.rerun(file, scene=mech).same and not pc.rerun(file, scene=pc.load("four_bar")).same
    with pytest.raises(pc.InputError, match="not the one that was simulated"):
        pc.rerun(file, scene=pc.load("five_bar"))
    assert pc.resume(file, scene=mech).success


def without_digests(file):
    """As an older version would have written it."""
    with np.load(file) as stored:
        parts = dict(stored)
    about = json.loads(str(parts["about"]))
    del about["recipe"]["mechanism"]
    np.savez(file, **parts | {"about": np.array(json.dumps(about))})


OTHERS = {
    "bodies, joints or gravity": lambda mech: mech.with_gravity([0, 0, -1.0]),
    "loops": lambda mech: dataclasses.replace(mech, loops=[dataclasses.replace(mech.loops[0], xyz1=(1e-3, 0, 0))]),
    "own forces": lambda mech: dataclasses.replace(mech, forces=[pc.JointDamping({"crank": 0.1}), push]),
    "guess": lambda mech: dataclasses.replace(mech, guess={"crank": 0.7}),
}


@pytest.mark.parametrize("part", OTHERS)
def test_a_run_in_memory_is_not_continued_with_another_mechanism(tmp_path, part):
    mech, file = dataclasses.replace(pc.load("four_bar"), forces=[pc.JointDamping({"crank": 0.2}), push]), "run.npz"
    file, other = tmp_path / file, OTHERS[part](mech)
    pc.record(mech, (0.0, 0.5), file, save_every=0.2, callback=until(0.3))
    before = file.read_bytes()
    with pytest.raises(
        pc.InputError, match=f"cannot be continued, because its scene has changed: the mechanism has different {part}"
    ):
        pc.resume(file, scene=other)
    assert file.read_bytes() == before
    assert f"the mechanism has different {part}" in pc.rerun(file, scene=other).differences
    assert pc.rerun(file, scene=mech).differences == ()
    same_again = dataclasses.replace(pc.load("four_bar"), forces=[pc.JointDamping({"crank": 0.2}), push])
    assert pc.resume(file, scene=same_again).success


def test_files_of_older_versions_are_continued_without_digests(tmp_path):
    mech, file = pc.load("four_bar"), tmp_path / "run.npz"
    pc.record(mech, (0.0, 0.5), file, save_every=0.2, callback=until(0.3))
    without_digests(file)
    assert pc.rerun(file, scene=mech).differences == () and pc.resume(file, scene=mech).success


def test_a_run_of_a_file_is_not_continued_with_another_mechanism(tmp_path):
    file = tmp_path / "run.npz"
    pc.record("four_bar", (0.0, 0.5), file, save_every=0.2, callback=until(0.3))
    with pytest.raises(pc.InputError, match="the mechanism has different bodies, joints or gravity"):
        pc.resume(file, scene=pc.load("four_bar").with_gravity([0, 0, -1.0]))
    assert pc.resume(file, scene=pc.load("four_bar")).success


def test_a_solution_of_simulate_does_not_say_how_it_was_made(tmp_path):
    file = pc.simulate(pc.load("four_bar"), (0.0, 0.1)).save(tmp_path / "run.npz")
    for call in (pc.rerun, pc.resume):
        with pytest.raises(pc.FormatError, match=r"does not contain how it was made.*pinconsist.record"):
            call(file)


def test_checkpoints_are_passed_over_where_saving_takes_too_long(tmp_path, monkeypatch):
    times = []
    save = pc.Solution.save
    monkeypatch.setattr(
        pc.Solution, "save", lambda sol, file: (time.sleep(0.05), times.append(sol.t[-1]), save(sol, file))[2]
    )
    slow = pc.record("four_bar", (0.0, 1.0), tmp_path / "run", save_every=0.01)
    assert times[0] == 0.01 and times[-1] == 1.0 and len(times) < 30  # of 100, whatever this machine does meanwhile
    monkeypatch.undo()
    assert same(slow, pc.record("four_bar", (0.0, 1.0), tmp_path / "fast", save_every=0.01))


BAD = {
    "events": ({"events": lambda t, q, v, lam: q[0]}, "events= is not for recorded runs, whose"),
    "dense": ({"dense_output": True}, "dense_output= is not for recorded runs"),
    "unknown": ({"rtoll": 1e-3}, "unknown option 'rtoll'.*rtol"),
    "period": ({"save_every": 0.0}, "save_every must be a positive number of seconds, got 0"),
    "NaN": ({"save_every": float("nan")}, "save_every"),
    "many": ({"save_every": 1e-9}, "into 100000000 parts; at most 100000"),
    "object": ({"rtol": object()}, "rtol = .* cannot be stored in a file"),
    "load": ({"load": {"loop": "x.yaml"}}, "load= must map options of load"),
}


@pytest.mark.parametrize("case", BAD)
def test_what_cannot_be_kept_is_refused_at_once(tmp_path, case):
    options, message = BAD[case]
    with pytest.raises(pc.InputError, match=message):
        pc.record("four_bar", (0.0, 0.1), tmp_path / "run", **options)
    assert not list(tmp_path.iterdir())


def test_bad_scenes_and_spans(tmp_path):
    for scene, span, message in (
        (3, (0, 1), "a scene is a name, a file or a Mechanism"), ("four_bar", (0, 1, 2), "t_span needs two numbers"),
        ("four_bar", ("a", 1), "t_span"), ("four_bra", (0, 1), "neither a built-in model"),
    ):  # fmt: skip
        with pytest.raises(pc.InputError, match=message):
            pc.record(scene, span, tmp_path / "run")


def test_the_commands(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = partial(called, capsys)
    cut = pc.record("four_bar", (0.0, 0.5), "run.npz", save_every=0.2, callback=until(0.3))
    code, out, _ = run("rerun", "run.npz")
    assert code == 0 and "the same numbers" in out  # up to where it was cut short
    code, out, _ = run("resume", "run.npz")
    assert code == 0 and out.startswith("continued from t = 0.2 s\n") and "written: run.npz" in out and len(cut.t)
    assert run("resume", "run.npz")[1] == "run.npz is complete: the end of the interval was reached\n"
    code, out, _ = run("rerun", "run.npz")
    assert code == 0 and out.startswith("the same numbers, bit for bit: ")
    assert json.loads(run("rerun", "run.npz", "--json")[1])["same"] is True
    other = dataclasses.replace(pc.Solution.load("run.npz"), q=pc.Solution.load("run.npz").q + 1e-15)
    other.save("run.npz")
    code, out, _ = run("rerun", "run.npz")
    assert code == 1 and "q: differs by up to" in out and "the numbers differ" in out
    assert run("simulate", "four_bar", "--save-every", 1)[0] == 2
    assert (
        run("simulate", "four_bar", "--until", 0.3, "--save-every", 0.1, "--out", "b.npz", "--at", "crank=0.2")[0] == 0
    )
    assert run("rerun", "b.npz")[0] == 0
