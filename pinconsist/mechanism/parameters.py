"""Parameters of a mechanism by name: numbers of its bodies, joints, loops, forces and gravity.

=======================  ===========================================================================================
``mass:NAME``            mass of a body, kg; its centre of mass, and its inertia about it, do not change. NAME is a body
                         or the joint that carries it; links that are fixed to each other are one body
``com:NAME[i]``          its centre of mass in the axes of the joint, m; i is 0, 1, 2
``inertia:NAME[ij]``     its inertia about the centre of mass in these axes, kg·m²; ij is xx, xy, yy, xz, yz, zz
``length:NAME``          of a loop or spring that has a length; otherwise the distance of a joint from its parent joint,
                         or of a frame from its joint, m; the direction does not change. It is a length of the body on
                         which the joint sits, not of the one that it carries
``stiffness:NAME``       of a spring or servo, by its label or joint
``damping:NAME``         of a spring, servo or joint
``friction:NAME``        of a joint
``anchor:LOOP.xyz2[0]``  a number of a loop; ``xyz1``, ``xyz2``, ``rpy1``, …
``gravity[2]``           m/s², along the axes 0, 1, 2; also ``gravity.z``
``NAME.NUMBER``          any number of a loop or force, named as in the scene file: ``gear.ratio``, ``motor.speed``
=======================  ===========================================================================================
"""

import re
from collections.abc import Callable, Mapping
from copy import copy
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from ..engine.systems import with_other_bodies
from ..errors import InputError
from .checks import near, number
from .forces import HeldTorque, JointDamping, JointFriction, bound_forces, model_forces
from .forces.actuators import Table
from .forces.force import ForceRecord
from .forces.held import HeldRecord
from .loops import GROUND, Loop
from .rows import rows_with_other_numbers

AXES = {name: i for i, axis in enumerate("xyz") for name in (f"gravity.{axis}", f"gravity[{i}]")}
OF_INERTIA = {"xx": (0, 0), "xy": (0, 1), "yy": (1, 1), "xz": (0, 2), "yz": (1, 2), "zz": (2, 2)}
OF_BODIES: dict[str, dict[str, list]] = {  # kind → index in the name → indices in mass, centre of mass or inertia
    "mass": {"": [()]},
    "com": {str(i): [i] for i in range(3)},
    "inertia": {index: [(i, j), (j, i)] for index, (i, j) in OF_INERTIA.items()},
}
_PLACES: WeakKeyDictionary[Any, dict] = WeakKeyDictionary()  # mechanism → the places of its records
OF_RECORDS = ("length", "stiffness", "damping", "friction")
OF_JOINTS = {"damping": JointDamping, "friction": JointFriction}


class UnknownParameterError(InputError):
    """A mechanism has no parameter of this name."""


@dataclass(frozen=True)
class Parameter:
    """A number of a mechanism: its value, and ``put(mechanism, value)``, which returns the mechanism with another one.

    If it changes neither loops nor lengths, ``part(value)`` describes the change: ``("inertia", joint, numbers)``, with
    mass, first moments and inertias about the joint as in Pinocchio's regressor; ``("gravity", numbers)``; ``("force",
    record)``; ``("nodes", record, path of the table, indices)`` for values of a table; or ``("held", label, rows and
    columns)`` for torques that are held. A parameter for several values of a table has an array as its value.
    """

    name: str
    value: Any
    put: Callable
    part: Callable | None = None
    place: tuple = ()


def with_parameters(mechanism, values: Mapping[str, float]):
    """See :meth:`Mechanism.with_parameters`."""
    if not isinstance(values, Mapping):
        raise InputError(f"with_parameters needs a mapping name → number, got {values!r}")
    changes = [(parameter(mechanism, name), number(value, name)) for name, value in values.items()]
    for found, value in changes:
        mechanism = found.put(mechanism, value)
    return mechanism


def _changed(mechanism, loop=None, **fields):
    """The mechanism with other numbers in a model, in a `loop` between anchors (its index) or in a force.

    These have been checked themselves, and all that depends on names and sizes is unchanged.
    """
    other = copy(mechanism)
    vars(other).update(fields)
    vars(other).pop("contact_elements", None)
    rows_with_other_numbers(mechanism, other, loop)
    if mechanism in _PLACES:
        _PLACES[other] = _PLACES[mechanism]
    return other


