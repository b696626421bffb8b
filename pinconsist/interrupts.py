"""Signals that end a run: they are noted when they come, and their handlers called between steps."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import contextmanager, nullcontext, suppress

IMPATIENCE = 1.0  # s within which several signals are one: fingers bounce, and supervisors send several
ENDING = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_came: list[float] = []


@contextmanager
def ended_like_ctrl_c():
    """Within the block SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does, and several at once raise one.

    Only signals that would end the process are changed: one that the application handles, or that `nohup` ignores,
    stays so. Signals belong to the main thread; in others nothing happens.
    """
    defaults = (signal.SIG_DFL, signal.default_int_handler)
    changed = {each: handler for each, handler in _handlers().items() if handler in defaults}
    if changed:
        _came.clear()
    for each in changed:
        signal.signal(each, _interrupt)
    try:
        yield
    finally:
        _put_back(changed, _interrupt)


def ignored_from_now_on() -> None:
    """The process ends because of a signal; those that still come must not end it before its exit code is out."""
    for each in _handlers():
        signal.signal(each, signal.SIG_IGN)


def interrupted() -> bool:
    """Whether a signal came within a block of `ended_like_ctrl_c`, also where `simulate` has dealt with it."""
    return bool(_came)


@contextmanager
def deferred(*, late=True, impatient=True):
    """Within the block signals are noted. Their handlers are called when somebody asks, or at the end.

    Yields ``interrupted()``, which calls the handlers of the signals that have come, and returns whether the work
    should stop. Signals without a handler in Python are left alone. Blocks may be nested; the outermost one counts.

    Parameters
    ----------
    late : bool
        Whether a KeyboardInterrupt of a handler is raised at the end of a block that went well. Without it the signal
        came too late to end what is finished. Other exceptions of handlers, such as SystemExit, are always raised.
    impatient : bool
        Whether the second signal, more than a second after the first, acts at once: user-defined functions may hang.
    """
    if not _handlers():
        yield lambda: False
        return
    outermost, before, done = not _noted.active, _noted.impatient, False
    try:
        _noted.impatient = impatient
        if outermost:
            _noted.begin()
        yield _noted.call_handlers
        done = True
    finally:
        _noted.impatient = before
        if outermost:
            with suppress(KeyboardInterrupt) if done and not late else nullcontext():
                _noted.end()


class _Noted:
    """The handler that notes signals, in place of those that were there."""

    def __init__(self):
        self.active, self.impatient, self.since = False, False, 0.0
        self.handlers, self.waiting, self.error = {}, [], None

    def __call__(self, number, frame):
        now = time.monotonic()
        self.since = self.since if self.waiting else now
        self.waiting.append(number)
        if self.impatient and now - self.since > IMPATIENCE and self.call_handlers():
            raise KeyboardInterrupt

    def begin(self):
        self.active, self.waiting, self.error = True, [], None
        self.handlers = {each: handler for each, handler in _handlers().items() if callable(handler)}
        for each in self.handlers:
            signal.signal(each, self)

    def end(self):
        self.active = False
        _put_back(self.handlers, self)
        if self.call_handlers():
            raise self.error or KeyboardInterrupt

    def call_handlers(self) -> bool:
        """Call each that has a signal waiting; whether one raised an exception, which ends the run."""
        stop = self.error is not None
        while self.waiting:
            number = self.waiting.pop()
            self.waiting = [each for each in self.waiting if each != number]
            try:
                self.handlers[number](number, None)
            except KeyboardInterrupt:
                stop = True
            except BaseException as error:  # such as SystemExit, which is raised at the end of the block
                self.error, stop = error, True
        return stop


_noted = _Noted()


def _handlers() -> dict:
    """Signal → its handler; none of them in threads other than the main one, which alone is given signals."""
    in_main = threading.current_thread() is threading.main_thread()
    return {each: signal.getsignal(each) for each in ENDING} if in_main else {}


def _put_back(handlers, instead):
    try:
        for each, handler in handlers.items():
            if signal.getsignal(each) is instead:
                signal.signal(each, handler)
    except BaseException:  # raised by a handler that is back already
        _put_back(handlers, instead)
        raise


def _interrupt(number, frame):
    now = time.monotonic()
    if not _came or now - _came[-1] > IMPATIENCE:
        _came.append(now)
        raise KeyboardInterrupt
