"""What became of one case, and the call that finds out wherever it is made."""

from __future__ import annotations

import secrets
import signal
import threading
import traceback as tracebacks
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

INTERRUPT = KeyboardInterrupt.__name__
SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What became of one case of a :func:`sweep`.

    Attributes
    ----------
    index : int
        Its place among the cases.
    case : object
        The case, as it was given.
    value : object
        What the function returned; None where it did not.
    error : str
        Type of the error, such as ``"AssemblyError"``; empty where there was none.
    message : str
        What the error says.
    traceback : str
        Where it was raised, as Python prints it; of an error in another process, the place there.
    finished : bool
        The function ran to its end, by a value or by an error of its own. False where no answer came: interrupted,
        lost with a worker that died, or something that cannot be sent to another process. These cases may be tried
        again.
    """

    index: int
    case: object
    value: object = None
    error: str = ""
    message: str = ""
    traceback: str = field(default="", repr=False)
    finished: bool = True

    @property
    def success(self) -> bool:
        """Whether there is a value. That a simulation failed on its way is for the value to say."""
        return not self.error


@dataclass(frozen=True)
class Attempt:
    """The call of a function with one case, whatever that raises.

    One object, so that pools send it unopened; its outcome leaves out the case, which the caller has.
    """

    function: Callable
    index: int
    case: object

    def __call__(self) -> Outcome:
        with interrupts() as seen:
            try:
                value = self.function(self.case)
            except KeyboardInterrupt:
                seen.append(True)
            except BaseException as error:  # sys.exit() in one case does not end the others
                if not seen:
                    return failed(self.index, None, error)
        if seen:
            return interrupted(self.index, None)
        return Outcome(self.index, None, value)

    def __dask_tokenize__(self):
        """By no name twice: dask answers a call that it believes to know from before, be it with an old error."""
        return secrets.token_hex(16)


def failed(index, case, error, *, finished=True, hint="") -> Outcome:
    """The outcome of a case that ended in an error, which is kept as text: not every exception can be sent."""
    frames = error.__traceback__ and error.__traceback__.tb_next if finished else error.__traceback__
    told = tracebacks.TracebackException(type(error), error, frames)
    text = ". ".join(filter(None, (str(told), hint)))
    return Outcome(index, case, None, type(error).__name__, text, "".join(told.format()), finished)


def interrupted(index, case) -> Outcome:
    """The outcome of a case that Ctrl-C kept from its end."""
    return Outcome(index, case, None, INTERRUPT, "interrupted before it came to its end", finished=False)


@contextmanager
def interrupts() -> Iterator[list]:
    """A list that is no longer empty after Ctrl-C, even if who was interrupted caught it, as `simulate` does.

    So with the other signals that raise KeyboardInterrupt. Elsewhere than in the main thread of a process, which alone
    is told of signals, it stays empty.
    """
    seen: list = []
    if threading.current_thread() is not threading.main_thread():
        yield seen
        return

    def noting(raises):
        def note(number, frame):
            try:
                raises(number, frame)
            except KeyboardInterrupt:
                seen.append(True)
                raise

        return note

    before = {each: handler for each in SIGNALS if callable(handler := signal.getsignal(each))}
    for each, handler in before.items():
        signal.signal(each, noting(handler))
    try:
        yield seen
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)
