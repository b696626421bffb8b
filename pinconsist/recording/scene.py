"""What has to be known to load a mechanism again."""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path

from ..errors import FormatError, InputError


@dataclass(frozen=True)
class Scene:
    """A source and the options of :func:`pinconsist.load`; with `reanchor`, loops are moved together at `at`."""

    source: str
    loops: str | None = None
    closure: str | None = None
    free_flyer: bool = False
    package_dirs: list[str] = field(default_factory=list)
    reanchor: bool = False
    at: dict[str, list[float]] = field(default_factory=dict)

    def load(self):
        """The mechanism."""
        from ..formats.load import load  # brings Pinocchio, which a command's --help does without

        mechanism = load(
            self.source, loops=self.loops, closure=self.closure, free_flyer=self.free_flyer,
            package_dirs=self.package_dirs,
        )  # fmt: skip
        return mechanism.reanchored(self.at or None) if self.reanchor else mechanism

    def load_with_hashes(self):
        """The mechanism, and the SHA-256 of every file it was read from, by its path as seen from the first."""
        from ..formats.reading import files_read

        with files_read() as found:
            mechanism = self.load()
        start = found[0][0].parent if found else ""
        return mechanism, {os.path.relpath(path, start): digest for path, digest in found}

    def record(self, run_file) -> dict:
        """As plain values for a run's file; paths as seen from it, so that both can be moved together."""
        from ..formats.catalogue import is_built_in

        folder = Path(run_file).absolute().parent
        about = asdict(self)
        about["source"] = self.source if is_built_in(self.source) else os.path.relpath(self.source, folder)
        about["loops"] = self.loops and os.path.relpath(self.loops, folder)
        about["package_dirs"] = [os.path.relpath(each, folder) for each in self.package_dirs]
        return about

    @classmethod
    def recorded(cls, about: dict, run_file) -> Scene:
        """The scene that :meth:`record` described; FormatError for anything else."""
        from ..formats.catalogue import is_built_in

        folder = Path(run_file).absolute().parent
        known, about = {each.name for each in fields(cls)}, dict(about) if isinstance(about, dict) else {}
        good = set(about) == known and isinstance(about["package_dirs"], list)
        if not good or not all(
            isinstance(each, str) for each in (about["source"], about["loops"] or "", *about["package_dirs"])
        ):
            raise FormatError("its record of the scene cannot be read", path=run_file)
        if not is_built_in(about["source"]):
            about["source"] = os.path.normpath(folder / about["source"])
        about["loops"] = about["loops"] and os.path.normpath(folder / about["loops"])
        about["package_dirs"] = [os.path.normpath(folder / each) for each in about["package_dirs"]]
        return cls(**about)


def loaded(scene: Scene, run_file):
    """`load_with_hashes` of the scene of a saved run; where it fails, the message names the run too."""
    try:
        return scene.load_with_hashes()
    except (InputError, FormatError) as error:
        raise InputError(f"the scene of {run_file} cannot be loaded; say where it is by --scene. {error}") from error
