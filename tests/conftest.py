"""What all tests share."""

import os
import signal

if "PYTEST_XDIST_WORKER" in os.environ:  # BLAS threads of several workers wait for one another: five times the work
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")

import pinocchio as pin
import pytest

# Subjects whose tests rounding could change: for runs under another OPENBLAS_CORETYPE.
KERNELS = "adaptive dense drive energy engine long_chains manifolds mechanism order paper rank".split()
KERNELS += "index1 reactions statics stress terms".split()


def pytest_configure(config):
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as in a background job of a shell; tests send it
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    """A worker has tests that follow each other: what a module keeps for its tests is made once, not by each worker."""
    from xdist.scheduler import WorkStealingScheduling

    return WorkStealingScheduling(config, log) if config.getoption("dist") == "load" else None


def subject_of(path):
    return path.stem.removeprefix("test_")


def pytest_ignore_collect(collection_path, config):
    """Files without the marker that is asked for are not read; half of a worker's start."""
    asked = config.option.markexpr.startswith("kernels")
    return True if asked and collection_path.suffix == ".py" and subject_of(collection_path) not in KERNELS else None


def pytest_collection_modifyitems(items):
    for item in items:
        if subject_of(item.path) in KERNELS:
            item.add_marker("kernels")


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
