"""A pytest plugin: test_twin.py sees both methods, every other test the Python one, which is where the mutants are."""

import pytest

from pinconsist import _core

both = _core.load


def pytest_runtest_setup(item):
    _core.load = both if item.path.name == "test_twin.py" else (lambda: (None, "only Python has mutants"))


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """The tests that most mutants fail come first."""
    items.sort(key=lambda item: ("[four_bar]" not in item.name, "test_same" not in item.name))
