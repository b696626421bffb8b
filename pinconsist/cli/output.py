"""Output of commands: exit codes, messages, tables, JSON, progress, and files, which are checked before a long run."""

import json
import math
import re
import secrets
import shlex
import shutil
import sys
import tempfile
import textwrap
import time
from collections.abc import Mapping
from contextlib import contextmanager, nullcontext, suppress
from itertools import zip_longest
from pathlib import Path
from typing import Annotated, Any

import typer

from .. import files
from ..errors import CONTROLS, AssemblyError, InputError

FINE, FAILED, WRONG_INPUT, INTERRUPTED = 0, 1, 2, 130
WIDTH, PLAIN_WIDTH = 160, 80  # largest width of text on a terminal; width in a file or a pipe
GAP, ABOUT = "  ", 43  # between columns; start of the last column of a certificate
NOTHING = 1e-12  # rad, m and so on: smaller numbers are printed as zero
WHOLE_WORDS: Any = {"break_long_words": False, "break_on_hyphens": False}
AT_TIME = re.compile(r"\bt = \S+ s\b")  # not broken across lines
LOADED = re.compile(r"load\(…, (\w+ ?= ?[^)]+)\)")
ARGUMENT = re.compile(
    r"(?<!-)\b(order|max_steps?|rtol|atol|package_dirs|free_flyer|precision|closure|loops|ignore|consistency|method|step|at)"
    r" ?= ?'?([^\s',;:()]*)'?|(?<!-)\b(order(?= must)|max_steps?|rtol|atol|package_dirs|free_flyer)\b"
)
IGNORED = re.compile(r"\bignore ?= ?\['([^']*)'\]")
SPELT = {"package_dirs": "package_dir"}

BAR_AFTER = 1.0  # s before the progress bar of a run appears
PERIOD = 0.1  # s between its updates

Json = Annotated[bool, typer.Option("--json", help="Print one JSON object instead.")]


def table(columns, rows, *, title=None):
    """Print a table and an empty line; a column named ``...>`` contains numbers: aligned right, never broken.

    After ``>`` the format of :func:`size` for its floats may follow, as in ``gap>.3g``. The table fits the terminal, or
    80 columns: texts are wrapped at words, and columns that do not fit are printed below, with the first one repeated.
    """
    parted = [name.partition(">") for name in columns]
    aligned = [sign or "<" for _, sign, _ in parted]
    cells = [
        [head, *(size(row[k], digits) if digits and isinstance(row[k], float) else str(row[k]) for row in rows)]
        for k, (head, _, digits) in enumerate(parted)
    ]
    whole = [
        [*head.split(), *(values if side == ">" else " ".join(values).split())]
        for (head, *values), side in zip(cells, aligned, strict=True)
    ]
    least, natural = ([max(map(len, column)) for column in parts] for parts in (whole, cells))
    room = _width(sys.stdout)
    for line in filter(None, [title]):
        print(line)
    for block in _blocks(least, room):
        widths = _widened([least[k] for k in block], [natural[k] for k in block], room)
        sides = [aligned[k] for k in block]
        for number, row in enumerate(zip(*(cells[k] for k in block), strict=True)):
            parts = [textwrap.wrap(cell, width, **WHOLE_WORDS) for cell, width in zip(row, widths, strict=True)]
            for texts in zip_longest(*parts, fillvalue=""):
                each = [f"{text:{side}{width}}" for text, side, width in zip(texts, sides, widths, strict=True)]
                print(GAP.join(each).rstrip())
            if number == 0:
                print("─" * len(GAP.join(each)))
        print()


def _blocks(widths, room) -> list[list[int]]:
    """The columns of the parts into which a table is split, each within `room` if possible."""
    blocks, taken = [[0]], widths[0]
    for k, width in enumerate(widths[1:], start=1):
        taken += len(GAP) + width
        if taken > room and len(blocks[-1]) > 1:
            blocks.append([0])
            taken = widths[0] + len(GAP) + width
        blocks[-1].append(k)
    return blocks


