"""Progress on stderr if it is a terminal, and tolerance of a stdout that is closed early."""

import os
import sys
import time
from contextlib import contextmanager, nullcontext
from typing import Any

from .output import on_terminal

PATIENCE = 1.0  # s before the bar of a run appears
PERIOD = 0.1  # s between its updates


def doing(what: str):
    """A context in which stderr, if it is a terminal, shows what is being done."""
    if not on_terminal():
        return nullcontext()
    from rich.console import Console
    from rich.text import Text

    return Console(stderr=True).status(Text(f"{what} …"))


def bar(*after):
    """A progress bar of `rich` on stderr, as wide as the terminal: percentage, time left, and further texts.

    It disappears when done.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.percentage:3.0f} %"), BarColumn(None), TimeRemainingColumn(), TextColumn("left,")
    console = Console(stderr=True)
    return Progress(*columns, *map(TextColumn, after), console=console, transient=True, expand=True)


@contextmanager
def counting(what: str, total=None, done=0):
    """A context with a function of (number done, total) that updates a bar; None if stderr is not a terminal."""
    if not on_terminal():
        yield None
        return
    with bar(f"{{task.completed}} of {{task.total}} {what}") as shown:
        task = shown.add_task("", total=total, completed=done)
        yield lambda done, total=total: shown.update(task, completed=done, total=total)


class RunProgress:
    """A context with a callback for `simulate` that shows the progress of a run; None if stderr is not a terminal."""

    each_step = False  # it is called with batches of steps, see dae/output.py

    def __init__(self, start: float, end: float):
        self.start, self.end, self.steps = start, end, 0
        self.bar: Any = None
        self.next_update = time.monotonic() + PATIENCE

    def __enter__(self):
        return self if on_terminal() else None

    def __exit__(self, *_):
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, t, step, order, count):
        self.steps += count
        if time.monotonic() < self.next_update:
            return
        self.next_update = time.monotonic() + PERIOD
        text = f"t = {t:.4g} of {self.end:g} s, {self.steps} steps"
        if self.bar is None:
            self.bar = bar("{task.description}")
            self.task = self.bar.add_task(text, total=abs(self.end - self.start))
            self.bar.start()
        self.bar.update(self.task, completed=abs(t - self.start), description=text)


class BrokenPipeTolerated:
    """A context in which a closed stdout does not end the run: the rest of the output is dropped.

    Its value is the list of errors. The first error is reported on stderr, unless the pipe was closed by its reader, as
    in ``... | head``.
    """

    def __enter__(self):
        self.stream, self.errors = sys.stdout, []
        sys.stdout = self
        return self.errors

    def __exit__(self, *_):
        self.flush()
        sys.stdout = self.stream

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def write(self, text):
        self._try("write", text)
        return len(text)

    def flush(self):
        self._try("flush")

    def _try(self, method, *arguments):
        if self.stream is None:  # it was closed at the start
            return
        try:
            getattr(self.stream, method)(*arguments)
        except OSError as error:
            if not (self.errors or isinstance(error, BrokenPipeError)):
                print(f"pinconsist: error: cannot print: {error.strerror}; files are written", file=sys.stderr)
            self.errors.append(error)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())  # also for what the interpreter flushes at its end
            os.close(nowhere)
