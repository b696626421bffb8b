"""The source of a scene, as plain data that is stored in a run's file and sent to other processes."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from ..errors import FormatError, InputError

LOAD_OPTIONS = ("loops", "closure", "free_flyer", "package_dirs", "ignore", "precision", "args")


@dataclass(frozen=True)
class SceneSource:
    """A source and the options of :func:`pinconsist.load`; with `reanchor`, open loops are closed at `at`."""

    source: str
    loops: str | None = None
    closure: str | None = None
    free_flyer: bool = False
    package_dirs: list[str] = field(default_factory=list)
    reanchor: bool = False
    at: dict[str, list[float]] = field(default_factory=dict)
    ignore: list[str] = field(default_factory=list)
    precision: float = 0.0
    args: dict[str, str] = field(default_factory=dict)

    def load(self):
        """The mechanism."""
        from ..formats.load import load  # imports Pinocchio, which a command's --help does not need

        options = {name: getattr(self, name) for name in LOAD_OPTIONS}
        if not self.reanchor:
            return load(self.source, **options)
        return load(self.source, **options | {"precision": 0.0}).reanchored(self.at or None).corrected(self.precision)

    def load_with_hashes(self):
        """The mechanism, and the SHA-256 of every file it was read from, by its path as seen from the first."""
        from ..formats.reading import files_read

        with files_read() as found:
            mechanism = self.load()
        start = found[0][0].parent if found else ""
        return mechanism, {os.path.relpath(path, start): digest for path, digest in found}

    def load_for(self, run_file):
        """`load_with_hashes` for the scene of a saved run; if it fails, the message also names the run."""
        try:
            return self.load_with_hashes()
        except (InputError, FormatError) as error:
            raise InputError(
                f"the scene of {run_file} cannot be loaded; give its location with --scene. {error}"
            ) from error

    def record(self, run_file) -> dict:
        """As plain values for a run's file; paths as seen from it, so that both can be moved together."""
        folder = Path(run_file).absolute().parent
        return self._with_paths(lambda path: os.path.relpath(path, folder))

    @classmethod
    def recorded(cls, about: dict, run_file) -> SceneSource:
        """The scene that :meth:`record` described; FormatError for anything else."""
        older = {"ignore": [], "precision": 0.0, "args": {}}  # what older files lack
        about = older | about if isinstance(about, dict) else {}
        lists = [about.get("package_dirs") or [], about.get("ignore") or []]
        texts = [about.get("source"), about.get("loops") or "", *lists[0], *lists[1], *(about.get("args") or {})]
        if set(about) != {each.name for each in fields(cls)} or not all(isinstance(each, str) for each in texts):
            raise FormatError("its record of the scene cannot be read", path=run_file)
        folder = Path(run_file).absolute().parent
        found = cls(**about | dict(zip(("package_dirs", "ignore"), lists, strict=True)))
        return cls(**found._with_paths(lambda path: os.path.normpath(folder / path)))

    def _with_paths(self, change) -> dict:
        from ..formats.catalogue import is_built_in

        return asdict(self) | {
            "source": self.source if is_built_in(self.source) else change(self.source),
            "loops": self.loops and change(self.loops),
            "package_dirs": [change(each) for each in self.package_dirs],
        }
