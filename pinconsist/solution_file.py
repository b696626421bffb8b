"""The npz file of a Solution: arrays, and one JSON text with them; never a pickle."""

import json
import platform
import zipfile
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

from . import __version__
from .errors import FormatError
from .files import suffixed, written_whole

FORMAT = 2
ARRAYS = {"t": 1, "q": 2, "v": 2, "lam": 2, "h": 1, "order": 1}
"""Name → number of dimensions."""
HELD = "held "
"""Before the label of a force, the name of the table that it has held."""
_ABOUT = {
    "status": int, "message": str, "nsteps": int, "nfev": int, "njev": int, "nlu": int, "rejected": dict,
    "success": bool, "method": dict, "scene": str, "recipe": dict | None, "versions": dict,
}  # fmt: skip


def write(solution, file) -> Path:
    """Write a solution, whole or not at all; ``.npz`` is added to a name without it."""
    path = suffixed(file, ".npz")
    about = {name: getattr(solution, name) for name in _ABOUT} | {"format": FORMAT}
    about["versions"] = about["versions"] or versions()
    with written_whole(path) as stream:
        arrays = {name: getattr(solution, name) for name in ARRAYS}
        held = {f"{HELD}{label}": table for label, table in solution.held.items()}
        np.savez(stream, about=np.array(json.dumps(about)), **arrays, **held)
    return path


def read(file) -> dict:
    """The fields of the solution in a file; FormatError for anything but a whole file of this format."""
    try:
        with zipfile.ZipFile(file) as archive:  # compressed, a few kB can stand for all of the memory
            if any(member.compress_type != zipfile.ZIP_STORED for member in archive.infolist()):
                raise ValueError("its arrays are compressed")
        with np.load(file, allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            if (written := about.pop("format", None)) != FORMAT:
                writer = about.get("versions", {}).get("pinconsist")
                by = f"pinconsist {writer}" if writer else "another version of pinconsist"
                here = f"pinconsist {__version__}, which is installed here, reads format {FORMAT}"
                raise FormatError(f"written by {by} in format {written!r}; {here}", path=file)
            arrays = {name: stored[name] for name in ARRAYS}
            held = {name[len(HELD) :]: stored[name] for name in stored.files if name.startswith(HELD)}
        _check(arrays, about)
        if any(
            table.shape[1:] not in ((1 + arrays["v"].shape[1],), (2,)) or table.dtype.kind != "f"
            for table in held.values()
        ):
            raise ValueError("a table of held torques does not fit")
    except FormatError:
        raise
    except FileNotFoundError:
        raise FormatError("no such file", path=file) from None
    except PermissionError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path=file) from None
    except Exception as error:  # zipfile, numpy and json raise many kinds for a damaged file
        reason = str(error) or type(error).__name__
        raise FormatError(f"damaged, or not a solution written by pinconsist ({reason})", path=file) from None
    for array in (*arrays.values(), *held.values()):
        array.setflags(write=False)
    return arrays | about | {"held": held}


def versions() -> dict[str, str]:
    """What the last bit of a result may depend on."""
    found = {"pinconsist": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for package in ("pin", "numpy", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # Pinocchio may come from elsewhere than pip
            found[package] = "unknown"
    return found


def _check(arrays, about):
    """Raise ValueError where shapes and types are not those of a solution."""
    if set(about) != set(_ABOUT):
        raise ValueError(f"missing or unknown entries: {', '.join(sorted(set(about) ^ set(_ABOUT)))}")
    for name, kind in _ABOUT.items():
        if not isinstance(about[name], kind):
            raise ValueError(f"{name} is a {type(about[name]).__name__}")
    rows, steps = len(arrays["t"]), len(arrays["h"])
    for name, array in arrays.items():
        wanted = steps if name in ("h", "order") else rows
        if array.ndim != ARRAYS[name] or array.dtype.kind not in "if" or len(array) != wanted:
            raise ValueError(f"{name} has shape {array.shape} and type {array.dtype}")
    if steps not in (0, rows - 1):
        raise ValueError(f"{steps} steps for {rows} rows")
