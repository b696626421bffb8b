"""The `pinconsist` command: its overview, the exit codes, and how errors are reported."""

import logging
import os
import re
import shlex
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import PurePath
from typing import Annotated

import typer

import pinconsist as pc

from ..errors import PinconsistError, SavingError
from ..run.interrupts import ended_like_ctrl_c, ignored_from_now_on, interrupted
from .assemble import assemble
from .check import check, models
from .compare import compare
from .convert import convert
from .output import FAILED, INTERRUPTED, WRONG_INPUT, in_options, message, print_error, print_json, rescued
from .referee import referee
from .replay import plot, render, replay
from .sensitivity import sensitivity
from .simulate import rerun, resume, simulate
from .sweep import sweep

OVERVIEW = """\
pinconsist simulates closed-chain mechanisms, with constraint forces that are
accurate from the first step on.

  pinconsist models                               the built-in scenes
  pinconsist check four_bar                       loops, rank, mobility
  pinconsist assemble four_bar --all-modes        all closed configurations
  pinconsist simulate four_bar --html run.html    5 s, certified, and a page
  pinconsist simulate four_bar --out run.npz      save the run
  pinconsist rerun run.npz                        the same numbers again?
  pinconsist resume run.npz                       continue an interrupted run
  pinconsist plot run.npz --what drift,energy     plot it
  pinconsist replay run.npz                       play it in the browser
  pinconsist render run.npz run.mp4               a video for a slide
  pinconsist compare problem51 --step 0.01 0.001  exact and consistent starts
  pinconsist sweep four_bar --vary crank=0:1:.1   many runs, in a table
  pinconsist sensitivity four_bar --of crank --to mass
                                                  effect of parameters
  pinconsist referee four_bar                     errors of other simulators
  pinconsist convert four_bar four_bar.xml        another file format

A scene is a built-in name, a file (.urdf, .xacro, .sdf, .xml, .usd, .wbt), or a
folder that contains one .urdf. Options of a command: pinconsist COMMAND --help"""