def parameter(mechanism, name: str) -> Parameter:
    """The parameter of this name; InputError if there is none."""
    if name in AXES:
        return _of_gravity(mechanism, name)
    kind, sign, whose = name.partition(":")
    if sign and kind in OF_BODIES:
        return _of_body(mechanism, name, kind, whose)
    if sign and kind in OF_RECORDS:
        found = _of_record(mechanism, name, kind, whose)
        return found or _of_tree(mechanism, name, kind, whose)
    path = whose if sign and kind == "anchor" else name
    for label, (place, i, record) in records_of(mechanism).items():
        if path.startswith(f"{label}."):
            number = re.sub(r"\[(\w+)\]", r".\1", path[len(label) + 1 :])  # xyz2[0] as xyz2.0
            return _number_of(name, label, place, i, record, path_of(record, label, number))
    raise unknown(mechanism, name)


def names_of(mechanism, kind: str) -> list[str]:
    """The names of all parameters of a kind: masses of bodies, lengths of joints, numbers of records, …"""
    model, joints = mechanism.model, list(enumerate(mechanism.joints, start=1))
    if kind == "mass":
        return [f"mass:{joint}" for i, joint in joints if model.inertias[i].mass > 0.0]
    if kind == "length":
        arms = [np.linalg.norm(pose.translation) for pose in model.jointPlacements]
        return [f"length:{joint}" for i, joint in joints if arms[i] > 1e-9]
    if kind in ("damping", "friction"):
        values = getattr(model, kind)
        return [f"{kind}:{joint}" for _, joint in joints if values[mechanism.columns(joint)].any()]
    if kind == "anchor":
        numbers = [(loop.name, path) for loop in mechanism.loops for path in numbers_of(loop)]
        return [f"anchor:{name}.{path[0]}[{path[1]}]" for name, path in numbers if path[0] in ("xyz1", "xyz2")]
    if kind == "gravity":
        return [f"gravity[{i}]" for i in range(3) if model.gravity.linear[i]]
    return [f"{label}.{'.'.join(path)}" for label, path in _numbers(mechanism) if path[-1] == kind]


def about_length(mechanism, name: str) -> str:
    """What the length of a joint is, ``crank to coupler``: that of its parent's body; empty for other parameters."""
    kind, _, joint = name.partition(":")
    if kind != "length" or joint in records_of(mechanism) or joint not in mechanism.joints:
        return ""
    parent = mechanism.model.parents[mechanism.joint_index(joint)]
    return f"{mechanism.model.names[parent] if parent else GROUND} to {joint}"


def _numbers(mechanism) -> list[tuple[str, tuple]]:
    """(name, path) of all numbers in loops and forces."""
    records = records_of(mechanism).items()
    return [(label, path) for label, (*_, record) in records for path in numbers_of(record)]


def _of_gravity(mechanism, name) -> Parameter:
    def changed(mechanism, value):
        return np.where(np.arange(3) == AXES[name], value, mechanism.model.gravity.linear)

    def put(mechanism, value):
        model = mechanism.model.copy()
        model.gravity.linear = changed(mechanism, value)
        with_other_bodies(model, mechanism.model, [])
        return _changed(mechanism, model=model)

    def part(value):
        return "gravity", changed(mechanism, value)

    return Parameter(name, float(mechanism.model.gravity.linear[AXES[name]]), put, part)


def _of_body(mechanism, name, kind, whose) -> Parameter:
    body, index = re.findall(r"^(.*?)(?:\[(\w+)\])?$", whose, re.DOTALL)[0]
    model = mechanism.model
    if body in mechanism.joints:
        joint = model.getJointId(body)
    elif model.existFrame(body) and model.frames[model.getFrameId(body)].parentJoint:
        joint = model.frames[model.getFrameId(body)].parentJoint
    else:
        raise unknown(mechanism, name, [f"{kind}:{joint}" for joint in mechanism.joints])
    if index not in (indices := OF_BODIES[kind]):
        raise InputError(f"{name!r}: needs {' or '.join(f'{kind}:{body}' + (f'[{i}]' if i else '') for i in indices)}")

    def parts(model):
        one = model.inertias[joint]
        return {"mass": np.array(one.mass), "com": one.lever.copy(), "inertia": one.inertia.copy()}

    def changed(model, value):
        found = parts(model)
        for place in indices[index]:
            found[kind][place] = value
        return float(found["mass"]), found["com"], found["inertia"]

    def put(mechanism, value):
        model = mechanism.model.copy()
        try:
            model.inertias[joint] = pin.Inertia(*changed(model, value))
        except RuntimeError as error:
            raise InputError(f"{name} cannot be {value:g}: {error}") from error
        if model.inertias[joint].mass < 0.0:
            raise InputError(f"the body at joint {model.names[joint]!r} has negative mass {value:g} kg")
        with_other_bodies(model, mechanism.model, [joint])
        return _changed(mechanism, model=model)

    def part(value):
        mass, lever, inertia = changed(model, value)
        about = inertia + mass * (lever @ lever * np.eye(3) - np.outer(lever, lever))  # the joint
        return "inertia", joint, np.array([mass, *(mass * lever), *(about[i] for i in OF_INERTIA.values())])

    value = float(parts(model)[kind][indices[index][0]])
    return Parameter(name, value, put, part, ("body", joint, kind, indices[index]))


