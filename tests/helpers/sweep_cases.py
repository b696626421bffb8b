"""Functions of one case that can be sent to other processes."""

from __future__ import annotations

import functools
import os
import signal
import time

import numpy as np

import pinconsist as pc

SPEEDS = [4.0, 7.5, 11.0]  # rad/s of the crank
PICKY = ["fine", "wrong", "exit", "odd", ("a", "tuple")]


@functools.cache
def mechanism(name):
    return pc.load(name)


def turning(speed):
    """All numbers of a checked run, and two random numbers of the case."""
    sol = pc.simulate(mechanism("crank_rocker"), (0.0, 0.3), v0={"crank": speed})
    rows = b"".join(part.tobytes() for part in (sol.t, sol.q, sol.v, sol.lam))
    return rows + repr(sol.check(error=False).force).encode()


def drawn(case):
    """Random numbers from the case's seed and from two seeds that it spawns."""
    _, seed = case
    return [np.random.default_rng(each).random() for each in (seed, *seed.spawn(2))]


def picky(case):
    if case == "wrong":
        pc.load("four_bar").joint_index("nose")
    if case == "exit":
        raise SystemExit("enough")
    if case == "odd":
        raise TwoWords("one", "two")
    return case


class TwoWords(Exception):
    """An exception that does not survive pickling: its arguments are not those of its constructor."""

    def __init__(self, one, two):
        super().__init__(f"{one} {two}")


def killer(case):
    """Kill this process silently, as the kernel does when memory runs out, after other cases have run."""
    if case == "kill":
        os.kill(os.getpid(), signal.SIGKILL)
    time.sleep(0.02)
    return case


def process(case):
    time.sleep(0.05)
    return os.getpid()


def unsendable(case):
    return lambda: case


def interrupted_by_itself(case):
    """Send Ctrl-C in the middle of a run, which catches it."""
    signal_at = 0.1 if case == 2 else 9.0

    def callback(t, *_):
        if t > signal_at:
            os.kill(os.getpid(), signal.SIGINT)

    return pc.simulate(mechanism("planar_pendulum"), (0.0, 0.3), callback=callback).status


def interrupted_into_an_error(case):
    try:
        os.kill(os.getpid(), signal.SIGINT)
        time.sleep(10)
    except KeyboardInterrupt:
        raise ValueError("something odd") from None


def deaf(case):
    os.kill(os.getpid(), signal.SIGINT)
    return case
