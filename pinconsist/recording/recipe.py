"""How a run is made, as plain data."""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ..errors import FormatError, InputError
from ..formats.reading import near
from ..formats.records import force_entries, force_record
from ..mechanism.checks import finite_array
from ..mechanism.digest import digests
from ..mechanism.mechanism import with_forces
from ..simulation import simulate
from .scene import Scene

_RETURNED = ("events", "dense_output")
"""Options of simulate whose results no file holds."""
_OTHERS = ("mech", "t_span", "q0", "v0", "forces", "callback", *_RETURNED)
_OPTIONS = tuple(name for name in inspect.signature(simulate).parameters if name not in _OTHERS)


@dataclass(frozen=True)
class Recipe:
    """All that a run depends on, beside the packages.

    Attributes
    ----------
    scene : dict or None
        A :class:`~pinconsist.recording.scene.Scene`, paths as seen from the run's file; None for a mechanism that
        was given as it stood in memory.
    files : dict[str, str]
        SHA-256 of each file of the scene.
    t_span : list of float
        Start and end, s.
    q0, v0 : dict, list or None
        Initial values as they were given.
    forces : list of dict or None
        Records as in a loop file; None where one was a Python function.
    options : dict
        Options of :func:`pinconsist.simulate`.
    save_every : float or None
        Period of checkpoints, s of simulated time.
    checkpoint : dict or None
        The last one: state, number of rows, counters.
    mechanism : dict or None
        Digests of the mechanism without `forces`; None in files of older versions.
    """

    scene: dict | None
    files: dict
    t_span: list
    q0: object = None
    v0: object = None
    forces: list | None = field(default_factory=list)
    options: dict = field(default_factory=dict)
    save_every: float | None = None
    checkpoint: dict | None = None
    mechanism: dict | None = None

    @classmethod
    def read(cls, solution, file) -> Recipe:
        """The recipe of a saved run; FormatError where the file holds none."""
        if solution.recipe is None:
            raise FormatError(
                "it does not say how it was made: a solution of simulate() on its own does not know from which file "
                "its mechanism came. Make the run by pinconsist.record(scene, ...) or the command line",
                path=file,
            )
        try:
            recipe = cls(**solution.recipe)
            recipe = replace(recipe, options={name: _given(each) for name, each in recipe.options.items()})
            recipe.given_forces()
            checked(recipe)
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise FormatError(f"its record of how it was made cannot be read ({error})", path=file) from error
        return recipe

    def plain(self) -> dict:
        """For JSON."""
        return asdict(self) | {"options": {name: _option(each, name) for name, each in self.options.items()}}

    def made_from(self, run_file) -> Scene | None:
        """The scene, with paths as they are from here."""
        return None if self.scene is None else Scene.recorded(self.scene, run_file)

    def given_forces(self) -> tuple:
        """The forces that came on top of the scene's, from their records."""
        return tuple(force_record(number, entry) for number, entry in enumerate(self.forces or (), start=1))


def recipe_of(scene, files, mechanism, t_span, q0, v0, forces, options, save_every) -> Recipe:
    """A recipe from the arguments of :func:`pinconsist.record`; InputError for what no file can hold."""
    for name in _RETURNED:
        if options.get(name):
            raise InputError(f"{name}= is not for runs that are kept in a file, which does not hold it; use simulate()")
    options = {name: each for name, each in options.items() if name not in _RETURNED}
    for name, each in options.items():
        _option(each, name)
    given = with_forces(replace(mechanism, forces=()), forces, "record")
    try:
        entries = force_entries(given)
    except InputError:  # a function of the user's
        entries = None
    span = finite_array(t_span, "t_span").tolist()
    start = _plain(q0, "q0"), _plain(v0, "v0")
    return checked(Recipe(scene, files, span, *start, entries, options, save_every, mechanism=digests(mechanism)))


def checked(recipe) -> Recipe:
    """The recipe, or InputError for a span, a period or options that cannot be."""
    for name in recipe.options:
        if name not in _OPTIONS:
            raise InputError(f"there is no option {name!r}{near(name, _OPTIONS)}")
    span, period = finite_array(recipe.t_span, "t_span"), recipe.save_every
    if span.shape != (2,):
        raise InputError(f"t_span needs two numbers (start, end), got {recipe.t_span!r}")
    if not isinstance(recipe.files, dict):
        raise InputError(f"no hashes of files: {recipe.files!r}")
    if not isinstance(recipe.mechanism, dict | None):
        raise InputError(f"no digests of the mechanism: {recipe.mechanism!r}")
    if period is None:
        return recipe
    period = finite_array(period, "save_every")
    if period.shape != () or not period > 0:
        raise InputError(f"save_every must be a positive number of seconds, got {recipe.save_every!s}")
    return replace(recipe, save_every=float(period))


def _plain(value, name):
    """What JSON holds exactly, or InputError."""
    if isinstance(value, Mapping):
        return {str(key): _plain(each, name) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(each, name) for each in value]
    if isinstance(value, np.ndarray | np.generic):
        return _plain(value.tolist(), name)
    if value is None or isinstance(value, str | bool | int | float):
        return value
    raise InputError(f"{name} = {value!r} cannot be kept in a file; numbers and names can")


def _option(value, name):
    """Like `_plain`; a pair (of tolerances) stays apart from a list."""
    plain = _plain(value, name)
    return {"pair": plain} if isinstance(value, tuple) and len(value) == 2 else plain


def _given(value):
    return tuple(value["pair"]) if isinstance(value, dict) else value
