"""What each skip saves: runs of a scene with one thing switched on that the method leaves out, beside plain runs.

The method has no options for this. Each switch replaces, for the time of one run, the one function in which the skip
is decided, or asks for what was not asked for. That dependent and zero rows leave the system cannot be switched off:
with them the Newton matrix is singular.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Annotated
from unittest.mock import patch

import numpy as np
import typer

from pinconsist import Event, InputError, load, simulate
from pinconsist.cli import output
from pinconsist.mechanism.system import MechanismSystem

from . import report

SCENES = {"crank_rocker": 2.0, "andrews": 0.02, "bricard": 4.0, "delta_robot": 0.5, "chain_8": 1.0, "chain_64": 1.0}
"""The scenes and how long they run, s."""
ELSEWHERE = 0.5  # s, of any other scene


@dataclass(frozen=True)
class Skip:
    """One thing that the method leaves out.

    Attributes
    ----------
    name : str
    switch : callable
        Makes a context in which nothing is left out.
    concerns : callable
        Whether a system has anything to leave out here; the switch changes nothing elsewhere.
    wishes : dict
        Keywords of :func:`pinconsist.simulate` that ask for the work.
    """

    name: str
    switch: Callable[[], AbstractContextManager] = nullcontext
    concerns: Callable[[MechanismSystem], bool] = lambda system: True
    wishes: dict = field(default_factory=dict)


@dataclass(frozen=True)
class Cost:
    """A scene with one skip switched off.

    Attributes
    ----------
    scene, skip : str
    ratio : float
        Time of the run, assembly and start included, to that with the skip: median of the rounds.
    time : float
        Median time of the processor without the skip, s.
    steps, residuals, matrices : int
        Accepted steps, residual evaluations, Newton matrices without the skip.
    """

    scene: str
    skip: str
    ratio: float
    time: float
    steps: int
    residuals: int
    matrices: int


def ablate(scenes=None, repeats: int = 7, shapes=None) -> Iterator[Cost]:
    """Switch each skip off in turn; yields for each scene first the plain run, then a :class:`Cost` for each skip.

    Parameters
    ----------
    scenes : sequence of str, optional
        Built-in models or files. Default: a few of every kind.
    repeats : int
        Rounds; in each all variants run one after the other.
    shapes : callable, optional
        ``shapes(mechanism)`` reads the shapes of a scene, as a viewer does; what that would add is measured, too.

    Raises
    ------
    InputError
        Fewer than one round.
    """
    if repeats < 1:
        raise InputError(f"repeats must be at least 1, got {repeats!r}")
    for scene in scenes or SCENES:
        mech = load(scene)
        span = (0.0, SCENES.get(scene, ELSEWHERE))
        system = simulate(mech, span, max_steps=1, backend="python").system
        variants = [PLAIN, *(skip for skip in SKIPS if skip.concerns(system))]
        if shapes is not None and mech.geometry is not None:
            variants.append(Skip("no geometry", partial(_geometry, shapes)))
        runs = [[_timed(mech, span, skip) for skip in variants] for _ in range(repeats + 1)][1:]  # the first warms up
        times = np.array([[elapsed for elapsed, _ in row] for row in runs])
        ratios = np.median(times / times[:, :1], axis=0)
        for skip, ratio, elapsed, (_, sol) in zip(variants, ratios, np.median(times, axis=0), runs[-1], strict=True):
            yield Cost(scene, skip.name, float(ratio), float(elapsed), sol.nsteps, sol.nfev, sol.njev)


def _timed(mech, span, skip):
    with skip.switch():
        start = time.process_time()
        sol = simulate(mech, span, backend="python", **skip.wishes)  # the switches act on Python
        return time.process_time() - start, sol


@contextmanager
def _charts():
    """Joints like any other: tables are moved from chart to chart, positions go through Pinocchio."""
    build, scale = MechanismSystem.__init__, MechanismSystem.position_scale

    def built(self, *args, **options):
        build(self, *args, **options)
        self.flat, self.vector_like = self.vector_like, False

    def scaled(self, p):
        return np.abs(p) if self.flat else scale(self, p)  # the same steps as before

    with patch.object(MechanismSystem, "__init__", built), patch.object(MechanismSystem, "position_scale", scaled):
        yield


@contextmanager
def _all_rows():
    """All rows of the loops are evaluated as they stand in the convention; the kept ones are picked from them."""
    build = MechanismSystem.__init__

    def built(self, *args, **options):
        build(self, *args, **options)

        def rows(data, q, t):
            phi, J = self.rows.evaluate(data, q, t)
            return phi[self.kept], J[self.kept]

        self._kept_rows = rows

    with patch.object(MechanismSystem, "__init__", built):
        yield


@contextmanager
def _force_gradient():
    """The turning of the constraint forces stands in every Newton matrix."""
    linearize = MechanismSystem.linearize

    def complete(self, t, p, v, a, lam, c, A):
        W = linearize(self, t, p, v, a, lam, c, A)
        if c:
            A -= c**2 * self.force_gradient(t, p, v, lam)
        return W

    with patch.object(MechanismSystem, "linearize", complete):
        yield


@contextmanager
def _geometry(shapes):
    """The shapes of the scene are read with every system that is built."""
    build = MechanismSystem.__init__

    def built(self, mechanism, *args, **options):
        build(self, mechanism, *args, **options)
        shapes(mechanism)

    with patch.object(MechanismSystem, "__init__", built):
        yield


def _never(*args):
    return False


def _far_away(t, q, v, lam):
    return t + 1.0


PLAIN = Skip("nothing switched off")
SKIPS = (
    Skip("no charts where joints are vector-like", _charts, lambda system: system.vector_like),
    Skip("only the kept rows are evaluated", _all_rows, lambda system: system.nc > 0),
    Skip("force gradient only where Newton is slow", _force_gradient, lambda system: system.nc > 0),
    Skip("no dense output", wishes={"dense_output": True}),
    Skip("no events", wishes={"events": [Event(_far_away)]}),
    Skip("no callback", wishes={"callback": _never}),
)


def command(
    scene: Annotated[
        list[str] | None, typer.Argument(metavar="[NAME|PATH ...]", help="Default: one scene of every kind.")
    ] = None,
    repeats: Annotated[int, typer.Option(metavar="N", help="Rounds, in each of which all variants run in turn.")] = 3,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Switch off each thing that a run skips, in turn, and print what that costs.

    Example: python -m benchmarks ablate crank_rocker
    """
    from pinconsist.view.visuals import visuals

    output.require_writable(csv=csv)
    rows = [asdict(cost) for cost in ablate(scene, repeats, shapes=visuals)]
    if csv:
        report.write_csv(csv, rows)
    if as_json:
        output.print_json({"machine": report.machine(), "ablate": rows})
        return output.FINE
    print(report.machine() + "\n")
    for name in dict.fromkeys(row["scene"] for row in rows):
        _print(name, [row for row in rows if row["scene"] == name])
    return output.FINE


def _print(scene, rows):
    counts = ("steps", "residuals", "matrices")
    output.table(
        ("skip switched off", "time>", "[ms]>", *(f"{count}>" for count in counts)),
        [
            (row["skip"], f"{row['ratio']:.2f}", f"{1e3 * row['time']:.1f}", *(row[count] for count in counts))
            for row in rows
        ],
        title=f"{scene}: what it costs not to skip (1.00: the run as it is)",
    )
