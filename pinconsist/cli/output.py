"""What commands print and write: exit codes, messages, tables, JSON, and files that are checked before a long run."""

import json
import math
import secrets
import shutil
import sys
import tempfile
import textwrap
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from .. import files
from ..errors import AssemblyError, InputError

FINE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
WIDTH = 160  # of tables that go to a file or a pipe
PLAIN_WIDTH = 80  # of text that goes there
NAME_WIDTH = 14  # to which a narrow terminal may squeeze a column of text

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead.")]


def table(columns, rows, *, title=None, width=WIDTH):
    """Print a table and an empty line; a column named ``...>`` holds numbers: aligned right, never shortened.

    `width` is used where the output is not a terminal.
    """
    from rich.box import SIMPLE_HEAD
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    grid = Table(box=SIMPLE_HEAD, pad_edge=False)
    rows = [[str(cell) for cell in row] for row in rows]
    least = 0  # rich drops columns from a table that is squeezed further; a terminal wraps the lines instead
    for k, name in enumerate(columns):
        heading, of_numbers = name.removesuffix(">"), name.endswith(">")
        own = max(map(len, [heading, *(row[k] for row in rows)]))
        least += 3 + (own if of_numbers else min(own, NAME_WIDTH))
        grid.add_column(heading, justify="right" if of_numbers else "left", no_wrap=of_numbers, overflow="fold")
    for row in rows:
        grid.add_row(*map(Text, row))
    console = Console(highlight=False, markup=False, emoji=False)
    console.width = max(least, console.width if console.is_terminal else width)
    with console.capture() as drawn:
        console.print(grid, crop=False)
    lines = filter(None, (line.rstrip() for line in drawn.get().splitlines()))
    print(*filter(None, [title]), *lines, "", sep="\n")


def paragraph(text, *, indent="", hanging=""):
    """Print a text in lines that fit the terminal, or 80 columns; words stay whole."""
    width = min(shutil.get_terminal_size().columns, WIDTH) if sys.stdout.isatty() else PLAIN_WIDTH
    options = {"break_long_words": False, "break_on_hyphens": False}
    print(textwrap.fill(text, width, initial_indent=indent, subsequent_indent=indent + hanging, **options))


def print_error(error):
    """Print an error on stderr and, where its advice is in terms of Python, the options to use instead."""
    print(f"pinconsist: error: {error}", file=sys.stderr)
    if isinstance(error, AssemblyError) and error.gaps:
        print("on the command line: --at JOINT=VALUE, --closure point, --reanchor", file=sys.stderr)


def counted(count: int, noun: str) -> str:
    """``1 loop``, ``2 loops``, ``2 bodies``."""
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count} {noun if count == 1 else plural}"


def first(texts, most, more="… and {} more") -> list[str]:
    """At most so many of the texts, and then how many more there are."""
    return [*texts[:most], *([more.format(len(texts) - most)] if len(texts) > most else [])]


def print_json(values):
    """One JSON object on stdout; numbers that JSON does not know become null."""
    print(json.dumps(_plain(values), allow_nan=False))


def _plain(value):
    if isinstance(value, Mapping):
        return {key: _plain(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each) for each in value]
    if hasattr(value, "tolist"):  # numpy's arrays and numbers
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def require_writable(*, figure=None, **others):
    """Raise InputError now for files, given by the names of their options, that could not be written after the run."""
    options: dict[Path, str] = {}
    for option, file in {**others, "plot": figure}.items():
        if file is not None:
            files.require_writable(file)
            if (first := options.setdefault(Path(file).absolute(), option)) != option:
                raise InputError(f"--{first} and --{option} name the same file")
    if figure is not None:
        from ..view.panels import require_figure

        require_figure(figure)


def print_written(*given, before=""):
    """Name the files that were written, if any."""
    if any(given):
        print(f"{before}written: {', '.join(filter(None, given))}")


def written(file, write):
    """Call `write`, which writes `file`; a disk error becomes an InputError."""
    try:
        return write()
    except OSError as error:
        raise InputError(f"{file} cannot be written: {error.strerror or error}") from error


def rescued(solution):
    """Save a run elsewhere whose own file cannot be written; the file, or None if no folder can be written."""
    for folder in (tempfile.gettempdir(), Path.home(), Path.cwd()):
        try:
            return solution.save(Path(folder, f"pinconsist-{secrets.token_hex(4)}.npz"))
        except OSError:
            continue
    return None


def on_terminal() -> bool:
    """Whether somebody may be watching stderr."""
    return sys.stderr.isatty()
