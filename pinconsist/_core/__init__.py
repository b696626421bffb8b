"""The methods of dae/ in C++, and everything that exists for speed alone: many accepted steps in one call.

It is there where ``pip install`` found a compiler. The C++ has the names of the Python: newton.hpp does what
dae/newton.py does, and so on. User-defined forces and constraints are called back in Python.
"""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

import numpy as np
import pinocchio  # loads the libraries that the compiled module is linked with

from ..dae import tuning
from ..dae.radau import table

INTERFACE = 19  # as in module.cpp: an editable install may hold an older build


@cache
def load():
    """(the compiled module, "") or (None, why there is none)."""
    if find_spec(f"{__name__}.twin") is None:
        return None, "pinconsist was installed without its compiled part (no C++ compiler was found)"
    try:
        from . import twin
    except ImportError as error:
        return None, f"the compiled part of pinconsist cannot be loaded ({error})"
    if getattr(twin, "INTERFACE", 0) != INTERFACE:
        return None, "the compiled part of pinconsist is of another version; install pinconsist again"
    if twin.PINOCCHIO_VERSION != pinocchio.__version__:
        return None, (
            f"the compiled part of pinconsist was built for Pinocchio {twin.PINOCCHIO_VERSION}, and this is "
            f"{pinocchio.__version__}; install pinconsist again"
        )
    from scipy.integrate import DOP853
    from scipy.linalg import cython_lapack

    twin.use_lapack(*(cython_lapack.__pyx_capi__[name] for name in ("dgetrf", "dgetrs")))
    coefficients = ("A", "B", "C", "E3", "E5", "D", "A_EXTRA", "C_EXTRA")
    twin.use_tuning(tuning)
    twin.use_dop853(*(np.ascontiguousarray(getattr(DOP853, name)) for name in coefficients))
    for s in tuning.STAGES:
        of = table(s)
        twin.use_radau(of.c, of.A, of.inverse, of.inverse2, of.modes)
    return twin, ""