def _of_record(mechanism, name, kind, whose) -> Parameter | None:
    """The number `kind` of a loop or force, found by its label or its joint; None if there is none."""
    for label, (place, i, record) in records_of(mechanism).items():
        of_joints = kind in OF_JOINTS and isinstance(record, OF_JOINTS[kind])
        if of_joints and _is_number(part_at(record, ("coefficients", whose))):
            found = _number_of(name, label, place, i, record, ("coefficients", whose))
            return replace(found, part=_coefficient_of(record, whose))
        named = whose in (label, label.partition(" ")[2], getattr(record, "joint", label))
        undamped = kind in OF_JOINTS and whose in mechanism.joints and not part_at(record, (kind,))
        if named and not undamped and _is_number(part_at(record, (kind,))):
            return _number_of(name, label, place, i, record, (kind,))
    return None


def _coefficient_of(record, joint) -> Callable:
    """The part of a coefficient of one joint in a force of several, which may act on it alone."""
    return lambda value: ("force", replace(record, coefficients={joint: value}))


def _of_tree(mechanism, name, kind, whose) -> Parameter:
    """Damping and friction of the model's joints, and distances of joints and frames."""
    model = mechanism.model
    if kind in ("damping", "friction") and whose in mechanism.joints:
        columns = mechanism.columns(whose)

        def put_coefficient(mechanism, value):
            model = mechanism.model.copy()
            getattr(model, kind)[columns] = number(value, name, least=0.0)
            with_other_bodies(model, mechanism.model, [])
            other = _changed(mechanism, model=model)
            _PLACES.pop(other, None)  # the model may have one more force, or one less
            return other

        def part(value):
            return "force", OF_JOINTS[kind]({whose: value})

        return Parameter(name, float(getattr(model, kind)[columns][0]), put_coefficient, part, ("joint", kind, columns))
    if kind != "length" or not (whose in mechanism.joints or model.existFrame(whose)):
        raise unknown(mechanism, name)
    of_joint = whose in mechanism.joints
    i = model.getJointId(whose) if of_joint else model.getFrameId(whose)

    def pose(model):
        return model.jointPlacements[i] if of_joint else model.frames[i].placement

    arm = pose(model).translation.copy()
    size = float(np.linalg.norm(arm))
    if size == 0.0:
        raise InputError(
            f"{name!r}, the distance of {whose!r} from its parent, is zero, so that it has no direction"
            f"{_lengths_of_body(mechanism, whose)}"
        )

    def put_length(mechanism, value):
        model = mechanism.model.copy()
        pose(model).translation = value * (arm / size)
        return replace(mechanism, model=model)

    return Parameter(name, size, put_length)


def _lengths_of_body(mechanism, joint) -> str:
    """Where the lengths of the body that a joint carries are: at the joints and anchors on it."""
    if joint not in mechanism.joints:
        return ""
    model, i = mechanism.model, mechanism.joint_index(joint)
    lengths = names_of(mechanism, "length")
    found = [name for name in lengths if model.parents[model.getJointId(name.partition(":")[2])] == i]
    for loop in mechanism.loops:
        for end, anchor in (("xyz1", getattr(loop, "frame1", "")), ("xyz2", getattr(loop, "frame2", ""))):
            if anchor and model.existFrame(anchor) and model.frames[model.getFrameId(anchor)].parentJoint == i:
                found.append(f"anchor:{loop.name}.{end}[0]")
    return f"; the lengths of the body that it carries are {', '.join(found)}" if found else ""


def _number_of(name, label, place, i, record, path) -> Parameter:
    """The number at a path in the record with index `i` among a mechanism's loops or forces."""

    def put(mechanism, value):
        records = list(getattr(mechanism, place))
        records[i] = with_number(records[i], path, value)
        if isinstance(records[i], Loop):
            return _changed(mechanism, i, loops=tuple(records))
        if isinstance(records[i], ForceRecord):
            return _changed(mechanism, forces=tuple(records))
        return replace(mechanism, **{place: records})

    part = _part_of(label, place, record, path)
    return Parameter(name, float(part_at(record, path)), put, part, (place, label, path))