def _widened(least, natural, room) -> list[int]:
    """Widths of columns that share the remaining room; those that need the least get it first."""
    widths, spare = list(least), room - sum(least) - len(GAP) * (len(least) - 1)
    for left, k in enumerate(sorted(range(len(least)), key=lambda k: natural[k] - least[k]), start=-len(least)):
        widths[k] += (more := max(0, min(natural[k] - least[k], spare // -left)))
        spare -= more
    return widths


def size(value, digits=".6g") -> str:
    """A number as text; a value below 1e-12 is rounding and printed as 0."""
    return "0" if abs(value) < NOTHING else f"{value:{digits}}"


def paragraph(text, *, indent="", hanging=""):
    """Print a text in lines that fit the terminal, or 80 columns, without breaking words."""
    print(_filled(CONTROLS.sub("?", text), sys.stdout, indent, indent + hanging))


def verdict(certificate):
    """Print a certificate, wrapped to the terminal, with its verdict and each ``look`` in colour."""
    from rich.console import Console
    from rich.text import Text

    console = Console(highlight=False)
    with console.capture() as drawn:
        for number, line in enumerate(in_options(str(certificate)).splitlines()):
            text = Text(_filled(line, sys.stdout, "", " " * (number and (6 if line.startswith("note") else ABOUT))))
            if number == 0:
                text.stylize("green" if certificate.ok and not certificate.not_judged else "yellow")
            else:
                text.highlight_regex(r"\blook\b", "yellow")
            console.print(text, soft_wrap=True)
    print(drawn.get(), end="")


def _filled(text, stream, first, others):
    """The text in lines that fit the stream."""
    text = AT_TIME.sub(lambda found: found[0].replace(" ", "\xa0"), text)
    filled = textwrap.fill(text, _width(stream), initial_indent=first, subsequent_indent=others, **WHOLE_WORDS)
    return filled.replace("\xa0", " ")


def _width(stream) -> int:
    return min(shutil.get_terminal_size().columns, WIDTH) if stream.isatty() else PLAIN_WIDTH


def message(kind, text):
    """Print an error or a warning on stderr, in terms of the command line; in a single line if not on a terminal."""
    line = f"pinconsist: {kind}: {in_options(text)}"
    print(_filled(line, sys.stderr, "", "  ") if on_terminal() else line, file=sys.stderr)


def in_options(text) -> str:
    """A text of the package with Python's arguments replaced by options: ``--rtol 1e-6`` for ``rtol = 1e-6``."""
    text = LOADED.sub(r"\1", CONTROLS.sub("?", str(text)))
    text = IGNORED.sub(lambda found: f"--ignore {shlex.quote(found[1])}", text)
    return ARGUMENT.sub(lambda found: f"--{SPELT.get(name := found[1] or found[3], name).replace('_', '-')}"
                        + (f" {found[2]}" if found[2] else ""), text)  # fmt: skip


def print_error(error):
    """Print an error on stderr and, if its advice is in terms of Python, the options to use instead."""
    message("error", error)
    if isinstance(error, AssemblyError) and error.gaps:
        print("on the command line: --at JOINT=VALUE, --closure point, --reanchor", file=sys.stderr)


def counted(count: int, noun: str) -> str:
    """``1 loop``, ``2 loops``, ``2 bodies``."""
    plural = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count} {noun if count == 1 else plural}"


def first(texts, most, more="… and {} more") -> list[str]:
    """At most `most` of the texts, followed by the number of the others."""
    return [*texts[:most], *([more.format(len(texts) - most)] if len(texts) > most else [])]


def print_json(values):
    """Print one JSON object on stdout; NaN and infinity become null."""
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
    """Raise InputError for files, given by the names of their options, that could not be written after the run."""
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


def written(file, write, hint=""):
    """Call `write`, which writes `file`; a disk error becomes an InputError, with a `hint`."""
    try:
        return write()
    except OSError as error:
        raise InputError(f"{file} cannot be written: {error.strerror or error}{hint}") from error


def rescued(solution):
    """Save a run elsewhere if its own file cannot be written; return the file, or None if no folder is writable."""
    for folder in (tempfile.gettempdir(), Path.home(), Path.cwd()):
        with suppress(OSError):
            return solution.save(Path(folder, f"pinconsist-{secrets.token_hex(4)}.npz"))
    return None


def on_terminal() -> bool:
    return sys.stderr.isatty()


def doing(what: str):
    """A context in which stderr, if it is a terminal, shows what is being done."""
    if not on_terminal():
        return nullcontext()
    from rich.console import Console
    from rich.text import Text

    return Console(stderr=True).status(Text(f"{what} …"))


def bar(*after):
    """A progress bar of `rich` on stderr, as wide as the terminal: percentage, time left, and further texts.

    It disappears when done.
    """
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = TextColumn("{task.percentage:3.0f} %"), BarColumn(None), TimeRemainingColumn(), TextColumn("left,")
    console = Console(stderr=True)
    return Progress(*columns, *map(TextColumn, after), console=console, transient=True, expand=True)


@contextmanager
def counting(what: str, total=None, done=0):
    """A context with a function of (number done, total) that updates a bar; None if stderr is not a terminal."""
    if not on_terminal():
        yield None
        return
    with bar(f"{{task.completed}} of {{task.total}} {what}") as shown:
        task = shown.add_task("", total=total, completed=done)
        yield lambda done, total=total: shown.update(task, completed=done, total=total)


class RunProgress:
    """A context with a callback for `simulate` that shows the progress of a run; None if stderr is not a terminal."""

    each_step = False  # it is called with batches of steps, see run/output.py

    def __init__(self, start: float, end: float):
        self.start, self.end, self.steps = start, end, 0
        self.bar: Any = None
        self.next_update = time.monotonic() + BAR_AFTER

    def __enter__(self):
        return self if on_terminal() else None

    def __exit__(self, *_):
        if self.bar is not None:
            self.bar.stop()

    def __call__(self, t, step, order, count):
        self.steps += count
        if time.monotonic() < self.next_update:
            return
        self.next_update = time.monotonic() + PERIOD
        text = f"t = {t:.4g} of {self.end:g} s, {self.steps} steps"
        if self.bar is None:
            self.bar = bar("{task.description}")
            self.task = self.bar.add_task(text, total=abs(self.end - self.start))
            self.bar.start()
        self.bar.update(self.task, completed=abs(t - self.start), description=text)
