"""What a run leaves out can be done for a measurement, and changes no result."""

import json
from functools import partial

import numpy as np
import pytest
from helpers import command_line

import pinconsist as pc
from benchmarks.ablate import PLAIN, VARIANTS, ablate, timed_run
from benchmarks.app import main
from benchmarks.rules import OFF, rules
from pinconsist.engine import required
from pinconsist.errors import InputError
from pinconsist.mechanism.system import MechanismSystem

called = partial(command_line.called, main=main)
BY_NAME = {variant.name: variant for variant in VARIANTS}


def run(variant, tol=1e-6):
    return timed_run(pc.load("crank_rocker"), 0.3, variant, tol, min(tol, 1e-8))[1]


@pytest.fixture(scope="module")
def plain():
    return run(PLAIN, 1e-10)


@pytest.mark.parametrize("variant", VARIANTS, ids=lambda variant: variant.name)
def test_a_variant_changes_the_way_and_not_the_solution(variant, plain):
    reached = run(variant, 1e-9)
    assert reached.status == 0
    for part, size in (("p", 1.0), ("v", 10.0), ("lam", 100.0)):
        np.testing.assert_allclose(getattr(reached, part)[-1], getattr(plain, part)[-1], atol=1e-6 * size)


def test_the_switches_act():
    assert run(BY_NAME["iteration forecast off"]).nfev > 1.3 * run(PLAIN).nfev
    assert run(BY_NAME["dense output"]).dense is not None and run(PLAIN).dense is None


def test_rows_of_the_measurement(capsys):
    rows = json.loads(called(capsys, "ablate", "four_bar", "--repeats", 1, "--json")[1])["ablate"]
    names = [row["variant"] for row in rows]
    assert names[0] == PLAIN.name and len(names) == len(set(names))
    assert all(row["ratio"] > 0.0 and row["time"] > 0.0 and row["steps"] > 5 for row in rows)
    assert {row["ratio"] for row in rows if row["variant"] == PLAIN.name} == {1.0}
    printed = called(capsys, "ablate", "four_bar", "--repeats", 1)[1]
    assert all(name in printed for name in names)


def test_only_what_a_scene_leaves_out_is_done():
    concerned = {}
    for scene in ("four_bar", "chain_32"):
        mech = pc.load(scene)
        system = MechanismSystem(mech, pc.assemble(mech).q)
        concerned[scene] = {variant.name for variant in VARIANTS if variant.concerns(system)}
    assert concerned["chain_32"] - concerned["four_bar"] == {"jacobian reuse off"}
    assert concerned["four_bar"] - concerned["chain_32"] == {"kept derivatives off"}


def test_a_rule_that_is_switched_off_changes_some_runs():
    """Without waiting, the number of stages grows at once; the constant is as before afterwards."""
    before = required().constants()
    assert {name for of_method in OFF.values() for name in of_method} <= set(before)
    rows = {row.constant: row for row in rules(["Radau"], {"four_bar": (0.3, 0.0), "n_four_bar_2": (2.0, -1.0)})}
    assert rows.keys() == OFF["Radau"].keys() and all(row.runs == 8 for row in rows.values())
    assert rows["CALM"].changed > 2 and rows["CALM"].steps < 1.0
    assert required().constants() == before


def test_bad_input():
    with pytest.raises(InputError, match="repeats"):
        list(ablate(["four_bar"], repeats=0))
    with pytest.raises(InputError, match="nowhere"):
        list(ablate(["nowhere"]))
