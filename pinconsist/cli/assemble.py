"""`pinconsist assemble`."""

from types import SimpleNamespace
from typing import Annotated

import pinconsist as pc

from . import output, scene
from .scene import PAGE, RESULTS, Text, option

MOST_SHOWN = 16  # modes on a page
RARE = 2


@scene.loads_scene
def assemble(
    source: scene.Scene,
    all_modes: Annotated[bool, option(
        "--all-modes", None, "Search for all closed configurations with the same positions of the joints that "
        "determine the others: those of --at, the motors, and others if needed.", RESULTS)] = False,
    html: Annotated[Text, option("--html", "FILE", "Write a page with the modes side by side.", PAGE)] = None,
    as_json: output.Json = False,
) -> None:  # fmt: skip
    """Close the loops of a scene, in one configuration or in all assembly modes.

    Example: pinconsist assemble four_bar --at crank=0.5 --all-modes
    """
    from ..mechanism.assembly_modes import assembly_modes
    from ..mechanism.names import position_names

    output.require_writable(html=html)
    mech = source.load()
    names = position_names(mech.model)
    if all_modes:
        with output.doing("searching for modes"):
            found = assembly_modes(mech, source.at)
        modes = found.modes
    else:
        assembly = scene.assembled(mech, source.at)
        found, gap = None, max(assembly.gaps.values(), default=0.0)
        modes = [SimpleNamespace(q=assembly.q, gap=gap, found=1, singular=False, beyond=())]
    if html:
        _page(mech, modes, html)
    if as_json:
        listed = [
            {"q": dict(zip(names, mode.q, strict=True)), "gap": mode.gap, "found": mode.found,
             "singular": mode.singular, "outside_limits": [each.joint for each in mode.beyond]}
            for mode in modes
        ]  # fmt: skip
        search = {"held": found.held, "starts": found.starts, "not_closed": found.missed} if found else {}
        output.print_json({"scene": mech.name, **search, "modes": listed, "html": html})
        return
    if found:
        _print_search(mech, found)
    columns = [f"mode {i + 1}>.6g" for i in range(len(modes))] if found else ["closed>.9g"]
    output.table(("joint [rad, m]", *columns), list(zip(names, *(mode.q for mode in modes), strict=True)))
    for i, mode in enumerate(modes if found else (), start=1):
        if notes := _notes(mode):
            print(f"mode {i}: {'; '.join(notes)}")
    output.print_written(html)


def _print_search(mech, found):
    held = f" with {', '.join(found.held)} held" if found.held else ""
    print(f"{mech.name}: {output.counted(len(found.modes), 'assembly mode')}{held}")
    open_starts = f"; from {found.missed} of them the loops did not close" if found.missed else ""
    output.paragraph(f"from {output.counted(found.starts, 'start')}{open_starts}", indent="  ", hanging="  ")
    rare = min(mode.found for mode in found.modes)
    if len(found.modes) > 1 and rare <= RARE:
        times = {1: "once", 2: "twice"}[rare]
        output.paragraph(f"a mode was found only {times}: others may be missing", indent="  ", hanging="  ")
    print()


def _notes(mode) -> list[str]:
    notes = ["singular: more rows depend on each other here"] if mode.singular else []
    if mode.beyond:
        notes.append(f"outside of limits: {', '.join(each.joint for each in mode.beyond)}")
    return notes


def _page(mech, modes, html):
    """The modes side by side, at rest."""
    shown = {f"mode {i}": SimpleNamespace(t=[0.0], q=[mode.q]) for i, mode in enumerate(modes[:MOST_SHOWN], 1)}
    if len(modes) > MOST_SHOWN:
        output.message("warning", f"the page shows the first {MOST_SHOWN} of {len(modes)} modes")
    output.written(html, lambda: pc.export_html(mech, shown, html, panel=False))
