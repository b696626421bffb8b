"""Replays and figures. meshcat, coal and matplotlib are looked for only when something is shown."""

from .meshcat import export_html, replay
from .plots import plot_comparison, plot_solution

__all__ = ["export_html", "plot_comparison", "plot_solution", "replay"]
