"""Signals that end a run: what was reached is kept."""

from __future__ import annotations

import signal
import threading
from contextlib import contextmanager

_ENDING = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP") if hasattr(signal, name)]


@contextmanager
def ended_like_ctrl_c():
    """Within the block SIGTERM and SIGHUP raise KeyboardInterrupt, as Ctrl-C does.

    Only signals that would end the process are changed: one that the application handles, or that `nohup` ignores,
    stays so. Signals belong to the main thread; in others nothing happens.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    changed = [each for each in _ENDING if signal.getsignal(each) is signal.SIG_DFL]
    for each in changed:
        signal.signal(each, signal.default_int_handler)
    try:
        yield
    finally:
        for each in changed:
            signal.signal(each, signal.SIG_DFL)


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
