"""``python -m benchmarks stress``."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import asdict, replace
from typing import Annotated

import typer

from pinconsist.cli import output
from pinconsist.interrupts import interrupted

from . import report
from .stress import cases
from .stress.case import run
from .stress.random_chains import FAMILY
from .stress_peers_command import stress_peers

SHORTENED = 100  # characters of a reason in the table; --json has it whole


def command(
    subject: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="SUBJECT", help="steps, scales, singular, starts, forces, tolerances, chains; all by default."
        ),
    ] = None,
    count: Annotated[int, typer.Option(metavar="N", help="How many random closed chains.")] = 100,
    seed: Annotated[int, typer.Option(metavar="N", help="Seed of the first of them.")] = 0,
    long: Annotated[bool, typer.Option("--long", help="Look at drift over a million steps, for minutes.")] = False,
    peers: Annotated[
        bool,
        typer.Option(
            "--peers",
            help="Let the peers of work-precision try a sample of the same cases, each for a few seconds at most.",
        ),
    ] = False,
    sample: Annotated[int, typer.Option(metavar="N", help="With --peers: cases of each kind.")] = 4,
    every: Annotated[bool, typer.Option("--every", help="A row for every random chain, also where it held.")] = False,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    """Try to break the method, and print what was tried and what held.

    Each case held, by a criterion that stands beside the figure, or was refused
    with a reason; anything else has FAILED, and the exit code is then 1.

    Example: python -m benchmarks stress chains --count 500
    """
    output.require_writable(csv=csv)
    if peers:
        return stress_peers(subject or (), count, seed, sample, csv, as_json)
    outcomes = _run(list(cases(subject or (), long=long, count=count, seed=seed)))
    counts = Counter(outcome.outcome for outcome in outcomes)
    if csv:
        report.write_csv(csv, [asdict(outcome) for outcome in outcomes])
    if as_json:
        output.print_json(
            {"machine": report.machine(), "counts": counts, "cases": [asdict(outcome) for outcome in outcomes]}
        )
    else:
        _print_table(outcomes if every else _gathered(outcomes))
        seconds = sum(outcome.seconds for outcome in outcomes)
        told = ", ".join(f"{number} {what}" for what, number in sorted(counts.items()))
        print(f"{output.counted(len(outcomes), 'case')} in {seconds:.0f} s: {told}")
    return output.FAILED if counts["FAILED"] else output.FINE


def _run(cases):
    outcomes = []
    with report.status() as show:
        for i, case in enumerate(cases, start=1):
            show(f"{i} of {len(cases)}, {case.family}: {case.varied}")
            outcomes.append(run(case))
            if interrupted():  # simulate returns what was reached, and the case was judged by that
                raise KeyboardInterrupt
    return outcomes


def _gathered(outcomes):
    """The outcomes with one row for all random chains that held, or were refused for one reason."""

    rows, alike = [], {}
    for outcome in outcomes:
        if outcome.family != FAMILY or outcome.outcome == "FAILED":
            rows.append(outcome)
        else:
            alike.setdefault((outcome.outcome, re.sub(r"[\d.e+-]+", "#", outcome.reason)), []).append(outcome)
    for same in alike.values():
        worst = max(same, key=lambda outcome: outcome.figure / outcome.criterion if outcome.figure else 0.0)
        total = sum(outcome.family == FAMILY for outcome in outcomes)
        rows.append(replace(worst, varied=f"{len(same)} of {total}, the worst: {worst.varied}"))
    return rows


def _print_table(outcomes):
    rows = []
    for each in outcomes:
        numbers = ("", "") if each.figure is None else (f"{each.figure:.1e}", f"{each.criterion:.1e}")
        reason = each.reason if len(each.reason) <= SHORTENED else f"{each.reason[:SHORTENED]}…"
        what = each.measure if each.outcome == "held" else reason
        rows.append((each.family, each.varied, each.outcome, *numbers, what))
    output.table(("case", "varied", "outcome", "figure>", "criterion>", "what the figure is, or the reason"), rows)
