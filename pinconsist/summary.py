"""A run in a few lines of text, and the work that it skipped."""

import numpy as np


def summary_of(solution) -> str:
    """The message; steps, their sizes and orders; rejected ones by reason; what the run took; loop rows left out."""
    lines = [solution.message]
    if len(solution.t):
        wasted = _rejected({reason: count for reason, count in solution.rejected.items() if count})
        lines.append(f"t = {solution.t[0]:g} … {solution.t[-1]:g} s in {solution.nsteps} steps{wasted}")
    taken = np.abs(solution.h[solution.h != 0])
    if len(taken):
        counts = np.bincount(solution.order[solution.h != 0])
        orders = [f"{count} of order {k}" for k, count in enumerate(counts) if k and count]
        orders += [f"{counts[0]} by the one-step start"] if counts[0] else []
        lines.append(f"steps {taken.min():.3g} … {taken.max():.3g} s: {', '.join(orders)}")
    lines.append(f"{solution.nfev} residuals, {solution.njev} Newton matrices, {solution.nlu} factorisations")
    if backend := solution.method.get("backend"):
        lines.append(f"steps made by the {backend} method" if backend == "compiled" else f"steps made in {backend}")
    if rows := [skip for skip in solution.method.get("skipped", ()) if "loop rows" in skip]:
        lines.append(f"skipped: {', '.join(rows)}")  # the rest, work that was not requested, is in `method`
    return "\n".join(lines)


def _rejected(counts) -> str:
    if len(counts) < 2:
        return "".join(f" ({count} rejected by {reason})" for reason, count in counts.items())
    each = ", ".join(f"{count} by {reason}" for reason, count in counts.items())
    return f" ({sum(counts.values())} rejected: {each})"


def skipped_work(trajectory) -> list[str]:
    """What the integration of a trajectory skipped: work that its scene does not need, or that was not requested."""
    system = trajectory.system
    skipped = ["charts (all joints vector-like)"] if system.vector_like else []
    rows = system.n_multipliers
    if rows > system.nc:
        skipped.append(f"{rows - system.nc} of {rows} loop rows (dependent or zero)")
    if getattr(getattr(system, "mechanism", None), "geometry", None) is not None:
        skipped.append("geometry")
    if trajectory.dense is None:
        skipped.append("dense output")
    if not trajectory.events:
        skipped.append("events")
    return skipped
