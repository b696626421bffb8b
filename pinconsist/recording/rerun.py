"""Whether a run that was made again is the one in the file."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..solution import Solution
from ..solution_file import versions
from .stretches import ROWS, STEPPED


@dataclass(frozen=True)
class Rerun:
    """A run made again from its file, and how it compares.

    Attributes
    ----------
    same : bool
        Every number of t, q, v, λ, steps and orders is the same, bit for bit.
    differences : tuple of str
        What is not as it was: versions, files of the scene, numbers.
    solution : Solution
        The new run; where the one in the file was cut short, up to there.
    """

    same: bool
    differences: tuple[str, ...]
    solution: Solution = field(repr=False)

    def __str__(self):
        rows = f"{len(self.solution.t)} rows up to t = {self.solution.t[-1]:g} s" if len(self.solution.t) else "no rows"
        told = f"the same numbers, bit for bit: {rows}" if self.same else "the numbers are not the same"
        return "\n".join((*self.differences, told))


def compared(old, new, changes) -> Rerun:
    """Two runs of one recipe, and what has changed in their scene."""
    about, made_now = [], versions()
    for name, then in old.versions.items():
        if then != (now := made_now.get(name)):
            about.append(f"{name} {then} then, {now} now")
    ways = old.method.get("backend"), new.method.get("backend")
    about += [f"the method ran {ways[0]} then, {ways[1]} now"] if ways[0] != ways[1] else []
    about += changes
    numbers = [
        told for name in (*ROWS, *STEPPED) if (told := _difference(name, getattr(old, name), getattr(new, name)))
    ]
    return Rerun(not numbers, (*about, *numbers), new)


def changed_files(then, now) -> list[str]:
    """A sentence for each file of a scene that is not what it was."""
    told = [f"{name} has changed" for name in then if name in now and then[name] != now[name]]
    told += [f"{name} is not read any more" for name in then if name not in now]
    return told + [f"{name} was not read then" for name in now if name not in then]


def changed_mechanism(then, now, same_pinocchio) -> list[str]:
    """A sentence if a mechanism is not what it was, as far as its digests tell: models only of one Pinocchio."""
    told = {"model": "bodies, joints or gravity", "loops": "loops", "forces": "own forces", "guess": "guess"}
    other = [told[part] for part in told if (part != "model" or same_pinocchio) and then.get(part) != now[part]]
    return [f"the mechanism has other {', other '.join(other)}"] if other else []


def _difference(name, old, new):
    if old.shape != new.shape:
        return f"{name}: shape {old.shape} then, {new.shape} now"
    if old.tobytes() == new.tobytes():
        return ""
    return f"{name}: differs by up to {np.abs(np.subtract(new, old, dtype=float)).max():.3g}"
