"""The tables of `pinconsist bench --ablate`."""

from __future__ import annotations

from dataclasses import asdict

from . import output


def ablate(scenes, repeats, as_json) -> list[dict]:
    """Measure what each skip saves on some scenes (default: one of every kind), print it, and return the rows."""
    from ..study.ablate import ablate as study
    from ..view.visuals import visuals

    rows = [asdict(cost) for cost in study(scenes, repeats, shapes=visuals)]
    if not as_json:
        for scene in dict.fromkeys(row["scene"] for row in rows):
            _print(scene, [row for row in rows if row["scene"] == scene])
    return rows


def _print(scene, rows):
    counts = ("steps", "residuals", "matrices")
    output.table(
        ("skip switched off", "time>", "[ms]>", *(f"{count}>" for count in counts)),
        [
            (row["skip"], f"{row['ratio']:.2f}", f"{1e3 * row['time']:.1f}", *(row[count] for count in counts))
            for row in rows
        ],
        title=f"{scene}: what it costs not to skip (1.00: the run as it is)",
    )
