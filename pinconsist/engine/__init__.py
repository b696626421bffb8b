"""The engine: the adaptive method in C++, and the systems that it integrates.

Reading order of the Python files:

1. :mod:`problem`: the form of the systems, and what each must be able to compute; :mod:`hessenberg`: general problems.
2. :mod:`index1`: accelerations, multipliers and projections of a state.
3. :mod:`charts`, :mod:`norms`, :mod:`rounding`, :mod:`radau_table`: positions on manifolds, sizes, tables of formulas.
4. :mod:`systems`: a mechanism's system in the engine; :mod:`tree`: its bodies.

The order of the C++ headers: ``tuning.hpp`` (the constants), ``system.hpp`` (equations) with ``mechanism.hpp``,
``rows.hpp``, ``forces.hpp`` and ``callback_system.hpp``; ``lanes.hpp`` and ``state_lanes.hpp`` (several
states at once, by the vectors of the processor); ``kkt.hpp``; ``run.hpp`` (the loop of a run) with
``events.hpp``; BDF: ``bdf.hpp``, ``newton.hpp``, ``control.hpp``, ``start.hpp``, ``stepper.hpp``; Radau IIA:
``radau.hpp``, ``stages.hpp``, ``stage_matrix.hpp``, ``collocation.hpp``, ``radau_stepper.hpp``; ``numbers.hpp``
and ``ensemble.hpp`` (many runs at once); ``gradient.hpp`` (derivatives).
"""

import atexit
import hashlib
import shlex
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from ..errors import PinconsistError

FOLDER = Path(__file__).parent


def _is_checkout() -> bool:
    return (FOLDER.parents[1] / "CMakeLists.txt").is_file()


def _command() -> str:
    """The command that compiles the package."""
    what = f"-e {shlex.quote(str(FOLDER.parents[1]))}" if _is_checkout() else "--force-reinstall --no-deps pinconsist"
    return f"{shlex.quote(sys.executable)} -m pip install {what}"


def digest_of(folder: Path) -> str:
    """The digest of the C++ sources in a folder, as CMakeLists.txt computes it."""
    sources = sorted([*folder.glob("*.hpp"), *folder.glob("*.cpp")])
    digests = [hashlib.sha256(source.read_bytes()).hexdigest() + "\n" for source in sources]
    return hashlib.sha256("".join(digests).encode()).hexdigest()


def trouble() -> str:
    """Why there are no runs: the compiled module is missing, or older than its sources. Empty if it is there."""
    spec = find_spec(f"{__name__}._engine")
    if spec is None or spec.origin is None:
        if not _is_checkout():
            return f"pinconsist was installed without its compiled part; install it again: {_command()}"
        return (
            f"pinconsist is imported from its sources in {FOLDER.parent}, without its compiled part: change to another "
            f"folder to use an installed package, or compile it there: {_command()}"
        )
    if not _is_checkout():
        return ""
    digest = Path(spec.origin).with_name("sources.sha256")
    if digest.is_file() and digest.read_text() == digest_of(FOLDER):
        return ""
    return (
        f"the compiled part of pinconsist, {spec.origin}, is older than its sources in {FOLDER}; compile it again: "
        f"{_command()}"
    )


@cache
def required():
    """The compiled module; PinconsistError with the reason if there is none for these sources."""
    if why := trouble():
        raise PinconsistError(f"pinconsist needs its compiled part: {why}")
    try:
        from . import _engine
    except ImportError as error:
        raise PinconsistError(
            f"the compiled part of pinconsist cannot be loaded ({error}); install it again: {_command()}"
        ) from error
    from .radau_table import STAGES, eigenvectors, gauss, table

    _engine.load_lapack_by(_load_lapack)
    atexit.register(_engine.load_lapack_by, None)
    for s in STAGES:
        of = table(s)
        _engine.use_radau(of.c, of.A, of.inverse, of.inverse2, of.modes, of.raised, *eigenvectors(s), *gauss(s))
    return _engine


def _load_lapack() -> None:
    """Pass SciPy's LAPACK to the engine, which asks for it when a matrix is large: its import takes long."""
    from scipy.linalg import cython_lapack

    required().use_lapack(*(cython_lapack.__pyx_capi__[name] for name in ("dgetrf", "dgetrs")))


def constant(name: str) -> float:
    """A constant of the method, see tuning.hpp."""
    return required().constant(name)
