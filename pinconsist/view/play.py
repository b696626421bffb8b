"""A motion in a viewer of the user's: anything with ``display(q)``, such as Pinocchio's visualizers."""

import time

import numpy as np

from ..errors import InputError
from ..mechanism.checks import near, number, places
from .motion import playing_times


class Translated:
    """Configurations of a mechanism as another model has them, joint by joint by their names."""

    def __init__(self, mechanism, model):
        self._parts, self._nq = [], model.nq
        names = list(model.names)[1:]
        if missing := [joint for joint in names if joint not in mechanism.joints]:
            reason = f"the model of the viewer has joint {missing[0]!r}, and {mechanism.name} has not"
            raise InputError(f"play: {reason}{near(missing[0], mechanism.joints)}")
        for i, name in enumerate(names, start=1):
            own, theirs = places(mechanism.model, mechanism.joint_index(name)), places(model, i)
            sizes = own[0].stop - own[0].start, theirs[0].stop - theirs[0].start
            if own[1].stop - own[1].start != theirs[1].stop - theirs[1].start or abs(sizes[0] - sizes[1]) > 1:
                raise InputError(f"play: joint {name!r} is of another kind in the model of the viewer")
            self._parts.append((own[0], theirs[0], *sizes))

    def __call__(self, q) -> np.ndarray:
        found = np.empty(self._nq)
        for own, theirs, mine, other in self._parts:
            part = q[own]
            if mine == other:
                found[theirs] = part
            elif mine == 2:
                found[theirs] = np.arctan2(part[1], part[0])
            else:
                found[theirs] = np.cos(part[0]), np.sin(part[0])
        return found


def play(sol, mechanism, viewer, speed, fps) -> None:
    """See :meth:`Solution.play`."""
    if not callable(getattr(viewer, "display", None)):
        raise InputError(f"play needs a viewer with a method display(q), got {type(viewer).__name__}")
    speed, fps = number(speed, "speed", above=0.0), number(fps, "fps", above=0.0)
    model = getattr(viewer, "model", None)
    change = Translated(mechanism, model) if model is not None else np.copy
    elapsed = np.abs(sol.t - sol.t[0])
    clock = playing_times([_Length(elapsed)], speed, fps)
    shown = sol.at(sol.t[0] + np.sign(sol.t[-1] - sol.t[0]) * np.minimum(speed * clock, elapsed[-1]), mechanism)
    began = time.perf_counter()
    for when, q in zip(clock, shown.q, strict=True):
        time.sleep(max(0.0, began + when - time.perf_counter()))
        viewer.display(change(q))


class _Length:
    """What `playing_times` needs of a run."""

    mech = None

    def __init__(self, elapsed):
        self.elapsed = elapsed
