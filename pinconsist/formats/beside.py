"""The loop file that belongs to a robot's file."""

from __future__ import annotations

import logging
import os
from pathlib import Path

_log = logging.getLogger(__name__)


def loop_file(path: Path) -> Path | None:
    """``<stem>.yaml`` or ``.yml`` beside a file, else ``robot.yaml`` or ``.yml`` there, else None."""
    candidates = (
        path.with_suffix(".yaml"),
        path.with_suffix(".yml"),
        path.parent / "robot.yaml",
        path.parent / "robot.yml",
    )
    return next((each for each in candidates if os.path.isfile(each)), None)


def tell_overlooked(path: Path) -> None:
    """Warn of YAML files beside a robot without a loop file: most likely one of them was meant."""
    others = sorted(each.name for each in (*path.parent.glob("*.yaml"), *path.parent.glob("*.yml")))
    if others:
        _log.warning(
            "%s has no loop file (%s.yaml or robot.yaml) and is read as a plain tree; name one by loops=, "
            "on the command line --loops, if it is %s",
            path, path.stem, " or ".join(others),
        )  # fmt: skip
