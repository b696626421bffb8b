"""One function over many cases: in a loop, on any executor, or in separate processes."""

import copy
import multiprocessing
import os
import pickle
import secrets
import signal
import threading
import time
import traceback as tracebacks
from collections.abc import Callable, Iterable
from concurrent.futures import BrokenExecutor, CancelledError, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from queue import SimpleQueue
from typing import Any

from ..errors import InputError, PinconsistError
from .interrupts import ended_like_ctrl_c, interrupted

INTERRUPT, LOST = KeyboardInterrupt.__name__, BrokenProcessPool.__name__
BROKEN = (
    "A worker died (killed, out of memory or crashed) and broke its pool while this case ran or waited. Run the "
    "unfinished cases in a new pool; if workers die repeatedly, they may need more memory"
)
NOT_SENT = (
    "Functions, cases and values are pickled for other processes: define the function at the top of a module, and use "
    "only plain data, mechanisms and solutions as cases and values"
)
NOT_COPIED = "A case is copied before it is passed to the function: use plain data"


@dataclass(frozen=True, eq=False)
class Outcome:
    """The outcome of one case of a :func:`sweep`.

    Attributes
    ----------
    index : int
        Its index among the cases.
    case : object
        The case, as it was given.
    value : object
        The value that the function returned; None if it did not return.
    error, message, traceback : str
        Type of the error, such as ``"AssemblyError"``, its message, and its traceback, as Python prints it (in another
        process, the traceback there); empty if there was no error.
    finished : bool
        Whether the function returned or raised an error. False if the case was interrupted, lost with a worker that
        died, or could not be sent to another process; it may be tried again.
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
        """Whether there is a value. A failed simulation also has one: its solution reports the failure."""
        return not self.error


@dataclass(frozen=True)
class Attempt:
    """The call of a function with one case. Its outcome leaves out the case, which need not be sent back."""

    function: Callable
    index: int
    case: object

    def __call__(self) -> Outcome:
        begun = time.monotonic()
        with ended_like_ctrl_c(others=False):
            try:
                outcome = Outcome(self.index, None, self.function(self.case))
            except KeyboardInterrupt:
                return _interrupted(self.index, None)
            except BaseException as error:  # sys.exit() in one case does not end the others
                outcome = _failed(self.index, None, error)
        if interrupted(begun):  # even if the function caught it, as `simulate` does: an interrupted run is not recorded
            return _interrupted(self.index, None)
        return outcome

    def __dask_tokenize__(self):
        """A new name for each call: for a name that it knows dask returns the old result, perhaps an error."""
        return secrets.token_hex(16)


def sweep(
    function: Callable, cases: Iterable, *, executor: Any = None, callback: Callable[[Outcome], object] | None = None
) -> list[Outcome]:
    """Call a function with each of many cases, and return their outcomes.

    The numbers are bit-for-bit identical with every executor and without one, as long as the function depends only on
    its case. A case that needs random numbers carries its own seed, one of
    ``numpy.random.SeedSequence(seed).spawn(n)``: case i gets the same seed however many cases there are.

    Parameters
    ----------
    function : callable
        ``function(case)``. For other processes it must be a module-level function, or a ``functools.partial`` of one;
        data common to all cases, such as the mechanism, are best created once per process (see docs/sweeps.md).
    cases : iterable
        One argument for each call: plain data. The function receives a copy, so that no case can change another.
    executor : concurrent.futures.Executor, optional
        Any object with its ``submit``, such as a ProcessPoolExecutor, loky, dask's ``client.get_executor()`` or
        ``mpi4py.futures.MPIPoolExecutor``; it is left open. Default: a plain loop in this process.
    callback : callable, optional
        ``callback(outcome)`` in this process, as the outcomes arrive. An exception in it ends the sweep.

    Returns
    -------
    list of Outcome
        One for each case, in order. A case that raises, or is lost with its worker, is an outcome with its error.
        Ctrl-C, SIGTERM and SIGHUP end the sweep: the cases that were not reached are not ``finished``.

    Raises
    ------
    InputError
        Arguments that cannot be used.
    """
    if not callable(function):
        raise InputError(f"sweep needs a function of one case, got {type(function).__name__}")
    if not isinstance(cases, Iterable):
        raise InputError(f"sweep needs a sequence of cases, got {type(cases).__name__}")
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise InputError(
            f"executor must have the submit() of concurrent.futures.Executor, got {type(executor).__name__}; "
            "for a dask client pass client.get_executor()"
        )
    if callback is not None and not callable(callback):
        raise InputError(f"callback must be a function of an outcome, got {type(callback).__name__}")
    return [*_swept(function, dict(enumerate(cases)), executor, callback).values()]


def _swept(function, cases: dict, executor, callback) -> dict[int, Outcome]:
    """The outcomes of cases by their indices."""
    outcomes: dict[int, Outcome] = {}

    def arrived(outcome):
        outcomes[outcome.index] = outcome
        if callback is not None:
            callback(outcome)

    with ended_like_ctrl_c():
        if executor is None:
            _in_a_loop(function, cases, arrived)
        else:
            _on(executor, function, cases, arrived)
    return {i: outcomes.get(i) or _interrupted(i, case) for i, case in cases.items()}


def _in_a_loop(function, cases, arrived):
    with suppress(KeyboardInterrupt):  # between two calls
        for i, case in cases.items():
            try:
                own = copy.deepcopy(case)  # as another process gets one
            except Exception as error:
                arrived(_failed(i, case, error, finished=False, hint=NOT_COPIED))
                continue
            arrived(outcome := replace(Attempt(function, i, own)(), case=case))
            if outcome.error == INTERRUPT:
                return


def _on(executor, function, cases, arrived):
    done: SimpleQueue = SimpleQueue()
    futures: dict[int, Future] = {}

    def hand_over(i):
        future = futures.pop(i)
        error = CancelledError() if future.cancelled() else future.exception()
        arrived(replace(future.result(), case=cases[i]) if error is None else _lost(i, cases[i], error))

    try:
        for i, case in cases.items():
            try:
                futures[i] = executor.submit(Attempt(function, i, case))
            except Exception as error:  # a broken pool accepts no further cases
                arrived(_lost(i, case, error))
                continue
            futures[i].add_done_callback(lambda _, i=i: done.put(i))
        while futures:
            hand_over(done.get())
    except BaseException as error:
        for future in reversed(futures.values()):  # the last first, so that none begins meanwhile
            future.cancel()
        if not isinstance(error, KeyboardInterrupt):
            raise
        while not done.empty():
            if (i := done.get()) in futures and not futures[i].cancelled():  # it ended before Ctrl-C came
                hand_over(i)


def _lost(i, case, error) -> Outcome:
    """The outcome of a case that never returned."""
    if isinstance(error, KeyboardInterrupt):
        return _interrupted(i, case)
    hint = NOT_SENT if isinstance(error, pickle.PicklingError) or "pickle" in str(error) else ""
    hint = BROKEN if isinstance(error, BrokenExecutor) else hint
    return _failed(i, case, error, finished=False, hint=hint)


def _failed(index, case, error, *, finished=True, hint="") -> Outcome:
    """The outcome of a case that ended in an error, which is kept as text: not every exception can be sent."""
    frames = error.__traceback__ and error.__traceback__.tb_next if finished else error.__traceback__
    described = tracebacks.TracebackException(type(error), error, frames)
    message, traceback = ". ".join(filter(None, (str(described), hint))), "".join(described.format())
    return Outcome(index, case, None, type(error).__name__, message, traceback, finished)


def _interrupted(index, case) -> Outcome:
    return Outcome(index, case, None, INTERRUPT, "interrupted before it finished", finished=False)


def sweep_in_processes(
    function: Callable, cases: list, workers: int, callback: Callable[[Outcome], object]
) -> list[Outcome]:
    """A :func:`sweep` in new processes, in which a worker that dies affects no other case.

    Its death breaks the pool. The cases that may have caused it are then tried one by one in a single process; the
    first one to kill this process becomes an outcome with an error, and the others go on in a new pool.
    """
    outcomes: dict[int, Outcome] = {}
    waiting, alone = list(range(len(cases))), False
    while waiting:
        tried = waiting[:workers] if alone else waiting  # started in order, so that those that ran come first
        found = _in_one_pool(function, {i: cases[i] for i in tried}, 1 if alone else workers, callback)
        lost = [i for i, outcome in found.items() if _is_lost(outcome)]
        outcomes |= found
        if any(outcome.error == INTERRUPT for outcome in found.values()):
            break
        if alone and lost:
            culprit = lost.pop(0)
            died = "its worker died (killed, out of memory or crashed), also when this case ran alone"
            outcomes[culprit] = replace(outcomes[culprit], message=died, traceback="", finished=True)
            callback(outcomes[culprit])
        waiting = lost + (waiting[workers:] if alone else [])
        alone = bool(lost) and not alone
    return [outcomes.get(i) or _interrupted(i, case) for i, case in enumerate(cases)]


def _in_one_pool(function, cases, workers, callback) -> dict[int, Outcome]:
    """The outcomes of cases in a pool that is closed afterwards, at once after Ctrl-C."""

    def arrived(outcome):
        if outcome.error != INTERRUPT and not _is_lost(outcome):
            callback(outcome)

    others, ended = multiprocessing.active_children(), False
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), end_with_parent)
    try:
        _start(pool, workers)
        outcomes = _swept(function, cases, pool, arrived)
        ended = not any(outcome.error == INTERRUPT for outcome in outcomes.values())
    finally:
        pool.shutdown(wait=ended, cancel_futures=True)
        if not ended:
            for process in set(multiprocessing.active_children()) - set(others):
                process.terminate()
    return outcomes


def _is_lost(outcome) -> bool:
    return outcome.error == LOST and not outcome.finished


def _start(pool, workers):
    """Start the workers, which ignore Ctrl-C: their parent gets it too, and handles it."""
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)  # which they inherit
    try:
        started = [pool.submit(os.getpid) for _ in range(workers)]
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        wait(started)
        started[0].result()
    except BrokenProcessPool as error:
        raise PinconsistError(f"no worker process can be started here: {error}") from error


def end_with_parent():
    """In a worker: end it when its parent is gone, perhaps killed; otherwise it would wait for work forever."""

    def watch():
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
