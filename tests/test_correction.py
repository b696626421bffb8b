"""Rounded numbers of files: mechanisms that move only because loops follow from others, against the exact ones."""

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
from helpers.overconstrained import parallelogram, rounded, turned, wrist
from typer.testing import CliRunner

import pinconsist as pc
from pinconsist.cli.app import app
from pinconsist.mechanism.closing import held_motors
from pinconsist.mechanism.correction import rounding_of

NAMES = ("bricard", "four_bar", "five_bar", "slider_crank", "n_four_bar_2", "jansen_leg")


@pytest.mark.parametrize("name", [*NAMES, "parallelogram", "wrist"])
@pytest.mark.parametrize("digits", [6, 9])
def test_scenes_whose_numbers_are_rounded_move_again(name, digits):
    """Every number is rounded. Rank and mobility are those of the exact scene, and no number moves by more."""
    exact = turned({"parallelogram": parallelogram, "wrist": wrist}.get(name, lambda: pc.load(name))())
    wanted, corrected = pc.assemble(exact), rounded(exact, digits).corrected(10.0**-digits)
    found = pc.assemble(corrected)
    assert (found.rank, found.mobility) == (wanted.rank, wanted.mobility)
    assert found.largest_gap[1] < 1e-11 and corrected.corrected_by <= 10.0**-digits


@pytest.mark.parametrize("name", ["four_bar", "delta_robot", "double_pendulum"])
def test_scenes_without_errors_stay_as_they_are(name):
    mech = pc.load(name)
    assert mech.corrected(1e-6) is mech and mech.corrected(0.0) is mech
    assert pc.load(name, precision=1e-6).corrected_by == 0.0


@pytest.mark.parametrize(
    ("exact", "off", "start"),
    [
        (parallelogram(), parallelogram(1e-9), {}),
        (parallelogram(kind="point"), parallelogram(5e-7, kind="point"), {}),
        (wrist(), wrist(6.5e-8), {"v0": {"motor1": 2.0, "motor2": 1.0}}),
    ],
    ids=["parallelogram", "points", "wrist"],
)
def test_motion_and_multipliers_are_those_of_the_exact_mechanism(exact, off, start):
    """The wrist locked before ("7 independent, mobility 0"); the second parallelogram did not close."""
    times = np.linspace(0.0, 0.4, 9)
    runs = [pc.simulate(mech, (0.0, times[-1]), t_eval=times, **start) for mech in (exact, off.corrected(1e-6))]
    lam = [run.lam for run in runs]
    np.testing.assert_allclose(runs[1].q - runs[1].q[0], runs[0].q - runs[0].q[0], rtol=0, atol=2e-5)
    np.testing.assert_allclose(lam[1], lam[0], rtol=0, atol=1e-4 * np.abs(lam[0]).max())
    found = runs[1].check()
    assert 0.0 < found.corrected_by < 1e-6 and f"{found.corrected_by:.2e} m, rad" in str(found)


def test_a_corrected_parallelogram_passes_its_change_points():
    """There all cranks lie along the coupler, and cranks that differ would turn into another mode of assembly."""
    mech = parallelogram(1e-7).corrected(1e-6)
    sol = pc.simulate(mech, (0.0, 2.0), {"a": 0.6}, {"a": 8.0})
    assert sol.success and np.ptp(sol.q[:, 0]) > 2 * np.pi and sol.check(error=False).position < 1e-10
    np.testing.assert_allclose(sol.q[:, 2], sol.q[:, 0], rtol=0, atol=1e-5)


def test_a_precision_that_is_too_small_changes_nothing():
    assert wrist(6.5e-8).corrected(1e-9).corrected_by == 0.0
    with pytest.raises(pc.InputError, match="precision must be at least 0"):
        pc.load("four_bar", precision=-1e-6)


def test_driven_mechanisms_are_corrected_wherever_their_drive_takes_them():
    mech = rounded(turned(pc.load("jansen_leg")), 6).corrected(1e-6)
    sol = pc.simulate(mech, (0.0, 0.5))
    assert sol.success and sol.check(error=False).position < 1e-10


def test_reanchored_loops_that_lock_are_named_with_what_helps():
    locked = wrist(6.5e-8)
    with pytest.warns(UserWarning, match=r"rank 7 and mobility 0 depend on rounding: leg\d \w+, .*precision=1e-06"):
        assert pc.assemble(locked).mobility == 0
    assert rounding_of(locked).mobility == 3
    assert held_motors(locked, locked.guess) == ["motor1", "motor2", "motor3"]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        free = locked.corrected(1e-6)
        assert pc.assemble(free).mobility == 3 and held_motors(free, free.guess) == []


def test_loops_that_contradict_each_other_say_which_precision_helps():
    with pytest.warns(UserWarning, match=r"nothing can move\. Most likely .*precision=1e-06\) .* the mobility is 1$"):
        assert pc.assemble(parallelogram(3e-7)).mobility == 0  # where the loops do close, all in one line
    crooked = rounded(turned(pc.load("bricard")), 6)
    with pytest.raises(
        pc.AssemblyError, match=r"precision=1e-06\) .* consistent and the mobility is 1\. Check lengths"
    ):
        pc.assemble(crooked)
    with pytest.warns(UserWarning, match=r"contradict each other slightly.*precision=1e-6"):
        assert pc.assemble(parallelogram(1e-9)).mobility == 1  # was 0: assembly left for where the loops close, locked
    far = pc.load("crank_rocker")
    far = far.with_loops(replace(far.loops[0], xyz2=(9.0, 0.0, 0.0)))
    with pytest.raises(pc.AssemblyError) as caught:
        pc.assemble(far)
    assert "precision" not in str(caught.value)


def test_check_says_what_a_rank_hangs_on(tmp_path):
    files = pc.write(wrist(6.5e-8), tmp_path / "wrist.urdf")
    path = str(tmp_path / "wrist.urdf")
    assert files
    told = json.loads(CliRunner().invoke(app, ["check", path, "--json"]).stdout)
    assert (told["mobility"], told["mobility_without_weak"]) == (0, 3) and len(told["weak"]) == 3
    assert told["held_motors"] == ["motor1", "motor2", "motor3"] and all(0 < row["by"] < 1e-6 for row in told["weak"])
    text = " ".join(CliRunner().invoke(app, ["check", path]).stdout.split())
    assert "depends on rows that are independent by less than 1e-6 m or rad: (leg" in text
    assert "without them it would be 3" in text
    assert "motors that cannot move independently: motor1, motor2, motor3" in text
    told = json.loads(CliRunner().invoke(app, ["check", path, "--precision", "1e-6", "--json"]).stdout)
    assert (told["mobility"], told["held_motors"], told["weak"]) == (3, [], []) and 0 < told["corrected_by"] < 1e-6


def test_a_recorded_run_keeps_its_precision(tmp_path):
    pc.write(parallelogram(1e-7), tmp_path / "p.urdf")
    sol = pc.record(tmp_path / "p.urdf", (0.0, 0.05), tmp_path / "a.npz", load={"precision": 1e-6})
    assert sol.success and pc.rerun(tmp_path / "a.npz").same
