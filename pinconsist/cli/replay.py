"""`pinconsist replay`."""

from __future__ import annotations

import logging
import time
import webbrowser
from typing import Annotated

import typer

from ..errors import InputError
from . import motion, output, scene, shown


def replay(
    source: motion.Source,
    scene_of_run: motion.SceneOfRun = None,
    until: scene.Until = None,
    forces: shown.Forces = False,
    traces: shown.Traces = None,
    speed: shown.Speed = None,
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

    def require(mech):
        if mech is None:
            raise InputError(
                f"{source} holds a general problem, which has no scene to play; pinconsist plot {source} draws it"
            )
        shown.require_drawable(mech, traces, speed)

    mech, sol, code = motion.motion(source, scene_of_run, until, require)
    look = {"speed": shown.pace(speed, sol), "traces": traces or (), "forces": forces}
    print(motion.told(mech, sol))
    if html:
        from ..view.page import export_html

        output.written(html, lambda: export_html(mech, sol, html, **look))
        print(f"written: {html}")
        return code
    _show(mech, sol, look, loop, no_browser)
    return code


def _show(mech, sol, look, loop, no_browser):
    from ..view.page import replay as show

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
