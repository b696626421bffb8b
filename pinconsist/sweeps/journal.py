"""The rows of a sweep as they come, one line each, so that a killed sweep goes on from what it has written."""

from __future__ import annotations

import fcntl
import json
from pathlib import Path

from ..errors import FormatError, InputError

FORMAT = 1


class Journal:
    """A file beside a table that is being made; locked while it is open.

    Parameters
    ----------
    table : path-like
        The file to be made. The journal is named like it, with ``.partial`` after it.
    about : dict
        What the rows are of, in plain data.

    Attributes
    ----------
    path : Path
    rows : dict[int, dict]
        Case → its row, of those that are done.

    Raises
    ------
    InputError
        The journal there is of another sweep, or another process writes it.
    FormatError
        It is no journal, or damaged.
    OSError
        It cannot be opened or written.
    """

    def __init__(self, table, about: dict):
        self.path = Path(f"{table}.partial")
        self.rows: dict[int, dict] = {}
        self._stream = open(self.path, "a+b", buffering=0)  # unbuffered: a line is written by one call, or not at all
        try:
            self._lock()
            self._begin(about)
        except BaseException:
            self._stream.close()
            raise

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._stream.close()

    def add(self, case: int, row: dict) -> None:
        """Keep the row of a case."""
        self._write([case, row])
        self.rows[case] = row

    def remove(self) -> None:
        """Delete the file, once its table is there."""
        self.path.unlink(missing_ok=True)

    def _write(self, values):
        line = json.dumps(values).encode() + b"\n"
        written = self._stream.write(line)
        if written != len(line):  # the next try tells why
            self._stream.write(line[written:])

    def _lock(self):
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise InputError(f"{self.path} is being written by another sweep; wait for its end, or stop it") from None

    def _begin(self, about):
        header = {"pinconsist sweep": FORMAT, "about": json.loads(json.dumps(about))}
        self._stream.seek(0)
        whole, newline, torn = self._stream.read().rpartition(b"\n")
        lines = whole.split(b"\n") if newline else []
        if not lines and not json.dumps(header).encode().startswith(torn):
            raise self._damaged(1)
        if torn:  # killed while it wrote
            self._stream.truncate(len(whole) + len(newline))
        if not lines:
            self._write(header)
            return
        entries = [self._entry(k, line) for k, line in enumerate(lines, start=1)]
        self._require_same(entries[0], header, len(entries) - 1)
        for k, entry in enumerate(entries[1:], start=2):
            match entry:
                case [int(i), {"status": str(), "message": str()}] if 0 <= i < about["cases"]["count"]:
                    self.rows[i] = entry[1]
                case _:
                    raise self._damaged(k)

    def _entry(self, k, line):
        try:
            return json.loads(line)
        except ValueError:
            raise self._damaged(k) from None

    def _require_same(self, found, header, count):
        if not isinstance(found, dict) or not isinstance(found.get("about"), dict) or header.keys() != found.keys():
            raise self._damaged(1)
        if found == header:
            return
        mine, other = header["about"], found["about"]
        different = [name for name in mine if mine[name] != other.get(name)] or ["its format"]
        raise InputError(
            f"{self.path} holds {count} cases of another sweep, which differs in {', '.join(different)}. End that one "
            f"by its own command, write this one elsewhere by --out, or delete {self.path.name} to begin afresh"
        )

    def _damaged(self, line) -> FormatError:
        what = "no journal of a sweep, or a damaged one; delete it, or move it away, to begin afresh"
        return FormatError(what, path=self.path, element=f"line {line}")
