"""The `pinconsist` command: its overview, and what errors look like from outside."""

from __future__ import annotations

import json
import logging
import re
import sys
import warnings
from typing import Annotated

import typer

from ..errors import PinconsistError, SavingError
from ..interrupts import ended_like_ctrl_c, ignored_from_now_on, interrupted
from . import check, compare, exit_codes, models, plot, replay, rerun, simulate, sweep
from .output import FAILED, INTERRUPTED, WRONG_INPUT, print_error, rescued
from .unbroken import unbroken_stdout

OVERVIEW = """\
pinconsist simulates closed-chain mechanisms, with constraint forces that are
right from the first step on.

  pinconsist models                               the built-in scenes
  pinconsist check four_bar                       loops, rank, mobility
  pinconsist simulate four_bar --html run.html    5 s, certified, and a page
  pinconsist simulate four_bar --out run.npz      save the run
  pinconsist rerun run.npz                        the same numbers again?
  pinconsist resume run.npz                       continue what was cut short
  pinconsist plot run.npz --what drift,energy     draw it
  pinconsist replay run.npz                       play it in the browser
  pinconsist compare problem51 --step 0.01 0.001  exact and consistent starts
  pinconsist sweep four_bar --vary crank=0:1:.1   many runs, in a table

A scene is a built-in name, a .urdf, .sdf or .xml (MJCF) file, or a folder that
holds one .urdf. Each command explains itself: pinconsist COMMAND --help"""
NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
SEVERAL = {"--step": NUMBER, "--at": re.compile(r"[^-].*=.*"), "--with-velocity": re.compile(r"[^-].*=.*")}

app = typer.Typer(
    add_completion=False,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=exit_codes.ALL,
)
for command, function in (
    ("simulate", simulate.simulate),
    ("compare", compare.compare),
    ("check", check.check),
    ("models", models.models),
    ("replay", replay.replay),
    ("plot", plot.plot),
    ("rerun", rerun.rerun),
    ("resume", rerun.resume),
    ("sweep", sweep.sweep),
):
    app.command(command, epilog=exit_codes.OF[command])(function)


def main(argv=None, *, app=app, program="pinconsist", studies=("compare",)):
    """Run the command line and end the process with its exit code.

    Parameters
    ----------
    argv : sequence of str, optional
        Arguments without the program's name; default those of the process.
    app : typer.Typer
        The commands.
    program : str
        Name of the program in its help.
    studies : sequence of str
        Commands that may fail after a signal because they were left with half a run.
    """
    arguments = spread(_asked_for_help(sys.argv[1:] if argv is None else argv))
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal without λ still shows the numbers
    log, handler = logging.getLogger("pinconsist"), logging.StreamHandler()
    handler.setFormatter(logging.Formatter("pinconsist: warning: %(message)s"))
    log.addHandler(handler)
    try:
        with warnings.catch_warnings(), ended_like_ctrl_c(), unbroken_stdout() as broken:
            warnings.showwarning = _without_source(warnings.showwarning)
            code = _run(arguments, app, program, studies)
            if code == INTERRUPTED:
                ignored_from_now_on()
        code = code or (FAILED if broken else code)
    finally:
        log.removeHandler(handler)
    sys.exit(code)


def _without_source(show):
    """A `warnings.showwarning` that tells what is meant for the user as a sentence; the rest it leaves to `show`."""

    def tell(message, category, *where, **more):
        if category is UserWarning:
            print(f"pinconsist: warning: {message}", file=sys.stderr)
        else:
            show(message, category, *where, **more)

    return tell


def _asked_for_help(arguments):
    """``help`` and ``help COMMAND`` as ``--help`` and ``COMMAND --help``."""
    return [*arguments[1:2], "--help"] if list(arguments[:1]) == ["help"] else arguments


def spread(arguments) -> list[str]:
    """The arguments with ``--step 0.1 0.2`` as ``--step 0.1 --step 0.2``, and joint=value lists alike."""
    result, option, first = [], None, False
    several = SEVERAL if "compare" in arguments[:1] else SEVERAL.keys() - {"--step"}  # simulate takes one step size
    for argument in arguments:
        name, sign, value = argument.partition("=")
        if name in several:
            option, first = name, not sign
            result += [name, value] if sign else [name]
            continue
        if option and not first:
            if SEVERAL[option].fullmatch(argument):
                result.append(option)
            else:
                option = None
        result.append(argument)
        first = False
    return result


def _run(arguments, app, program, studies) -> int:
    command = typer.main.get_command(app)
    try:
        code = command.main(arguments, prog_name=program, standalone_mode=False) or 0
        return _interrupted() if code == INTERRUPTED else code  # typer too makes this code of a KeyboardInterrupt
    except SavingError as error:
        file = rescued(error.solution)
        mistake = f"{error}; the run is {f'saved as {file} instead' if file else 'lost, no other folder takes it'}"
    except PinconsistError as error:
        mistake = error
    except (typer.Abort, KeyboardInterrupt):
        return _interrupted()
    except MemoryError:
        print_error("out of memory; what --out --save-every saved on the way is there")
        return FAILED
    except Exception as error:
        if interrupted() and arguments[0] in studies:
            return _interrupted()
        if not hasattr(error, "format_message"):  # what every usage error of typer has, whichever click it builds on
            raise
        context = getattr(error, "ctx", None)
        help_of = f" (see {context.command_path} --help)" if context else ""
        mistake = error.format_message().rstrip(".") + help_of
    print_error(mistake)
    if "--json" in arguments:
        print(json.dumps({"error": str(mistake)}))
    return WRONG_INPUT


def _interrupted() -> int:
    print("pinconsist: interrupted", file=sys.stderr)
    return INTERRUPTED


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
):
    """Simulate closed-chain mechanisms, with constraint forces that are right from the first step on."""
    if version:
        from .. import __version__

        print(f"pinconsist {__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        print(OVERVIEW)
