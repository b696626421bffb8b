"""What a run left out because nothing needed it, in words."""

from __future__ import annotations


def skipped(trajectory) -> list[str]:
    """What the integration of a trajectory skipped: work that its scene does not need or that nobody asked for."""
    system = trajectory.system
    skips = ["charts (all joints vector-like)"] if system.vector_like else []
    rows = system.n_multipliers
    if rows > system.nc:
        skips.append(f"{rows - system.nc} of {rows} loop rows (dependent or zero)")
    if getattr(getattr(system, "mechanism", None), "geometry", None) is not None:
        skips.append("geometry")
    if trajectory.dense is None:
        skips.append("dense output")
    if not trajectory.events:
        skips.append("events")
    return skips
