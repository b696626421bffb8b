"""The suite runs on the compiled twin where it is built; ``pytest --backend python`` runs it on the Python method."""

import os
import signal
import sys
from pathlib import Path

if "PYTEST_XDIST_WORKER" in os.environ:  # BLAS threads of several workers wait for one another: five times the work
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")

import pinocchio as pin
import pytest

from pinconsist import _core

# Subjects whose tests rounding could change, and those that depend on who makes the steps: for the markers.
KERNELS = "adaptive dense drive energy long_chains manifolds mechanism one_step order paper rank reactions".split()
KERNELS += "statics stepper stress twin".split()
INTEGRATOR = "bad_input events explain forces lock loop_kinds models robots signals solution".split()
INTEGRATOR += [name for name in KERNELS if name != "twin"]  # which runs both methods anyway
MARKED = {"kernels": KERNELS, "integrator": INTEGRATOR}


def pytest_addoption(parser):
    parser.addoption("--backend", choices=("compiled", "python"), help="run everything on one of the two")


def pytest_configure(config):
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a background job of a shell; tests send it
        signal.signal(signal.SIGINT, signal.default_int_handler)
    wanted = config.getoption("--backend")
    if wanted == "python":  # in this process, and in those that tests start
        sys.modules["pinconsist._core.twin"] = None
        _core.load.cache_clear()
        paths = [str(Path(__file__).parent / "without_twin"), *filter(None, [os.environ.get("PYTHONPATH")])]
        os.environ["PYTHONPATH"] = os.pathsep.join(paths)
    elif wanted == "compiled" and _core.load()[0] is None:
        raise pytest.UsageError(_core.load()[1])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A worker has tests that follow each other: what a module keeps for its tests is made once, not by each worker."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None


def shown_elsewhere(item):
    """For the compiled method alone, or with the Python method asked for, beside a test that takes what is at hand."""
    asks_for = item.callspec.params.get("backend") if hasattr(item, "callspec") else None
    return item.get_closest_marker("compiled") or asks_for == "python"


def subject_of(path):
    return path.stem.removeprefix("test_")


def pytest_ignore_collect(collection_path, config):
    """Files without the marker that is asked for are not read; half of a worker's start."""
    marker = config.option.markexpr.removesuffix(" and not slow")
    if marker in MARKED and collection_path.suffix == ".py" and subject_of(collection_path) not in MARKED[marker]:
        return True


def pytest_collection_modifyitems(items):
    for item in items:
        for marker, subjects in MARKED.items():
            if subject_of(item.path) in subjects and not (marker == "integrator" and shown_elsewhere(item)):
                item.add_marker(marker)


@pytest.fixture(autouse=True)
def chance_as_always():
    """Pinocchio's random bodies are the same in every order of the tests, and on every worker."""
    pin.seed(0)


@pytest.fixture(autouse=True)
def signals_as_before():
    """A command that was interrupted within a test leaves its process deaf, as it should be at its end."""
    ending = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {each: signal.getsignal(each) for each in ending}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)
