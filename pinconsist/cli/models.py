"""`pinconsist models`."""

from __future__ import annotations

from ..errors import MissingExtraError
from . import output


def models(
    as_json: output.Json = False,
) -> int:
    """List the built-in scenes, the families of scenes, and the robots that are installed.

    Example: pinconsist models
    """
    from ..formats.catalogue import models as built_in
    from ..reference import PROBLEMS

    scenes, (robots, missing) = built_in(), _robots()
    if as_json:
        output.print_json({"models": scenes, "robots": robots, "problems": list(PROBLEMS)})
        return output.FINE
    output.table(("scene", "what it is"), scenes.items())
    print("<n> stands for a number of your choice, as in chain_16\n")
    if robots:
        print("robots of the pip package example-robot-data, which is installed:")
        output.paragraph(", ".join(robots), indent="  ")
    if missing:
        print("robots that can be had by: pip install 'pinconsist[robots]'")
        output.paragraph(", ".join(missing), indent="  ")
    print(f"\nfor compare also {' and '.join(PROBLEMS)}, whose answers are known in closed form")
    return output.FINE


def _robots() -> tuple[list[str], list[str]]:
    """Robots whose files are there, and those whose files are not."""
    from ..formats.robots import ROBOTS, robot_file

    found, missing = [], []
    for name in ROBOTS:
        try:
            robot_file(name)
            found.append(name)
        except MissingExtraError:
            missing.append(name)
    return found, missing
