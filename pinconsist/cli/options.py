"""The options that several commands share."""

from typing import Annotated

import typer

SCENE, START, METHOD, RESULTS, PAGE = "Scene", "Start", "Method", "Results", "Page"  # panels of a command's help
Text = str | None
Texts = list[str] | None
Number = float | None
Count = int | None


def option(name, metavar, about, panel=None):
    """An option for `typer`; a flag has no `metavar`."""
    return typer.Option(name, metavar=metavar, help=about, rich_help_panel=panel)


def present(**values) -> dict:
    """The options that were given."""
    return {name: value for name, value in values.items() if value is not None}


# fmt: off
Source = Annotated[str, typer.Argument(metavar="SCENE", help=(
    "A built-in scene (see: pinconsist models), a .urdf, .sdf or .xml (MJCF) file, or a folder of one .urdf."))]
Loops = Annotated[Text, option("--loops", "FILE", "Loop file (YAML). Default: the one next to the .urdf.", SCENE)]
Closure = Annotated[Text, option(
    "--closure", "KIND", "Close every loop by this kind instead, such as point, hinge or frame.", SCENE)]
FreeFlyer = Annotated[bool, option(
    "--free-flyer", None, "Let the root link float instead of fixing it to the ground.", SCENE)]
PackageDirs = Annotated[Texts, option("--package-dir", "DIR", "Folder to look for meshes in; may be repeated.", SCENE)]
Precision = Annotated[float, option(
    "--precision", "NUMBER", "How far off the numbers of the file may be, m and rad: 1e-6 if it was written with six "
    "digits. Loops that lock or contradict each other only by rounding then move.", SCENE)]
Ignore = Annotated[Texts, option(
    "--ignore", "TAG", "Load a file without these elements, which close loops in another program and are not read "
    "here, by tag or name; may be repeated.", SCENE)]
Reanchor = Annotated[bool, option(
    "--reanchor", None, "Move the anchors of loops that cannot close to where they fit best.", SCENE)]

From = Annotated[float, option("--from", "SECONDS", "Start time.", START)]
Until = Annotated[Number, option(
    "--until", "SECONDS", "End time. Default: the scene's own duration, or 5 s if it has none.", START)]
At = Annotated[Texts, option(
    "--at", "JOINT=VALUE ...",
    "Initial positions of these joints, in rad or m, such as 0.3, pi/2 or 30deg; the others follow. Several numbers: "
    "joint=0,0,0,1.", START)]
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
