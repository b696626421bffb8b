"""Signals at any time: nothing that was reached is lost, nothing that is finished is spoilt."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from pkgutil import resolve_name

import numpy as np
import pytest

import pinconsist as pc
from pinconsist.run.interrupts import deferred


@pytest.fixture(autouse=True)
def handlers():
    """Those of the process, before and after."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def after(end):
    """A force that ends the program."""

    def law(t, q, v):
        if t > end:
            sys.exit("the sensor is gone")
        return np.array([0.5, 0.0, 0.0])

    return law


def test_signals_that_another_thread_takes_wait_for_the_file(tmp_path):
    """The system gives a signal to any thread that does not block it; numpy's BLAS has some."""
    script = """if True:
        import os, signal, sys, threading, time
        import numpy as np
        import pinconsist as pc
        threading.Thread(target=time.sleep, args=(60,), daemon=True).start()
        save = np.savez
        def interrupted(stream, **arrays):
            for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
                os.kill(os.getpid(), number)
            time.sleep(0.2)
            save(stream, **arrays)
        np.savez = interrupted
        sol = pc.record("four_bar", (0.0, 0.1), sys.argv[1])
        print(sol.status, pc.Solution.load(sys.argv[1]).success, signal.getsignal(signal.SIGINT).__name__)
    """
    done = subprocess.run([sys.executable, "-c", script, tmp_path / "run.npz"], capture_output=True, text=True,
                          timeout=60, check=False)  # fmt: skip
    assert done.stdout.split() == ["0", "True", "default_int_handler"], done.stderr


def interrupting(function, number=signal.SIGINT):
    """The function, and a signal as soon as it has returned."""

    def call(*arguments, **options):
        result = function(*arguments, **options)
        signal.raise_signal(number)
        return result

    return call


LATE = {  # between the last step and the file
    "march": ("pinconsist.run.integrate.March", "to_end"),
    "rows": ("pinconsist.run.output.Record", "arrays"),
    "steps": ("pinconsist.run.output.Record", "steps"),
    "solution": ("pinconsist.run.simulation", "Solution._from_trajectory"),
    "stretch": ("pinconsist.run.checkpoints._Parts", "run"),
    "chain": ("pinconsist.run.checkpoints._Parts", "add"),
    "whole": ("pinconsist.run.checkpoints._Parts", "solution"),
    "saved": ("pinconsist.run.solution.Solution", "save"),
}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("place", LATE)
def test_signals_after_the_last_step_lose_nothing(tmp_path, monkeypatch, place, number):
    owner, name = LATE[place]
    file = tmp_path / "run.npz"
    with monkeypatch.context() as patch:
        patch.setattr(f"{owner}.{name}", interrupting(resolve_name(f"{owner}.{name}"), number))
        sol = pc.record("four_bar", (0.0, 0.5), file)
        assert sol.status == 0 and sol.message == "the end of the interval was reached" and sol.t[-1] == 0.5
        cut = pc.record("four_bar", (0.0, 0.5), tmp_path / "cut", save_every=0.2)
    assert pc.Solution.load(file).status == 0 and pc.rerun(file).same
    assert place in ("whole", "saved") or (cut.status, round(float(cut.t[-1]), 9)) == (1, 0.2)
    assert pc.resume(tmp_path / "cut.npz").status == 0 and pc.rerun(tmp_path / "cut.npz").same


@pytest.mark.parametrize("place", ["march", "rows", "steps", "solution"])
def test_simulate_returns_what_ctrl_c_came_too_late_for(monkeypatch, place):
    owner, name = LATE[place]
    mech = pc.load("four_bar")
    with monkeypatch.context() as patch:
        patch.setattr(f"{owner}.{name}", interrupting(resolve_name(f"{owner}.{name}")))
        sol = pc.simulate(mech, (0.0, 0.1))
        assert sol.success and sol.status == 0
        assert pc.integrate(mech, (0.0, 0.1), sol.q[0], sol.v[0]).status == 0
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_ctrl_c_at_random_times_loses_no_solution():
    """Sent while a run of half a second is on its way or ends."""
    script = """if True:
        import os, signal, threading, time
        import pinconsist as pc
        mech, span = pc.load("four_bar"), (0.0, 100.0)
        began = time.perf_counter()
        pc.simulate(mech, span)
        whole = time.perf_counter() - began
        for k in range(30):
            sol = None
            timer = threading.Timer(whole * (0.5 + 0.02 * k), os.kill, (os.getpid(), signal.SIGINT))
            try:
                timer.start()
                sol = pc.simulate(mech, span)
                timer.join()
                time.sleep(0.002)
            except KeyboardInterrupt:
                pass
            assert sol is not None and len(sol.t) == len(sol.h) + 1 == sol.nsteps + 1, k
            assert (sol.status, sol.message[:3]) == ((0, "the") if sol.t[-1] == span[1] else (1, "int"))
        print("fine")
    """
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=240, check=False)
    assert done.stdout == "fine\n", done.stderr


