"""One function over many cases, in a loop or on any executor."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Iterable
from concurrent.futures import BrokenExecutor, CancelledError, Future
from dataclasses import replace
from queue import Empty, SimpleQueue
from typing import Any

from ..errors import InputError
from ..interrupts import ended_like_ctrl_c
from .outcome import INTERRUPT, Attempt, Outcome, failed, interrupted

BROKEN = (
    "A worker died (killed, out of memory or crashed) and took its pool with it while this case ran or waited. Run the "
    "cases that are not finished in a new pool; a worker that dies again and again may need more memory"
)
NOT_SENT = (
    "Functions, cases and values go to other processes by pickle: define the function at the top of a module, and keep "
    "cases and values to plain data, mechanisms and solutions"
)

NOT_COPIED = "A case is copied before the function gets it: keep it to plain data"


def sweep(
    function: Callable, cases: Iterable, *, executor: Any = None, callback: Callable[[Outcome], object] | None = None
) -> list[Outcome]:
    """Call a function with each of many cases, and tell what became of each.

    The numbers are the same, bit for bit, with every executor and without one, as long as the function takes all it
    needs from its case. A case that needs random numbers carries its own seed, one of
    ``numpy.random.SeedSequence(seed).spawn(n)``: case i gets the same seed however many cases there are.

    Parameters
    ----------
    function : callable
        ``function(case)``. For other processes it is a function at the top of a module, or a ``functools.partial`` of
        one; what is the same for all cases, such as the mechanism, it best makes once for each process (see
        docs/sweeps.md).
    cases : iterable
        One argument each: plain data. The function gets a copy, so that no case can change another.
    executor : concurrent.futures.Executor, optional
        Anything with its ``submit``: a ProcessPoolExecutor, loky, dask's ``client.get_executor()``,
        ``mpi4py.futures.MPIPoolExecutor``. Default: a plain loop in this process. It is left open.
    callback : callable, optional
        ``callback(outcome)`` in this process, as the outcomes arrive. What it raises ends the sweep.

    Returns
    -------
    list of Outcome
        In the order of the cases, one each. A case that raises is an outcome with its error; so is one that was lost
        with its worker. Ctrl-C, SIGTERM and SIGHUP end the sweep: what was reached is returned, the other cases
        are outcomes that are not ``finished``.

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
            "of a dask client give client.get_executor()"
        )
    if callback is not None and not callable(callback):
        raise InputError(f"callback must be a function of an outcome, got {type(callback).__name__}")
    cases = list(cases)
    outcomes: dict[int, Outcome] = {}

    def arrived(outcome):
        outcomes[outcome.index] = outcome
        if callback is not None:
            callback(outcome)

    with ended_like_ctrl_c():
        if executor is None:
            _loop(function, cases, arrived)
        else:
            _on(executor, function, cases, arrived)
    return [outcomes.get(i) or interrupted(i, case) for i, case in enumerate(cases)]


def _loop(function, cases, arrived):
    try:
        for i, case in enumerate(cases):
            outcome = _called(function, i, case)
            arrived(outcome)
            if outcome.error == INTERRUPT:
                return
    except KeyboardInterrupt:  # between two calls
        return


def _called(function, i, case) -> Outcome:
    """The outcome of a call here, with a copy of the case, as another process gets one."""
    try:
        own = copy.deepcopy(case)
    except Exception as error:
        return failed(i, case, error, finished=False, hint=NOT_COPIED)
    return replace(Attempt(function, i, own)(), case=case)


def _on(executor, function, cases, arrived):
    done: SimpleQueue = SimpleQueue()
    futures: dict[int, Future] = {}
    try:
        for i, case in enumerate(cases):
            try:
                future = executor.submit(Attempt(function, i, case))
            except Exception as error:  # a pool that broke meanwhile takes no more
                arrived(_lost(i, case, error))
                continue
            futures[i] = future
            future.add_done_callback(lambda _, i=i: done.put(i))
        while futures:
            i = done.get()
            arrived(_result(futures.pop(i), i, cases[i]))
    except KeyboardInterrupt:
        _cancel(futures)
        _drain(done, futures, cases, arrived)
    except BaseException:
        _cancel(futures)
        raise


def _cancel(futures):
    for future in reversed(futures.values()):  # the last first, lest one begins meanwhile
        future.cancel()


def _drain(done, futures, cases, arrived):
    """Hand over what came to its end before Ctrl-C did."""
    while True:
        try:
            i = done.get_nowait()
        except Empty:
            return
        future = futures.pop(i, None)
        if future is not None and not future.cancelled():
            arrived(_result(future, i, cases[i]))


def _result(future, i, case) -> Outcome:
    try:
        error = future.exception()
    except CancelledError as cancelled:
        error = cancelled
    return replace(future.result(), case=case) if error is None else _lost(i, case, error)


def _lost(i, case, error) -> Outcome:
    """The outcome of a case that never gave its answer."""
    if isinstance(error, KeyboardInterrupt):
        return interrupted(i, case)
    hint = ""
    if isinstance(error, BrokenExecutor):
        hint = BROKEN
    elif isinstance(error, pickle.PicklingError) or "pickle" in str(error):
        hint = NOT_SENT
    return failed(i, case, error, finished=False, hint=hint)
