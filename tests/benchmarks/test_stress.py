"""The stress suite can fail, says what it found, and a selection of it holds."""

import json
import signal
import subprocess
import sys
import time
import warnings
from pathlib import Path

import numpy as np
import pytest

from benchmarks.app import main
from benchmarks.linkages import four_bar
from benchmarks.stress import SUBJECTS, cases
from benchmarks.stress.case import EITHER, HELD, REFUSED, Case, Figure, Refused, completed, run
from pinconsist.errors import InputError


def judged(check, expected=HELD, reason=""):
    return run(Case("family", "what", check, expected, reason))


def refuse(by, message="loop 'end' is open"):
    raise Refused(message)


def below(by):
    return np.zeros(2) @ np.zeros(3)


def warn(by):
    warnings.warn("overflow", RuntimeWarning, stacklevel=1)
    return [Figure("error", 0.0, 1.0)]


@pytest.mark.parametrize(
    ("check", "expected", "reason", "outcome"),
    [
        (lambda by: [Figure("error", 1.0, 2.0)], HELD, "", "held"),
        (lambda by: [Figure("error", 1.0, 2.0), Figure("gap", 3.0, 2.0)], HELD, "", "FAILED"),
        (lambda by: [Figure("error", float("nan"), 2.0), Figure("gap", 1.0, 2.0)], HELD, "", "FAILED"),
        (lambda by: [Figure("error", float("inf"), 2.0)], EITHER, "", "FAILED"),
        (lambda by: [Figure("error", 1.0, 2.0)], REFUSED, "", "FAILED"),
        (lambda by: [Figure("error", 1.0, 2.0)], EITHER, "", "held"),
        (refuse, HELD, "", "FAILED"),
        (refuse, EITHER, "", "refused"),
        (refuse, REFUSED, "'end'", "refused"),
        (refuse, REFUSED, "motor", "FAILED"),
        (lambda by: refuse(by, ""), REFUSED, "", "FAILED"),
        (below, EITHER, "", "FAILED"),
        (warn, EITHER, "", "FAILED"),
    ],
)
def test_what_counts_as_held_refused_and_failed(check, expected, reason, outcome):
    assert judged(check, expected, reason).outcome == outcome


def test_the_worst_figure_is_told_with_its_criterion():
    outcome = judged(lambda by: [Figure("error", 1e-6, 1e-3), Figure("gap", 1e-9, 1e-8), Figure("energy", 0.0, 1e-3)])
    assert (outcome.measure, outcome.figure, outcome.criterion) == ("gap", 1e-9, 1e-8)


def test_a_solution_without_success_is_a_refusal_with_its_message():
    from pinconsist import simulate

    sol = simulate(four_bar(), (0.0, 10.0), max_steps=10)
    outcome = judged(lambda by: completed(sol), EITHER)
    assert outcome.outcome == "refused" and "max_steps = 10" in outcome.reason


def test_cases_of_every_subject_have_names_of_their_own():
    found = list(cases(long=True))
    names = [(case.family, case.varied) for case in found]
    assert len(set(names)) == len(names) > 150
    assert sum("1,000,000 steps" in varied for _, varied in names) == 2


def test_unknown_subjects():
    with pytest.raises(InputError, match="no stress subject 'chain'; choose from steps"):
        cases(["chain"])


SELECTION = (
    "problem51, order 1, h = 1e-09 s",
    "problem52, order 5, h = 1e-06 s",
    "problem51, order 1, h = 1e-08 s, raw",
    "rocker times 1e+08",
    "coupler times 1e-08",
    "all lengths times 1e-06",
    "coupler on a spring of 1e+06 N/m, with damper",
    "top on a pivot loop at 1e+04 rad/s, 10 turns",
    "5 parallelograms through several",
    "start in one",
    "bricard, each loop 5 times",
    "four-bar closed by point and hinge",
    "stewart_platform, q0 off by 1e-01",
    "four_bar, v0 off by 1e+00 /s",
    "problem51, p0 as it stands, off by 1e-05",
    "crank torque jumps by 100 N·m in mid-run",
    "dry friction over 1e-06 rad/s",
    "crank_rocker, rtol = atol = 1e-13",
)


@pytest.mark.parametrize("varied", SELECTION)
def test_a_selection_holds_or_is_refused(varied):
    (case,) = (case for case in cases() if case.varied == varied)
    outcome = run(case)
    assert outcome.outcome != "FAILED", outcome


@pytest.mark.parametrize(
    "case", [case for case in cases(["forces"]) if case.family == "user function"], ids=lambda case: case.varied
)
def test_every_nonsense_of_a_user_is_refused_by_name(case):
    outcome = run(case)
    assert outcome.outcome == "refused", outcome


def test_command_prints_a_table_and_json(capsys, monkeypatch):
    monkeypatch.setitem(SUBJECTS, "steps", lambda long: iter([GOOD, BAD]))
    with pytest.raises(SystemExit) as ended:
        main(["stress", "steps"])
    text = capsys.readouterr().out
    assert ended.value.code == 1
    assert "2 cases" in text and "1 FAILED, 1 held" in text and "is beyond its criterion" in text
    with pytest.raises(SystemExit) as ended:
        main(["stress", "steps", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert ended.value.code == 1 and told["counts"] == {"held": 1, "FAILED": 1}
    assert told["cases"][0]["figure"] == 1.0 and told["cases"][1]["outcome"] == "FAILED"
    monkeypatch.setitem(SUBJECTS, "steps", lambda long: iter([GOOD]))
    with pytest.raises(SystemExit) as ended:
        main(["stress", "steps"])
    assert ended.value.code == 0


@pytest.mark.slow
def test_ctrl_c_in_a_study_ends_it():
    command = [sys.executable, "-m", "benchmarks", "stress"]
    root = Path(__file__).parents[2]
    process = subprocess.Popen(command, cwd=root, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    time.sleep(2.5)  # at whatever it is then
    process.send_signal(signal.SIGTERM)
    _, err = process.communicate(timeout=60)
    assert process.returncode in (130, -signal.SIGTERM) and "Traceback" not in err


GOOD = Case("family", "good", lambda by: [Figure("error", 1.0, 2.0)])
BAD = Case("family", "bad", lambda by: [Figure("error", 3.0, 2.0)])
