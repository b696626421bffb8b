"""The package's own methods: every method, order and consistency, and whatever else a run can be asked for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinconsist import Solution, __version__, integrate
from pinconsist.engine.bdf import MAX_ORDER
from pinconsist.engine.consistency import MODES
from pinconsist.run import integrate as dae
from pinconsist.run.control import Switches
from pinconsist.run.options import Options
from pinconsist.run.output import Output
from pinconsist.run.steppers import stepper_for

from .problem import Peer, Rows, SolverFailed

HIGHEST = 5  # of variable step
SETTINGS = {
    "BDF": {"method": "BDF"},
    **{f"BDF ≤ {k}": {"method": "BDF", "order": k} for k in range(HIGHEST - 1, 1, -1)},
    "Radau": {"method": "Radau"},
    **{f"Radau, order {k}": {"method": "Radau", "order": k} for k in (9, 13)},
    "ImplicitEuler": {"method": "ImplicitEuler"},
}
"""Name → keywords of :func:`pinconsist.integrate`: variable step, every step corrected."""
DETAILS = {f"BDF ≤ {k}, exact": {"method": "BDF", "order": k, "consistency": "exact"} for k in range(HIGHEST, 0, -1)}
"""The same without the correction."""
FIXED = {
    f"fixed BDF-{k}, {mode}": {"method": "BDF", "order": k, "consistency": mode}
    for k in range(1, MAX_ORDER + 1)
    for mode in MODES
}
"""The same for a fixed step, which is implicit Euler where the order is 1."""


class Own(Peer):
    """A row of the tables above."""

    package = module = "pinconsist"

    def __init__(self, setting, options, *, fixed_step=False, detail=False):
        self.name, self.options = f"pinconsist {setting}", options
        self.fixed_step, self.detail = fixed_step, detail

    def version(self):
        return __version__

    def can(self, problem):
        return None

    def run(self, problem, options):
        return integrate(problem.system, problem.span, problem.q0, problem.v0, **options)

    def prepare(self, problem, setting):
        sizes = {"step": (problem.span[1] - problem.span[0]) / setting} if self.fixed_step else {}
        options = self.options | (sizes or {"rtol": setting, "atol": setting})

        def solve():
            return self.run(problem, options)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            first = 1 + int(np.argmax(sol.order > 0))  # earlier rows come from the one-step start
            rows = thin(len(sol.t), first)
            return Rows(sol.t[rows], sol.q[rows], sol.v[rows], sol.lam[rows], int(np.searchsorted(rows, first)))

        return solve, read


class WithoutSwitch(Own):
    """BDF of variable step, without one of the features that exist only for speed."""

    def __init__(self, switch):
        super().__init__(f"BDF, {switch.replace('_', ' ')} off", {}, detail=True)
        self.switches = replace(Switches(), **{switch: False})

    def run(self, problem, options):
        span, tolerances = problem.span, (options["rtol"], options["atol"])
        method = Options("BDF", None, None, *tolerances).for_span(span)
        method = replace(method, switches=self.switches)
        stepper = stepper_for(problem.system, method)
        run = dae.integrate(problem.system, span, problem.q0, problem.v0, method, Output(), stepper)
        return Solution._from_trajectory(run, method)


def own_methods() -> list[Own]:
    """All of them, the one that others are measured against first."""
    return [
        *(Own(*row) for row in SETTINGS.items()),
        *(Own(*row, detail=True) for row in DETAILS.items()),
        WithoutSwitch("kept_derivatives"),
        *(Own(*row, fixed_step=True, detail=True) for row in FIXED.items()),
    ]
