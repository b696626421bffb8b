"""`pinconsist referee`."""

from typing import Annotated, Any

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import RESULTS, Number, Text, Texts, option

JUDGED = "Judged"


@scene.loads_scene
def referee(
    source: scene.Scene,
    start: scene.From = 0.0,
    until: scene.Until = None,
    with_velocity: scene.WithVelocity = None,
    control: scene.Control = None,
    motion: Annotated[Text, option(
        "--motion", "FILE.csv", "Positions of joints over time, columns t and joints, which they are to follow: by "
        "the torques of the exact dynamics and a PD law of 10 Hz, the same for all simulators.", scene.START)] = None,
    log: Annotated[Text, option(
        "--log", "FILE.csv", "Judge this log of another simulator or robot: columns t, q.JOINT, optionally v.JOINT, "
        "command.ACTUATOR, torque.JOINT, force.LOOP.x y z; units in brackets.", JUDGED)] = None,
    tool: Annotated[Texts, option(
        "--tool", "NAME", "Judge this simulator: mujoco, pinocchio or pinconsist; may be repeated. Default: all that "
        "are installed; none with --log.", JUDGED)] = None,
    below: Annotated[float, option(
        "--below", "PERCENT", "Force error for which the cheapest setting is searched for.", JUDGED)] = 1.0,
    budget: Annotated[float, option(
        "--budget", "SECONDS", "Time that one run may take; finer settings are left out.", JUDGED)] = 10.0,
    html: Annotated[Text, option(
        "--html", "FILE.html", "Write a page that overlays the reference motion and that of the first other "
        "simulator.", RESULTS)] = None,
    speed: Annotated[Number, option("--speed", "FACTOR", "Speed of the page; 0.1: slow motion.", RESULTS)] = None,
    table: Annotated[Text, option("--csv", "FILE.csv", "Write all runs as a table.", RESULTS)] = None,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Measure the errors of the loop forces of other simulators on a scene, with several settings.

    The same motion is simulated in MuJoCo, in Pinocchio's constrained dynamics and
    in pinconsist, each with several settings, and compared with a reference on
    which two methods agree. Alternatively, the log of another simulator is judged.

    Example: pinconsist referee crank_rocker --with-velocity crank=12 --until 2
    """
    output.require_writable(html=html, csv=table)
    if speed is not None and not html:
        raise InputError("--speed is for the page of --html; add --html FILE.html")
    mech = source.load()
    velocities = scene.joint_values(with_velocity, "--with-velocity")
    commands = scene.commands_of(control)
    options: dict[str, Any] = {
        "control": commands or None,
        "below": below / 100.0,
        "budget": budget,
        "tools": tool or None,
    }
    if log:
        given = {"--until": until, "--with-velocity": velocities, "--motion": motion, "--at": source.at}
        for name, value in given.items():
            if value:
                raise InputError(f"{name}: the start, the times and the motion are those of --log")
        options["log"] = log
    else:
        until = start + mech.duration if until is None else until
        options |= {"t_span": (start, until), "q0": source.at or None, "v0": velocities or None}
    if motion:
        from ..judging.motion import motion_of

        options["motion"] = motion_of(motion, mech)
    if str(source.source).endswith(".xml"):
        options["mjcf"] = source.source
    with output.doing("running the simulators"):
        judgement = pc.referee(mech, **options)
    if html:
        output.written(html, lambda: judgement.to_html(html, speed=speed or 1.0))
    if table:
        output.written(table, lambda: judgement.to_csv(table))
    if as_json:
        from ..judging.report import plain

        output.print_json(plain(judgement) | {"files": {"html": html, "csv": table}})
    else:
        print(judgement)
        output.print_written(html, table, before="\n")
    return output.FINE
