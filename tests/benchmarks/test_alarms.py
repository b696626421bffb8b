"""Verdicts against true errors: what counts as a missed and as a false alarm."""

import json

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from benchmarks import alarms
from benchmarks.alarms import Judged, judged, kind, scene
from benchmarks.app import main
from benchmarks.chains.scenes import random_chain

BASE = {"seed": 1, "pulse": 0.0, "method": "BDF", "tol": 1e-4}


def row(stated, true, tolerances, concerns=(), estimated=True):
    found = {"stated": stated, "true": true, "tolerances": tolerances, "concerns": concerns, "estimated": estimated}
    return Judged(**BASE, **found)


def test_kinds_of_wrong_verdicts():
    right, off = (1e-5, 1e-4, 1e-5), (1e-3, 1e-4, 1e-5)
    assert kind(row(right, right, (0.1, 0.1))) == ""
    assert kind(row(right, off, (10.0, 0.1))) == "missed"
    assert kind(row(right, off, (10.0, 0.1), ("error",))) == ""
    assert kind(row(right, right, (0.1, 0.1), ("energy",))) == "false"
    assert kind(row(right, right, (0.1, 0.1), ("joint limits",))) == ""
    assert kind(row((0.0, 0.0, 1e-5), off, (200.0, 0.1), estimated=False)) == "not seen"
    assert kind(row((1e-12, 1e-12, 0.0), (1e-8, 1e-9, 0.0), (0.0, 0.0))) == ""  # rounding, below all tolerances


@pytest.mark.parametrize("pulse", [0.0, 0.1])
def test_a_run_is_compared_with_its_reference(pulse):
    found = judged(Judged(2, pulse, "Radau", 1e-5), 0.1)
    assert kind(found) == "" and found.estimated and found.verdict.endswith(": ok")
    assert max(found.tolerances) < 10 and len(found.true) == len(found.stated) == 3


def test_a_pulse_acts_for_its_part_of_the_span():
    mech, q, v, (start, end) = scene(5, 0.01, 2.0)
    force = mech.forces[-1].function
    assert end - start == pytest.approx(0.02) and not force(start, q, v).any() and not force(end, q, v).any()
    assert np.count_nonzero(force(0.5 * (start + end), q, v)) == 1


def test_the_command_counts(capsys):
    with pytest.raises(SystemExit) as ended:
        main(["alarms", "--count", "1", "--pulses", "1", "--seed", "2", "--tol", "1e-4", "--until", "0.1", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0 and told["wrong"] == [] and [each["runs"] for each in told["summary"]] == [1, 1, 1, 1]
    assert set(alarms.METHODS) == {each["method"] for each in told["summary"]}


@pytest.mark.parametrize("seed", [5118, 5122])
def test_the_stated_error_of_a_run_far_below_its_tolerance(seed):
    """The ends that rows force on the finer run cost it digits, which the long steps of the run keep."""
    mech, q, v = random_chain(seed)
    sol = pc.simulate(mech, (0.0, 1.0), q, v, rtol=1e-7, atol=1e-9, method="Radau")
    exact = pc.paper.reference_solution(sol.system, 0.0, sol.q[0], sol.v[0], sol.t, rtol=1e-12, atol=1e-13)
    error = max(np.abs(pin.difference(mech.model, a, b)).max() for a, b in zip(sol.q, exact.q, strict=True))
    assert error / 10 < sol.check(error=True).error.q < 10 * error
