"""`pinconsist bench --overhead`."""

from __future__ import annotations

from dataclasses import asdict

from . import output

TIMED = "crank_rocker"


def overhead(scenes, as_json) -> dict:
    """Measure and print what a step costs; the figures by name."""
    from ..study import overhead as study

    results = {"overhead": {name: [asdict(row) for row in study.overhead(name)] for name in scenes or [TIMED]}}
    if not scenes:
        results["chains"] = [asdict(row) for row in study.chain_steps()]
    if not as_json:
        for name, rows in results["overhead"].items():
            _print_overhead(name, rows)
        output.paragraph(
            "run/steps: the whole run, assembly and start included; K⁻¹: computeRNEADerivatives and LAPACK's dgesv, "
            "which a step with a Newton matrix of its own needs besides; step/bare: the median over runs made in turn"
        )
        print()
        if not scenes:
            _print_chains(results["chains"])
    return results


def _print_overhead(name, rows):
    how = ", 5 s from 12 rad/s" if name == TIMED else ", from rest"
    output.table(
        ("backend", "rtol", "steps>", "residuals/step>", "step [us]>", "run/steps [us]>", "bare calls [us]>",
         "with K⁻¹ [us]>", "step/bare>"),
        [
            (row["backend"], f"{row['rtol']:g}", row["steps"], f"{row['residuals']:.2f}",
             f"{1e6 * row['step_time']:.2f}", f"{1e6 * row['run_time']:.2f}", f"{1e6 * row['bare_time']:.2f}",
             f"{1e6 * row['least_time']:.2f}", f"{row['ratio']:.2f}")
            for row in rows
        ],
        title=f"{name}{how}: a step beside rnea + joint Jacobians + constraint + its Jacobian",
    )  # fmt: skip


def _print_chains(rows):
    fewest = {row["backend"]: row for row in reversed(rows)}
    output.table(
        ("backend", "links>", "steps>", "step [us]>", "over the shortest>", "over linear>"),
        [
            (row["backend"], row["links"], row["steps"], f"{1e6 * row['step_time']:.1f}",
             f"{(growth := row['step_time'] / fewest[row['backend']]['step_time']):.1f}",
             f"{growth * fewest[row['backend']]['links'] / row['links']:.2f}")
            for row in rows
        ],
        title="hanging chains from rest, 1 s at 1e-6: a step, the start not counted",
    )  # fmt: skip
