"""The run of one case of `pinconsist sweep`, as plain data that any process can be sent, and the row it makes."""

from __future__ import annotations

import hashlib
import json
import logging
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from .. import _core
from ..errors import InputError, PinconsistError
from ..mechanism.digest import digests
from ..mechanism.mechanism import Mechanism
from ..simulation import simulate
from ..solution_file import versions
from .targets import Run, target

MEASURED = ("status", "t", "steps", "gap", "energy_error")
DONE, FAILED, ERROR = "done", "failed", "error"
_log = logging.getLogger(__name__)
_loaded: dict[str, Mechanism] = {}
"""Recipe → its mechanism, for the one sweep that a process works at."""


def loaded(scene, *, anew=False) -> Mechanism:
    """The mechanism of a scene, loaded once in each process; `anew` where its files may have changed since."""
    recipe = repr(scene)
    if anew or recipe not in _loaded:
        _loaded.clear()
        _loaded[recipe] = scene.load()
    return _loaded[recipe]


@dataclass(frozen=True)
class Study:
    """How each case of a sweep is run.

    Parameters
    ----------
    scene : object
        A recipe: plain data with a method ``load() -> Mechanism``.
    names : tuple of str
        What the numbers of a case are, by the names of :func:`~pinconsist.sweeps.targets.target`.
    start, until : float
        Of the run, s.
    q0, v0 : mapping
        Joint name → number(s), for the joints that are not varied.
    options : mapping
        Of :func:`~pinconsist.simulate`.
    """

    scene: Any
    names: tuple[str, ...]
    start: float
    until: float
    q0: Mapping
    v0: Mapping
    options: Mapping

    def __call__(self, case) -> dict:
        """The row of a case: what was measured, ``end`` (q and v of the last row), and a message where one is due."""
        run = self.run(case)
        sol = self._simulated(run, run.until)
        row = (DONE if sol.success else FAILED, float(sol.t[-1]), sol.nsteps, _gap(sol), sol.energy().balance_error)
        told = [*([] if sol.success else [sol.message]), _moved(run, sol.q[0])]
        end = [*map(float, sol.q[-1]), *map(float, sol.v[-1])]
        return dict(zip(MEASURED, row, strict=True)) | {"end": end, "message": "; ".join(filter(None, told))}

    def run(self, case) -> Run:
        """What `simulate` is called with for a case; InputError where its numbers cannot be."""
        mechanism = loaded(self.scene)
        run = Run(mechanism, self.until, dict(self.q0), dict(self.v0), {}, dict(self.options))
        for name, value in zip(self.names, case, strict=True):
            target(mechanism, name)(run, value)
        return run

    def check(self, case) -> None:
        """Raise InputError if the run of a case cannot even begin for what was asked."""
        try:
            self._simulated(self.run(case), self.start)
        except InputError:
            raise
        except PinconsistError as error:  # that concerns this case alone, and its row will tell
            _log.debug("the first case: %s", error)

    def _simulated(self, run, until):
        forces = [run.torques] if run.torques else ()
        q0, v0 = run.q0 or None, run.v0 or None
        return simulate(run.mechanism, (self.start, until), q0, v0, forces=forces, **run.options)

    def about(self, cases) -> dict:
        """What two sweeps must share for the rows of one to be those of the other."""
        mechanism = loaded(self.scene)
        return {
            "scene": {"name": mechanism.name, **digests(mechanism)},
            "start": {"time": self.start, "q": dict(self.q0), "v": dict(self.v0)},
            "settings": {"until": self.until, **self.options},
            "varied": list(self.names),
            "cases": {"count": len(cases), "content": hashlib.sha256(json.dumps(cases).encode()).hexdigest()},
            "backend": "python" if _core.load()[0] is None else "compiled",  # the last bits are others
            "versions": versions(),
        }

    def columns(self) -> list[str]:
        """The names of the numbers of ``end``: ``q.crank``, or ``q.ball[0]`` of a joint of several."""
        mechanism = loaded(self.scene)
        names = []
        for letter, sizes in (("q", mechanism.model.nqs), ("v", mechanism.model.nvs)):
            for joint, size in zip(mechanism.joints, list(sizes)[1:], strict=True):
                own = f"{letter}.{joint}"
                names += [own] if size == 1 else [f"{own}[{k}]" for k in range(size)]
        return names


def _gap(sol) -> float:
    """`Certificate.position`, alone: the forces, which no row tells, are most of a certificate's work."""
    gaps = [sol.system.loop_rows(q, t)[0] for t, q in zip(sol.t, sol.q, strict=True)]
    return float(np.abs(gaps).max(initial=0.0))


def _moved(run, q) -> str:
    """Which joints could not start where they were put."""
    mechanism, told = run.mechanism, []
    for joint, value in run.q0.items():
        if not np.allclose(mechanism.configuration({joint: value}, base=q), q, rtol=0, atol=1e-9):
            start = mechanism.model.idx_qs[i := mechanism.joint_index(joint)]
            at = " ".join(f"{each:g}" for each in q[start : start + mechanism.model.nqs[i]])
            asked = " ".join(f"{each:g}" for each in np.atleast_1d(value))
            told.append(f"the loops do not close with {joint} = {asked}; it began at {at}")
    return "; ".join(told)
