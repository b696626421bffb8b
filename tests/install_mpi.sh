#!/usr/bin/env bash
# What the MPI run of test_sweep_engines.py needs: Debian's Open MPI (as root) and mpi4py in the Python at hand.
set -euo pipefail

if ! command -v mpiexec >/dev/null; then
    apt-get update -qq
    DEBIAN_FRONTEND=noninteractive apt-get install -y -qq libopenmpi-dev openmpi-bin
fi
python -m pip install --quiet 'mpi4py>=4.0'
