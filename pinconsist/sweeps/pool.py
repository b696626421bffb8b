"""Processes of one's own: begun again where a worker dies, ended when their parent is."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import replace

from ..errors import PinconsistError
from .outcome import INTERRUPT, Outcome
from .sweep import sweep

LOST = BrokenProcessPool.__name__
DIED = "its worker died (killed, out of memory or crashed), and again with this case alone"


def sweep_in_processes(
    function: Callable, cases: list, workers: int, callback: Callable[[Outcome], object]
) -> list[Outcome]:
    """A :func:`sweep` in new processes that loses no case to another one's death.

    A worker that dies takes its pool along. The cases that may have killed it are then tried in one process, one after
    the other; the first to kill that is an outcome with an error, and all others go on in a new pool.

    Parameters
    ----------
    function, cases
        As in :func:`sweep`.
    workers : int
        How many processes.
    callback : callable
        ``callback(outcome)``, once for each case that came to an end.

    Returns
    -------
    list of Outcome
        As of :func:`sweep`.
    """
    outcomes: dict[int, Outcome] = {}
    waiting, alone = list(range(len(cases))), False
    while waiting:
        tried = waiting[:workers] if alone else waiting  # begun in order, so that those that ran stand first
        found = _one_pool(function, cases, tried, 1 if alone else workers, callback)
        lost = [outcome.index for outcome in found if _is_lost(outcome)]
        outcomes |= {outcome.index: outcome for outcome in found}
        if any(outcome.error == INTERRUPT for outcome in found):
            break
        if alone and lost:
            culprit = lost.pop(0)
            outcomes[culprit] = replace(outcomes[culprit], message=DIED, traceback="", finished=True)
            callback(outcomes[culprit])
        waiting = lost + (waiting[workers:] if alone else [])
        alone = bool(lost) and not alone
    missing = "interrupted before it began"
    return [
        outcomes.get(i) or Outcome(i, case, None, INTERRUPT, missing, finished=False) for i, case in enumerate(cases)
    ]


def _one_pool(function, cases, indices, workers, callback) -> list[Outcome]:
    """The outcomes of some of the cases in a pool that is closed afterwards, at once after Ctrl-C."""

    def arrived(outcome):
        if outcome.error != INTERRUPT and not _is_lost(outcome):
            callback(replace(outcome, index=indices[outcome.index]))

    others, ended = multiprocessing.active_children(), False
    pool = ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), end_with_parent)
    try:
        _start(pool, workers)
        outcomes = sweep(function, [cases[i] for i in indices], executor=pool, callback=arrived)
        ended = not any(outcome.error == INTERRUPT for outcome in outcomes)
    finally:
        pool.shutdown(wait=ended, cancel_futures=True)
        if not ended:
            for process in set(multiprocessing.active_children()) - set(others):
                process.terminate()
    return [replace(outcome, index=indices[outcome.index]) for outcome in outcomes]


def _start(pool, workers):
    """Start the workers, deaf to Ctrl-C, which their parent hears too and answers."""
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


def _is_lost(outcome) -> bool:
    return outcome.error == LOST and not outcome.finished


def end_with_parent():
    """In a worker: end it as soon as its parent is gone, killed perhaps; it would wait for work for ever."""
    threading.Thread(target=_wait_for_the_end, daemon=True).start()


def _wait_for_the_end():
    if (parent := multiprocessing.parent_process()) is not None:
        parent.join()
    os._exit(1)
