"""The package's exceptions. ``str(error)`` is a readable message; attributes hold the data behind it."""

import copyreg
import re
import sys
import traceback
import warnings

CONTROLS = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f\u200e\u200f\u202a-\u202e\u2066-\u2069]")
"""What a terminal would act on if a message repeated it, and what reverses the direction of text."""


class PinconsistError(Exception):
    """Base of every error that pinconsist raises on purpose."""


class InputError(PinconsistError, ValueError):
    """An invalid argument: wrong size, NaN, unknown name, impossible option. Also a ValueError."""


class FormatError(PinconsistError, ValueError):
    """A file that is not a valid scene or recorded run. Also a ValueError.

    ``str(error)`` is the `message` preceded by the file and the element.

    Attributes
    ----------
    path : str
        The file; empty if the data do not come from a file.
    element : str
        The element, record or line at fault; empty for the whole file.
    reason : str
        The message alone.
    """

    def __init__(self, message: str, *, path: object = "", element: str = ""):
        self.path, self.element, self.reason = str(path), element, message
        where = ": ".join(part for part in (self.path, element) if part)
        super().__init__(f"{where}: {message}" if where else message)


class AssemblyError(PinconsistError):
    """No closed configuration, or no velocity on the constraints, was found.

    The `message` names the loops and their gaps, or the velocities, and suggests a remedy.

    Attributes
    ----------
    gaps : dict[str, float]
        Remaining gap of each open loop: the largest row of Φ, in m (or rad). Empty where velocities contradict the
        loops, or a run or a motion cannot follow them.
    q : ndarray or None
        The best or last configuration reached, shape (nq,), if known.
    """

    def __init__(self, message: str, *, gaps: dict | None = None, q=None):
        super().__init__(message)
        self.gaps, self.q = dict(gaps or {}), q


class EquilibriumError(PinconsistError):
    """No configuration was found in which the forces balance.

    The `message` says which forces are not balanced, at which joints, and suggests a remedy.

    Attributes
    ----------
    q : ndarray or None
        Where the search ended, shape (nq,).
    residual : float
        The unbalanced force there, N·m or N.
    names : tuple[str, ...]
        The joints it acts on.
    """

    def __init__(self, message: str, *, q=None, residual: float = 0.0, names: tuple = ()):
        super().__init__(message)
        self.q, self.residual, self.names = q, residual, tuple(names)


class SingularSystemError(PinconsistError):
    """The equations of motion have no unique solution at a configuration.

    The `message` says what is undetermined, and suggests a remedy.

    Attributes
    ----------
    names : tuple[str, ...]
        The joints or loops whose directions are undetermined; empty if unknown.
    """

    def __init__(self, message: str, *, names: tuple = ()):
        super().__init__(message)
        self.names = tuple(names)


class SavingError(PinconsistError):
    """A run could not be written to its file; it is not lost.

    The `message` names the file, and why it cannot be written.

    Attributes
    ----------
    solution : Solution
        The run; save it elsewhere by ``error.solution.save(file)``.
    """

    def __init__(self, message: str, *, solution=None):
        super().__init__(message)
        self.solution = solution


class UserFunctionError(PinconsistError):
    """A user-defined function raised an exception; that exception is the ``__cause__``.

    ``str(error)`` names the function (`what`), the exception (`error`), the time, and the line that raised it.

    Attributes
    ----------
    t : float
        When it was called, s.
    """

    def __init__(self, what: str, t: float, error: BaseException):
        tail = traceback.extract_tb(error.__traceback__)[-1:]
        where = f", {tail[0].filename}:{tail[0].lineno}" if tail else ""
        super().__init__(f"{what} raised {type(error).__name__}: {error} (at t = {t:.6g}{where})")
        self.t = t

    def __reduce__(self):  # not through __init__, which would need a traceback
        return copyreg.__newobj__, (type(self), *self.args), vars(self)


class MissingExtraError(PinconsistError, ImportError):
    """An optional package is missing; the message says what to install with pip. Also an ImportError."""


def warn(message: str) -> None:
    """Issue a UserWarning at the line of the user's code that called this package."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").split(".")[0] == "pinconsist":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, stacklevel=level)
