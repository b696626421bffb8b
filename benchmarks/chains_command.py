"""``python -m benchmarks chains``."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict
from typing import Annotated

import numpy as np

from pinconsist import InputError
from pinconsist.cli import output
from pinconsist.cli.scene import option

from . import report
from .chains import campaign

TOLERANCES = (1e-3, 1e-5, 1e-7)
QUANTITIES = ("q", "v", "force")
FAR, NEAR = 100.0, 3.0
SMALL = 1e-3
"""Of a tolerance: errors and estimates below it are taken to be as large, as rounding decides them."""
SHORTENED = 160
SAVED = 20  # runs after which the rows are written anew


# fmt: off
def command(
    count: Annotated[int, option("--count", "N", "How many random closed chains.")] = 100,
    seed: Annotated[int, option("--seed", "N", "Seed of the first of them.")] = 1,
    tol: Annotated[list[float] | None, option(
        "--tol", "NUMBER", "An rtol, atol being a hundredth; may be repeated. Default: 1e-3, 1e-5, 1e-7.")] = None,
    method: Annotated[str, option("--method", "NAME", "As of simulate.")] = "BDF",
    until: Annotated[float, option("--until", "SECONDS", "Span of a run.")] = 1.0,
    limit: Annotated[float, option("--limit", "SECONDS", "How long a run and its reference may take.")] = 120.0,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Compare runs of random closed chains with independent equations.

    Trees of 2 to 8 bodies with all kinds of joints, loops, couplings, drives
    and forces. The reference is DOP853 on equations of its own. Prints the
    runs that failed, were refused, or are off by more than 100 tolerances, and
    the distribution of the largest error of a run over its tolerance. The exit
    code is 1 where a run failed.

    Example: python -m benchmarks chains --count 500 --tol 1e-3 --tol 1e-5
    """
    output.require_writable(csv=csv)
    if count < 1 or seed < 0:
        raise InputError(f"--count must be positive and --seed not negative, got {count} and {seed}")
    plan = tol or TOLERANCES, method
    rows, total = [], count * len(plan[0])
    with report.status() as show:
        for run in campaign.runs(range(seed, seed + count), *plan, until=until, limit=limit):
            rows.append(asdict(run))
            show(f"{len(rows)} of {total}: seed {run.seed}, {run.scene}")
            if csv and len(rows) % SAVED == 0:
                report.write_csv(csv, rows)
    counts, errors = Counter(row["outcome"] for row in rows), distribution(rows)
    if not report.in_files(csv, as_json, rows, counts=counts, errors=errors, runs=rows):
        far = [row for row in rows if row["outcome"] != campaign.FINE or max(row[q] or 0.0 for q in QUANTITIES) > FAR]
        report.table(far, REMARKABLE, "failed, refused, or far off")
        report.table(errors, ERRORS, "largest error of a run over its tolerance")
        print(estimates(rows))
        print(", ".join(f"{number} {what}" for what, number in counts.most_common()))
    return output.FAILED if any(counts[kind] for kind in campaign.FAILURES) else output.FINE


def distribution(rows) -> list[dict]:
    """Of each quantity and tolerance: median, 90 %, 99 % and the worst with its seed."""
    found = []
    for name, tol in sorted({(name, row["tol"]) for row in rows for name in QUANTITIES}):
        alike = [row for row in rows if row["tol"] == tol and row[name] is not None]
        alike = [row for row in alike if row["outcome"] == campaign.FINE]
        if alike:
            errors, worst = [row[name] for row in alike], max(alike, key=lambda row: row[name])
            shares = dict(zip(("median", "most", "nearly_all"), np.quantile(errors, (0.5, 0.9, 0.99)), strict=True))
            about = {"quantity": name, "tol": tol, "runs": len(alike)}
            found.append(about | shares | {"worst": worst[name], "seed": worst["seed"]})
    return found


def estimates(rows) -> str:
    """How well the solutions know their errors, where the reference covers the run; below a floor all are the same."""
    fine = [row for row in rows if row["outcome"] == campaign.FINE and not row["reference"]]
    known = [row for row in fine if row["q"] and row["estimate"]]
    if not known:
        return "no error was estimated"
    ratios = np.array([max(row["estimate"], SMALL) / max(row["q"], row["v"], SMALL) for row in known])
    found = ", ".join(f"{np.mean(np.abs(np.log(ratios)) <= np.log(factor)):.1%} within {factor}" for factor in (3, 10))
    unnamed = sum(max(row["q"], row["v"]) > FAR and row["estimate"] < FAR / NEAR for row in known)
    return f"estimated over true error of {len(known)} runs: {found}; {unnamed} of those off by more than 100 unnoticed"


def _errors(row):
    return " ".join("-" if row[name] is None else f"{row[name]:.2g}" for name in QUANTITIES)


def _why(row):
    """The message, or by how much the motion amplifies a change where that explains an error."""
    text = " ".join(row["message"].split()) or f"a change of the start grows {row['amplification'] or 0:.1e} times"
    if len(text) <= SHORTENED:
        return text
    return f"…{text[-SHORTENED:]}" if row["outcome"] == campaign.FOREIGN else f"{text[:SHORTENED]}…"


REMARKABLE = ["seed>", "tol>:g", "outcome", ("q, v, force / tol", _errors), ("why", _why)]
ERRORS = [
    ("", "{quantity}"), "tol>:g", "runs>", "median>:.2g",
    ("90 %>", "{most:.2g}"), ("99 %>", "{nearly_all:.2g}"), "worst>:.2g", "seed>",
]  # fmt: skip
