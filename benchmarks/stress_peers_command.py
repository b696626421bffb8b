"""``python -m benchmarks stress --peers``."""

from __future__ import annotations

from collections import Counter
from dataclasses import asdict

from pinconsist.cli import output
from pinconsist.errors import InputError

from . import report
from .stress import cases, others

SHORTENED = 90  # characters of a reason in the table; --json has it whole


def stress_peers(subjects, count, seed, each, csv, as_json) -> int:
    """Let every method try a sample of the cases, and print what held; the exit code does not judge the peers."""
    if unknown := set(subjects) - set(others.SUBJECTS):
        raise InputError(
            f"{', '.join(sorted(unknown))}: not with --peers, which tries {', '.join(others.SUBJECTS)}: steps of a "
            "given size and starts off the loops are the package's own"
        )
    sample = others.sample(cases(subjects or others.SUBJECTS, count=count, seed=seed), each)
    found = []
    with report.status() as show:
        for method, outcome in others.outcomes(sample):
            found.append((method, outcome))
            show(f"{len(found)} of {len(sample) * len(others.methods())}, {outcome.family}: {method}")
    rows = [{"method": method} | asdict(outcome) for method, outcome in found]
    if csv:
        report.write_csv(csv, rows)
    if as_json:
        output.print_json({"machine": report.machine(), "cases": rows})
    else:
        print(report.machine() + "\n")
        _print(found, others)
    own = [outcome for method, outcome in found if method == others.OWN]
    return output.FAILED if any(outcome.outcome == "FAILED" for outcome in own) else output.FINE


def _print(found, others):
    kinds = ("held", "refused", "FAILED", others.CUT, others.CANNOT)
    counts = {method: Counter(outcome.outcome for name, outcome in found if name == method) for method, _ in found}
    output.table(
        ("method", *(f"{kind}>" for kind in kinds)),
        [(method, *(count[kind] or "" for kind in kinds)) for method, count in counts.items()],
        title=f"{len(found) // len(counts)} cases by each method: held, or refused where that is right; FAILED; "
        f"{others.CUT} after {others.LIMIT:g} s; {others.CANNOT}: not for it",
    )
    families = list(dict.fromkeys(outcome.family for _, outcome in found))
    output.table(
        ("method", *(f"{family}>" for family in families)),
        [(method, *(_share(found, method, family, others) for family in families)) for method in counts],
        title="held or rightly refused, of those tried",
    )
    rows = [
        (method, f"{outcome.family}: {outcome.varied}", *_figures(outcome), _why(outcome))
        for method, outcome in found
        if outcome.outcome in ("FAILED", others.CUT)
    ]
    output.table(("method", "what did not hold", "figure>", "criterion>", "why"), rows)
    for reason in others.missing():
        print(reason)


def _share(found, method, family, others):
    outcomes = [outcome.outcome for name, outcome in found if (name, outcome.family) == (method, family)]
    tried = [outcome for outcome in outcomes if outcome != others.CANNOT]
    right = sum(outcome in ("held", "refused") for outcome in tried)
    return f"{right}/{len(tried)}" if tried else ""


def _figures(outcome):
    return ("", "") if outcome.figure is None else (f"{outcome.figure:.1e}", f"{outcome.criterion:.1e}")


def _why(outcome):
    reason = " ".join(outcome.reason.split())
    if outcome.figure is not None:
        return outcome.measure
    return reason if len(reason) <= SHORTENED else f"{reason[:SHORTENED]}…"
