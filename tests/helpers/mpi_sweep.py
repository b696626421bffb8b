"""A sweep on MPI, run by test_sweep_engines.py: mpiexec -n 3 python -m mpi4py.futures mpi_sweep.py RESULT."""

import json
import sys
from pathlib import Path

import numpy as np
import sweep_cases as cases
from mpi4py.futures import MPIPoolExecutor

import pinconsist as pc

if __name__ == "__main__":
    with MPIPoolExecutor() as pool:
        turning = pc.sweep(cases.turning, cases.SPEEDS, executor=pool)
        drawn = pc.sweep(cases.drawn, list(enumerate(np.random.SeedSequence(7).spawn(3))), executor=pool)
        picky = pc.sweep(cases.picky, cases.PICKY, executor=pool)
        ranks = {outcome.value for outcome in pc.sweep(cases.process, range(20), executor=pool)}
    told = {
        "turning": [outcome.value.hex() for outcome in turning],
        "drawn": [outcome.value for outcome in drawn],
        "picky": [[outcome.error, outcome.message] for outcome in picky],
        "processes": len(ranks),
    }
    Path(sys.argv[1]).write_text(json.dumps(told))
