"""Several solutions in one picture: which they are and what each is called."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import InputError
from .actions import motors
from .motion import Run

FIRST = 8  # rows, among which the first of a multistep method are
VISIBLE = 0.02  # of a force: less is not worth a word


def runs_of(mech, sol, *, forces: bool = False) -> list[Run]:
    """The runs that are shown, from left to right.

    Parameters
    ----------
    mech : Mechanism or sequence of Mechanism
        The scene of all solutions, or one for each.
    sol : solution, sequence of solutions, or mapping of titles to solutions
        What is shown. Without titles they are told apart by what they differ in: consistency, else the mechanism's
        name, else a number.
    forces : bool
        Whether multipliers are needed, and velocities where motors act.

    Raises
    ------
    InputError
        No solution, another number of mechanisms than of solutions, a solution that does not fit its mechanism.
    """
    sols = _listed(sol)
    if not sols:
        raise InputError("nothing to show: the list of solutions is empty")
    mechs = list(mech) if isinstance(mech, list | tuple) else [mech] * len(sols)
    if len(mechs) != len(sols):
        raise InputError(f"{len(mechs)} mechanisms for {len(sols)} solution(s): give one for all, or one for each")
    titled = len(sols) > 1 or isinstance(sol, Mapping)
    titles = ([str(title) for title in sol] if isinstance(sol, Mapping) else _titles(mechs, sols)) if titled else [""]
    needs = [(("lam", "v") if motors(each) else ("lam",)) if forces else () for each in mechs]
    return [Run.of(*each, needs=need) for *each, need in zip(mechs, sols, titles, needs, strict=True)]


def contrast(sol) -> str:
    """Of two solutions of which one starts from exact values, what to look at; empty where there is nothing to see."""
    sols = _listed(sol)
    if len(sols) != 2 or [_consistency(each) for each in sols].count("exact") != 1:
        return ""
    exact = [_consistency(each) for each in sols].index("exact")
    off, right = (sols[k].lam[1:FIRST] for k in (exact, 1 - exact))
    if off.shape != right.shape or not right.size:
        return ""
    errors, sizes = np.linalg.norm(off - right, axis=1), np.linalg.norm(right, axis=1)
    worst = errors.argmax()
    if not sizes[worst] or errors[worst] < VISIBLE * sizes[worst]:
        return ""
    wrong = errors[worst] / sizes[worst]
    here, there = ("left", "right") if exact == 0 else ("right", "left")
    told = f"{100 * wrong:.0f} %" if wrong < 2 else f"{wrong:.0f} times its size"
    return f"{here}: the first force is wrong by {told}, however small the step; {there}: numerically consistent"


def _listed(sol) -> list:
    if isinstance(sol, Mapping):
        return list(sol.values())
    return list(sol) if isinstance(sol, list | tuple) else [sol]


def _titles(mechs, sols) -> list[str]:
    tries = ([_consistency(sol) for sol in sols], [mech.name for mech in mechs])
    numbers = [str(number) for number in range(1, len(sols) + 1)]
    return next((names for names in tries if all(names) and len(set(names)) == len(names)), numbers)


def _consistency(sol) -> str:
    return getattr(sol, "method", {}).get("consistency", "")
