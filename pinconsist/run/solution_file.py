"""A solution in a few lines of text, and as an npz file: arrays, and one JSON text with them; never a pickle."""

import json
import platform
from pathlib import Path

import numpy as np

from .. import __version__
from ..errors import FormatError
from ..files import suffixed, written_whole
from .certificate import Certificate, from_plain, plain
from .contact_results import ContactHistory

FORMAT = 4
ARRAYS = {"t": 1, "q": 2, "v": 2, "lam": 2, "h": 1, "order": 1}
"""Name → number of dimensions."""
TYPES = {"order": np.int64}
"""Types of arrays that are not of double precision."""
HELD = "held "
"""Before the label of a force, the name of the table that it has held."""
EVENTS = ("t_events", "q_events", "v_events")
"""Before the number of an event, from 0 on, the name of the times or states at which it occurred."""
_ABOUT = {
    "status": int, "message": str, "nsteps": int, "nfev": int, "njev": int, "nlu": int, "rejected": dict,
    "success": bool, "method": dict, "scene": str, "recipe": dict | None, "versions": dict,
}  # fmt: skip


def write(solution, file) -> Path:
    """Write a solution, whole or not at all; ``.npz`` is added to a name without it."""
    path = suffixed(file, ".npz")
    about = {name: getattr(solution, name) for name in _ABOUT} | {"format": FORMAT}
    about["versions"] = about["versions"] or versions()
    about["certificate"] = plain(solution.certificate)
    if solution.contacts is not None:
        about["contacts"] = solution.contacts.plain()
    with written_whole(path) as stream:
        arrays = {name: getattr(solution, name) for name in ARRAYS}
        held = {f"{HELD}{label}": table for label, table in solution.held.items()}
        occurred = {f"{name} {k}": each for name in EVENTS for k, each in enumerate(getattr(solution, name))}
        np.savez(stream, about=np.array(json.dumps(about)), **arrays, **held, **occurred)
    return path


def read(file) -> tuple[dict, Certificate | None]:
    """The fields of the solution in a file, and its certificate; FormatError for anything but a whole file."""
    import zipfile

    try:
        with zipfile.ZipFile(file) as archive:  # if compressed, a few kB can expand to all of the memory
            if any(member.compress_type != zipfile.ZIP_STORED for member in archive.infolist()):
                raise ValueError("its arrays are compressed")
        with np.load(file, allow_pickle=False) as stored:
            about = json.loads(str(stored["about"]))
            if (written := about.pop("format", None)) != FORMAT:
                writer = about.get("versions", {}).get("pinconsist")
                by = f"pinconsist {writer}" if writer else "another version of pinconsist"
                here = f"pinconsist {__version__}, which is installed here, reads format {FORMAT}"
                raise FormatError(f"written by {by} in format {written!r}; {here}", path=file)
            arrays = {name: _numbers(name, stored[name]) for name in ARRAYS}
            names = [name for name in stored.files if name.startswith(HELD)]
            held = {name[len(HELD) :]: _numbers(name, stored[name]) for name in names}
            count = sum(name.startswith(f"{EVENTS[0]} ") for name in stored.files)
            events = {name: [_numbers(name, stored[f"{name} {k}"]) for k in range(count)] for name in EVENTS}
        certificate = from_plain(about.pop("certificate", None))
        contacts = ContactHistory.recorded(about.pop("contacts", None))
        _check(arrays, about, held, events)
    except FormatError:
        raise
    except FileNotFoundError:
        raise FormatError("no such file", path=file) from None
    except PermissionError as error:
        raise FormatError(f"cannot be read: {error.strerror}", path=file) from None
    except Exception as error:  # zipfile, numpy and json raise many kinds for a damaged file
        reason = str(error) or type(error).__name__
        raise FormatError(f"damaged, or not a solution written by pinconsist ({reason})", path=file) from None
    for array in (*arrays.values(), *held.values(), *(each for several in events.values() for each in several)):
        array.setflags(write=False)
    return arrays | about | events | {"held": held, "contacts": contacts}, certificate


def versions() -> dict[str, str]:
    """Versions on which the last bit of a result may depend."""
    from importlib.metadata import PackageNotFoundError, version  # rarely needed, and slow to import

    found = {"pinconsist": __version__, "python": platform.python_version(), "machine": platform.machine()}
    for package in ("pin", "numpy", "scipy"):
        try:
            found[package] = version(package)
        except PackageNotFoundError:  # Pinocchio may not have been installed by pip
            found[package] = "unknown"
    return found


