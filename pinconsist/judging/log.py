"""A log of a simulator or of a robot: a CSV file with positions, velocities, commands and loop forces by name.

Columns may be in any order, each with a unit: ``t [s]``, ``q.crank [deg]``, ``v.crank [rad/s]``, ``command.knee``,
``torque.crank [N·m]``, ``force.pin.x [N]``. These are the headings of :meth:`Solution.to_csv`. Positions may also be
named by the joint alone. The positions of joints that are not in the file are determined by the loops.
"""

from __future__ import annotations

import csv
import re
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from ..errors import AssemblyError, FormatError, InputError
from ..files import as_path
from ..mechanism.assembly import assemble
from ..mechanism.checks import near, places
from ..mechanism.forces import Actuator, HeldTorque
from ..mechanism.lie import difference
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import position_names, velocity_names

UNIT = re.compile(r"(.*?)\s*\[([^\]]*)\]", re.DOTALL)
UNITS = {"": 1.0, "s": 1.0, "ms": 1e-3, "rad": 1.0, "deg": np.pi / 180, "m": 1.0, "mm": 1e-3, "cm": 1e-2, "N": 1.0}
UNITS |= {"kN": 1e3, "N·m": 1.0, "Nm": 1.0, "N*m": 1.0, "rad/s": 1.0, "deg/s": np.pi / 180, "m/s": 1.0, "mm/s": 1e-3}
TIMES = ("t", "time")
PARTS = ("q", "v", "command", "torque", "force")
IGNORED = ("a", "lam", "moment", "length", "speed")  # of tables of this package
MAX_ROWS = 1000  # rows that are judged
ALIGNED = 0.5  # forces agree with others signs or axes, if their error is this part of that with ours


@dataclass(frozen=True)
class Log:
    """A log: times (n,), q (n, nq), v (n, nv), and by loop the forces on its body 2 in world axes, (n, 3).

    ``mechanism`` has the commands and torques of the log. ``notes`` are what was derived, assumed or left out.
    """

    mechanism: Mechanism
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    forces: dict
    notes: tuple[str, ...]


def read_log(mechanism, file) -> Log:
    """Read a log of a mechanism. FormatError for a file that is none, InputError for names that it does not have."""
    columns = columns_of(file)
    time = next((columns[name] for name in TIMES if name in columns), None)
    if time is None:
        raise FormatError(f"there is no column of times; it is called {' or '.join(TIMES)}", path=file)
    if len(time) < 3 or not (np.diff(time) > 0.0).all():
        raise FormatError("a log needs at least three rows, at increasing times", path=file)
    sorted_by = {part: {} for part in PARTS}
    positions, notes = position_names(mechanism.model), []
    for name, values in columns.items():
        part, _, rest = name.partition(".")
        if name in positions or name in mechanism.joints:
            sorted_by["q"][name] = values
        elif part in PARTS and rest:
            sorted_by[part][rest] = values
        elif name not in TIMES and part not in IGNORED:
            notes.append(f"column {name!r} is neither a joint nor one of {', '.join(f'{p}.NAME' for p in PARTS)}")
    commanded = _commanded(mechanism, time, sorted_by, file)
    q, missing = _positions(mechanism, sorted_by["q"], file)
    v, derived = _velocities(mechanism, time, sorted_by["v"], q if not missing else None, file)
    forces = _forces(mechanism, sorted_by["force"], file)
    rows = np.unique(np.linspace(0, len(time) - 1, min(len(time), MAX_ROWS)).astype(int))
    if len(rows) < len(time):
        notes.append(f"{len(rows)} of {len(time)} rows are judged")
    if missing:
        q = _completed(mechanism, q[rows], missing, time[rows])
        v = _derived(mechanism, time[rows], q) if derived else v[rows]
        notes.append(
            f"positions of {', '.join(missing)} are not in the log; they follow from the loops, so that gaps do"
        )
        notes[-1] += " not show"
    else:
        q, v = q[rows], v[rows]
    if derived:
        notes.append("velocities are not in the log; they are derivatives of splines through its positions")
    forces = {name: values[rows] for name, values in forces.items()}
    return Log(commanded, time[rows], q, v, forces, tuple(notes))


