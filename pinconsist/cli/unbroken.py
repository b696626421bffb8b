"""A stdout that may break off without taking the run along."""

from __future__ import annotations

import os
import sys
from contextlib import contextmanager


@contextmanager
def unbroken_stdout():
    """Within the block, what cannot be printed any more is left out.

    Yields the list of errors: the first is told on stderr, unless it is a reader that has gone, as in ``... | head``.
    """
    real, errors = sys.stdout, []
    if real is None:  # closed from the start
        yield errors
        return
    sys.stdout = _Unbroken(real, errors)
    try:
        yield errors
    finally:
        sys.stdout.flush()
        sys.stdout = real


class _Unbroken:
    def __init__(self, stream, errors):
        self._stream, self._errors = stream, errors

    def __getattr__(self, name):
        return getattr(self._stream, name)

    def write(self, text):
        self._tried(lambda: self._stream.write(text))
        return len(text)

    def flush(self):
        self._tried(self._stream.flush)

    def _tried(self, call):
        try:
            call()
        except OSError as error:
            if not (self._errors or isinstance(error, BrokenPipeError)):
                print(f"pinconsist: error: cannot print: {error.strerror}; files are written", file=sys.stderr)
            self._errors.append(error)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self._stream.fileno())  # also for what the interpreter flushes at its end
            os.close(nowhere)
