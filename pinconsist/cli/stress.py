"""`pinconsist stress`."""

from __future__ import annotations

import re
from collections import Counter
from contextlib import nullcontext
from dataclasses import asdict, replace
from typing import Annotated

import typer

from ..interrupts import interrupted
from . import output

SHORTENED = 100  # characters of a reason in the table; --json has it whole


def stress(
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
            help="Let the peers of pinconsist bench try a sample of the same cases, each for a few seconds at most.",
        ),
    ] = False,
    sample: Annotated[int, typer.Option(metavar="N", help="With --peers: cases of each kind.")] = 4,
    every: Annotated[bool, typer.Option("--every", help="A row for every random chain, also where it held.")] = False,
    as_json: output.Json = False,
) -> int:
    """Try to break the method, and print what was tried and what held.

    Each case held, by a criterion that stands beside the figure, or was refused
    with a reason; anything else has FAILED, and the exit code is then 1.

    Example: pinconsist stress chains --count 500
    """
    if peers:
        from .stress_peers import stress_peers

        return stress_peers(subject or (), count, seed, sample, as_json)
    from ..study.stress import cases

    outcomes = _run(list(cases(subject or (), long=long, count=count, seed=seed)))
    counts = Counter(outcome.outcome for outcome in outcomes)
    if as_json:
        output.print_json(
            {"machine": output.machine(), "counts": counts, "cases": [asdict(outcome) for outcome in outcomes]}
        )
    else:
        _print_table(outcomes if every else _gathered(outcomes))
        seconds = sum(outcome.seconds for outcome in outcomes)
        told = ", ".join(f"{number} {what}" for what, number in sorted(counts.items()))
        print(f"{output.counted(len(outcomes), 'case')} in {seconds:.0f} s: {told}")
    return output.FAILED if counts["FAILED"] else output.FINE


def _run(cases):
    from ..study.stress.case import run

    outcomes = []
    with progress_bar(len(cases)) as bar:
        for case in cases:
            if bar:
                bar.update(bar.task_ids[0], description=f"{case.family}: {case.varied}"[:60])
            outcomes.append(run(case))
            if interrupted():  # simulate returns what was reached, and the case was judged by that
                raise KeyboardInterrupt
            if bar:
                bar.advance(bar.task_ids[0])
    return outcomes


def progress_bar(total):
    """A bar on stderr where somebody may be watching."""
    if not output.on_terminal():
        return nullcontext()
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

    columns = MofNCompleteColumn(), BarColumn(bar_width=20), TextColumn("{task.description}", markup=False)
    bar = Progress(*columns, console=Console(stderr=True), transient=True)
    bar.add_task("", total=total)
    return bar


def _gathered(outcomes):
    """The outcomes with one row for all random chains that held, or were refused for one reason."""
    from ..study.stress.random_chains import FAMILY

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
