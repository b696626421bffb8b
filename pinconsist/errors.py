"""The package's exceptions. Each carries its evidence as attributes beside a message for a person."""

from __future__ import annotations

import copyreg
import traceback


class PinconsistError(Exception):
    """Base of every error that pinconsist raises on purpose."""


class InputError(PinconsistError, ValueError):
    """An argument that cannot be used: wrong size, NaN, unknown name, impossible option."""


class FormatError(PinconsistError, ValueError):
    """A file that cannot be read as a scene.

    Attributes
    ----------
    path : str
        The file.
    element : str
        The element, record or line at fault; empty if the whole file is meant.
    """

    def __init__(self, message: str, *, path: object = "", element: str = ""):
        self.path, self.element, self.reason = str(path), element, message
        where = ": ".join(part for part in (self.path, element) if part)
        super().__init__(f"{where}: {message}" if where else message)


class AssemblyError(PinconsistError):
    """No closed configuration, or no velocity on the constraints, was found.

    Attributes
    ----------
    gaps : dict[str, float]
        Remaining gap of each loop that did not close: the largest row of Φ, in m (or rad).
    q : ndarray or None
        The best configuration that was reached, shape (nq,).
    """

    def __init__(self, message: str, *, gaps: dict | None = None, q=None):
        super().__init__(message)
        self.gaps, self.q = dict(gaps or {}), q


class EquilibriumError(PinconsistError):
    """No configuration was found in which the forces balance.

    Attributes
    ----------
    q : ndarray or None
        Where the search ended, shape (nq,).
    residual : float
        What is not balanced there, N·m or N.
    names : tuple[str, ...]
        The joints that are pushed.
    """

    def __init__(self, message: str, *, q=None, residual: float = 0.0, names: tuple = ()):
        super().__init__(message)
        self.q, self.residual, self.names = q, residual, tuple(names)


class SingularSystemError(PinconsistError):
    """The equations of motion have no unique solution at a configuration.

    Attributes
    ----------
    names : tuple[str, ...]
        The joints or loops whose directions are undetermined.
    """

    def __init__(self, message: str, *, names: tuple = ()):
        super().__init__(message)
        self.names = tuple(names)


class SavingError(PinconsistError):
    """A run could not be written to its file; nothing of it is lost.

    Attributes
    ----------
    solution : Solution
        The run.
    """

    def __init__(self, message: str, *, solution=None):
        super().__init__(message)
        self.solution = solution


class UserFunctionError(PinconsistError):
    """A function given by the user raised an exception; that exception is the ``__cause__``.

    Attributes
    ----------
    t : float
        When, s.
    """

    def __init__(self, what: str, t: float, error: BaseException):
        tail = traceback.extract_tb(error.__traceback__)[-1:]
        where = f", {tail[0].filename}:{tail[0].lineno}" if tail else ""
        super().__init__(f"{what} raised {type(error).__name__}: {error} (at t = {t:.6g}{where})")
        self.t = t

    def __reduce__(self):  # not by __init__, which would look for a traceback
        return copyreg.__newobj__, (type(self), *self.args), vars(self)


class MissingExtraError(PinconsistError, ImportError):
    """An optional package is needed; the message names the pip extra that brings it."""