def _numbers(name, array):
    """A stored array in the type of a solution, whatever the type and byte order in which it was written."""
    if array.dtype.kind not in "biuf":
        raise ValueError(f"array {name!r} has type {array.dtype}, not numbers")
    kind = TYPES.get(name, np.float64)
    found = np.ascontiguousarray(array, kind)
    if kind == np.int64 and (found != array).any():
        raise ValueError(f"array {name!r} has numbers that are not whole")
    return found.reshape(array.shape)


def _check(arrays, about, held, events):
    """Raise ValueError unless shapes and types are those of a solution."""
    if set(about) != set(_ABOUT):
        raise ValueError(f"missing or unknown entries: {', '.join(sorted(set(about) ^ set(_ABOUT)))}")
    for name, kind in _ABOUT.items():
        if not isinstance(about[name], kind):
            raise ValueError(f"{name} is a {type(about[name]).__name__}")
    rows, steps = len(arrays["t"]), len(arrays["h"])
    for name, array in arrays.items():
        wanted = steps if name in ("h", "order") else rows
        if array.ndim != ARRAYS[name] or len(array) != wanted:
            raise ValueError(f"array {name!r} has shape {array.shape}")
    if not np.isfinite(arrays["t"]).all():
        raise ValueError("array 't' has times that are not finite")
    if steps not in (0, rows - 1):
        raise ValueError(f"{steps} steps for {rows} rows")
    widths = (1 + arrays["v"].shape[1],), (2,)
    for name, table in held.items():
        if table.shape[1:] not in widths:
            raise ValueError(f"array {HELD + name!r} has shape {table.shape}")
    for k, occurred in enumerate(zip(*events.values(), strict=True)):
        count = len(occurred[0])
        shapes = (count,), *((count, *arrays[name].shape[1:]) for name in "qv")
        for name, array, shape in zip(EVENTS, occurred, shapes, strict=True):
            if array.shape != shape and (count or array.size):
                raise ValueError(f"array {f'{name} {k}'!r} has shape {array.shape}")


def summary_of(solution) -> str:
    """The message; steps, their sizes and orders; rejected steps by reason; evaluations; skipped loop rows."""
    lines = [solution.message]
    if len(solution.t):
        rejected = {reason: count for reason, count in solution.rejected.items() if count}
        wasted = "".join(f" ({count} rejected by {reason})" for reason, count in rejected.items())
        if len(rejected) > 1:
            each = ", ".join(f"{count} by {reason}" for reason, count in rejected.items())
            wasted = f" ({sum(rejected.values())} rejected: {each})"
        lines.append(f"t = {solution.t[0]:g} … {solution.t[-1]:g} s in {solution.nsteps} steps{wasted}")
    taken = np.abs(solution.h[solution.h != 0])
    if len(taken):
        counts = np.bincount(solution.order[solution.h != 0])
        orders = [f"{count} of order {k}" for k, count in enumerate(counts) if k and count]
        orders += [f"{counts[0]} of the start"] if counts[0] else []
        lines.append(f"steps {taken.min():.3g} … {taken.max():.3g} s: {', '.join(orders)}")
    lines.append(f"{solution.nfev} residuals, {solution.njev} Newton matrices, {solution.nlu} factorisations")
    if rows := [skip for skip in solution.method.get("skipped", ()) if "loop rows" in skip]:
        lines.append(f"skipped: {', '.join(rows)}")  # the rest, work that was not requested, is in `method`
    return "\n".join(lines)


def skipped_work(trajectory) -> list[str]:
    """What the integration of a trajectory skipped: work that its scene does not need, or that was not requested."""
    system = trajectory.system
    skipped = ["charts (all joints vector-like)"] if system.vector_like else []
    rows = system.n_multipliers
    if rows > system.nc:
        skipped.append(f"{rows - system.nc} of {rows} loop rows (dependent or zero)")
    if system.mechanism is not None and system.mechanism.geometry is not None:
        skipped.append("geometry")
    if trajectory.dense is None:
        skipped.append("dense output")
    if not trajectory.events:
        skipped.append("events")
    return skipped
