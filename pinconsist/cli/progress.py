"""What is shown of work that takes long enough to be watched."""

from __future__ import annotations

import time
from contextlib import contextmanager
from typing import Any

from .output import on_terminal

PATIENCE = 1.0  # s before the bar appears
PERIOD = 0.1  # s between its updates


@contextmanager
def doing(what: str):
    """Say what takes its time, on stderr, where somebody may be watching."""
    if not on_terminal():
        yield
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status(Text(f"{what} …")):
        yield


class Progress:
    """A callback of `simulate` that shows how far a run has come, on stderr; a context manager."""

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
            told = {"t": t, "steps": self.steps, "step": step, "order": self.order}
            if self.bar is None:
                self._open(told)
            self.bar.update(self.task, completed=abs(t - self.start), **told)
        return False

    def _open(self, told):
        from rich.console import Console
        from rich.progress import BarColumn, TextColumn, TimeRemainingColumn
        from rich.progress import Progress as Bar

        self.bar = Bar(
            TextColumn("t = {task.fields[t]:.4g} of {task.fields[end]:g} s"),
            BarColumn(bar_width=12),
            TextColumn("{task.fields[steps]} steps, now {task.fields[step]:.2g} s, order {task.fields[order]},"),
            TimeRemainingColumn(),
            TextColumn("left"),
            console=Console(stderr=True),
            transient=True,
        )
        total = abs(self.end - self.start)
        self.task = self.bar.add_task("", total=total, end=self.end, **told)
        self.bar.start()
