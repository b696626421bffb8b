"""`pinconsist replay`."""

from __future__ import annotations

import logging
import time
import webbrowser
from dataclasses import replace as changed
from pathlib import Path
from typing import Annotated

import typer

from ..errors import FormatError, InputError
from . import output, scene, shown
from .simulate import exit_code, run

SECONDS = 5.0


def replay(
    source: Annotated[
        str, typer.Argument(metavar="RUN.npz|SCENE", help="A saved run, or a scene, of which 5 s are simulated first.")
    ],
    scene_of_run: Annotated[
        str | None,
        typer.Option("--scene", metavar="SCENE", help="Scene of a saved run, where it is not the one recorded."),
    ] = None,
    forces: shown.Forces = False,
    traces: shown.Traces = None,
    speed: shown.Speed = 1.0,
    loop: Annotated[bool, typer.Option("--loop/--once", help="Play again and again, or once.")] = True,
    html: Annotated[
        str | None, typer.Option(metavar="FILE.html", help="Write the page instead of opening a browser.")
    ] = None,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Only print the page's address and serve it until Ctrl-C.")
    ] = False,
) -> int:
    """Play a saved run, or a scene, in the browser.

    Example: pinconsist replay run.npz --forces --trace coupler_tip --speed 0.5
    """
    output.require_writable(html)
    if Path(source).suffix == ".npz":
        mech, sol = saved_run(source, scene_of_run)
        code = output.FINE
    else:
        if scene_of_run:
            raise InputError("--scene says of which scene a saved run (.npz) is; a scene itself needs none")
        mech = scene.Scene(source).load()
        shown.require_drawable(mech, traces, speed)
        sol = run(mech, (0.0, SECONDS))
        code = exit_code(sol)
    look = {"speed": speed, "traces": traces or (), "forces": forces}
    print(f"{mech.name}: t = {sol.t[0]:g} … {sol.t[-1]:g} s, {len(sol.t)} rows; {sol.message}")
    if html:
        from ..view.meshcat import export_html

        output.written(html, lambda: export_html(mech, sol, html, **look))
        print(f"written: {html}")
        return code
    _show(mech, sol, look, loop, no_browser)
    return code


def saved_run(file, given):
    """Mechanism and solution of a saved run."""
    from ..solution import Solution

    sol = Solution.load(file)
    about = sol.method.get("scene")
    what = scene.Scene.recorded(about, file) if about else scene.Scene(sol.scene)
    if given:
        what = changed(what, source=given)
    try:
        mech = what.load()
    except (InputError, FormatError) as error:
        raise InputError(f"the scene of {file} cannot be loaded; say where it is by --scene. {error}") from error
    if sol.q.shape[1] != mech.nq:
        raise InputError(
            f"{file} is a run of another scene than {what.source}: it has {sol.q.shape[1]} numbers in a configuration, "
            f"the scene {mech.nq}; say which by --scene"
        )
    return mech, sol


def _show(mech, sol, look, loop, no_browser):
    from ..view.meshcat import replay as show

    try:
        webbrowser.get()
    except webbrowser.Error:
        no_browser = True
        print("no browser was found here")
    address = show(mech, sol, **look, loop=loop, open_browser=not no_browser)
    if not no_browser:
        print("the page is open in your browser, and plays on without this command")
        return
    print(f"served at {address} until Ctrl-C; --html FILE writes the page to a file", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("no longer served")
