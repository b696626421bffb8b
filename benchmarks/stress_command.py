"""``python -m benchmarks stress``, by the package or by the peers."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Annotated

import typer

from pinconsist import InputError
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.run.interrupts import interrupted

from . import report
from .stress import SUBJECTS, by_peers, cases
from .stress.case import FAILED, run

SHORTENED = 100  # characters of a reason in the table; --json and --csv have it whole
KINDS = ("held", "refused", FAILED, by_peers.CUT, by_peers.CANNOT)


# fmt: off
def command(
    subject: Annotated[list[str] | None, typer.Argument(
        metavar="SUBJECT", help=f"{', '.join(SUBJECTS)}; all by default.")] = None,
    long: Annotated[bool, option("--long", None, "Look at drift over a million steps, for minutes.")] = False,
    peers: Annotated[bool, option(
        "--peers", None, "Let the peers of work-precision try a sample of the same cases, each for a few seconds at "
        "most.")] = False,
    sample: Annotated[int, option("--sample", "N", "With --peers: cases of each kind.")] = 4,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Try to break the method, and print what was tried and what held.

    Each case held, by the criterion next to its figure, or was refused
    with a reason; anything else has FAILED, and the exit code is then 1. The exit
    code does not judge the peers; their counts go to FILE_methods.csv.

    Example: python -m benchmarks stress singular forces
    """
    output.require_writable(csv=csv)
    if peers:
        return _by_peers(by_peers.sample(_shared(subject or ()), sample), csv, as_json)
    outcomes = _run(list(cases(subject or (), long=long)))
    counts = Counter(outcome.outcome for outcome in outcomes)
    rows = [asdict(outcome) for outcome in outcomes]
    if not report.in_files(csv, as_json, rows, counts=counts, cases=rows):
        columns = [("case", "{family}"), "varied", "outcome", *FIGURES]
        report.table(rows, columns, None)
        seconds = sum(outcome.seconds for outcome in outcomes)
        summary = ", ".join(f"{number} {what}" for what, number in sorted(counts.items()))
        print(f"{output.counted(len(outcomes), 'case')} in {seconds:.0f} s: {summary}")
    return output.FAILED if counts[FAILED] else output.FINE


def _run(cases):
    outcomes = []
    with report.status() as show:
        for i, case in enumerate(cases, start=1):
            show(f"{i} of {len(cases)}, {case.family}: {case.varied}")
            outcomes.append(run(case))
            if interrupted():  # simulate returns what was reached, and the case was judged by that
                raise KeyboardInterrupt
    return outcomes


def _number(name):
    return lambda row: "" if row[name] is None else f"{row[name]:.1e}"


def _why(row):
    """What the figure is, where it stands for itself, or the reason."""
    reason = " ".join(row["reason"].split())
    if row["outcome"] == "held" or (reason.endswith("is beyond its criterion") and "method" in row):
        return row["measure"]
    return reason if len(reason) <= SHORTENED else f"{reason[:SHORTENED]}…"


FIGURES = [
    ("figure>", _number("figure")),
    ("criterion>", _number("criterion")),
    ("what the figure is, or the reason", _why),
]


def _shared(subjects):
    if unknown := set(subjects) - set(by_peers.SUBJECTS):
        raise InputError(
            f"{', '.join(sorted(unknown))}: not with --peers, which tries {', '.join(by_peers.SUBJECTS)}: steps of a "
            "given size and starts off the loops are the package's own"
        )
    return cases(subjects or by_peers.SUBJECTS)


def _by_peers(sample, csv, as_json) -> int:
    rows = []
    with report.status() as show:
        for method, outcome in by_peers.outcomes(sample):
            rows.append({"method": method} | asdict(outcome))
            show(f"{len(rows)} of {len(sample) * len(by_peers.methods())}, {outcome.family}: {method}")
    families, methods = list(dict.fromkeys(case.family for case in sample)), _counted(rows)
    if csv:
        report.write_csv(report.beside(csv, "methods"), methods)
    if not report.in_files(csv, as_json, rows, cases=rows):
        report.table(
            methods,
            ["method", *((f"{kind}>", lambda row, kind=kind: row[kind] or "") for kind in KINDS)],
            f"{len(sample)} cases by each method: held, or refused where that is right; FAILED; "
            f"{by_peers.CUT} after {by_peers.LIMIT:g} s; {by_peers.CANNOT}: not applicable",
        )
        columns = ["method", *(f"{family}>" for family in families)]
        report.table(methods, columns, "held or rightly refused, of those tried")
        columns = ["method", ("what did not hold", "{family}: {varied}"), *FIGURES]
        report.table([row for row in rows if row["outcome"] in (FAILED, by_peers.CUT)], columns, None)
        for reason in by_peers.missing():
            print(reason)
    own = [row["outcome"] for row in rows if row["method"] == by_peers.OWN]
    return output.FAILED if FAILED in own else output.FINE


def _counted(rows):
    """For each method how many outcomes of each kind there are, and the share of each family that is right."""
    counted = []
    for method in dict.fromkeys(row["method"] for row in rows):
        own = [row for row in rows if row["method"] == method]
        counts = Counter(row["outcome"] for row in own)
        summary = {"method": method} | {kind: counts[kind] for kind in KINDS}
        for family in dict.fromkeys(row["family"] for row in rows):
            tried = [row["outcome"] for row in own if row["family"] == family and row["outcome"] != by_peers.CANNOT]
            right = sum(outcome in ("held", "refused") for outcome in tried)
            summary[family] = f"{right}/{len(tried)}" if tried else ""
        counted.append(summary)
    return counted
