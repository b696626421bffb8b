"""Signals that end a run: what was reached is kept."""

from __future__ import annotations

import signal
import threading
import time
import traceback as tracebacks
from contextlib import ExitStack, contextmanager, nullcontext, suppress

IMPATIENCE = 1.0  # s after a signal in which others mean the same: fingers bounce, and supervisors send several
_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]
_DEFAULTS = (signal.SIG_DFL, signal.default_int_handler)
_came: list[float] = []


@contextmanager
def ended_like_ctrl_c():
    """Within the block SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does, and several at once raise one.

    Only signals that would end the process are changed: one that the application handles, or that `nohup` ignores,
    stays so. Signals belong to the main thread; in others nothing happens.
    """
    if not _in_main_thread():
        yield
        return
    before = {each: signal.getsignal(each) for each in (signal.SIGINT, *_ENDING)}
    changed = {each: handler for each, handler in before.items() if handler in _DEFAULTS}
    if changed:
        _came.clear()
    for each in changed:
        signal.signal(each, _interrupt)
    try:
        yield
    finally:
        for each, handler in changed.items():
            if signal.getsignal(each) is _interrupt:
                signal.signal(each, handler)


def ignored_from_now_on() -> None:
    """The process ends because of a signal; those that still come must not end it before its exit code is out."""
    if _in_main_thread():
        for each in (signal.SIGINT, *_ENDING):
            signal.signal(each, signal.SIG_IGN)


def interrupted() -> bool:
    """Whether a signal came within the block, also where who was interrupted caught it, as `simulate` does."""
    return bool(_came)


@contextmanager
def held_back(*, late=True):
    """Within the block Ctrl-C, SIGTERM and SIGHUP wait, so that what it makes is made to its end.

    They are held back from Python, not from the thread: the system gives a signal to any thread, such as those of
    numpy's BLAS, and Python then handles it in the main one. Only handlers in Python wait; a signal that ends the
    process without them still does. Blocks may be nested.

    Parameters
    ----------
    late : bool
        Whether a KeyboardInterrupt that waited is raised at the end of a block that went well. Without it the handlers
        are told, and nothing is raised: it came too late to end what is finished.
    """
    if not _in_main_thread():
        yield
        return
    outermost, was = not _gate.held, _gate.open
    done = _gate.open = False
    try:
        if outermost:
            _gate.take_over()
        yield
        done = True
    finally:
        with nullcontext() if late or not done else suppress(KeyboardInterrupt):
            if outermost:
                _gate.give_back()
            _gate.open = was
            if was:
                _gate.pass_on()


@contextmanager
def let_through():
    """Within the block, inside of one of `held_back`, signals act at once; so do those that have waited."""
    if not _in_main_thread():
        yield
        return
    was, _gate.open = _gate.open, True
    try:
        _gate.pass_on()
        yield
    finally:
        _gate.open = was


def put_back() -> None:
    """Let a KeyboardInterrupt wait on: it came too late for who caught it, but maybe not for those around."""
    if _in_main_thread():
        _gate.returned = _gate.held


def raised_by_a_handler(error) -> bool:
    """Whether an exception came from the handler of a signal, and not from the code that it broke into."""
    return any(frame.f_code is _Gate.__call__.__code__ for frame, _ in tracebacks.walk_tb(error.__traceback__))


class _Gate:
    """Stands where the handlers stood: lets signals through to them, or keeps them waiting."""

    def __init__(self):
        self.open, self.held, self.returned, self.handlers, self.waiting = True, False, False, {}, []

    def __call__(self, number, frame):
        if self.open:
            self.handlers[number](number, frame)
        elif number not in self.waiting:
            self.waiting.append(number)

    def take_over(self):
        self.held = True
        for number in (signal.SIGINT, *_ENDING):
            if callable(handler := signal.getsignal(number)) and handler is not self:
                self.handlers[number] = handler
                signal.signal(number, self)

    def give_back(self):
        self.held = False
        try:
            while self.handlers:
                number, handler = next(iter(self.handlers.items()))
                if signal.getsignal(number) is self:
                    signal.signal(number, handler)
                del self.handlers[number]
        except BaseException:  # raised by a handler that is back already
            self.give_back()
            raise

    def pass_on(self):
        """Tell the handlers what has waited, each of them, whatever they raise."""
        returned, self.returned = self.returned, False
        with ExitStack() as told:
            while self.waiting:
                told.callback(signal.raise_signal, self.waiting.pop())
        if returned:
            raise KeyboardInterrupt


_gate = _Gate()


def _in_main_thread() -> bool:
    return threading.current_thread() is threading.main_thread()


def _interrupt(number, frame):
    now = time.monotonic()
    if not _came or now - _came[-1] > IMPATIENCE:
        _came.append(now)
        raise KeyboardInterrupt