def _part_of(label, place, record, path) -> Callable | None:
    """:attr:`Parameter.part` of the number at a path in a record; None where its derivative is not known."""
    if isinstance(part_at(record, path[:-2]), Table) and path[-2] == "values":
        return lambda value: ("nodes", record, path[:-2], [int(path[-1])])
    if isinstance(record, HeldTorque) and path[0] == "torques":
        node = int(path[1]), int(path[2]) if len(path) > 2 else 0
        return lambda value: ("held", label, [node])
    if place == "forces" and isinstance(record, ForceRecord) and not isinstance(record, HeldRecord):
        return lambda value: ("force", with_number(record, path, value))
    return None


def records_of(mechanism) -> dict:
    """Name → ("loops", "forces" or "contacts", index among them, record) of all of them, the longest names first."""
    places = _PLACES.get(mechanism)
    if places is None:
        places = _PLACES[mechanism] = _places_of_records(mechanism)
    return {label: (place, i, getattr(mechanism, place)[i]) for label, (place, i) in places.items()}


def _places_of_records(mechanism) -> dict:
    """The same without the records."""
    own = len(model_forces(mechanism.model))
    labels = list(bound_forces(mechanism.model, mechanism.forces))[own:]
    found = {label: ("forces", i) for i, label in enumerate(labels)}
    found |= {loop.name: ("loops", i) for i, loop in enumerate(mechanism.loops)}
    found |= {each.name: ("contacts", i) for i, each in enumerate(mechanism.contacts)}
    return dict(sorted(found.items(), key=lambda item: -len(item[0])))


def unknown(mechanism, name, also=(), listed="") -> UnknownParameterError:
    """The error for an unknown name: lists similar names, including those of `also`, all kinds, and `listed`."""
    records = records_of(mechanism)
    known = [*also, *AXES]
    for kind in ("mass", *OF_RECORDS):
        known += names_of(mechanism, kind)
    known += [f"{label}.{path[-1]}" for label, path in _numbers(mechanism)]
    joints, named = (", ".join([*names][:12]) + ", …" * (len(names) > 12) for names in (mechanism.joints, records))
    return UnknownParameterError(
        f"{mechanism.name} has no parameter {name!r}{near(name, known)}. Its parameters are mass:, com:, inertia:, "
        f"length:, damping: and friction: of the joints {joints} and their bodies, anchor:LOOP.xyz1[0], the numbers of "
        f"{named or 'no loop or force'} (NAME.NUMBER), gravity[0], gravity[1], gravity[2]{listed}"
    )


def path_of(record, label, name) -> tuple:
    """The path to the number with this name in a record; its last word is enough if it is unique."""
    numbers = numbers_of(record)
    found = [path for path in numbers if ".".join(path) == name] or [path for path in numbers if path[-1] == name]
    if len(found) == 1:
        return found[0]
    listed = [".".join(path) for path in found or numbers]
    there = (", ".join(listed[:12]) + ", …" * (len(listed) > 12)) or "none"
    raise InputError(f"{label!r} has {'several numbers' if found else 'no number'} {name!r}; it has {there}")


def numbers_of(record) -> list[tuple]:
    """The paths to all numbers in a record and its parts."""
    if _is_number(record):
        return [()]
    return [(name, *path) for name, part in _parts(record).items() for path in numbers_of(part)]


def with_number(record, path, value):
    """The record with another number at a path."""
    if not path:
        return value
    name, *rest = path
    changed = with_number(_parts(record).get(name), rest, value)
    if isinstance(record, tuple):
        return (*record[: int(name)], changed, *record[int(name) + 1 :])
    if isinstance(record, np.ndarray):
        table = record.copy()
        table[int(name)] = changed
        return table
    return replace(record, **{name: changed}) if is_dataclass(record) else {**record, name: changed}


def _is_number(record) -> bool:
    return isinstance(record, float | int) and not isinstance(record, bool)


def part_at(record, path):
    """The part at a path, or None."""
    for name in path:
        record = _parts(record).get(name)
    return record


def _parts(record) -> dict:
    """The parts of a tuple, a mapping, a table or a record, by name."""
    if isinstance(record, np.ndarray) and record.ndim == 2 and record.shape[1] == 1:
        record = record[:, 0]
    if isinstance(record, tuple | np.ndarray):
        return {str(i): part for i, part in enumerate(record)}
    if not is_dataclass(record):
        return dict(record) if isinstance(record, Mapping) else {}
    parts = {each.name: (getattr(record, each.name), each.type) for each in fields(record)}
    return {name: 0.0 if part is None and kind == "float | None" else part for name, (part, kind) in parts.items()}
