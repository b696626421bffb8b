"""`pinconsist models`."""

import pinconsist as pc

from ..errors import MissingExtraError
from . import output


def models(as_json: output.Json = False) -> int:
    """List the built-in scenes, the families of scenes, and the robots that are installed.

    Example: pinconsist models
    """
    from ..formats.catalogue import ROBOTS
    from ..reference import PROBLEMS

    scenes, robots = pc.models(), [name for name in ROBOTS if _is_installed(name)]
    if as_json:
        output.print_json({"models": scenes, "robots": robots, "problems": list(PROBLEMS)})
        return output.FINE
    output.table(("scene", "what it is"), scenes.items())
    print("<n> stands for a number of your choice, as in chain_16\n")
    if robots:
        print("robots of the pip package example-robot-data, which is installed:")
        output.paragraph(", ".join(robots), indent="  ")
    if missing := [name for name in ROBOTS if name not in robots]:
        print("robots that are available after: pip install 'pinconsist[robots]'")
        output.paragraph(", ".join(missing), indent="  ")
    print()
    output.paragraph(f"for compare also {' and '.join(PROBLEMS)}, whose solutions are known in closed form")
    return output.FINE


def _is_installed(robot) -> bool:
    from ..formats.catalogue import robot_file

    try:
        robot_file(robot)
    except MissingExtraError:
        return False
    return True
