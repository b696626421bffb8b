"""The method, in C++: many accepted steps in one call.

User-defined forces and constraints are called back in Python.
"""

import shlex
import sys
from functools import cache
from importlib.util import find_spec
from pathlib import Path

from ..dae import tuning
from ..dae.radau_table import gauss, table
from ..errors import PinconsistError

INTERFACE = 38  # as in module.cpp: an editable install may hold an older build


def _absent(folder: Path) -> str:
    """The reason why there is no compiled module for the package in a folder."""
    if _is_checkout(folder):
        return (
            f"pinconsist is imported from its sources in {folder}, without its compiled part: change to another folder "
            f"to use an installed package, or compile it there: {_command(folder)}"
        )
    return f"pinconsist was installed without its compiled part; install it again: {_command(folder)}"


def _is_checkout(folder: Path) -> bool:
    return (folder / "CMakeLists.txt").is_file()


def _command(folder: Path) -> str:
    """The command that compiles the package in a folder."""
    what = f"-e {shlex.quote(str(folder))}" if _is_checkout(folder) else "--force-reinstall --no-deps pinconsist"
    return f"{shlex.quote(sys.executable)} -m pip install {what}"


@cache
def load():
    """(the compiled module, "") or (None, the reason why there is none)."""
    folder = Path(__file__).parents[2]
    again = f"install pinconsist again: {_command(folder)}"
    if find_spec(f"{__name__}.twin") is None:
        return None, _absent(folder)
    try:
        from . import twin
    except ImportError as error:
        return None, f"the compiled part of pinconsist cannot be loaded ({error}); {again}"
    if getattr(twin, "INTERFACE", 0) != INTERFACE:
        return None, (
            f"the compiled part of pinconsist, {twin.__file__}, does not have the version of the Python code in "
            f"{Path(__file__).parent}; {again}"
        )
    from scipy.linalg import cython_lapack

    twin.use_lapack(*(cython_lapack.__pyx_capi__[name] for name in ("dgetrf", "dgetrs")))
    twin.use_tuning(tuning)
    for s in tuning.STAGES:
        of = table(s)
        twin.use_radau(of.c, of.A, of.inverse, of.inverse2, of.modes, of.raised, *gauss(s))
    return twin, ""


def required():
    """The compiled module; PinconsistError with the reason if there is none."""
    module, why = load()
    if module is None:
        raise PinconsistError(f"pinconsist needs its compiled part: {why}")
    return module
