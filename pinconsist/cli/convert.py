"""`pinconsist convert`."""

import re
from pathlib import Path
from typing import Annotated

import typer

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import RESULTS, Texts, option

KINDS = (".urdf", ".sdf", ".xml", ".mjcf", ".usda", ".usd")


@scene.loads_scene
def convert(
    source: scene.Scene,
    file: Annotated[str, typer.Argument(metavar="FILE", help=(
        "The file to write; its extension selects the format: .urdf (with its loop file), .sdf, .xml (MJCF), .usda."))],
    without: Annotated[Texts, option(
        "--without", "NAME", "Leave out this loop, drive, coupling or force, by its name in an error message or in "
        "check; may be repeated.", RESULTS)] = None,
    as_json: output.Json = False,
) -> None:  # fmt: skip
    """Write a scene in another file format.

    Anything that the format cannot represent is named in an error, and nothing is
    written. Before that, the file is read back and must move as the scene does.

    Example: pinconsist convert four_bar four_bar.xml
    """
    if Path(file).suffix.lower() not in KINDS:
        raise InputError(f"{file}: the ending selects the kind of file: {', '.join(KINDS)}")
    mech = source.load()
    for name in without or ():
        mech = _without(mech, name)
    try:
        path = pc.write(mech, file)
    except InputError as error:
        raise InputError(re.sub(r"leave it out: mech.*", "--without NAME leaves it out", str(error))) from error
    written = [path, path.with_suffix(".yaml")] if path.suffix == ".urdf" else [path]
    if as_json:
        output.print_json({"written": [str(each) for each in written]})
        return
    print(f"wrote {' and '.join(str(each) for each in written)}")


def _without(mech, name):
    from ..mechanism.forces import label_of

    names = {loop.name: loop for loop in mech.loops}
    forces = {label_of(force): force for force in mech.forces}
    if name in names:
        return mech.with_loops(*[loop for loop in mech.loops if loop.name != name])
    if name in forces:
        return mech.with_forces(*[force for force in mech.forces if force is not forces[name]])
    known = ", ".join(repr(each) for each in [*names, *forces]) or "none"
    raise InputError(f"--without: no loop, drive, coupling or force {name!r}; there are: {known}")
