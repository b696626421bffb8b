"""Index-3 BDF and Radau IIA for closed chains on Pinocchio, with multipliers that are accurate from the first step on.

The public names are those of ``__init__.pyi``. They are loaded when first used, so that the import costs little.
"""

import logging as _logging
import os as _os
import re as _re
import warnings as _warnings
from importlib import import_module as _import_module

from .engine import trouble as _trouble

__version__ = "0.2.0"

with open(_os.path.splitext(__file__)[0] + ".pyi", encoding="utf-8") as _stub:
    _MODULE_OF = {name: module for module, name in _re.findall(r"^from \.(\S+) import (\w+)", _stub.read(), _re.M)}
__all__ = sorted(_MODULE_OF)

if _why := _trouble():
    _warnings.warn(f"there are no runs: {_why}", RuntimeWarning, stacklevel=2)

_logging.getLogger(__name__).addHandler(_logging.NullHandler())  # silent unless the application listens


def __getattr__(name: str):
    if name == "paper":
        return _import_module(".paper", __name__)
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = globals()[name] = getattr(_import_module(f".{_MODULE_OF[name]}", __name__), name)
    return value


def __dir__():
    return [*globals(), *__all__, "paper"]
