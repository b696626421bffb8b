"""The options that several commands share."""

from typing import Annotated

import typer

from ..run_file import SceneSource

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
    "A built-in scene (see: pinconsist models), a .urdf, .sdf or .xml (MJCF) file, or a folder of one .urdf."))]

From = Annotated[float, option("--from", "SECONDS", "Start time.", START)]
Until = Annotated[Number, option(
    "--until", "SECONDS", "End time. Default: the scene's own duration, or 5 s if it has none.", START)]
WithVelocity = Annotated[Texts, option(
    "--with-velocity", "JOINT=VALUE ...",
    "Initial velocities of these joints, in rad/s or m/s; the others follow. Default: at rest.", START)]

Control = Annotated[Texts, option(
    "--control", "ACTUATOR=VALUE ...", "Commands of actuators, by their names or those of their joints, such as 0.4 or "
    "30deg. Default: those of the file.", START)]
Step = Annotated[Number, option("--step", "SECONDS", "Fixed step. Default: step and order vary.", METHOD)]
Rtol = Annotated[float, option("--rtol", "NUMBER", "Accuracy of the run, relative to the largest values.", METHOD)]
Atol = Annotated[float, option("--atol", "NUMBER", "Accuracy of the run, absolute: rad, m; rad/s, m/s.", METHOD)]
MaxSteps = Annotated[Count, option("--max-steps", "N", "Stop a run with an error after this many steps.", METHOD)]

Forces = Annotated[bool, option("--forces", None, "Draw loop forces and moments, and motor torques, as arrows.", PAGE)]
Traces = Annotated[Texts, option("--trace", "FRAME", "Draw the path of this frame; may be repeated.", PAGE)]
Speed = Annotated[Number, option(
    "--speed", "FACTOR", "2 plays twice as fast, 0.1 in slow motion. Default: 1; slower for runs of less than 1 s.",
    PAGE)]

RunOrScene = Annotated[str, typer.Argument(
    metavar="RUN.npz|SCENE", help="A saved run, or a scene, which is simulated first.")]
SavedRun = Annotated[str, typer.Argument(metavar="RUN.npz", help="A saved run.")]
SceneOfRun = Annotated[Text, option("--scene", "SCENE", "Scene of a saved run, where it is not the recorded one.")]
