"""A tree of bodies out of a net of joints, and the joints that are left over to close loops."""

from __future__ import annotations

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Branch:
    """A joint of the tree, by its index, from the body `start`, which is nearer to a root, to the body `end`."""

    joint: int
    start: str
    end: str


def spanning_tree(
    ends: Sequence[tuple[str, str]], weights: Sequence[float], held: Iterable[str], candidates: Iterable[str]
) -> tuple[list[Branch], list[str], list[int]]:
    """The tree of largest weight (Prim's algorithm), by shortest chains among equal ones.

    Ties go to joints that lead from parent to child, then to short chains, then to the order given.

    Parameters
    ----------
    ends : sequence of (str, str)
        Parent and child body of each joint.
    weights : sequence of float
        How much each joint should be in the tree rather than close a loop.
    held : iterable of str
        Bodies that do not move: roots.
    candidates : iterable of str
        All bodies; of those that no joint ties to one that is held, the first becomes a root.

    Returns
    -------
    branches, roots, cut
        The tree's joints, each after those that lead to it; the roots among `candidates`; indices of the other joints.
    """
    at: dict[str, list[int]] = {}
    for joint, pair in enumerate(ends):
        for body in pair:
            at.setdefault(body, []).append(joint)
    depth, heap, branches, roots = {}, [], [], []

    def reach(body, distance):
        depth[body] = distance
        for joint in at.get(body, ()):
            parent, child = ends[joint]
            backwards = body == child
            other = parent if backwards else child
            if other not in depth:
                heapq.heappush(heap, (-weights[joint], backwards, distance + 1, joint, body, other))

    def grow():
        while heap:
            _, _, distance, joint, start, end = heapq.heappop(heap)
            if end not in depth:
                branches.append(Branch(joint, start, end))
                reach(end, distance)

    for body in dict.fromkeys(held):
        reach(body, 0)
    grow()
    for body in candidates:
        if body not in depth:
            roots.append(body)
            reach(body, 0)
            grow()
    used = {branch.joint for branch in branches}
    return branches, roots, [joint for joint in range(len(ends)) if joint not in used]
