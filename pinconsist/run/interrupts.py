"""Signals that end a run: they are recorded during a step, and handled between steps."""

import signal
import threading
import time
from _signal import getsignal  # those of `signal` make enumerations of all handlers: 30 µs a run
from _signal import signal as handle
from contextlib import contextmanager, nullcontext, suppress

IMPATIENCE = 1.0  # s within which several signals count as one (debounce): supervisors send several
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
_came: list[float] = []  # times at which a signal raised KeyboardInterrupt


@contextmanager
def ended_like_ctrl_c(*, others=True):
    """Within the block SIGTERM and SIGHUP (`others`) raise KeyboardInterrupt, like Ctrl-C; several at once raise one.

    Signals that the application handles itself, or that `nohup` ignores, are left alone.
    """
    defaults = (signal.default_int_handler, signal.SIG_DFL) if others else (signal.default_int_handler,)
    changed = {each: handler for each, handler in _handlers().items() if handler in defaults}
    if changed:
        _came.clear()
    try:
        for each in changed:
            handle(each, _interrupt)
        yield
    finally:
        _put_back(changed, _interrupt)


def ignored_from_now_on() -> None:
    """Ignore further signals: the process is ending because of one, and must still return its exit code."""
    for each in _handlers():
        signal.signal(each, signal.SIG_IGN)


def interrupted(since=0.0) -> bool:
    """Whether a signal has raised KeyboardInterrupt since this `time.monotonic()`, even if it was caught."""
    return bool(_handlers() and _came) and _came[-1] >= since


class deferred:
    """Within the block signals with a Python handler are recorded; the handlers are called on demand, or at its end.

    The context's value is a function that calls them and returns whether the work should stop. Nested blocks end with
    the outermost one. Exceptions of handlers other than KeyboardInterrupt are raised at the end; KeyboardInterrupt at
    the end of a block that succeeded only if `late`. If `impatient`, a second signal more than a second after the
    first acts at once: user-defined functions may hang.
    """

    def __init__(self, *, late=True, impatient=True):
        self.late, self.impatient, self.handlers = late, impatient, {}
        self.waiting, self.since, self.error = set(), 0.0, None

    def __enter__(self):
        before = _handlers()
        self.outer = next((handler for handler in before.values() if isinstance(handler, deferred)), None)
        if self.outer is not None:
            self.impatient, self.outer.impatient = self.outer.impatient, self.impatient
            return self.outer.interrupted
        self.handlers = {each: handler for each, handler in before.items() if callable(handler)}
        try:
            for each in self.handlers:
                handle(each, self)
        except BaseException:  # raised by a handler that is still there
            _put_back(self.handlers, self)
            raise
        return self.interrupted

    def __call__(self, number, frame):
        self.since = self.since if self.waiting else time.monotonic()
        self.waiting.add(number)
        if self.impatient and time.monotonic() - self.since > IMPATIENCE and self.interrupted():
            raise KeyboardInterrupt

    def interrupted(self) -> bool:
        stop = False
        while self.waiting:
            number = self.waiting.pop()
            try:
                self.handlers[number](number, None)
            except KeyboardInterrupt:
                stop = True
                _came.append(time.monotonic())
            except BaseException as error:
                self.error = error
        return stop or self.error is not None

    def __exit__(self, kind, *_):
        if self.outer is not None:
            self.outer.impatient = self.impatient
            return
        with suppress(KeyboardInterrupt) if kind is None and not self.late else nullcontext():
            _put_back(self.handlers, self)
            if self.interrupted():
                raise self.error or KeyboardInterrupt


def _handlers() -> dict:
    """Signal → its handler; empty in threads other than the main one, which alone receives signals."""
    main = threading.current_thread() is threading.main_thread()
    return {each: getsignal(each) for each in SIGNALS if main}


def _put_back(handlers, ours):
    try:
        for each, handler in handlers.items():
            if getsignal(each) is ours:
                handle(each, handler)
    except BaseException:  # raised by a handler that is back already
        _put_back(handlers, ours)
        raise


def _interrupt(number, frame):
    if not interrupted(time.monotonic() - IMPATIENCE):
        _came.append(time.monotonic())
        raise KeyboardInterrupt
