"""Other integrators of the same equations, written as their own documentation writes them."""

from __future__ import annotations

from .casadi_idas import CasadiIdas
from .dae_solvers import Ida, SolveDae
from .exudyn_alpha import ExudynAlpha
from .mujoco_soft import Mujoco
from .own import own_methods
from .scipy_index1 import ScipyIvp

OWN = "pinconsist BDF"
"""What the others are measured against."""


def peers() -> list:
    """Every method that can be measured, installed or not, the package's own first."""
    return [
        *own_methods(),
        *(ScipyIvp(method) for method in ("DOP853", "LSODA", "Radau")),
        *(SolveDae(method) for method in ("BDF", "Radau")),
        *(Ida(form) for form in ("GGL", "index 1")),
        CasadiIdas(),
        *(ExudynAlpha(index) for index in (3, 2)),
        *(Mujoco(integrator) for integrator in ("implicitfast", "RK4")),
    ]
