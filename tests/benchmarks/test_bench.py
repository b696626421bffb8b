"""The measuring commands measure something that can be believed; the figures themselves are not tested."""

import csv
import json
import re
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import pytest
from helpers import command_line
from helpers.mjcf_zoo import ZOO

from benchmarks import actuation, gradients, mjcf_actuators, sampled, stepped, sweep
from benchmarks.against import against
from benchmarks.app import main
from benchmarks.around import CHECK, FORCE, PLAIN, around
from benchmarks.overhead import chain_steps, overhead
from benchmarks.robots import robots
from pinconsist.errors import InputError

called = partial(command_line.called, main=main)
ROBOTS = Path(__file__).parents[3] / "shared" / "robots"


def test_each_way_of_sampling_is_timed_and_right():
    rows = sampled.measured([replace(sampled.SCENES[0], periods=(0.1,))], repeats=1)
    assert {row.way for row in rows} == set(sampled.WAYS)
    assert all(row.time > 0.0 and row.q < 1e-3 and row.lam < 1.0 for row in rows)


def test_steps_of_a_millisecond_are_timed_and_right(monkeypatch):
    for name in "STEPS", "ROUNDS", "RUNS":
        monkeypatch.setattr(stepped, name, 2)
    rows = stepped.measured(["four_bar"])
    assert all(row.time > 0.0 for row in rows)
    assert all(row.q < 1e-3 and row.gap < 1e-12 for row in rows if not row.way.startswith("MuJoCo"))


def test_sweeps_and_threads_are_timed():
    assert [row.cases for row in sweep.sweeps(2)] == [2, 2] and all(row.ratio > 0.0 for row in sweep.sweeps(2))
    row = sweep.threads(0.05, "Radau", repeats=1, cases=2)
    assert 0.0 < row.free < 1.0 and row.ratio > 0.0


LAWS = (
    '<motor joint="{}" gear="-3" ctrlrange="-.5 .4"/>', '<position joint="{}" kp="7" kv=".3" forcerange="-2 3"/>',
    '<velocity joint="{}" kv="2" gear="1.5"/>', '<motor joint="{}" forcerange="-.2 .1"/>',
    '<general joint="{}" gaintype="affine" gainprm="2 .3 .1" biastype="affine" biasprm=".1 -4 -.3"/>',
)  # fmt: skip


def test_actuators_of_many_models_are_mujocos(tmp_path):
    """Of every third model of the zoo, with an actuator on every hinge and slide."""
    pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")
    for number, text in enumerate([text for text in ZOO.values() if "<default" not in text][::3]):
        given = re.split(r"<joint(?=[ /])(?![^>]*(?:name|joint1?)=)", text)
        text = given[0] + "".join(f'<joint name="n{i}"{part}' for i, part in enumerate(given[1:]))
        plain = [i for i, part in enumerate(given[1:]) if not re.match(r'[^>]*type="(ball|free)"', part)]
        acting = "".join(LAWS[(i + number) % len(LAWS)].format(f"n{i}") for i in plain)
        (tmp_path / f"{number}.xml").write_text(f"<mujoco>{text}<actuator>{acting}</actuator></mujoco>")
    rows, refused = mjcf_actuators.compared(tmp_path, states=15)
    assert not refused and len(rows) >= 10
    assert all(row.acting == row.actuators and row.difference < 1e-10 for row in rows)
    assert any(row.cut > 0.3 for row in rows) and any(row.cut == 0.0 for row in rows)


def test_actuation_is_timed_and_its_walk_keeps_the_branch():
    (row,) = actuation.measured(["four_bar"], calls=2, repeats=1)  # with C where there is a compiler and CasADi
    assert (row.velocities, row.motors) == (3, 1) and min(row.closure, row.jacobian, row.reduced, row.forward) > 0.0
    walked = actuation.walk(60)
    assert walked["jumps"] == 0 and walked["blocked"] < 60
    if (ROBOTS / "digit_like").is_dir():
        felt = actuation.reflected(ROBOTS / "digit_like", *actuation.DIGIT, positions=(0.0,))[0]
        assert felt.serial < felt.rods < felt.whole and felt.whole - felt.rods == pytest.approx(actuation.ROTOR)


def test_derivatives_are_exact_and_timed():
    for row in gradients.accuracy(("andrews",), (1e-6,)):
        assert row.dq < 1e-6 and row.dv < 1e-6 and row.dlam < 1e-5 and row.back < 1e-10
    for row in gradients.events((1e-6,)):
        assert max(row.jump, row.load, row.dq) < 1e-4
    for row in gradients.cost(("andrews",), repeats=1, rtol=1e-6):
        assert min(row.run, row.fixed, row.adjoint) > 0.0
    for row in gradients.many((gradients.swung,), repeats=1, rtol=1e-5):
        assert row.parameters == 1000 and min(row.run, row.gradient) > 0.0


def test_overhead_counts_steps_residuals_and_times():
    rows = overhead(tolerances=(1e-5,), repeats=1)
    for row in rows:
        assert row.steps > 500 and 1.0 < row.residuals < 2.7 and min(row.run_time, row.step_time) > 0.0
        assert row.ratio == pytest.approx(row.step_time / row.bare_time) and row.least_time > row.bare_time


