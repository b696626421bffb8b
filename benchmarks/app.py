"""The commands of ``python -m benchmarks``."""

from __future__ import annotations

from collections.abc import Callable

import typer

from pinconsist.cli import app as package

from . import (
    ablate,
    actuation,
    alarms,
    calibration,
    chains_command,
    control,
    gallery,
    gradients,
    impacts,
    landing,
    lanes,
    mujoco_motion,
    overhead,
    pulses,
    referee,
    robots,
    sampled,
    standing,
    stepped,
    stress_command,
    sweep,
    work_precision_command,
)

WRONG_INPUT = "2 wrong input; 130 interrupted"
COMMANDS: dict[str, tuple[Callable, str]] = {
    "work-precision": (work_precision_command.command, WRONG_INPUT),
    "robots": (robots.command, WRONG_INPUT),
    "gallery": (gallery.command, WRONG_INPUT),
    "mujoco": (mujoco_motion.command, WRONG_INPUT),
    "overhead": (overhead.command, WRONG_INPUT),
    "sampled": (sampled.command, WRONG_INPUT),
    "stepped": (stepped.command, WRONG_INPUT),
    "standing": (standing.command, WRONG_INPUT),
    "landing": (landing.command, WRONG_INPUT),
    "impacts": (impacts.command, WRONG_INPUT),
    "pulses": (pulses.command, WRONG_INPUT),
    "sweep": (sweep.command, WRONG_INPUT),
    "actuation": (actuation.command, WRONG_INPUT),
    "ablate": (ablate.command, WRONG_INPUT),
    "calibration": (calibration.command, WRONG_INPUT),
    "control": (control.command, WRONG_INPUT),
    "gradients": (gradients.command, WRONG_INPUT),
    "lanes": (lanes.command, WRONG_INPUT),
    "referee": (referee.command, WRONG_INPUT),
    "chains": (chains_command.command, f"1 a run failed; {WRONG_INPUT}"),
    "alarms": (alarms.command, f"1 a verdict was wrong; {WRONG_INPUT}"),
    "stress": (stress_command.command, f"1 a case failed; {WRONG_INPUT}"),
}
"""Name → function, and its exit codes apart from 0."""

app = typer.Typer(
    help="Measure run time and accuracy on this machine. Pin the threads first: OMP_NUM_THREADS=1.",
    add_completion=False,
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for name, (function, codes) in COMMANDS.items():
    app.command(name, epilog=f"Exit codes: 0 fine; {codes}.")(function)


def main(argv=None):
    package.main(argv, app=app, program="python -m benchmarks", studies=COMMANDS)
