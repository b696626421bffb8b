"""Several solutions in one picture: which they are and what each is called."""

from __future__ import annotations

from collections.abc import Mapping

from ..errors import InputError
from .actions import motors
from .motion import Run


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
    several = isinstance(sol, Mapping | list | tuple)
    sols = list(sol.values() if isinstance(sol, Mapping) else sol) if several else [sol]
    if not sols:
        raise InputError("nothing to show: the list of solutions is empty")
    mechs = list(mech) if isinstance(mech, list | tuple) else [mech] * len(sols)
    if len(mechs) != len(sols):
        raise InputError(f"{len(mechs)} mechanisms for {len(sols)} solution(s): give one for all, or one for each")
    titled = len(sols) > 1 or isinstance(sol, Mapping)
    titles = ([str(title) for title in sol] if isinstance(sol, Mapping) else _titles(mechs, sols)) if titled else [""]
    needs = [(("lam", "v") if motors(each) else ("lam",)) if forces else () for each in mechs]
    return [Run.of(*each, needs=need) for *each, need in zip(mechs, sols, titles, needs, strict=True)]


def _titles(mechs, sols) -> list[str]:
    tries = ([_consistency(sol) for sol in sols], [mech.name for mech in mechs])
    numbers = [str(number) for number in range(1, len(sols) + 1)]
    return next((names for names in tries if all(names) and len(set(names)) == len(names)), numbers)


def _consistency(sol) -> str:
    return getattr(sol, "method", {}).get("consistency", "")