def test_what_stands_around_a_run_is_timed():
    rows = around(repeats=1, checked={"four_bar": 0.2, "andrews": 0.003})
    by_what = {(row.scene, row.method, row.what): row for row in rows}
    assert len(by_what) == len(rows) == 36 + 8 and all(min(row.seconds, row.wall) > 0.0 for row in rows)
    assert [row.what for row in rows if row.ratio == row.wall_ratio == 1.0] == 6 * [PLAIN]
    for row in rows:
        over = by_what[row.scene, row.method, FORCE if row.what.startswith(f"{FORCE}, ") else PLAIN]
        assert row.ratio == pytest.approx(row.seconds / over.seconds)
        assert row.wall_ratio == pytest.approx(row.wall / over.wall)
    assert {what for scene, _, what in by_what if scene == "andrews"} == {PLAIN, CHECK}


def test_steps_of_chains_are_counted_and_timed():
    rows = chain_steps({4: 1.0, 40: 0.3}, repeats=1)
    assert [row.links for row in rows] == [4, 40]
    assert all(row.steps > 1 and row.step_time > 0.0 for row in rows)


def test_a_folder_of_one_robot(tmp_path):
    (tmp_path / "bar").mkdir()
    urdf = Path(__file__).parents[2] / "models" / "four_bar.urdf"
    for suffix in (".urdf", ".yaml"):
        (tmp_path / "bar" / f"four_bar{suffix}").write_text(urdf.with_suffix(suffix).read_text())
    run, tight = robots(tmp_path, until=0.1)
    assert (run.robot, run.closure, run.status, run.rtol, tight.rtol) == ("bar", "as written", "done", 0.0, 1e-7)
    closing = run.assembly
    assert closing == tight.assembly and closing.from_neutral in (True, False)
    assert closing.tried == 20 and 15 <= closing.closed <= 20 and closing.time > 0.0
    assert run.steps >= 3 and run.gap < 1e-12 and run.energy_error < 1e-5 and run.step_time > 0.0
    with pytest.raises(InputError, match="no folder"):
        list(robots(tmp_path / "bar"))


@pytest.mark.skipif(not ROBOTS.is_dir(), reason="the folder of real robots is not beside the project")
def test_what_cannot_close_runs_in_two_other_ways(tmp_path):
    (tmp_path / "kangaroo_like").symlink_to(ROBOTS / "kangaroo_like")
    runs = list(robots(tmp_path, until=0.01, tries=1))
    assert [run.closure for run in runs] == ["point", "point", "re-anchored", "re-anchored"]
    assert all(run.status == "done" and run.gap < 1e-8 for run in runs)


def test_the_command_measures_a_scene_and_draws_it(tmp_path, capsys):
    figure = tmp_path / "bench.png"
    options = ["--tol", "1e-4", "--tol", "1e-6", "--repeats", "1", "--method", "LSODA"]
    scene = ["problem51", "--until", "0.2"]
    table = tmp_path / "bench.csv"
    options += ["--plot", figure, "--csv", table, "--json"]
    code, out, _ = called(capsys, "work-precision", *scene, *options)
    assert code == 0 and figure.stat().st_size > 1000
    (diagram,) = json.loads(out)["scenes"]
    assert (
        diagram["scene"] == "problem51"
        and diagram["until"] == 0.2
        and diagram["versions"].keys() == {"pinconsist", "scipy"}
    )
    assert {point["method"] for point in diagram["points"]} == {"pinconsist BDF", "scipy LSODA, index 1"}
    assert all(point["status"] == "done" and point["q"] < 1e-2 for point in diagram["points"])
    rows = list(csv.DictReader(table.read_text().splitlines()))
    assert [float(row["q"]) for row in rows] == pytest.approx([point["q"] for point in diagram["points"]], rel=1e-3)
    equal = list(csv.DictReader((tmp_path / "bench_equal_error.csv").read_text().splitlines()))
    assert {row["target"] for row in equal} == {"0.001", "0.0001", "1e-06", "1e-08"} and equal[0]["ratio"] == "1"
    assert {row["of"] for row in equal} == {"q", "v", "lam", "force"} and equal[0]["core_ratio"] in ("1", "")
    assert all(min(float(row["setup"]), float(row["time"])) > 0.0 and float(row["force"]) < 1e-2 for row in rows)


def test_the_command_prints_tables(capsys):
    """With set-up and without, of every error, over the method that is named; what is timed says nothing."""
    options = ["--tolerances", "3", "--repeats", "1", "--method", "MuJoCo", "--over", "pinconsist Radau"]
    _, text, err = called(capsys, "work-precision", "problem51", "--until", "0.2", *options)
    text = " ".join(text.split())
    assert "MuJoCo implicitfast, soft loops" in text and "double precision" not in err
    for what in ("q", "v", "λ", "Jᵀλ"):
        assert f"equal error in {what} (largest over the run), over that of pinconsist Radau; in parentheses" in text
    core = r"( \(\d+\.\d+\))?"  # nothing where noise makes a set-up longer than its run
    assert (
        len(re.findall(rf"pinconsist BDF( \d+\.\d+{core}){{4}} pinconsist Radau( \d+\.\d+ ms{core}){{4}}", text)) == 4
    )


@pytest.mark.parametrize("option", ["--method", "--over"])
def test_the_command_refuses_what_it_does_not_know(capsys, option):
    code, _, err = called(capsys, "work-precision", "problem51", option, "nonsense")
    assert code == 2 and "no method 'nonsense'" in err


def test_compiled_runs_of_two_interpreters_in_turn():
    (row,) = against(sys.executable, ["four_bar"], repeats=1, least=0.01)
    assert row.steps == row.other_steps > 5 and 0.1 < row.ratio < 10.0
    with pytest.raises(InputError, match="cannot be run"):
        against("/no/such/python", ["four_bar"], repeats=1)
