"""The sweep of a scene: what its cases change, the run of each, the journal of their rows, and the table."""

import csv
import fcntl
import hashlib
import io
import json
import logging
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from ..engine.systems import with_all_rows
from ..errors import FormatError, InputError, PinconsistError
from ..files import written_whole
from ..mechanism.description import digests
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import position_names, velocity_names
from ..mechanism.parameters import UnknownParameterError, parameter, unknown
from .quantities import Quantity
from .simulation import simulate
from .solution_file import versions

FORMAT = 1
SETTINGS = ("rtol", "atol", "step", "until")
MEASURED = ("status", "t", "steps", "gap", "energy_error")
DONE, FAILED, ERROR = "done", "failed", "error"
_log = logging.getLogger(__name__)
_loaded: dict[str, Mechanism] = {}
"""Text of a scene source → its mechanism, for the sweep that this process works on."""


def loaded(scene, *, anew=False) -> Mechanism:
    """The mechanism of a scene, loaded once in each process; use `anew` if its files may have changed since.

    Warnings of loading are shown then, and not again by every process.
    """
    if anew or repr(scene) not in _loaded:
        _loaded.clear()
        with warnings.catch_warnings():
            if not anew:
                warnings.simplefilter("ignore")
            _loaded[repr(scene)] = scene.load()
    return _loaded[repr(scene)]


@dataclass
class Run:
    """The arguments of a call of `simulate`."""

    mechanism: Mechanism
    until: float
    q0: dict = field(default_factory=dict)
    v0: dict = field(default_factory=dict)
    torques: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)

    def put(self, name: str, value: float) -> None:
        """Change the value of this name; InputError if it is unknown.

        Names are those of joints of one degree of freedom (initial position, rad or m), ``<joint>_speed`` (initial
        velocity), ``<joint>_torque`` (constant, in addition to the scene's forces); ``until``, ``rtol``, ``atol``,
        ``step``; and those of :mod:`pinconsist.mechanism.parameters`, such as ``gear.ratio`` and ``mass:coupler``.
        """
        mechanism, starts = self.mechanism, {"": self.q0, "_speed": self.v0, "_torque": self.torques}
        for ending, values in starts.items():
            joint = name.removesuffix(ending)
            if joint in mechanism.joints and joint + ending == name:
                columns = mechanism.columns(joint)
                if columns.stop - columns.start != 1:
                    raise InputError(f"{name} cannot be varied: joint {joint!r} has several degrees of freedom")
                values[joint] = value
                return
        if name == "until":
            self.until = value
        elif name in SETTINGS:
            self.options[name] = value
        else:
            try:
                self.mechanism = parameter(mechanism, name).put(mechanism, value)
            except UnknownParameterError:
                known = [*mechanism.joints, *(f"{joint}_speed" for joint in mechanism.joints), *SETTINGS]
                listed = f", JOINT, JOINT_speed and JOINT_torque for a joint, {', '.join(SETTINGS)}"
                raise unknown(mechanism, name, known, listed) from None


@dataclass(frozen=True)
class SceneSweep:
    """How each case of a sweep is run: plain data that can be sent to any process."""

    scene: Any  # plain data with a method load() -> Mechanism
    names: tuple[str, ...]  # meaning of the numbers of a case, see `Run.put`
    start: float
    until: float
    q0: Mapping  # of the joints that are not varied
    v0: Mapping
    options: Mapping  # of simulate
    of: tuple[str, ...] = ()  # quantities that are columns, as for `Solution.evaluate`

    def __call__(self, case) -> dict:
        """The row of a case: the results, ``end`` (q and v of the last row), and a message if there is one."""
        run = self.run(case)
        sol, warned = self._simulated(run, run.until)
        messages = warned if sol.success else [sol.message, *warned]
        numbers, missing = self._numbers(sol)
        return {
            "status": DONE if sol.success else FAILED, "t": float(sol.t[-1]), "steps": sol.nsteps, "gap": _gap(sol),
            "energy_error": sol.energy().balance_error, "of": numbers,
            "end": np.concatenate([sol.q[-1], sol.v[-1]]).tolist(), "message": "; ".join([*messages, *missing]),
        }  # fmt: skip

    def _numbers(self, sol):
        """The quantities of a run, None for those that it has not, and why it has not."""
        numbers: list[float | None] = []
        missing = []
        for text in self.of:
            try:
                numbers.append(Quantity.of(text, sol.mechanism).number(sol))
            except PinconsistError as error:
                numbers.append(None)
                missing.append(str(error))
        return numbers, missing

    def run(self, case) -> Run:
        """The arguments of `simulate` for a case; InputError if its numbers are not valid."""
        run = Run(loaded(self.scene), self.until, dict(self.q0), dict(self.v0), {}, dict(self.options))
        for name, value in zip(self.names, case, strict=True):
            run.put(name, value)
        return run

    def check(self, case) -> None:
        """Raise InputError if the run of a case cannot begin because of the options."""
        try:
            start, _ = self._simulated(self.run(case), self.start)
            for text in self.of:
                Quantity.of(text, start.mechanism).require_number(start)
        except InputError:
            raise
        except PinconsistError as error:  # it concerns only this case, and is in its row
            _log.debug("the first case: %s", error)

    def _simulated(self, run, until):
        """The solution, and the warnings of the run."""
        forces = [run.torques] if run.torques else ()
        q0, v0 = run.q0 or None, run.v0 or None
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", UserWarning)
            dense = run.options.get("method") == "Radau"  # energies of its few rows need states between them
            options = {"dense_output": dense, **run.options}
            sol = simulate(run.mechanism, (self.start, until), q0, v0, forces=forces, **options)
        return sol, list(dict.fromkeys(str(each.message) for each in caught))

    def about(self, cases) -> dict:
        """The data that two sweeps must share for their rows to be the same."""
        mechanism = loaded(self.scene)
        return {
            "scene": {"name": mechanism.name, **digests(mechanism)},
            "start": {"time": self.start, "q": dict(self.q0), "v": dict(self.v0)},
            "settings": {"until": self.until, **self.options},
            "varied": list(self.names),
            "quantities": list(self.of),
            "cases": {"count": len(cases), "content": hashlib.sha256(json.dumps(cases).encode()).hexdigest()},
            "versions": versions(),
        }

    def columns(self) -> list[str]:
        """The names of the table's columns; q and v as ``q.crank``, or ``q.ball[0]`` of a joint of several."""
        model = loaded(self.scene).model
        ends = [f"q.{name}" for name in position_names(model)] + [f"v.{name}" for name in velocity_names(model)]
        return ["case", *self.names, *MEASURED, *self.of, *ends, "message"]

    def rows(self, cases, measured: dict[int, dict]) -> list[list]:
        """The rows of the cases that have been run, in their order; None for missing numbers."""
        of = [None] * len(self.of)
        end = [None] * (len(self.columns()) - len(self.names) - len(MEASURED) - len(of) - 2)
        return [
            [i, *cases[i], *map(row.get, MEASURED), *row.get("of", of), *row.get("end", end), row["message"]]
            for i, row in sorted(measured.items())
        ]