def columns_of(file) -> dict[str, np.ndarray]:
    """The columns of a CSV file in SI units, by their names without units."""
    try:
        with open(as_path(file), newline="", encoding="utf-8-sig") as stream:
            heads, *lines = [line for line in csv.reader(stream) if line]
    except (OSError, UnicodeDecodeError) as error:
        raise FormatError(f"it cannot be read: {getattr(error, 'strerror', None) or error}", path=file) from error
    except ValueError:
        raise FormatError("it is empty", path=file) from None
    found = {}
    for k, head in enumerate(heads):
        name, unit = _heading(head.strip())
        if unit not in UNITS and not unit.endswith("/s²"):
            reason = f"unknown unit {unit!r}; known are {', '.join(filter(None, UNITS))}"
            raise FormatError(reason, path=file, element=f"column {head!r}")
        try:
            values = np.array([float(line[k]) for line in lines])
        except (ValueError, IndexError):
            raise FormatError("not a number in every row", path=file, element=f"column {head!r}") from None
        if not np.isfinite(values).all():
            raise FormatError("a number is not finite", path=file, element=f"column {head!r}")
        found[name] = UNITS.get(unit, 1.0) * values
    return found


def _heading(head) -> tuple[str, str]:
    """The name and the unit of a column; ``ball[0]`` is a name."""
    match = UNIT.fullmatch(head)
    unit = match[2].partition(";")[0].strip() if match else ""
    return (head, "") if match is None or unit.isdigit() else (match[1], unit)


def _commanded(mechanism, time, sorted_by, file):
    """The mechanism with the commands of the log, linear between its rows, and its torques, held from row to row."""
    names = [force.name for force in mechanism.forces if isinstance(force, Actuator)]
    for name in sorted_by["command"]:
        if name not in names and name not in mechanism.joints:
            reason = f"{mechanism.name} has no actuator {name!r}{near(name, names)}"
            raise FormatError(
                f"{reason}; available: {', '.join(names) or 'none'}", path=file, element=f"command.{name}"
            )
    if sorted_by["command"]:
        tables = {name: (time, values) for name, values in sorted_by["command"].items()}
        mechanism = mechanism.with_control(tables)
    torques = {name: values for name, values in sorted_by["torque"].items() if name in mechanism.joints}
    unknown = sorted_by["torque"].keys() - torques.keys()
    if unknown:
        name = min(unknown)
        raise FormatError(f"{mechanism.name} has no joint {name!r}", path=file, element=f"torque.{name}")
    if torques:
        table = HeldTorque(time, np.column_stack([*torques.values()]), joints=list(torques))
        mechanism = mechanism.add_forces(table)
    return mechanism


def _positions(mechanism, given, file):
    """q (n, nq) of the log, and the joints that it does not have."""
    model, names = mechanism.model, position_names(mechanism.model)
    for name in given:
        if name not in names and name not in mechanism.joints:
            reason = f"{mechanism.name} has no joint {name!r}{near(name, names)}"
            raise FormatError(reason, path=file, element=f"q.{name}")
    if not given:
        raise FormatError(f"it has no position of any joint of {mechanism.name}: {', '.join(names)}", path=file)
    n = len(next(iter(given.values())))
    q, missing = np.tile(mechanism.guess, (n, 1)), []
    for i, joint in enumerate(mechanism.joints, start=1):
        part = places(model, i)[0]
        own = names[part]
        if joint in given and len(own) == 2 and model.nvs[i] == 1:
            q[:, part] = np.column_stack((np.cos(given[joint]), np.sin(given[joint])))
        elif all(name in given for name in own):
            q[:, part] = np.column_stack([given[name] for name in own])
        else:
            missing.append(joint)
    return np.array([pin.normalize(model, row) for row in q]), missing


