"""Which files load, close and run: ``python -m benchmarks gallery``."""

from __future__ import annotations

import logging
import re
import time
import warnings
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, distribution
from math import nan
from pathlib import Path
from typing import Annotated

import typer

import pinconsist as pc
from pinconsist.cli import output
from pinconsist.cli.scene import option
from pinconsist.formats.catalogue import READERS, reader_of
from pinconsist.mechanism.closing import held_motors

from . import report

PACKAGES = {
    "robots": ("example-robot-data", "cmeel.prefix/share/example-robot-data/robots"),
    "mujoco": ("mujoco", "mujoco"),
}
"""Name → pip package, and the folder in it that is searched."""
WALL = 20.0  # s after which a run is ended
SHOWN = 90  # characters of a message


class _TooLong(Exception):
    pass


@dataclass
class Row:
    """One file, released from rest where its loops close."""

    file: str
    kind: str  # reader
    verdict: str = ""
    bodies: int = 0
    loops: int = 0
    rows: int = 0
    rank: int = 0
    mobility: int = 0
    closed_to: float = nan  # largest |Φ|, m or rad
    wall: float = nan  # s for each simulated second
    motors: int = 0
    moving: int = 0  # motors that can move independently
    ok: bool = False  # the verdict of its certificate


def gallery(sources, until=0.5) -> Iterator[Row]:
    """Load, close and simulate all files of the sources: names of `PACKAGES`, ``models``, or folders."""
    for source in sources:
        for title, file in files_of(source):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                yield _row(title, file, until)


def files_of(source):
    """(title, path) of the files of a source; the names of built-in scenes instead of their paths."""
    if source == "models":
        yield from ((name, name) for name in pc.models() if "<" not in name)
        return
    if source in PACKAGES:
        package, folder = PACKAGES[source]
        try:
            root = Path(str(distribution(package).locate_file(folder)))
        except PackageNotFoundError:
            raise pc.InputError(f"{source}: pip install {package}") from None
    else:
        root = Path(source)
    found = [path for path in sorted(root.rglob("*")) if _is_scene(path)]
    if not found:
        raise pc.InputError(f"{source}: no file of a kind that can be read")
    for path in found:
        if path.suffix != ".xml" or path.name != "package.xml":
            yield str(path.relative_to(root)), path


def _is_scene(path) -> bool:
    try:
        return path.suffix.lower() in READERS and path.is_file() and bool(reader_of(path))
    except pc.FormatError:  # of YAML files, which are of many kinds
        return False


def _row(title, file, until) -> Row:
    row = Row(title, "built in" if isinstance(file, str) else reader_of(file))
    try:
        mech = pc.load(file, **({} if isinstance(file, str) else {"package_dirs": [str(file.parents[1])]}))
        row.bodies, row.loops, row.motors = len(mech.joints), len(mech.loops), len(mech.actuated)
        assembly = pc.assemble(mech)
        row.rows, row.rank, row.mobility = assembly.rows, assembly.rank, assembly.mobility
        row.closed_to = max(assembly.gaps.values(), default=0.0)
        row.moving = row.motors - len(held_motors(mech, assembly.q))
        start = time.perf_counter()

        def on_time(*_):
            if time.perf_counter() - start > WALL:
                raise _TooLong

        sol = pc.simulate(mech, (0.0, until), callback=on_time)
        if not sol.success:
            row.verdict = sol.message
            return row
        row.wall = (time.perf_counter() - start) / until
        certificate = sol.check()
        row.ok = certificate.ok
        row.verdict = re.sub(r".*?: (ok|look)", r"\1", certificate.verdict)
    except pc.PinconsistError as error:
        row.verdict = f"{type(error).__name__}: {error}".replace(f"{Path(file).parent}/", "")
    except _TooLong:
        row.verdict = f"not at its end after {WALL:g} s"
    return row


def counts(rows) -> list[dict]:
    """Kind → how many files there are, load, close, run to the end, and have the verdict ok."""
    kinds = dict.fromkeys(row["kind"] for row in rows)
    return [
        {"kind": kind, "files": len(of), "load": sum(row["bodies"] > 0 for row in of),
         "close": sum(row["closed_to"] == row["closed_to"] for row in of),
         "run": sum(row["wall"] == row["wall"] for row in of), "ok": sum(row["ok"] for row in of)}
        for kind in kinds for of in [[row for row in rows if row["kind"] == kind]]
    ]  # fmt: skip


# fmt: off
def command(
    sources: Annotated[list[str] | None, typer.Argument(metavar="[robots|mujoco|models|FOLDER ...]", help=(
        "The files of example-robot-data, of MuJoCo's wheel, the built-in scenes, or all files in a folder. "
        "Default: the first three."))] = None,
    until: Annotated[float, option("--until", "SECONDS", "Simulated time.")] = 0.5,
    csv: report.Csv = None,
    as_json: output.Json = False,
) -> int:
    # fmt: on
    """Load all files that can be had, close their loops, and let them fall from rest.

    Example: python -m benchmarks gallery robots mujoco --csv gallery.csv
    """
    output.require_writable(csv=csv)
    logging.getLogger("pinconsist").setLevel(logging.ERROR)
    rows = [asdict(row) for row in gallery(sources or [*PACKAGES, "models"], until)]
    if report.in_files(csv, as_json, rows, gallery=rows, counts=counts(rows)):
        return output.FINE
    heads = ["kind", "files>", "load>", "close>", "run>", "ok>"]
    report.table(counts(rows), heads, "files that load, close, run to the end, and have the verdict ok")
    columns = ["file", "bodies>", "loops>", "rows>", "rank>", "mobility>", ("closed to>", "{closed_to:.0e}"),
               ("wall [s/s]>", "{wall:.2g}"), ("motors>", "{moving}/{motors}"),
               ("verdict", lambda row: row["verdict"][:SHOWN])]  # fmt: skip
    report.table(rows, columns, f"released from rest, {until:g} s")
    return output.FINE
