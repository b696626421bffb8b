"""Options shared by several commands."""

from math import floor, log10
from typing import Annotated

import typer

from ..errors import InputError
from ..scene_source import SceneSource

SCENE, START, METHOD, RESULTS, PAGE = "Scene", "Start", "Method", "Results", "Page"  # panels of a command's help
Text = str | None
Texts = list[str] | None
Number = float | None
Count = int | None


def option(name, metavar, about, panel=None, **limits):
    """An option for `typer`; a flag has no `metavar`; numbers may have ``min`` and ``max``."""
    return typer.Option(name, metavar=metavar, help=about, rich_help_panel=panel, **limits)


def present(**values) -> dict:
    return {name: value for name, value in values.items() if value is not None}


# fmt: off
Scene = Annotated[SceneSource, typer.Argument(metavar="SCENE", help=(
    "A built-in scene (see: pinconsist models), a .urdf, .sdf or .xml (MJCF) file, or a folder with one .urdf."))]

From = Annotated[float, option("--from", "SECONDS", "Start time.", START)]
Until = Annotated[Number, option(
    "--until", "SECONDS", "End time. Default: the scene's own duration, or 5 s if it has none.", START)]
WithVelocity = Annotated[Texts, option(
    "--with-velocity", "JOINT=VALUE ...",
    "Initial velocities of these joints, in rad/s or m/s; the others follow. Default: at rest.", START)]

Control = Annotated[Texts, option(
    "--control", "ACTUATOR=VALUE ...", "Commands of actuators, by their names or those of their joints, such as 0.4 or "
    "30deg. Default: those of the file.", START)]
Step = Annotated[Number, option("--step", "SECONDS", "Fixed step. Default: variable step and order.", METHOD)]
Rtol = Annotated[float, option("--rtol", "NUMBER", "Accuracy of the run, relative to the largest values.", METHOD)]
Atol = Annotated[float, option("--atol", "NUMBER", "Accuracy of the run, absolute: rad, m; rad/s, m/s.", METHOD)]
MaxSteps = Annotated[Count, option("--max-steps", "N", "Stop the run with an error after this many steps.", METHOD)]

Forces = Annotated[bool, option("--forces", None, "Draw loop forces and moments, and motor torques, as arrows.", PAGE)]
Traces = Annotated[Texts, option("--trace", "FRAME", "Draw the path of this frame; may be repeated.", PAGE)]
Speed = Annotated[Number, option(
    "--speed", "FACTOR", "2: twice as fast; 0.1: slow motion. Default: 1, or slower for runs of less than 1 s.",
    PAGE)]

RunOrScene = Annotated[str, typer.Argument(
    metavar="RUN.npz|SCENE", help="A saved run, or a scene, which is simulated first.")]
SavedRun = Annotated[str, typer.Argument(metavar="RUN.npz", help="A saved run.")]
SceneOfRun = Annotated[Text, option("--scene", "SCENE", "Scene of a saved run, if it is not the recorded one.")]
# fmt: on


def look(sol, forces, traces, speed) -> dict:
    """The options of a page; without --speed it plays in real time, or slower if the run is short."""
    length = abs(sol.t[-1] - sol.t[0])
    if speed is None:
        speed = 10.0 ** floor(log10(length)) if 0 < length < 1 else 1.0
    return {"speed": speed, "traces": traces or (), "forces": forces}


def require_drawable(source, traces, speed, mech):
    """Raise InputError before a long run if it cannot be shown: no scene, an unknown --trace, an invalid --speed."""
    if mech is None:
        raise InputError(
            f"{source} contains a general problem, which has no scene to show; use pinconsist plot {source}"
        )
    if speed is not None and not 0 < speed < float("inf"):
        raise InputError(f"--speed {speed}: it must be a positive number")
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
            raise InputError(f"{name} is for the page of --html; add --html FILE.html")
