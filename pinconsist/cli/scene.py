"""Options shared by several commands; the scene of a command, its description, and warnings about likely mistakes."""

import logging
import re
import warnings
from dataclasses import replace
from functools import wraps
from inspect import Parameter, Signature, signature
from math import floor, isfinite, log10, pi
from typing import Annotated, get_args

import typer

import pinconsist as pc

from ..errors import InputError
from ..run.scene_source import SceneSource
from .output import counted, first, size

PARTS_OF_PI = re.compile(r"([+-]?)(?:(\d+\.?\d*|\.\d+)\*?)?pi(?:/(\d+\.?\d*))?")
CLOSE_BY = 1e-2  # rad or m
MOST_SHOWN = 3  # warnings of a kind

_log = logging.getLogger(__name__)

SCENE, START, METHOD, RESULTS, PAGE = "Scene", "Start", "Method", "Results", "Page"  # panels of a command's help
Text = str | None
Texts = list[str] | None
QUANTITY = (
    '"peak reaction PIN", "rms torque MOTOR", "position FOOT z at 2.5", "min length SPRING", "max energy kinetic" '
    "(min, max, peak, rms, mean, final)"
)
Number = float | None
Count = int | None


def option(name, metavar, about, panel=None, **limits):
    """An option for `typer`; a flag has no `metavar`; numbers may have ``min`` and ``max``."""
    return typer.Option(name, metavar=metavar, help=about, rich_help_panel=panel, **limits)


def present(**values) -> dict:
    return {name: value for name, value in values.items() if value is not None}


# fmt: off
Scene = Annotated[SceneSource, typer.Argument(metavar="SCENE", help=(
    "A built-in scene (see: pinconsist models), a .urdf, .xacro, .sdf, .xml (MJCF), .usd or .wbt file, or a folder "
    "with one .urdf."))]

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


def source_of(
    source: str,
    loops: Annotated[Text, option(
        "--loops", "FILE", "Loop file (YAML). Default: the one next to the .urdf.", SCENE)] = None,
    closure: Annotated[Text, option(
        "--closure", "KIND", "Use this kind for all points, frames and hinges: point, frame or hinge.", SCENE)] = None,
    free_flyer: Annotated[bool, option(
        "--free-flyer", None, "Let the root link float instead of fixing it to the ground.", SCENE)] = False,
    package_dirs: Annotated[Texts, option(
        "--package-dir", "DIR", "Folder in which meshes are searched for; may be repeated.", SCENE)] = None,
    precision: Annotated[float, option(
        "--precision", "NUMBER", "Error of the numbers in the file, m and rad: 1e-6 if it was written with six digits. "
        "Loops that lock or contradict each other only because of rounding are made consistent.", SCENE)] = 0.0,
    ignore: Annotated[Texts, option(
        "--ignore", "TAG", "Load the file without these elements, by tag or name, which close loops in another program "
        "and are not supported here; may be repeated.", SCENE)] = None,
    arguments: Annotated[Texts, option(
        "--arg", "NAME=VALUE ...", "Arguments of a xacro file.", SCENE)] = None,
    reanchor: Annotated[bool, option(
        "--reanchor", None, "Move the anchors of loops that cannot close to the best fit.", SCENE)] = False,
    at: Annotated[Texts, option(
        "--at", "JOINT=VALUE ...", "Initial positions of these joints, in rad or m, such as 0.3, pi/2 or 30deg; the "
        "others follow. For a joint with several numbers: joint=0,0,0,1.", START)] = None,
) -> SceneSource:
    # fmt: on
    """The source of a scene, from the options of all commands that load one."""
    q0 = joint_values(at, "--at")
    found = SceneSource(source, loops, closure, free_flyer, package_dirs or [], reanchor, q0, ignore or [], precision)
    return replace(found, args=_arguments(arguments))


def _arguments(texts) -> dict[str, str]:
    values = {}
    for text in texts or ():
        name, sign, value = text.partition("=")
        name = name.removesuffix(":").strip()  # ``name:=value``, as ROS has it
        if not sign or not name or name in values:
            raise InputError(f"--arg needs NAME=VALUE, each name once, got {text!r}")
        values[name] = value
    return values


def loads_scene(command):
    """Replace the parameter `source` of a command by the options of :func:`source_of`, which create it."""
    options, parameters = signature(source_of).parameters, []
    for name, each in signature(command).parameters.items():
        if name == "source":
            argument, others = Annotated[str, get_args(each.annotation)[1]], list(options.values())[1:]
            parameters += [options[name].replace(annotation=argument), *others]
        else:
            parameters.append(each)

    @wraps(command)
    def loading(**values):
        return command(source=source_of(**{name: values.pop(name) for name in options}), **values)

    loading.__signature__ = Signature([each.replace(kind=Parameter.KEYWORD_ONLY) for each in parameters])
    loading.__annotations__ = {each.name: each.annotation for each in parameters}  # typer reads both
    return loading


def commands_of(texts) -> dict[str, float]:
    """Actuator → command, from the texts of --control."""
    given = joint_values(texts, "--control", "actuator")
    if several := [name for name, values in given.items() if len(values) > 1]:
        raise InputError(f"--control {several[0]} needs one number, got {len(given[several[0]])}")
    return {name: values[0] for name, values in given.items()}


