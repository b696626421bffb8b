"""What the commands have in common: the machine, CSV files, what is being done."""

from __future__ import annotations

import csv
import os
import platform
import time
from contextlib import contextmanager
from importlib.metadata import version
from math import inf
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from pinconsist.cli import output

Csv = Annotated[Path | None, typer.Option("--csv", metavar="FILE", help="Write the rows to a CSV file.")]


def machine() -> str:
    """The machine and the versions behind a measurement, in a line."""
    packages = ", ".join(f"{name} {version(name)}" for name in ("pin", "numpy", "scipy"))
    return f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, {packages}"


def write_csv(file, rows) -> None:
    """Write rows, mappings with the same keys, with four significant digits."""

    def write():
        with open(file, "w", newline="", encoding="utf-8") as stream:
            writer = csv.writer(stream, lineterminator="\n")
            writer.writerow(rows[0])
            writer.writerows(map(_cell, row.values()) for row in rows)

    if rows:
        output.written(file, write)


def in_files(csv, as_json, rows=(), /, **measured) -> bool:
    """Write the rows to a CSV file and print all that was `measured` as JSON, where asked for.

    True where that is all; else the tables for a person follow, below a line with the machine.
    """
    if csv:
        write_csv(csv, rows)
    if as_json:
        output.print_json({"machine": machine(), **measured})
    else:
        print(machine() + "\n")
    return as_json


class Least(NamedTuple):
    """The least times of one function, s: `process` counts all its threads, `wall` what a user waits."""

    process: float = inf
    wall: float = inf


def least_times(work, repeats) -> dict[str, Least]:
    """The least times of each of the functions in `work`, name → function, called in turn."""
    least = dict.fromkeys(work, Least())
    for _ in range(repeats):
        for name, do in work.items():
            begun = time.process_time(), time.perf_counter()
            do()
            taken = time.process_time() - begun[0], time.perf_counter() - begun[1]
            least[name] = Least(*map(min, least[name], taken))
    return least


def _cell(value):
    if value is None or value != value:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else value


def table(rows, columns, title) -> None:
    """Print rows, mappings, in columns (heading, format string or function of a row); ``"name>:.2f"`` is its own.

    Nothing is printed if there are no rows.
    """
    if not rows:
        return

    def whole(column):
        heading, colon, form = column.partition(":")
        return heading, "{" + heading.removesuffix(">") + colon + form + "}"

    columns = [whole(column) if isinstance(column, str) else column for column in columns]
    cells = [[cell.format(**row) if isinstance(cell, str) else cell(row) for _, cell in columns] for row in rows]
    output.table([heading for heading, _ in columns], cells, title=title)


def scaled(name, factor, digits=1):
    """Cell of a column: a number of the row times a factor."""
    return lambda row: f"{factor * row[name]:.{digits}f}"


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
