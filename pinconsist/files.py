"""Files are written whole or not at all."""

import csv
import errno
import io
import os
import secrets
from contextlib import contextmanager, suppress
from pathlib import Path

from .errors import InputError


def as_path(file) -> Path:
    """The path of a file; InputError for what is no path."""
    try:
        return Path(file)
    except TypeError:
        raise InputError(f"a file must be named by a path, got {file!r}") from None


@contextmanager
def written_whole(file):
    """A binary stream whose content becomes `file` at the end of the block; after an error nothing is left behind.

    What is not a regular file, such as /dev/stdout or a pipe, is written to directly and never replaced.
    """
    file = as_path(file)
    if os.path.exists(file) and not os.path.isfile(file):
        with open(file, "wb") as stream:
            yield stream
        return
    target = Path(os.path.realpath(file))
    if not target.parent.is_dir():  # an error of `open` would name the draft, which the user does not know
        raise FileNotFoundError(errno.ENOENT, "there is no folder for", str(target))
    draft = target.with_name(f".{target.name}.{secrets.token_hex(6)}")
    try:
        with open(draft, "xb") as stream:  # next to the target: os.replace is atomic only within one file system
            yield stream
            stream.flush()
            os.fsync(stream.fileno())  # otherwise a power failure may leave the new name with no content
        os.replace(draft, target)
        _sync_folder(target.parent)
    finally:
        draft.unlink(missing_ok=True)


def _sync_folder(folder) -> None:
    """Flush file names to the disk if platform and file system can: a power failure might undo them."""
    with suppress(OSError):
        number = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(number)
        finally:
            os.close(number)


def suffixed(file, suffix: str) -> Path:
    """The path with a suffix added to a name without it."""
    path = as_path(file)
    return path if path.suffix == suffix else path.with_name(path.name + suffix)


def require_writable(file) -> None:
    """Raise InputError now for a file that could not be written after a long run."""
    path = as_path(file)
    folder = path.absolute().parent
    if path.is_dir():
        raise InputError(f"{file} cannot be written: it is a folder")
    if not folder.is_dir():
        raise InputError(f"{file} cannot be written: there is no folder {folder}")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"{file} cannot be written: no permission to write in {folder}")


def write_csv(file, names, units, values) -> Path:
    """The CSV file of a table, units in its headings, numbers with all their digits; whole or not at all."""
    import numpy as np

    heads = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
    csv.writer(line := io.StringIO(), lineterminator="\n").writerow(heads)
    with written_whole(file) as stream:
        stream.write(line.getvalue().encode())
        np.savetxt(stream, values, fmt="%.17g", delimiter=",")
    return Path(file)
