"""Progress on stderr while somebody watches, and a stdout that may be closed early."""

from __future__ import annotations

import os
import sys
import time
from contextlib import contextmanager, nullcontext
from typing import Any

from .output import on_terminal

PATIENCE = 1.0  # s before the bar of a run appears
PERIOD = 0.1  # s between its updates


@contextmanager
def doing(what: str):
    """Show on stderr what takes its time, where somebody may be watching."""
    if not on_terminal():
        yield
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status(Text(f"{what} …")):
        yield


def bar(*columns):
    """A progress bar of `rich` on stderr, which disappears when it is done; its columns as texts or classes."""
    from rich.console import Console
    from rich.progress import Progress, TextColumn

    made = [TextColumn(each) if isinstance(each, str) else each for each in columns]
    return Progress(*made, console=Console(stderr=True), transient=True)


def progress_of_run(start, end):
    """A callback of `simulate` that shows how far a run has come, as a context; None where nobody watches."""
    return RunProgress(start, end) if on_terminal() else nullcontext()


class RunProgress:
    """The callback of :func:`progress_of_run`."""

    def __init__(self, start: float, end: float):
        self.start, self.end = start, end
        self.steps, self.last_t = -1, start  # the first call is the initial row
        self.bar: Any = None
        self.order = 0  # of the step; set by the run before each call
        self.next_update = time.monotonic() + PATIENCE

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, t, q, v, lam) -> bool:
        self.steps += 1
        step, self.last_t = abs(t - self.last_t), t
        now = time.monotonic()
        if now >= self.next_update:
            self.next_update = now + PERIOD
            fields = {"t": t, "steps": self.steps, "step": step, "order": self.order}
            if self.bar is None:
                self._open(fields)
            self.bar.update(self.task, completed=abs(t - self.start), **fields)
        return False

    def _open(self, fields):
        from rich.progress import BarColumn, TimeRemainingColumn

        self.bar = bar(
            "t = {task.fields[t]:.4g} of {task.fields[end]:g} s",
            BarColumn(bar_width=12),
            "{task.fields[steps]} steps, now {task.fields[step]:.2g} s, order {task.fields[order]},",
            TimeRemainingColumn(),
            "left",
        )
        self.task = self.bar.add_task("", total=abs(self.end - self.start), end=self.end, **fields)
        self.bar.start()


@contextmanager
def tolerate_broken_pipe():
    """Within the block, what can no longer be printed is left out, so that a run goes on without its reader.

    Yields the list of errors. The first is reported on stderr, unless the reader is gone, as in ``... | head``.
    """
    real = sys.stdout
    if real is None:  # closed from the start
        yield []
        return
    sys.stdout = _Tolerant(real)
    try:
        yield sys.stdout.errors
    finally:
        sys.stdout.flush()
        sys.stdout = real


class _Tolerant:
    def __init__(self, stream):
        self.stream, self.errors = stream, []

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def write(self, text):
        self._try(self.stream.write, text)
        return len(text)

    def flush(self):
        self._try(self.stream.flush)

    def _try(self, call, *arguments):
        try:
            call(*arguments)
        except OSError as error:
            if not (self.errors or isinstance(error, BrokenPipeError)):
                print(f"pinconsist: error: cannot print: {error.strerror}; files are written", file=sys.stderr)
            self.errors.append(error)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())  # also for what the interpreter flushes at its end
            os.close(nowhere)
