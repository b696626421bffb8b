"""Many runs: the same numbers on every engine, and what becomes of the cases that fail, are lost or interrupted."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor

import numpy as np
import pytest
from helpers import sweep_cases as cases

import pinconsist as pc
from pinconsist.run.sweeps import sweep_in_processes

INTERRUPT = "KeyboardInterrupt"


class OnlySubmit:
    """The least of an executor; it answers when it has three calls, in the reverse order."""

    def __init__(self):
        self.calls = []

    def submit(self, call):
        self.calls.append((future := Future(), call))
        if len(self.calls) == 3:
            for waiting, each in reversed(self.calls):
                waiting.set_result(each())
        return future


@pytest.fixture(scope="module")
def pool():
    with ProcessPoolExecutor(2) as executor:
        yield executor


def values(outcomes):
    assert [outcome.index for outcome in outcomes] == list(range(len(outcomes)))
    assert all(outcome.success and outcome.finished and not outcome.message for outcome in outcomes)
    return [outcome.value for outcome in outcomes]


def test_a_loop_a_pool_and_threads_give_the_numbers_of_simulate_bit_for_bit(pool):
    direct = [cases.turning(speed) for speed in cases.SPEEDS]
    assert values(pc.sweep(cases.turning, cases.SPEEDS)) == direct
    assert values(pc.sweep(cases.turning, cases.SPEEDS, executor=pool)) == direct
    assert values(pc.sweep(cases.turning, iter(cases.SPEEDS), executor=OnlySubmit())) == direct
    with ThreadPoolExecutor(2) as threads:
        assert values(pc.sweep(cases.turning, cases.SPEEDS, executor=threads)) == direct
    assert sweep_in_processes(cases.turning, [], 2, None) == []


def test_outcomes_arrive_in_the_parent_and_are_returned_in_order():
    seen = []
    outcomes = pc.sweep(str, "abc", executor=OnlySubmit(), callback=lambda o: seen.append((o.value, os.getpid())))
    assert seen == [(letter, os.getpid()) for letter in "bac"]  # c's answer was there before anyone waited
    assert [(outcome.case, outcome.value) for outcome in outcomes] == [(each, each) for each in "abc"]


def test_seeds_of_cases_are_the_same_everywhere_and_for_more_cases(pool):
    def several(count):
        return list(enumerate(np.random.SeedSequence(7).spawn(count)))

    few = several(3)
    first = values(pc.sweep(cases.drawn, few))
    assert values(pc.sweep(cases.drawn, few)) == first  # no case is spent by a run
    assert values(pc.sweep(cases.drawn, few, executor=pool)) == first
    assert values(pc.sweep(cases.drawn, several(5), executor=pool))[:3] == first
    assert len({number for row in first for number in row}) == 9


@pytest.mark.parametrize("where", ["loop", "pool"])
def test_a_failing_case_is_an_outcome_with_its_error(where, pool):
    outcomes = pc.sweep(cases.picky, cases.PICKY, executor=pool if where == "pool" else None)
    fine, wrong, end, odd, last = outcomes
    assert values([fine]) == ["fine"] and last.value == ("a", "tuple")
    assert (wrong.error, wrong.case, wrong.value, wrong.success, wrong.finished) == (
        "InputError", "wrong", None, False, True,
    )  # fmt: skip
    assert wrong.message.startswith("four_bar: no joint 'nose'")
    assert "sweep_cases.py" in wrong.traceback and wrong.traceback.endswith(f"{wrong.message}\n")
    assert "pinconsist/run/" not in wrong.traceback  # the package's own frames tell nobody anything
    assert (end.error, end.message) == ("SystemExit", "enough")
    assert (odd.error, odd.message) == ("TwoWords", "one two")


def test_a_worker_that_is_killed_takes_its_pool_and_every_case_tells_so():
    with ProcessPoolExecutor(2) as pool:
        outcomes = pc.sweep(cases.killer, [0, 1, "kill", *range(3, 40)], executor=pool)
        assert [outcome.index for outcome in outcomes] == list(range(40))
        again = pc.sweep(cases.killer, [1], executor=pool)  # the pool stays broken
    lost = [outcome for outcome in outcomes if not outcome.finished]
    assert {2, *range(30, 40)} <= {outcome.index for outcome in lost}
    for outcome in [*lost, *again]:
        assert not outcome.success and outcome.value is None and outcome.error == "BrokenProcessPool"
        assert "new pool" in outcome.message
    assert all(outcome.value == outcome.case for outcome in outcomes if outcome.finished)


def test_a_pool_of_our_own_loses_the_killing_cases_alone():
    seen = []
    given = ["kill", 1, 2, 3, 4, "kill", *range(6, 12)]
    outcomes = sweep_in_processes(cases.killer, given, 2, seen.append)
    assert [outcome.case for outcome in outcomes] == given
    assert [outcome.index for outcome in outcomes if not outcome.success] == [0, 5]
    assert all("died" in outcomes[i].message and outcomes[i].finished for i in (0, 5))
    assert sorted(outcome.index for outcome in seen) == list(range(12))  # each once
    assert all(outcomes[outcome.index].case == outcome.case for outcome in seen)


@pytest.mark.parametrize(
    ("function", "given"), [(lambda case: case, 1), (cases.unsendable, 1), (cases.picky, threading.Lock())]
)
def test_what_cannot_be_sent_is_told(function, given, pool):
    (outcome,) = pc.sweep(function, [given], executor=pool)
    assert not outcome.success and not outcome.finished and "top of a module" in outcome.message
    assert values(pc.sweep(cases.picky, ["x"], executor=pool)) == ["x"]  # and the pool lives


def test_a_case_that_cannot_be_copied_is_told_in_a_loop_too():
    first, second = pc.sweep(cases.picky, [threading.Lock(), "x"])
    assert "plain data" in first.message and not first.finished and second.value == "x"


def test_a_case_cannot_change_what_was_given():
    given = [[1], [2]]
    assert values(pc.sweep(lambda case: case.append(0) or case, given)) == [[1, 0], [2, 0]]
    assert given == [[1], [2]]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_loop_returns_what_was_reached(number, monkeypatch):
    monkeypatch.setattr(signal, "SIGINT", number)  # what the case sends itself
    before = signal.getsignal(number)
    outcomes = pc.sweep(cases.interrupted_by_itself, range(5))
    assert [outcome.value for outcome in outcomes[:2]] == [0, 0]
    for outcome in outcomes[2:]:  # simulate caught it, yet half a run is no value
        assert (outcome.error, outcome.value, outcome.finished) == (INTERRUPT, None, False)
    assert signal.getsignal(number) is before


def test_ctrl_c_while_a_pool_works_returns_what_was_reached_and_cancels_the_rest():
    with ProcessPoolExecutor(1) as pool:

        def stop(outcome):
            if outcome.index == 2:
                signal.raise_signal(signal.SIGINT)

        outcomes = pc.sweep(cases.killer, range(60), executor=pool, callback=stop)
        again = pc.sweep(cases.killer, ["more"], executor=pool)  # the executor is the caller's, and still works
    assert all(outcome.value == outcome.index for outcome in outcomes[:3])
    assert all(outcome.error == INTERRUPT and not outcome.finished for outcome in outcomes[30:])
    assert values(again) == ["more"]


@pytest.mark.parametrize("error", [KeyboardInterrupt, OSError])
def test_what_has_not_begun_is_cancelled(error):
    """Of three calls the first two have answers when the callback gets the first of them."""
    futures = []

    class Slow:
        def submit(self, call):
            futures.append(future := Future())
            if len(futures) < 3:
                future.set_result(call())
            return future

    seen = []

    def callback(outcome):
        seen.append(outcome.index)
        if outcome.index == 0:
            raise error

    if error is KeyboardInterrupt:
        outcomes = pc.sweep(str, "abc", executor=Slow(), callback=callback)
        assert seen == [0, 1] and [outcome.value for outcome in outcomes] == ["a", "b", None]
    else:
        with pytest.raises(OSError):
            pc.sweep(str, "abc", executor=Slow(), callback=callback)
    assert [future.cancelled() for future in futures] == [False, False, True]


def test_an_interrupt_that_a_function_makes_another_error_is_one_still():
    outcomes = pc.sweep(cases.interrupted_into_an_error, range(2))
    assert [outcome.error for outcome in outcomes] == [INTERRUPT, INTERRUPT]


def test_ctrl_c_ends_a_pool_of_our_own_at_once():
    others = set(multiprocessing.active_children())
    timer = threading.Timer(1.5, os.kill, [os.getpid(), signal.SIGINT])
    timer.start()
    began = time.monotonic()
    outcomes = sweep_in_processes(time.sleep, [0.0, *[60.0] * 5], 2, lambda outcome: None)
    timer.cancel()
    assert time.monotonic() - began < 30.0
    assert [outcome.error for outcome in outcomes] == ["", *[INTERRUPT] * 5]
    while set(multiprocessing.active_children()) - others:  # else its workers sleep on
        assert time.monotonic() - began < 30.0
        time.sleep(0.01)


def test_workers_of_our_own_leave_ctrl_c_to_their_parent():
    assert values(sweep_in_processes(cases.deaf, [1, 2], 2, lambda outcome: None)) == [1, 2]


def test_what_a_callback_raises_ends_the_sweep(pool):
    def full(outcome):
        raise OSError("disk full")

    for executor in (None, pool):
        with pytest.raises(OSError, match="disk full"):
            pc.sweep(cases.killer, range(50), executor=executor, callback=full)


@pytest.mark.parametrize(
    ("arguments", "options", "message"),
    [
        ((3, []), {}, "function of one case"),
        ((str, 3), {}, "sequence of cases"),
        ((str, []), {"executor": 4}, "submit"),
        ((str, []), {"callback": 4}, "callback"),
    ],
)
def test_arguments_that_cannot_be_used(arguments, options, message):
    with pytest.raises(pc.InputError, match=message):
        pc.sweep(*arguments, **options)
