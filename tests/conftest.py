"""The suite runs on the compiled twin where it is built; ``pytest --backend python`` runs it on the Python method."""

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
