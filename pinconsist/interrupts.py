"""Signals that end a run: what was reached is kept."""

from __future__ import annotations

import signal
import threading
import time
from contextlib import contextmanager

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
    if threading.current_thread() is not threading.main_thread():
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
    if threading.current_thread() is threading.main_thread():
        for each in (signal.SIGINT, *_ENDING):
            signal.signal(each, signal.SIG_IGN)


def interrupted() -> bool:
    """Whether a signal came within the block, also where who was interrupted caught it, as `simulate` does."""
    return bool(_came)


@contextmanager
def held_back():
    """Within the block Ctrl-C, SIGTERM and SIGHUP wait, so that a file is written to its end."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, *_ENDING})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _interrupt(number, frame):
    now = time.monotonic()
    if not _came or now - _came[-1] > IMPATIENCE:
        _came.append(now)
        raise KeyboardInterrupt
