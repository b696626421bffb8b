"""Skip tests whose optional packages are not installed, with their names."""

from contextlib import contextmanager

import pytest

import pinconsist as pc


@contextmanager
def skips_missing_extras():
    """A context in which a missing extra skips the test."""
    try:
        yield
    except pc.MissingExtraError as error:
        pytest.skip(str(error))
