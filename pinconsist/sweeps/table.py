"""The table of a sweep: a row for each case, in their order."""

from __future__ import annotations

import csv
import io

from ..files import written_whole
from .study import MEASURED


def columns(study) -> list[str]:
    """The names of the table's columns."""
    return ["case", *study.names, *MEASURED, *study.columns(), "message"]


def rows(study, cases, measured: dict[int, dict]) -> list[list]:
    """The rows of the cases that have been run; None where there is nothing to tell."""
    empty = [None] * len(study.columns())
    return [
        [i, *cases[i], *(row.get(name) for name in MEASURED), *(row.get("end") or empty), row["message"]]
        for i, row in sorted(measured.items())
    ]


def write(file, study, cases, measured: dict[int, dict]) -> None:
    """Write a CSV file, whole or not at all; floats have the digits that give the same float again."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns(study))
    writer.writerows(rows(study, cases, measured))
    with written_whole(file) as stream:
        stream.write(text.getvalue().encode())
