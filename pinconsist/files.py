"""Files are written whole or not at all."""

from __future__ import annotations

import os
import secrets
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def written_whole(file):
    """A binary stream whose content becomes `file` at the end of the block; after an error nothing is left behind."""
    target = Path(os.path.realpath(file))
    draft = target.with_name(f".{target.name}.{secrets.token_hex(6)}")
    try:
        with open(draft, "xb") as stream:  # beside the target: os.replace is atomic only within one file system
            yield stream
        os.replace(draft, target)
    finally:
        draft.unlink(missing_ok=True)
