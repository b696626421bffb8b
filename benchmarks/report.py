"""What the commands have in common: the machine, CSV files, what is being done."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from pinconsist.cli import output

Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the rows to a CSV file.")]


def write_csv(file, rows) -> None:
    """Write rows, mappings with the same keys, with four significant digits."""

    def write():
        with open(file, "w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(rows[0])
            writer.writerows(map(_cell, row.values()) for row in rows)

    if rows:
        output.written(file, write)


def flat(row: Mapping) -> dict:
    """A row without mappings in it: their keys stand after the name of the field that held them."""
    cells = {}
    for name, value in row.items():
        cells |= {f"{name}_{key}": each for key, each in value.items()} if isinstance(value, Mapping) else {name: value}
    return cells


def _cell(value):
    if value is None or value != value:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else value


def beside(file, suffix) -> Path:
    """The file of a second table: ``bench.csv`` → ``bench_<suffix>.csv``."""
    return file.with_stem(f"{file.stem}_{suffix}")


@contextmanager
def status():
    """A function that shows what is being measured, on stderr if that is a terminal."""
    if not output.on_terminal():
        yield lambda text: None
        return
    from rich.console import Console
    from rich.text import Text

    with Console(stderr=True).status("") as line:
        yield lambda text: line.update(Text(text))
