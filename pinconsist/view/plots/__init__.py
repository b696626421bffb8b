"""Figures in one look, legible in grey: lines differ in colour, dash and marker."""

from .comparison import plot_comparison, plot_work_precision
from .pictures import (
    PICTURES,
    plot_drift,
    plot_energy,
    plot_multipliers,
    plot_phase,
    plot_solution,
    plot_steps,
    plot_trajectory,
)

__all__ = [
    "PICTURES",
    "plot_comparison",
    "plot_drift",
    "plot_energy",
    "plot_multipliers",
    "plot_phase",
    "plot_solution",
    "plot_steps",
    "plot_trajectory",
    "plot_work_precision",
]
