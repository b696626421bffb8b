"""How a run is made, as the plain data that its file holds: the source of its scene, and all that it depends on."""

from __future__ import annotations

import inspect
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields, replace
from pathlib import Path

from .errors import FormatError, InputError

LOAD_OPTIONS = ("loops", "closure", "free_flyer", "package_dirs", "ignore", "precision")


@dataclass(frozen=True)
class SceneSource:
    """A source and the options of :func:`pinconsist.load`; with `reanchor`, open loops are closed at `at`."""

    source: str
    loops: str | None = None
    closure: str | None = None
    free_flyer: bool = False
    package_dirs: list[str] = None  # type: ignore[assignment]  # a list after __post_init__
    reanchor: bool = False
    at: dict[str, list[float]] = field(default_factory=dict)
    ignore: list[str] = None  # type: ignore[assignment]  # a list after __post_init__
    precision: float = 0.0

    def __post_init__(self):
        for several in ("package_dirs", "ignore"):
            object.__setattr__(self, several, getattr(self, several) or [])

    def load(self):
        """The mechanism."""
        from .formats.load import load  # brings Pinocchio, which a command's --help does without

        options = {name: getattr(self, name) for name in LOAD_OPTIONS}
        if not self.reanchor:
            return load(self.source, **options)
        return load(self.source, **options | {"precision": 0.0}).reanchored(self.at or None).corrected(self.precision)

    def load_with_hashes(self):
        """The mechanism, and the SHA-256 of every file it was read from, by its path as seen from the first."""
        from .formats.reading import files_read

        with files_read() as found:
            mechanism = self.load()
        start = found[0][0].parent if found else ""
        return mechanism, {os.path.relpath(path, start): digest for path, digest in found}

    def record(self, run_file) -> dict:
        """As plain values for a run's file; paths as seen from it, so that both can be moved together."""
        folder = Path(run_file).absolute().parent
        return self._with_paths(lambda path: os.path.relpath(path, folder))

    @classmethod
    def recorded(cls, about: dict, run_file) -> SceneSource:
        """The scene that :meth:`record` described; FormatError for anything else."""
        about = about if isinstance(about, dict) else {}
        lists = *(about.get("package_dirs") or ()), *(about.get("ignore") or ())
        texts = [about.get("source"), about.get("loops") or "", *lists]
        known = {*about, "ignore", "precision"}  # which files of older versions lack
        if known != {each.name for each in fields(cls)} or not all(isinstance(each, str) for each in texts):
            raise FormatError("its record of the scene cannot be read", path=run_file)
        folder = Path(run_file).absolute().parent
        return cls(**cls(**about)._with_paths(lambda path: os.path.normpath(folder / path)))

    def _with_paths(self, change) -> dict:
        from .formats.catalogue import is_built_in

        return asdict(self) | {
            "source": self.source if is_built_in(self.source) else change(self.source),
            "loops": self.loops and change(self.loops),
            "package_dirs": [change(each) for each in self.package_dirs],
        }


def loaded(scene: SceneSource, run_file):
    """`load_with_hashes` of the scene of a saved run; where it fails, the message names the run too."""
    try:
        return scene.load_with_hashes()
    except (InputError, FormatError) as error:
        raise InputError(f"the scene of {run_file} cannot be loaded; say where it is by --scene. {error}") from error


_RETURNED = ("events", "dense_output")
"""Options of simulate whose results are not stored."""
_OTHERS = ("mech", "t_span", "q0", "v0", "forces", "callback", *_RETURNED)


@dataclass(frozen=True)
class Recipe:
    """All that a run depends on, apart from the packages."""

    scene: dict | None  # a SceneSource, paths as seen from the run's file; None for a mechanism in memory
    files: dict  # of the scene → SHA-256
    t_span: list
    q0: object = None
    v0: object = None
    forces: list | None = field(default_factory=list)  # records as in a loop file; None: one was a Python function
    options: dict = field(default_factory=dict)
    save_every: float | None = None
    checkpoint: dict | None = None  # the last one: state, number of rows, counters
    mechanism: dict | None = None  # digests, without `forces`; None in files of older versions

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
            options = {
                name: tuple(each["pair"]) if isinstance(each, dict) and name != "control" else each
                for name, each in recipe.options.items()
            }
            recipe = replace(recipe, options=options)
            recipe.given_forces()
            _checked(recipe)
        except (TypeError, ValueError, AttributeError, KeyError) as error:
            raise FormatError(f"its record of how it was made cannot be read ({error})", path=file) from error
        return recipe

    def plain(self) -> dict:
        """For JSON."""
        return asdict(self) | {"options": {name: _option(each, name) for name, each in self.options.items()}}

    def given_forces(self) -> tuple:
        """The forces given in addition to the scene's, from their records."""
        from .formats.records import force_record

        return tuple(force_record(number, entry) for number, entry in enumerate(self.forces or (), start=1))


def recipe_of(scene, files, mechanism, t_span, q0, v0, forces, options, save_every) -> Recipe:
    """A recipe from the arguments of :func:`pinconsist.record`; InputError for what no file can hold."""
    from .formats.records import force_entries
    from .mechanism.checks import finite_array
    from .mechanism.description import digests
    from .mechanism.mechanism import with_forces

    for name in _RETURNED:
        if options.get(name):
            raise InputError(f"{name}= is not for recorded runs, whose file does not store it; use simulate()")
    options = {name: each for name, each in options.items() if name not in _RETURNED}
    for name, each in options.items():
        _option(each, name)
    given = with_forces(replace(mechanism, forces=()), forces, "record")
    try:
        entries = force_entries(given)
    except InputError:  # a user-defined function
        entries = None
    span, start = finite_array(t_span, "t_span").tolist(), (_plain(q0, "q0"), _plain(v0, "v0"))
    return _checked(Recipe(scene, files, span, *start, entries, options, save_every, mechanism=digests(mechanism)))


def _checked(recipe) -> Recipe:
    """The recipe, or InputError for a span, a period or options that are not valid."""
    from .mechanism.checks import near
    from .options import positive_time, span_of
    from .simulation import simulate

    known = [name for name in inspect.signature(simulate).parameters if name not in _OTHERS]
    for name in recipe.options:
        if name not in known:
            raise InputError(f"there is no option {name!r}{near(name, known)}")
    span_of(recipe.t_span)
    for what, kind in (("files", dict), ("mechanism", dict | None)):
        if not isinstance(value := getattr(recipe, what), kind):
            raise InputError(f"no hashes of its {what}: {value!r}")
    if recipe.save_every is None:
        return recipe
    return replace(recipe, save_every=positive_time(recipe.save_every, "save_every"))


def _plain(value, name):
    """What JSON holds exactly, or InputError."""
    try:
        text = json.dumps(value, default=lambda each: dict(each) if isinstance(each, Mapping) else each.tolist())
    except (TypeError, ValueError, AttributeError):
        raise InputError(f"{name} = {value!r} cannot be stored in a file; numbers and names can") from None
    return json.loads(text)


def _option(value, name):
    """Like `_plain`; a pair (of tolerances) is kept distinct from a list."""
    plain = _plain(value, name)
    return {"pair": plain} if isinstance(value, tuple) and len(value) == 2 else plain