SCENE = "2 wrong input, loops that cannot close, or a singular configuration"
SAVED = "(the run up to there is saved by --out)"
RESUMED = "(the run up to there is in the file)"
SHOWN = f"1 the integration of a scene failed (the run up to there is shown); {SCENE}; 130 interrupted"
INPUT = "2 wrong input; 130 interrupted"
COMMANDS: dict[Callable, str] = {
    simulate: f"1 the integration failed {SAVED}; {SCENE}; 130 interrupted {SAVED}: --json then has "
    "run.interrupted = true and run.success = true",
    compare: f"{SCENE}; 130 interrupted",
    check: f"{SCENE}; 130 interrupted",
    assemble: "2 wrong input, or loops that cannot close; 130 interrupted",
    models: INPUT,
    replay: SHOWN,
    render: SHOWN,
    plot: SHOWN,
    rerun: f"1 the numbers differ; {INPUT}",
    resume: f"1 the integration failed {RESUMED}; 2 wrong input, or a scene that has changed; 130 interrupted "
    f"{RESUMED}: --json then has interrupted = true and success = true",
    sweep: "1 a case failed (its row has the reason); 2 wrong input; 130 interrupted (the rows so far are in "
    "FILE.csv.partial)",
    sensitivity: f"{SCENE}; 130 interrupted",
    referee: f"{SCENE}; 130 interrupted",
    convert: "2 wrong input, loops that cannot close, or what the other format cannot represent; 130 interrupted",
}
"""Each command and its exit codes other than 0."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")
SEVERAL = {"--to": re.compile(r"[^-].*"), "--step": NUMBER}
SEVERAL |= dict.fromkeys(("--with-velocity", "--control", "--arg"), re.compile(r"[^-].*=.*"))
SEVERAL["--at"] = re.compile(rf"[^-].*=.*|{NUMBER.pattern}")
"""Options that take several values, and the pattern of a further value."""
WRITTEN = {".html": ("--html",), ".csv": ("--csv", "--out"), ".npz": ("--out",)}
WRITTEN |= dict.fromkeys((".png", ".pdf", ".svg"), ("--plot", "--out"))
"""Suffix of a file → the options that write such a file."""

app = typer.Typer(
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog=f"Exit codes: 0 success; 1 a run or a case failed, or numbers differ; {SCENE}; 130 interrupted.",
)
for command, codes in COMMANDS.items():
    app.command(command.__name__, epilog=f"Exit codes: 0 success; {codes}.")(command)


def main(argv=None, *, app=app, program="pinconsist", studies=("compare",)):
    """Run the commands of `app` with the arguments `argv`, or those of the process, and end it with the exit code.

    `studies` are commands that make several runs. After a signal a run returns early, so they may fail in any way.
    """
    arguments = list(sys.argv[1:] if argv is None else argv)
    if arguments[:1] == ["help"]:
        arguments = [*arguments[1:2], "--help"]
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors="replace")  # a terminal without λ still shows the numbers
    log, handler = logging.getLogger("pinconsist"), Warnings()
    log.addHandler(handler)
    try:
        with warnings.catch_warnings(), ended_like_ctrl_c(), BrokenPipeTolerated() as broken:
            warnings.showwarning = partial(_show_warning, warnings.showwarning, set())
            code = _run(spread(arguments), app, program, studies)
            if code == INTERRUPTED:
                print("pinconsist: interrupted", file=sys.stderr)
                ignored_from_now_on()
        code = code or (FAILED if broken else code)
    finally:
        log.removeHandler(handler)
    sys.exit(code)


class Warnings(logging.Handler):
    def emit(self, record):
        with suppress(OSError):  # an unwritable stderr must not end the run
            message("warning", record.getMessage())


class BrokenPipeTolerated:
    """A context in which a closed stdout does not end the run: the rest of the output is dropped.

    Its value is the list of errors. The first error is reported on stderr, unless the pipe was closed by its reader, as
    in ``... | head``.
    """

    def __enter__(self):
        self.stream, self.errors = sys.stdout, []
        sys.stdout = self
        return self.errors

    def __exit__(self, *_):
        self.flush()
        sys.stdout = self.stream

    def __getattr__(self, name):
        return getattr(self.stream, name)

    def write(self, text):
        self._try("write", text)
        return len(text)

    def flush(self):
        self._try("flush")

    def _try(self, method, *arguments):
        if self.stream is None:  # it was closed at the start
            return
        try:
            getattr(self.stream, method)(*arguments)
        except OSError as error:
            if not (self.errors or isinstance(error, BrokenPipeError)):
                print(f"pinconsist: error: cannot print: {error.strerror}; files are written", file=sys.stderr)
            self.errors.append(error)
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, self.stream.fileno())  # also for what the interpreter flushes at its end
            os.close(nowhere)


def _show_warning(show, shown, text, category, *where, **more):
    """Print each UserWarning once, without the line of code; pass other warnings to `show`."""
    if category is UserWarning:
        if str(text) not in shown:
            message("warning", text)
        shown.add(str(text))
    else:
        show(text, category, *where, **more)


def spread(arguments) -> list[str]:
    """The arguments with ``--step 0.1 0.2`` as ``--step 0.1 --step 0.2``; lists of joint=value in the same way."""
    result, option = [], None
    several = SEVERAL if "compare" in arguments[:1] else SEVERAL.keys() - {"--step"}  # simulate takes one step size
    for argument in arguments:
        name, sign, value = argument.partition("=")
        if name in several:
            option = name
            result += [name, value] if sign else [name]
            continue
        if option and result[-1] != option:  # the option already has its first value
            option = option if SEVERAL[option].fullmatch(argument) else None
            result += [option] if option else []
        result.append(argument)
    return result


def _run(arguments, app, program, studies) -> int:
    try:
        return typer.main.get_command(app).main(arguments, prog_name=program, standalone_mode=False) or 0
    except SavingError as error:
        file = rescued(error.solution)
        text = f"{error}; the run is {f'saved as {file} instead' if file else 'lost: no other folder is writable'}"
    except PinconsistError as error:
        text = error
    except (typer.Abort, KeyboardInterrupt):
        return INTERRUPTED
    except MemoryError:
        print_error("out of memory; the file has what --out and --save-every saved")
        return FAILED
    except Exception as error:
        if interrupted() and arguments[0] in studies:
            return INTERRUPTED
        if not hasattr(error, "format_message"):  # all usage errors of typer have it, for any version of click
            raise
        context = getattr(error, "ctx", None)
        help_of = f" (see {context.command_path} --help)" if context else ""
        reason = error.format_message().rstrip(".")
        text = reason + (_meant(reason, arguments, context) if "extra argument" in reason else "") + help_of
    print_error(text)
    if "--json" in arguments:
        print_json({"error": in_options(text)})
    return WRONG_INPUT


def _meant(reason, arguments, context) -> str:
    """The end of a message about too many arguments: the option of a file, or one that must be repeated."""
    options = {name: each for each in context.command.params for name in each.opts if name.startswith("--")}
    extra = reason.partition("(s) (")[2].rstrip(")").split()
    for text in extra:
        suffix = PurePath(text).suffix
        for name in WRITTEN.get(suffix, ()):
            if name in options:
                return f"; a {suffix} file is written by {name} {shlex.quote(text)}"
    for option, first, second in zip(arguments, arguments[1:], arguments[2:], strict=False):
        if getattr(options.get(option), "multiple", False) and second.split()[:1] == extra[:1]:
            return f"; {option} may be repeated: {option} {shlex.quote(first)} {option} {shlex.quote(second)}"
    return ""


@app.callback(invoke_without_command=True)
def overview(
    context: typer.Context, version: Annotated[bool, typer.Option("--version", help="Print the version.")] = False
):
    """Simulate closed-chain mechanisms, with constraint forces that are accurate from the first step on."""
    if version:
        print(f"pinconsist {pc.__version__}")
        raise typer.Exit()
    if context.invoked_subcommand is None:
        print(OVERVIEW)