def _velocities(mechanism, time, given, q, file):
    """v (n, nv), and whether it was derived from positions."""
    names = velocity_names(mechanism.model)
    for name in given:
        if name not in names:
            raise FormatError(
                f"{mechanism.name} has no joint {name!r}{near(name, names)}", path=file, element=f"v.{name}"
            )
    if all(name in given for name in names):
        return np.column_stack([given[name] for name in names]), False
    return (None if q is None else _derived(mechanism, time, q)), True


def _derived(mechanism, time, q):
    """Velocities of a cubic spline through positions, in the chart at each row."""
    from scipy.interpolate import CubicSpline

    model, n = mechanism.model, len(time)
    if model.nq == model.nv:
        return CubicSpline(time, q)(time, 1)
    v = np.empty((n, model.nv))
    for i in range(n):
        near_by = slice(max(0, min(i - 2, n - 5)), max(0, min(i - 2, n - 5)) + 5)
        chart = np.array([difference(model, q[i], each) for each in q[near_by]])
        v[i] = CubicSpline(time[near_by], chart)(time[i], 1)
    return v


def _completed(mechanism, q, missing, time):
    """The configurations with the missing joints where the loops put them, each close to the one before."""
    model, known = mechanism.model, [joint for joint in mechanism.joints if joint not in missing]
    closed, base = np.array(q), mechanism
    for i, row in enumerate(q):
        named = {joint: row[places(model, mechanism.joint_index(joint))[0]] for joint in known}
        try:
            closed[i] = assemble(base, named, t=time[i]).q
        except AssemblyError as error:
            reason = f"the loops of {mechanism.name} do not close at t = {time[i]:g} s with the positions of the log"
            raise InputError(f"{reason}: {error}") from error
        base = replace(mechanism, guess=closed[i])
    return closed


def _forces(mechanism, given, file) -> dict:
    loops = [loop.name for loop in mechanism.anchored_loops]
    found: dict[str, dict] = {}
    for name, values in given.items():
        loop, _, axis = name.rpartition(".")
        if loop not in loops or axis not in "xyz":
            if name in loops or loop in mechanism.joints or name in mechanism.joints:
                continue  # the tension of an element, or what a joint of the tree transmits
            reason = f"force.LOOP.x, .y and .z are forces on body 2 of a loop of {mechanism.name}: {', '.join(loops)}"
            raise FormatError(f"{reason}{near(loop, loops)}", path=file, element=f"force.{name}")
        found.setdefault(loop, {})[axis] = values
    for loop, parts in found.items():
        if parts.keys() != set("xyz"):
            raise FormatError("a force needs its x, y and z", path=file, element=f"force.{loop}")
    return {loop: np.column_stack([parts[axis] for axis in "xyz"]) for loop, parts in found.items()}


def aligned(mechanism, name, forces, exact, q):
    """Forces of a loop in our sign and axes, and what was changed in words; compared with the `exact` ones (n, 3)."""
    loop = next(each for each in mechanism.anchored_loops if each.name == name)
    frame = mechanism.model.frames[mechanism.model.getFrameId(loop.frame1)]
    data, turned = mechanism.model.createData(), np.empty_like(forces)
    for i, row in enumerate(q):
        pin.forwardKinematics(mechanism.model, data, row)
        anchor = data.oMi[frame.parentJoint] * frame.placement * loop.placement1
        turned[i] = anchor.rotation @ forces[i]
    choices = {
        "": forces,
        f"the forces of {name} have the opposite sign, as if on body 1": -forces,
        f"the forces of {name} are in the axes of its anchor 1": turned,
        f"the forces of {name} are in the axes of its anchor 1, with the opposite sign": -turned,
    }
    known = np.isfinite(exact).all(axis=1)
    off = {what: float(np.linalg.norm((each - exact)[known])) for what, each in choices.items()}
    best = min(off, key=lambda what: off[what])
    best = best if off[best] < ALIGNED * off[""] else ""
    return choices[best], best
