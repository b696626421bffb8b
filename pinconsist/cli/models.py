"""`pinconsist models`."""

from __future__ import annotations

from typing import Annotated

import typer

from . import output


def models(
    as_json: Annotated[bool, typer.Option("--json", help="Print one JSON object instead of a table.")] = False,
) -> int:
    """List the built-in scenes."""
    from ..formats.catalogue import models as built_in
    from ..study.reference import PROBLEMS

    scenes = built_in()
    if as_json:
        output.print_json({"models": scenes, "problems": list(PROBLEMS)})
    else:
        output.table(("scene", "what it is"), scenes.items())
        print(f"for compare also {' and '.join(PROBLEMS)}, whose answers are known in closed form")
    return output.FINE