def test_signals_wait_in_blocks_within_blocks():
    with pytest.raises(KeyboardInterrupt), deferred():
        with deferred():
            signal.raise_signal(signal.SIGINT)
        with deferred(late=False):
            signal.raise_signal(signal.SIGINT)
        reached = True
    assert reached
    with deferred(late=False) as interrupted:
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
        with deferred() as inner:  # as a run in a callback of another
            assert inner() and not inner()
        assert not interrupted()
        signal.raise_signal(signal.SIGINT)
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_a_second_signal_later_on_acts_at_once_but_not_while_a_file_is_written(monkeypatch):
    monkeypatch.setattr("pinconsist.run.interrupts.IMPATIENCE", 0.05)
    with pytest.raises(KeyboardInterrupt), deferred(late=False):
        signal.raise_signal(signal.SIGINT)
        with deferred(impatient=False):
            time.sleep(0.1)
            signal.raise_signal(signal.SIGINT)
        signal.raise_signal(signal.SIGINT)
        raise AssertionError("the last one acts at once")


def test_a_function_that_never_returns_is_left_at_the_second_signal(monkeypatch):
    def stuck(t, q, v):
        if t > 0.3 and v.any():  # in the run, not at rest, where it is sampled before
            for wait in (0.1, 0.6):
                threading.Timer(wait, os.kill, (os.getpid(), signal.SIGINT)).start()
            while True:
                time.sleep(0.01)
        return np.zeros(3)

    monkeypatch.setattr("pinconsist.run.interrupts.IMPATIENCE", 0.2)
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[stuck])
    assert sol.status == 1 and 0.1 < sol.t[-1] <= 0.3 and "interrupted" in sol.message


def test_an_own_handler_that_returns_is_called_once_during_the_run():
    seen, begun = [], time.monotonic()
    signal.signal(signal.SIGINT, lambda *_: seen.append(time.monotonic()))
    threading.Timer(0.1, os.kill, (os.getpid(), signal.SIGINT)).start()
    mech = pc.load("four_bar")
    while not seen:
        assert pc.simulate(mech, (0.0, 20.0)).status == 0 and time.monotonic() < begun + 30
    assert pc.simulate(mech, (0.0, 0.1)).status == 0 and len(seen) == 1


def test_a_handler_of_the_application_may_end_it_and_is_told_of_what_waited():
    seen = []
    signal.signal(signal.SIGTERM, lambda *_: sys.exit("stopped") if seen else seen.append(1))
    with deferred(late=False):
        signal.raise_signal(signal.SIGTERM)
        assert not seen
    assert seen
    with pytest.raises(SystemExit, match="stopped"):
        pc.simulate(pc.load("four_bar"), (0.0, 1.0), callback=lambda *_: signal.raise_signal(signal.SIGTERM))


def test_sys_exit_in_a_force_ends_the_run_and_not_the_program():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=after(0.5))
    assert sol.status == -1 and 0.3 < sol.t[-1] <= 0.5
    assert "raised SystemExit: the sensor is gone" in sol.message and "test_signals.py:" in sol.message
    with pytest.raises(pc.UserFunctionError, match="raised SystemExit") as caught:
        pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=after(-1.0))
    assert isinstance(caught.value.__cause__, SystemExit)


def test_an_error_after_a_signal_is_still_an_error(monkeypatch, capsys):
    """Only a study, left with half a run, may fail because of the signal."""
    from pinconsist.cli import app

    def broken(*arguments, **options):
        signal.raise_signal(signal.SIGTERM)

    def wrong(*arguments, **options):
        with pytest.raises(KeyboardInterrupt):
            broken()
        raise TypeError("a bug")

    monkeypatch.setattr("pinconsist.run.checkpoints.carry_out", wrong)
    with pytest.raises(TypeError, match="a bug"):
        app.main(["simulate", "four_bar", "--until", "0.1"])
    monkeypatch.setattr("pinconsist.paper.compare", wrong)
    with pytest.raises(SystemExit) as ended:
        app.main(["compare", "problem51"])
    assert ended.value.code == 130 and "interrupted" in capsys.readouterr().err
