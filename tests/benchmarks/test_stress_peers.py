"""The stress suite of the peers: what is sampled, what counts, and that nothing can hang it."""

import json
import os
import sys
import time
from functools import partial

import numpy as np
import pytest
from helpers import command_line

from benchmarks.app import main
from benchmarks.linkages import START, four_bar
from benchmarks.peers.problem import Peer, Rows, SolverFailed
from benchmarks.peers.scipy_index1 import ScipyIvp
from benchmarks.stress import SUBJECTS, by_peers, cases
from benchmarks.stress.case import EITHER, HELD, REFUSED, Case, Figure, completed
from pinconsist.errors import InputError

called = partial(command_line.called, main=main)


class Fake(Peer):
    """Does as it is told; its rows stand still."""

    package, module, name = "numpy", "numpy", "fake"

    def __init__(self, act=lambda: None):
        self.act = act

    def prepare(self, problem, setting):
        def read(result, thin):
            still = np.zeros((2, 1))
            return Rows(
                np.array(problem.span), still + problem.q0, still + problem.v0, still + np.zeros(problem.system.rows.nc)
            )

        return self.act, read


def fail():
    raise SolverFailed("no more steps")


def simulated(by, **options):
    sol = completed(by.simulate(four_bar(), (0.0, 0.1), START, rtol=1e-7, atol=1e-7, max_steps=1000, **options))
    found = sol.check(error=False)
    return [Figure("loop gap [m]", found.position, 1e-9), Figure("energy error", found.energy_error, 1e-3)]


def case(check=simulated, expected=HELD, family="family"):
    return Case(family, "what", check, expected, "a reason in other words")


@pytest.mark.parametrize(
    ("peer", "expected", "outcome"),
    [
        (None, HELD, "held"),
        (ScipyIvp("DOP853"), HELD, "held"),
        (ScipyIvp("DOP853"), REFUSED, "FAILED"),
        (Fake(), HELD, "FAILED"),  # the four-bar falls
        (Fake(fail), EITHER, "refused"),
        (Fake(fail), HELD, "FAILED"),
    ],
)
def test_what_counts(peer, expected, outcome):
    def check(by):
        moved = np.abs(by.simulate(four_bar(), (0.0, 0.1), START, rtol=1e-7, atol=1e-7, max_steps=1000).q[-1, 0] + 1.0)
        return [*simulated(by), Figure("stood still", 1.0 if moved < 1e-3 else 0.0, 0.5)]

    found, *_ = by_peers.judged(case(check, expected), peer)
    assert found == outcome


def test_what_is_not_for_a_peer():
    def told(**options):
        return by_peers.judged(case(lambda by: simulated(by, **options)), ScipyIvp("LSODA"))[:2]

    assert told(step=1e-3) == ("cannot", "step: not with this method")
    assert told(events=[]) == ("cannot", "events: not with this method")
    fixed = Fake()
    fixed.fixed_step = True
    assert by_peers.judged(case(family="tolerance"), fixed) == ("cannot", "it has no error control")
    fixed.module = "no_such_module"
    outcome, reason = by_peers.judged(case(), fixed)
    assert outcome == "cannot" and "not installed" in reason


def test_a_peer_need_only_keep_to_its_tolerance():
    """Index 1 at 1e-7 drifts off loops by more than the rounding that the package is held to."""
    tight = case(lambda by: simulated(by)[:1])
    outcome, _, _, gap, criterion = by_peers.judged(tight, ScipyIvp("LSODA"))
    assert outcome == "held" and 1e-9 < gap < criterion == pytest.approx(1e-4)
    assert by_peers.judged(tight, None)[4] == 1e-9


def test_nothing_hangs_and_a_dead_process_is_replaced(monkeypatch):
    acts = {"hangs": lambda: time.sleep(60), "dies": lambda: os._exit(3), "gives up": fail}
    known = {by_peers.OWN: None} | {name: Fake(act) for name, act in acts.items()}
    monkeypatch.setattr(by_peers, "methods", lambda: known)
    start = time.monotonic()
    found = list(by_peers.outcomes([case(), case(expected=EITHER)], limit=2.0))
    assert time.monotonic() - start < 30.0
    assert [(name, outcome.outcome) for name, outcome in found] == [
        (by_peers.OWN, "held"), ("hangs", "cut"), ("dies", "FAILED"), ("gives up", "FAILED"),
        (by_peers.OWN, "held"), ("hangs", "cut"), ("dies", "FAILED"), ("gives up", "refused"),
    ]  # fmt: skip
    reasons = [outcome.reason for _, outcome in found]
    assert "not done after 2 s" in reasons[1] and "its process died (3)" in reasons[2]


def test_a_sample_is_spread_over_every_family():
    every = list(cases(by_peers.SUBJECTS))
    few = by_peers.sample(every, 3)
    families = {one.family for one in every}
    assert {one.family for one in few} == families and len(few) == 3 * len(families)
    masses = [one.varied for one in few if one.family == "mass ratio"]
    assert masses[0] == "crank times 1e+02" and "1e+08" in masses[-1]
    with pytest.raises(InputError, match="at least one"):
        by_peers.sample(every, 0)
    with pytest.raises(InputError, match="limit"):
        next(by_peers.outcomes(few, limit=0.0))


def test_the_command(monkeypatch, capsys):
    known = {by_peers.OWN: None, "scipy LSODA": ScipyIvp("LSODA"), "fake": Fake(fail)}
    monkeypatch.setattr(by_peers, "methods", lambda: known)
    monkeypatch.setitem(SUBJECTS, "scales", lambda long: iter([case()]))
    code, text, _ = called(capsys, "stress", "scales", "--peers")
    assert code == 0 and "1/1" in text and "0/1" in text and "no more steps" in " ".join(text.split())
    rows = json.loads(called(capsys, "stress", "scales", "--peers", "--json")[1])["cases"]
    assert [(row["method"], row["outcome"]) for row in rows] == [
        (by_peers.OWN, "held"), ("scipy LSODA", "held"), ("fake", "FAILED"),
    ]  # fmt: skip
    code, _, err = called(capsys, "stress", "steps", "--peers")
    assert code == 2 and "steps: not with --peers" in err


class Refusing:
    """A finder of modules that refuses one, as an application's may."""

    def find_spec(self, name, path=None, target=None):
        if name == "away":
            raise ModuleNotFoundError("No module named 'away'", name=name)


def test_what_is_not_installed_is_said(monkeypatch, capsys):
    absent, refused = Fake(), Fake()
    absent.package = absent.module = "not_there"
    refused.package, refused.module = "far-away", "away"
    monkeypatch.setattr(sys, "meta_path", [Refusing(), *sys.meta_path])
    known = {by_peers.OWN: None, "absent": absent, "again": absent, "refused": refused, "fake": Fake(fail)}
    monkeypatch.setattr(by_peers, "methods", lambda: known)
    monkeypatch.setitem(SUBJECTS, "scales", lambda long: iter([case()]))
    code, text, _ = called(capsys, "stress", "scales", "--peers")
    assert code == 0 and "ModuleNotFoundError" not in text and text.endswith(
        "\nnot_there is not installed: pip install --group benchmarks\n"
        "far-away is not installed: pip install --group benchmarks\n"
    )  # fmt: skip
    assert by_peers.judged(case(), refused)[0] == by_peers.CANNOT