def joint_values(texts, option: str, kind: str = "joint") -> dict[str, list[float]]:
    """Joint → numbers from texts like ``crank=0.3``."""
    values = {}
    for text in texts or ():
        joint, sign, numbers = text.partition("=")
        joint = joint.strip()
        if not sign or not joint:
            raise InputError(f"{option} needs {kind}=value, got {text!r}")
        if joint in values:
            raise InputError(f"{option} names {kind} {joint!r} twice")
        try:
            values[joint] = [number(each) for each in numbers.split(",")]
        except ValueError:
            several = "; separate joints by spaces" if "=" in numbers else ""
            raise InputError(f"{option} {text}: {numbers!r} is not a number{several}") from None
    return values


def number(text) -> float:
    """A number; also a multiple of pi, as only exact values are singular configurations, or degrees, such as 30deg."""
    text = text.replace(" ", "")
    if text.endswith("deg"):
        return number(text.removesuffix("deg")) * pi / 180.0
    match = PARTS_OF_PI.fullmatch(text)
    if not match:
        return float(text)
    sign, times, over = match.groups()
    if over and float(over) == 0.0:
        raise ValueError(text)
    return float(f"{sign}1") * float(times or 1) * pi / float(over or 1)


def describe(mech, assembly) -> str:
    """The scene in one line."""
    text = f"{mech.name}: {counted(len(mech.joints), 'joint')}, {counted(len(mech.loops), 'loop')}"
    if mech.loops:
        text += f" of {counted(assembly.rows, 'row')} ({assembly.rank} independent)"
    text += f", mobility {assembly.mobility}"
    return text + f", numbers corrected by up to {mech.corrected_by:.1e} m or rad" * (mech.corrected_by > 0.0)


def assembled(mech, q0, v0=None, t=0.0):
    """The closed configuration of a command, from the values of --at and --with-velocity.

    InputError if each position is possible alone, but not all together. If the joints end nearby, only a warning is
    issued: rounded values may be meant to select one of several assembly modes.
    """
    from ..mechanism.assembly import not_kept
    from ..mechanism.checks import coordinates

    def positions(q, joints):
        return ", ".join(f"{joint} = {text(coordinates(mech.model, joint, q), 6)}" for joint in joints)

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assembly = pc.assemble(mech, q0 or None, v0 or None, t=t)
    with warnings.catch_warnings():  # warnings about single joints are suppressed
        warnings.simplefilter("ignore")
        if len(q0) > 1 and not_kept(mech, q0, assembly.q, CLOSE_BY):
            alone = {joint: pc.assemble(mech, {joint: value}, t=t).q for joint, value in q0.items()}
            if not any(not_kept(mech, {joint: q0[joint]}, q) for joint, q in alone.items()):
                first, *others = q0
                raise InputError(
                    f"{mech.name}: the loops do not allow the positions given for {', '.join(q0)} together: with "
                    f"{positions(alone[first], [first])} they close at {positions(alone[first], others)}. Give fewer "
                    "joints with --at"
                )
    for each in caught:
        warnings.warn_explicit(each.message, each.category, each.filename, each.lineno)
    return assembly


def text(value, digits=4) -> str:
    """A number, or several separated by spaces."""
    return " ".join(size(each, f".{digits}g") for each in (value if hasattr(value, "__len__") else [value]))


def scene_warnings(mech, assembly) -> list[str]:
    """Log warnings about likely mistakes in a scene that closes; return them as sentences."""
    from ..mechanism.names import beyond_limits

    outside = [
        f"{each.joint} = {size(each.value)} is outside the limits of its file, {each.lower:.6g} … {each.upper:.6g}: a "
        f"wrong anchor or guess? --at {each.joint}={_inside(each):.3g} starts within them"
        for each in beyond_limits(mech, [0.0], assembly.q[None, :])
    ]
    sentences = first(outside, MOST_SHOWN, "and {} more") + _immobile(mech, assembly)
    for sentence in sentences:
        _log.warning("%s", sentence)
    return sentences


def _inside(limits) -> float:
    """A value within limits: the middle, or the limit that is finite."""
    finite = [each for each in (limits.lower, limits.upper) if isfinite(each)]
    return sum(finite) / len(finite)


def _immobile(mech, assembly) -> list[str]:
    """A warning about a mechanism of mobility 0 without drives, with the rows that lock it; or an empty list."""
    import numpy as np

    from ..mechanism.closing import LoopSolver
    from ..mechanism.correction import hint
    from ..mechanism.loops import LOOP_KINDS
    from ..mechanism.rank import independent_rows

    if assembly.mobility or not mech.loops:
        return []
    solver = LoopSolver(mech)
    if solver.loop_rows.moving or hint(mech):  # about the hint, assembly has warned
        return []
    _, J = solver.rows(assembly.q)
    helping = []
    for loop in mech.anchored_loops:
        rows = LOOP_KINDS[loop.kind].rotations
        kept = np.array([of != loop.name or row not in rows for of, row in mech.row_labels])
        if left := mech.nv - len(independent_rows(J[kept], solver.loop_rows.turns[kept])):
            helping.append(f"without rows {', '.join(rows)}, loop {loop.name!r} would leave {counted(left, 'motion')}")
    advice = f"; {'; '.join(helping[:MOST_SHOWN])}, as a planar hinge does" if helping else ""
    return [
        f"nothing can move: the loops lock all {mech.nv} velocities, and there are no drives. Check the axes of loops "
        f"and joints{advice}"
    ]


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
