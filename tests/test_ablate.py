"""What is skipped is told, can be switched off for a measurement, and changes no result."""

import dataclasses
import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.cli.ablate import ablate as ablate_command
from pinconsist.errors import InputError
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.study.ablate import SKIPS, ablate


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
    rows = ablate_command(["four_bar"], 1, False)
    names = [row["skip"] for row in rows]
    assert (names[0], names[-1]) == ("nothing switched off", "no geometry") and len(names) == len(set(names))
    assert (
        all(row["ratio"] > 0.0 and row["time"] > 0.0 and row["steps"] > 5 for row in rows) and rows[0]["ratio"] == 1.0
    )
    printed = capsys.readouterr().out
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


def test_what_was_skipped_is_told(tmp_path):
    """All of it in the method; in the summary the loop rows alone, which a reader of its multipliers misses."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.1), backend="python")
    rows = "3 of 5 loop rows (dependent or zero)"
    for each in (sol, pc.Solution.load(sol.save(tmp_path / "run"))):
        assert each.method["skipped"] == ["charts (all joints vector-like)", rows, "geometry", "dense output", "events"]
        assert f"skipped: {rows}" in each.summary().splitlines()
    events = [lambda t, q, v, lam: t - 1.0]
    asked = pc.simulate(mech, (0.0, 0.1), dense_output=True, events=events, backend="python").method["skipped"]
    assert "geometry" in asked and "dense output" not in asked and "events" not in asked
    assert "skipped" not in pc.simulate(pc.load("planar_pendulum"), (0.0, 0.1)).summary()


def test_the_summary_tells_rejected_steps_once():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.1))
    for rejected, told in (
        ({"error": 29, "newton": 0}, "steps (29 rejected by error)\n"),
        ({"error": 2, "newton": 1}, "steps (3 rejected: 2 by error, 1 by newton)\n"),
        ({"error": 0}, "steps\n"),
    ):
        assert told in dataclasses.replace(sol, rejected=rejected).summary()


def test_importing_costs_little():
    """Beside Pinocchio (and numpy with it) only a few modules of Python's own library come with the package."""
    code = "import sys, pinocchio; before = set(sys.modules); import pinconsist; print(*set(sys.modules) - before)"
    printed = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    own = {name for name in printed if name.startswith("pinconsist")}
    assert own == {"pinconsist"} and len(printed) < 20
    assert all(name.split(".")[0] in sys.stdlib_module_names for name in set(printed) - own)
