"""`pinconsist replay`, `render` and `plot`: the commands that show a run, saved or simulated for them."""

import logging
import time
import webbrowser
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import Text, Texts, look, option, require_drawable
from .simulate import exit_code, print_in_a_line

OF_A_SCENE = ("forces", "drift", "energy")  # pictures that need the mechanism
_log = logging.getLogger(__name__)


def replay(
    source: scene.RunOrScene,
    scene_of_run: scene.SceneOfRun = None,
    until: scene.Until = None,
    forces: scene.Forces = False,
    traces: scene.Traces = None,
    speed: scene.Speed = None,
    loop: Annotated[bool, option("--loop/--once", None, "Play repeatedly, or once.")] = True,
    html: Annotated[Text, option("--html", "FILE.html", "Write the page instead of opening a browser.")] = None,
    no_browser: Annotated[bool, option(
        "--no-browser", None, "Only print the page's address and serve it until Ctrl-C.")] = False,
) -> int:  # fmt: skip
    """Play a saved run or a scene in the browser.

    Example: pinconsist replay run.npz --forces --trace coupler_tip --speed 0.5
    """
    output.require_writable(html=html)

    mech, sol, code = run_of(source, scene_of_run, until, partial(require_drawable, source, traces, speed))
    if html:
        output.written(html, lambda: pc.export_html(mech, sol, html, **look(sol, forces, traces, speed)))
    print_in_a_line(sol)
    if html:
        output.print_written(html)
    else:
        _serve(mech, sol, look(sol, forces, traces, speed) | {"loop": loop}, no_browser)
    return code


def _serve(mech, sol, options, no_browser):
    try:
        webbrowser.get()
    except webbrowser.Error:
        no_browser = True
        print("no browser was found")
    address = pc.replay(mech, sol, **options, open_browser=not no_browser)
    if not no_browser:
        print("the page is open in your browser, and keeps playing after this command")
        return
    print(f"served at {address} until Ctrl-C; --html FILE writes the page to a file", flush=True)
    with suppress(KeyboardInterrupt):
        while True:
            time.sleep(3600)


def render(
    source: scene.RunOrScene,
    out: Annotated[str, typer.Argument(
        metavar="FILE", help="A video (.mp4 or .gif), or drawings of a planar mechanism (.svg).")],
    at: Annotated[list[float] | None, option(
        "--at", "SECONDS ...", "Times to draw in an .svg. Default: the start.")] = None,
    scene_of_run: scene.SceneOfRun = None,
    until: scene.Until = None,
    forces: scene.Forces = False,
    traces: scene.Traces = None,
    speed: scene.Speed = None,
) -> int:  # fmt: skip
    """Make a video of a saved run or a scene, or draw it at given times.

    Example: pinconsist render run.npz run.mp4 --forces
    """
    from ..view import render as painted

    output.require_writable(FILE=out)
    painted.require_file(out, at or ())
    mech, sol, code = run_of(source, scene_of_run, until, partial(require_drawable, source, traces, speed))
    options = look(sol, forces, traces, speed) | {"at": at or ()}
    with output.counting("frames") as watch:
        output.written(out, lambda: painted.render(mech, sol, out, **options, watch=watch))
    print_in_a_line(sol)
    output.print_written(out)
    return code


def plot(
    source: scene.RunOrScene,
    what: Annotated[str, option(
        "--what", "NAME,NAME,...",
        "Pictures, from top to bottom: trajectory, multipliers, forces, drift, energy, steps, phase.",
    )] = "trajectory,multipliers",
    of: Annotated[Texts, option(
        "--of", "QUANTITY", 'Instead, any quantity over time, in quotes: "reaction PIN", "position FOOT z", "energy '
        'kinetic"; may be repeated. Each unit has its own panel.')] = None,
    out: Annotated[Text, option("--out", "FILE.png", "The figure (or .pdf, .svg). Default: NAME.png here.")] = None,
    until: scene.Until = None,
    scene_of_run: scene.SceneOfRun = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Plot a saved run or a scene.

    Example: pinconsist plot run.npz --what multipliers,energy --out run.png
    """
    out = out or f"{Path(source).resolve().stem}.png"
    output.require_writable(figure=out)
    from ..view.plots import PICTURES, pictures_of

    if of:
        return _plot_of(source, of, out, until, scene_of_run, as_json)
    names = [name.strip() for name in what.split(",")]
    for name in names:
        if name not in PICTURES:
            raise InputError(f"--what {what}: there is no picture {name!r}; available: {', '.join(PICTURES)}")
    mech, sol, code = run_of(source, scene_of_run, until)
    if mech is None and (without := [name for name in names if name in OF_A_SCENE]):
        there = ", ".join(name for name in PICTURES if name not in OF_A_SCENE)
        raise InputError(
            f"--what {without[0]}: {source} contains a general problem, which has no scene; available for it: {there}"
        )
    output.written(out, lambda: pictures_of(sol, names, out, mech))
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


def _plot_of(source, of, out, until, scene_of_run, as_json) -> int:
    """Plot quantities over time."""
    mech, sol, code = run_of(source, scene_of_run, until)
    output.written(out, lambda: pc.plot(sol, *of, file=out, mech=mech))
    if as_json:
        about = {"scene": mech and mech.name, "t": [sol.t[0], sol.t[-1]], "rows": len(sol.t), "message": sol.message}
        output.print_json({**about, "of": of, "files": {"out": out}})
    else:
        print_in_a_line(sol)
        output.print_written(out)
    return code


def run_of(source, scene_of_run, until, require=lambda mech: None):
    """Mechanism, solution and exit code of a saved run, or of a scene, which is simulated first.

    The mechanism of a saved general problem, which has no scene, is None. `require` is called with the mechanism
    before a long run begins.
    """
    if Path(source).suffix == ".npz":
        if until is not None:
            raise InputError("--until is for scenes; the end of a saved run (.npz) is fixed")
        mech, sol = _saved(source, scene_of_run)
        require(mech)
        return mech, sol, output.FINE
    if scene_of_run:
        raise InputError("--scene names the scene of a saved run (.npz); a scene itself needs none")
    mech = scene.SceneSource(source).load()
    require(mech)
    span = (0.0, mech.duration if until is None else until)
    with output.RunProgress(*span) as progress:
        sol = pc.simulate(mech, span, callback=progress)
    return mech, sol, exit_code(sol)


def _saved(file, given):
    """Mechanism (None for a general problem) and solution of a saved run."""
    from ..formats.catalogue import is_built_in
    from ..run.runs import changed_files
    from ..run.solution import require_mechanism

    sol = pc.Solution.load(file)
    name = given or sol.scene
    if about := (sol.recipe or {}).get("scene"):
        source = scene.SceneSource.recorded(about, file)
        source = replace(source, source=given) if given else source
    elif not name:  # even if a file in the folder has this name
        return None, sol
    elif given or is_built_in(name):
        source = scene.SceneSource(name)
    else:
        raise InputError(
            f"{file} contains only the name of its scene, {name!r}, because the run was made in Python; pass the scene "
            "with --scene"
        )
    mech, hashes = source.load_for(file)
    require_mechanism(sol, mech, file, "; pass its scene with --scene")
    if changed := changed_files((sol.recipe or {}).get("files", hashes), hashes):
        _log.warning(
            "the scene has changed since this run was made (%s); energies and forces are those of the changed scene",
            "; ".join(changed),
        )
    return mech, sol
