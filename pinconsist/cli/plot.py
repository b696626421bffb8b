"""`pinconsist plot`."""

from pathlib import Path
from typing import Annotated

from ..errors import InputError
from . import options as given
from . import output
from .options import Text, option
from .run import print_in_a_line, run_of

OF_A_SCENE = ("drift", "energy")  # pictures that need the mechanism


def plot(
    source: given.RunOrScene,
    what: Annotated[str, option(
        "--what", "NAME,NAME,...",
        "Pictures, one under the other: trajectory, multipliers, drift, energy, steps, phase.",
    )] = "trajectory,multipliers",
    out: Annotated[Text, option("--out", "FILE.png", "The figure (or .pdf, .svg). Default: NAME.png here.")] = None,
    until: given.Until = None,
    scene_of_run: given.SceneOfRun = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Draw a saved run, or a scene.

    Example: pinconsist plot run.npz --what multipliers,energy --out run.png
    """
    out = out or f"{Path(source).resolve().stem}.png"
    output.require_writable(figure=out)
    from ..view.plots import PICTURES, plot_solution

    names = [name.strip() for name in what.split(",")]
    for name in names:
        if name not in PICTURES:
            raise InputError(f"--what {what}: there is no picture {name!r}; there are {', '.join(PICTURES)}")
    mech, sol, code = run_of(source, scene_of_run, until)
    if mech is None and (without := [name for name in names if name in OF_A_SCENE]):
        there = ", ".join(name for name in PICTURES if name not in OF_A_SCENE)
        raise InputError(
            f"--what {without[0]}: {source} holds a general problem, which has no scene; what can be drawn "
            f"of it: {there}"
        )
    output.written(out, lambda: plot_solution(sol, out, mech, names))
    if as_json:
        output.print_json({
            "scene": mech and mech.name, "t": [sol.t[0], sol.t[-1]], "rows": len(sol.t), "message": sol.message,
            "what": names, "files": {"out": out},
        })  # fmt: skip
    else:
        print_in_a_line(sol)
        print(*(f"  {name:12} {PICTURES[name][0]}" for name in names), sep="\n")
        output.print_written(out)
    return code
