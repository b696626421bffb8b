"""What a run leaves out can be switched on for a measurement, and changes no result."""

import json
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers import command_line

import pinconsist as pc
from benchmarks.ablate import SKIPS, ablate
from benchmarks.app import main
from pinconsist.errors import InputError
from pinconsist.mechanism.system import MechanismSystem

called = partial(command_line.called, main=main)


@pytest.fixture(scope="module")
def plain():
    return pc.simulate(pc.load("crank_rocker"), (0.0, 0.3), rtol=1e-9, atol=1e-9, backend="python")


@pytest.mark.parametrize("skip", SKIPS, ids=lambda skip: skip.name)
def test_a_switch_changes_the_way_and_not_the_solution(skip, plain):
    methods = dict(vars(MechanismSystem))
    with skip.switch():
        sol = pc.simulate(pc.load("crank_rocker"), (0.0, 0.3), rtol=1e-9, atol=1e-9, **skip.wishes, backend="python")
    assert dict(vars(MechanismSystem)) == methods
    for part, size in (("q", 1.0), ("v", 10.0), ("lam", 100.0)):
        np.testing.assert_allclose(getattr(sol, part)[-1], getattr(plain, part)[-1], atol=1e-6 * size)


def test_the_switches_act():
    mech = pc.load("crank_rocker")
    by_name = {skip.name: skip for skip in SKIPS}

    def run(name):
        skip = by_name[name]
        with skip.switch():
            return pc.simulate(mech, (0.0, 0.3), **skip.wishes, backend="python")

    plain = pc.simulate(mech, (0.0, 0.3), backend="python")
    assert plain.system.vector_like and not run("no charts where joints are vector-like").system.vector_like
    assert run("one look at the equations where one is enough").nfev > 1.5 * plain.nfev
    assert run("no dense output").sol is not None
    fast, slow = plain.system._kept_rows, run("only the kept rows are evaluated").system._kept_rows
    data, q = plain.system.data, plain.q[-1]
    pin.computeJointJacobians(plain.system.model, data, q)
    for one, other in zip(fast(data, q, 0.0), slow(data, q, 0.0), strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)
    assert fast.__qualname__ != slow.__qualname__


def test_rows_of_the_measurement(capsys):
    rows = json.loads(called(capsys, "ablate", "four_bar", "--repeats", 1, "--json")[1])["ablate"]
    names = [row["skip"] for row in rows]
    assert (names[0], names[-1]) == ("nothing switched off", "no geometry") and len(names) == len(set(names))
    assert (
        all(row["ratio"] > 0.0 and row["time"] > 0.0 and row["steps"] > 5 for row in rows) and rows[0]["ratio"] == 1.0
    )
    printed = called(capsys, "ablate", "four_bar", "--repeats", 1)[1]
    assert all(name in printed for name in names)


def test_only_what_a_scene_skips_is_switched_off():
    concerned = {}
    for scene in ("four_bar", "chain_32"):
        mech = pc.load(scene)
        system = MechanismSystem(mech, pc.assemble(mech).q)
        concerned[scene] = {skip.name for skip in SKIPS if skip.concerns(system)}
    assert concerned["chain_32"] - concerned["four_bar"] == {"a kept Newton matrix where a new one is dear"}


def test_bad_input():
    with pytest.raises(InputError, match="repeats"):
        list(ablate(["four_bar"], repeats=0))
    with pytest.raises(InputError, match="nowhere"):
        list(ablate(["nowhere"]))
