"""What is not installed skips a test, and says what it is."""

from contextlib import contextmanager

import pytest

import pinconsist as pc


@contextmanager
def skips_missing_extras():
    """Within it, an extra that is missing skips the test."""
    try:
        yield
    except pc.MissingExtraError as error:
        pytest.skip(str(error))