def write_table(file, sweep: SceneSweep, cases, measured: dict[int, dict]) -> None:
    """Write a CSV file, whole or not at all; floats have enough digits to be read back exactly."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows([sweep.columns(), *sweep.rows(cases, measured)])
    with written_whole(file) as stream:
        stream.write(text.getvalue().encode())


def _gap(sol) -> float:
    """`Certificate.position` alone: the forces, most of a certificate's work, are not in the table."""
    system = sol.system
    if not len(sol.t) or not system.rows.nc:
        return 0.0
    widest = int(np.abs(with_all_rows(system).gaps(sol.t, sol.q)).max(axis=1).argmax())
    return float(np.abs(system.loop_rows(sol.q[widest], sol.t[widest])[0]).max())


class Journal:
    """The rows of an unfinished table, one line each, in a file next to it, from which a killed sweep continues.

    The file, ``.partial`` after the table's name, is locked while it is open. InputError if it belongs to another
    sweep, by its `about`, or another process writes it; FormatError if it is not a journal, or damaged. Without a
    `table` the rows are in memory only.
    """

    def __init__(self, table, about):
        self.path = Path(f"{table}.partial")
        self.rows: dict[int, dict] = {}  # case → row
        self._stream: Any = None
        if not table:
            return
        self._stream = open(self.path, "a+b", buffering=0)  # unbuffered: a line is written by one call, or not at all
        try:
            fcntl.flock(self._stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._begin({"pinconsist sweep": FORMAT, "about": json.loads(json.dumps(about))})
        except BaseException as error:
            self._stream.close()
            if not isinstance(error, BlockingIOError):
                raise
            reason = "is being written by another sweep; wait until it ends, or stop it"
            raise InputError(f"{self.path} {reason}") from None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        if self._stream:
            self._stream.close()

    def add(self, case: int, row: dict) -> None:
        if self._stream:
            self._write([case, row])
        self.rows[case] = row

    def remove(self) -> None:
        self.path.unlink(missing_ok=True)

    def _write(self, values):
        line = json.dumps(values).encode() + b"\n"
        written = self._stream.write(line)
        if written != len(line):  # the next try raises the reason
            self._stream.write(line[written:])

    def _begin(self, header):
        self._stream.seek(0)
        *lines, torn = self._stream.read().split(b"\n")
        if not lines and not json.dumps(header).encode().startswith(torn):
            raise self._damaged(1)
        if torn:  # killed while it wrote
            self._stream.truncate(self._stream.tell() - len(torn))
        if not lines:
            self._write(header)
        for k, line in enumerate(lines, start=1):
            try:
                entry = json.loads(line)
            except ValueError:
                raise self._damaged(k) from None
            match entry:
                case {"pinconsist sweep": _, "about": dict()} if k == 1:
                    self._require_same(entry, header, len(lines) - 1)
                case [int(i), {"status": str(), "message": str()} as row] if (
                    k > 1 and 0 <= i < header["about"]["cases"]["count"]
                ):
                    self.rows[i] = row
                case _:
                    raise self._damaged(k)

    def _require_same(self, found, header, count):
        if found == header:
            return
        mine, other = header["about"], found["about"]
        different = [name for name in mine if mine[name] != other.get(name)] or ["its format"]
        raise InputError(
            f"{self.path} holds {count} cases of another sweep, which differs in {', '.join(different)}. Finish that "
            f"sweep with its own command, write this one elsewhere with --out, or delete {self.path.name} to restart"
        )

    def _damaged(self, line) -> FormatError:
        what = "not the journal of a sweep, or damaged; delete or move it to start again"
        return FormatError(what, path=self.path, element=f"line {line}")
