"""Accepted steps that were made in one call: what passes from a stepper to events and the record."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .dense import Curve


@dataclass
class StepBatch:
    """Accepted steps that were made in one call, as arrays with one row a step, and their polynomials if wanted."""

    t: np.ndarray
    p: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    order: np.ndarray
    curve: Curve | None
    failure: str = ""  # why there are no more, or empty
    error: BaseException | None = None  # what a user's function raised after these steps

    def __post_init__(self):
        for array in self.states:  # users' functions look at them
            array.flags.writeable = False

    @classmethod
    def of(cls, states, orders, curve, *why) -> StepBatch:
        """The batch of a list of states (t, p, v, λ)."""
        t, *columns = zip(*states, strict=True) if states else ((), (), (), ())
        return cls(np.array(t), *(np.array(column) for column in columns), np.array(orders, int), curve, *why)

    @property
    def states(self):
        """p, v and λ."""
        return self.p, self.v, self.lam

    def first(self, n: int) -> StepBatch:
        """The first `n` of the steps."""
        curve = self.curve and n and self.curve.until(self.t[n - 1])
        return StepBatch(self.t[:n], *(each[:n] for each in self.states), self.order[:n], curve or None)

    def looked_into(self, looks: int, with_multipliers: bool):
        """t, p, v and λ at so many times in each step, its end the last."""
        if looks == 1:
            return self.t, *self.states
        before = np.concatenate(([self.curve.start], self.t[:-1]))[:, None]
        t = (before + (self.t[:, None] - before) * (np.arange(1, looks + 1) / looks)).reshape(-1)
        t[looks - 1 :: looks] = self.t
        states = self.curve(t, with_multipliers)
        for inside, ends in zip(states, self.states, strict=True):
            inside[looks - 1 :: looks] = ends
        return t, *states

    def cut(self, n, with_curve, t, p, v, lam) -> StepBatch:
        """The first `n` steps, and the part up to a time, where an event happens, of the one after them."""
        rows = (np.concatenate((each[:n], row[None])) for each, row in zip(self.states, (p, v, lam), strict=True))
        curve = self.curve.until(t) if with_curve else None
        return StepBatch(np.append(self.t[:n], t), *rows, self.order[: n + 1], curve)
