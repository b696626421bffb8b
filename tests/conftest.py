"""The suite runs on the compiled twin where it is built; ``pytest --backend python`` runs it on the Python method."""

import signal

import pytest

from pinconsist import _core


def pytest_addoption(parser):
    parser.addoption("--backend", choices=("compiled", "python"), help="run everything on one of the two")


def pytest_configure(config):
    wanted = config.getoption("--backend")
    if wanted == "python":
        _core.load = lambda: (None, "the tests run on Python")
    elif wanted == "compiled" and _core.load()[0] is None:
        raise pytest.UsageError(_core.load()[1])


@pytest.fixture(autouse=True)
def signals_as_before():
    """A command that was interrupted within a test leaves its process deaf, as it should be at its end."""
    ending = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
    before = {each: signal.getsignal(each) for each in ending}
    yield
    for each, handler in before.items():
        signal.signal(each, handler)
