"""`pinconsist replay` and `pinconsist render`, and the options for how a picture looks."""

import logging
import time
import webbrowser
from functools import partial
from math import floor, log10
from typing import Annotated

import typer

import pinconsist as pc

from ..errors import InputError
from . import options as given
from . import output
from .options import Text, option
from .run import print_in_a_line, run_of
from .terminal import counting


def replay(
    source: given.RunOrScene,
    scene_of_run: given.SceneOfRun = None,
    until: given.Until = None,
    forces: given.Forces = False,
    traces: given.Traces = None,
    speed: given.Speed = None,
    loop: Annotated[bool, option("--loop/--once", None, "Play again and again, or once.")] = True,
    html: Annotated[Text, option("--html", "FILE.html", "Write the page instead of opening a browser.")] = None,
    no_browser: Annotated[bool, option(
        "--no-browser", None, "Only print the page's address and serve it until Ctrl-C.")] = False,
) -> int:  # fmt: skip
    """Play a saved run, or a scene, in the browser.

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
        print("no browser was found here")
    address = pc.replay(mech, sol, **options, open_browser=not no_browser)
    if not no_browser:
        print("the page is open in your browser, and plays on without this command")
        return
    print(f"served at {address} until Ctrl-C; --html FILE writes the page to a file", flush=True)
    try:
        while True:
            time.sleep(3600)
    except KeyboardInterrupt:
        logging.getLogger(__name__).debug("no longer served")


def render(
    source: given.RunOrScene,
    out: Annotated[str, typer.Argument(
        metavar="FILE", help="A film (.mp4 or .gif), or drawings of a planar mechanism (.svg).")],
    at: Annotated[list[float] | None, option(
        "--at", "SECONDS ...", "Times to draw in an .svg. Default: the start.")] = None,
    scene_of_run: given.SceneOfRun = None,
    until: given.Until = None,
    forces: given.Forces = False,
    traces: given.Traces = None,
    speed: given.Speed = None,
) -> int:  # fmt: skip
    """Make a film of a saved run or a scene, or draw it at given times.

    Example: pinconsist render run.npz run.mp4 --forces
    """
    from ..view import render as painted

    output.require_writable(FILE=out)
    painted.require_file(out, at or ())
    mech, sol, code = run_of(source, scene_of_run, until, partial(require_drawable, source, traces, speed))
    options = look(sol, forces, traces, speed) | {"at": at or ()}
    with counting("frames") as watch:
        output.written(out, lambda: painted.render(mech, sol, out, **options, watch=watch))
    print_in_a_line(sol)
    output.print_written(out)
    return code


def look(sol, forces, traces, speed) -> dict:
    """The options of a page; without --speed it plays in real time, or slower if the run is short."""
    length = abs(sol.t[-1] - sol.t[0])
    if speed is None:
        speed = 10.0 ** floor(log10(length)) if 0 < length < 1 else 1.0
    return {"speed": speed, "traces": traces or (), "forces": forces}


def require_drawable(source, traces, speed, mech):
    """Raise InputError before a long run for what cannot be shown: no scene, a --trace that is no frame, a --speed."""
    if mech is None:
        raise InputError(
            f"{source} holds a general problem, which has no scene to show; pinconsist plot {source} draws it"
        )
    if speed is not None and not 0 < speed < float("inf"):
        raise InputError(f"--speed {speed}: needs a positive number")
    if traces:
        from ..formats.reading import near

        names = [frame.name for frame in mech.model.frames]
        for name in traces:
            if name not in names:
                raise InputError(f"{mech.name}: no frame {name!r} to trace{near(name, names)}")


def require_page(html, forces, traces, speed):
    """Raise InputError for options of a page without --html."""
    for name, value in {"--forces": forces, "--trace": traces, "--speed": speed is not None}.items():
        if value and not html:
            raise InputError(f"{name} sets how the page of --html looks; give --html FILE.html too")
