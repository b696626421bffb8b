"""Loop files: YAML files with the loops of a tree, in several conventions.

The project's own convention has ``loops``, ``forces`` and ``contacts``, which are lists of records
(:mod:`pinconsist.formats.records`), ``description``, ``guess``, ``actuated`` (the motorised joints; ``name_mot`` is
accepted, too), ``duration`` (how long commands simulate by default, s; 5 if it is missing), and ``joints``,
``gravity`` and ``joint_order`` (:mod:`pinconsist.formats.joints`). The other convention is the ``robot.yaml`` of the
example-parallel-robots collection: ``closed_loop`` (pairs of frames), ``type`` (3d or 6d), ``name_mot``,
``joint_name`` and ``joint_type``. The lists of loops of other exporters are read by :mod:`.loop_lists`.
"""

import os
import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pinocchio as pin
import yaml

from ..errors import FormatError, warn
from ..mechanism.joint_constraints import Coupling, Drive
from ..mechanism.loops import Loop
from ..mechanism.mechanism import Mechanism
from ..mechanism.rows import LoopRows
from . import loop_lists
from .closures import closed
from .joints import check_type, in_order, joint_settings, new_names, with_values
from .reading import finite, located, near, read_bytes, require_known, short_repr
from .records import (
    amount,
    contact_record,
    force_element,
    force_record,
    items,
    known_keys,
    loop_element,
    loop_record,
    name,
    numbers,
)

MAX_BYTES = 1_000_000
MAX_VALUE = 10_000  # characters: the time to parse 1:1:1:..., a number in base 60, grows with their square
MAX_MERGED = 1000
_OWN_KEYS = (
    "description",
    "loops",
    "forces",
    "contacts",
    "guess",
    "actuated",
    "duration",
    "joints",
    "gravity",
    "joint_order",
)
_ROBOT_KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type")
_KEY = rf"(?:^|[{{,]\s*)[\"']?(loops|forces|closed_loop|(?:{'|'.join(loop_lists.KEYS)})(?![\"']?\s*:\s*\[\]))[\"']?\s*:"
_LOOP_KEY = re.compile(_KEY.encode(), re.MULTILINE)
LISTS = ("loop_closures", "robot_data")  # names of files in which exporters list loops
_SUBFOLDERS = ("urdf", "sdf", "xml", "mjcf")  # of a robot's folder, with the files of its tree
_ROBOTS = (".urdf", ".sdf", ".xml", ".mjcf")
_KINDS = {"3d": "point", "6d": "frame"}


@dataclass(frozen=True)
class LoopFile:
    """The content of a loop file."""

    loops: tuple[Loop | Coupling | Drive, ...] = ()
    forces: tuple = ()  # records of :mod:`pinconsist.mechanism.forces`
    contacts: tuple = ()  # records of :mod:`pinconsist.mechanism.contacts`
    actuated: tuple[str, ...] = ()  # motorised joints, by their names after replacement
    guess: dict = field(default_factory=dict)  # joint → one or several values, the initial guess of the assembly
    joint_types: dict[str, str] = field(default_factory=dict)  # see `joints.joint_settings`
    joint_values: dict[str, dict] = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None  # m/s², in world axes
    joint_order: tuple[str, ...] = ()  # all joints, or none
    description: str = ""  # one line for lists of models
    duration: float = Mechanism.duration  # simulated by default, s
    ignored: tuple[str, ...] = ()  # what has no effect, counted

    def applied(self, model: pin.Model) -> pin.Model:
        """The model with this file's joint order, joint values and gravity; may modify and return `model` itself."""
        model = with_values(in_order(model, self.joint_order), self.joint_values)
        if self.gravity is not None:
            model.gravity.linear = np.array(self.gravity)
        return model

    def check(self, model) -> None:
        """Raise FormatError for frames and joints that the model lacks, or that do not fit their record."""
        for number, loop in enumerate(closed(model, self.loops), start=1):
            prefix = f"{'loop' if isinstance(loop, Loop) else loop.kind} {loop.name!r}: "
            with located(element=loop_element(number, loop.name), prefix=prefix):
                LoopRows(model, [loop])
        for number, force in enumerate(self.forces, start=1):
            with located(element=force_element(number, force)):
                force.bind(model)
        for number, contact in enumerate(self.contacts, start=1):
            with located(element=f"contact {number} ({contact.kind})", prefix=f"{contact.kind} {contact.name!r}: "):
                contact.elements(model, self.loops)
        for element, named in (("guess", self.guess), ("actuated joints", self.actuated)):
            for joint in named:
                require_known(joint, tuple(model.names)[1:], f"the model has no joint {joint!r}", element)


def find_loop_file(path: Path) -> Path | None:
    """``<stem>.yaml`` or ``.yml`` next to a file, else ``robot.yaml`` or ``.yml`` there, else None.

    Else ``loop_closures.yaml`` or ``robot_data.yaml`` with loops, there, in the folder above that of the URDF, or in
    the folder ``config`` of one of these.
    """
    plain = path.with_name(path.name.removesuffix(".xacro")) if path.suffix == ".xacro" else path
    stems = (plain, path.with_name("robot.urdf"))
    candidates = (stem.with_suffix(suffix) for stem in stems for suffix in (".yaml", ".yml"))
    found = next((each for each in candidates if os.path.isfile(each)), None)
    if found is not None:
        return found
    above = (path.parent.parent,) if path.parent.name in _SUBFOLDERS else ()
    folders = [inner for folder in (path.parent, *above) for inner in (folder, folder / "config")]
    lists = (folder / f"{name}{suffix}" for folder in folders for name in LISTS for suffix in (".yaml", ".yml"))
    return next((each for each in lists if os.path.isfile(each) and _describes_loops(each) in loop_lists.KEYS), None)


def warn_of_other_files(path: Path) -> None:
    """Warn of YAML files beside a robot's file that describe loops and are not read: one of them may be meant.

    Those of the robots beside it (``other.urdf`` and ``other.yaml``) are not.
    """
    folders = (path.parent, path.parent.parent) if path.parent.name in _SUBFOLDERS else (path.parent,)
    files = (each for folder in folders for suffix in ("yaml", "yml") for each in sorted(folder.glob(f"*.{suffix}")))
    for file in files:
        key = _describes_loops(file)
        others = file.stem != path.stem and any(file.with_suffix(suffix).exists() for suffix in _ROBOTS)
        if not key or others:
            continue
        advice = f'if it belongs to the robot, pass it as loops="{file}"'
        warn(f"{path}: {file.name} next to it describes loops and is not read; {advice}")


def _describes_loops(file: Path) -> str:
    """The key of a YAML file that has loops, forces or joints that close loops; empty for other files."""
    try:
        with file.open("rb") as opened:
            found = _LOOP_KEY.search(opened.read(MAX_BYTES))
    except OSError:
        return ""
    return found[1].decode() if found else ""


def with_distinct_frames(records, model):
    """A copy of the model in which the joint's frame is renamed if a link has the same name and the same placement.

    Exported files often have such names. If the placements differ, both names are kept, and :meth:`LoopFile.check`
    refuses them.
    """
    used = {getattr(each, field, None) for each in records for field in ("frame", "frame1", "frame2", "on")}
    names, model = [frame.name for frame in model.frames], model.copy()
    for twice in (each for each in sorted(set(names) & used) if names.count(each) == 2):
        first, second = (frame for frame in model.frames if frame.name == twice)
        if first.parentJoint == second.parentJoint and first.placement.isApprox(second.placement):
            own = f"{twice}_joint"
            while own in names:
                own += "_"
            names.append(own)
            joints = (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
            (first if first.type in joints else second).name = own
    return model


def read(path) -> LoopFile:
    """Read a loop file in either convention; FormatError names the invalid record."""
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    with located(path):
        record = parsed_yaml(content)
        if not isinstance(record, dict) or not all(isinstance(key, str) for key in record):
            raise FormatError(f"this is not a loop file, which has keys such as {', '.join(_OWN_KEYS)}")
        if set(record) & set(loop_lists.KEYS) and not set(record) & {"loops", "closed_loop"}:
            return _listed(record, path)
        theirs = set(record) & set(_ROBOT_KEYS)
        own = theirs <= {"name_mot"} and set(record) & set(_OWN_KEYS)
        return _own(record) if own or not theirs else _robot(record, path)


class _PlainLoader(yaml.SafeLoader):
    """Plain data only: no tags, no aliases (a few lines can expand to gigabytes), no repeated keys."""

    aliases = False

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent) and not self.aliases:
            _refuse("aliases (*name) are not supported", self.peek_event())
        return super().compose_node(parent, index)

    def construct_scalar(self, node):
        value = super().construct_scalar(node)
        if len(value) > MAX_VALUE:
            _refuse(f"a value has {len(value)} characters", node)
        return value

    def construct_mapping(self, node, deep=False):
        seen = set()
        pairs = node.value if isinstance(node, yaml.MappingNode) else ()
        for key in (key for key, _ in pairs if isinstance(key, yaml.ScalarNode)):
            if key.value in seen:
                _refuse(f"the key {key.value!r} is given twice", key)
            seen.add(key.value)
        return super().construct_mapping(node, deep)


def _refuse(problem, where):
    raise yaml.MarkedYAMLError(problem=problem, problem_mark=where.start_mark)


class _AliasLoader(_PlainLoader):
    """With aliases, for readers that count what they expand to, and a few keys that mappings merge (``<<``)."""

    aliases = True

    def flatten_mapping(self, node):
        merged = [value for key, value in node.value if key.tag == "tag:yaml.org,2002:merge"]
        parts = [part for each in merged for part in (each.value if isinstance(each, yaml.SequenceNode) else [each])]
        for part in parts:  # each once, as this removes its own merged keys
            if isinstance(part, yaml.MappingNode):
                self.flatten_mapping(part)
        if sum(len(part.value) for part in parts) > MAX_MERGED:
            _refuse(f"more than {MAX_MERGED} keys are merged", node)
        super().flatten_mapping(node)


class _TagLoader(_AliasLoader):
    """With tags of mappings, such as ``!Rpy``, under the empty key."""


_TagLoader.add_multi_constructor("!", lambda loader, tag, node: {**loader.construct_mapping(node, deep=True), "": tag})


def parsed_yaml(content, aliases=False, tags=False):
    """The plain data of a YAML file; FormatError with the line."""
    try:
        if tags:
            return yaml.load(content, Loader=_TagLoader)
        if aliases:
            return yaml.load(content, Loader=_AliasLoader)
        return yaml.load(content, Loader=_PlainLoader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise FormatError(f"not usable YAML: {error.problem}", element=line) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # encodings, impossible dates, deep nesting
        raise FormatError(f"not usable YAML: {str(error).splitlines()[0]}") from error


def _own(record):
    known_keys(record, (*_OWN_KEYS, "name_mot"), "")
    loops = []
    for number, entry in enumerate(items(record, "loops"), start=1):
        loop = loop_record(number, entry)
        if loop.name in (other.name for other in loops):
            raise FormatError("another loop has this name", element=loop_element(number, loop.name))
        loops.append(loop)
    forces = tuple(force_record(number, entry) for number, entry in enumerate(items(record, "forces"), start=1))
    contacts = tuple(contact_record(number, entry) for number, entry in enumerate(items(record, "contacts"), start=1))
    guess = record.get("guess") or {}
    if not isinstance(guess, dict):
        raise FormatError("it must map joint names to values", element="guess")
    description = record.get("description", "")
    if not isinstance(description, str):
        raise FormatError(f"a line of text is needed, not {short_repr(description)}", element="description")
    duration = finite(given := record.get("duration", Mechanism.duration))
    if duration is None or not duration > 0:
        raise FormatError(f"a positive number of seconds is needed, not {short_repr(given)}", element="duration")
    guess = {joint: amount(value, f"guess: {joint}") for joint, value in guess.items()}
    gravity = None if record.get("gravity") is None else numbers(record["gravity"], "gravity", count=3)
    actuated = tuple(dict.fromkeys((*_names(record, "actuated"), *_names(record, "name_mot"))))
    settings = (*joint_settings(record), gravity, _names(record, "joint_order"))
    return LoopFile(tuple(loops), forces, contacts, actuated, guess, *settings, description, duration)


def _robot(record, path):
    for key in set(record) - set(_ROBOT_KEYS):
        if key in _OWN_KEYS:
            raise FormatError(f"the key {key!r} cannot be combined with those of robot.yaml ({', '.join(_ROBOT_KEYS)})")
        warn(f"{path}: the key {key!r} is not known and has no effect{near(key, _ROBOT_KEYS)}")
    pairs, kinds = items(record, "closed_loop"), items(record, "type")
    if kinds and len(kinds) != len(pairs):
        raise FormatError(f"{len(kinds)} types for {len(pairs)} loops", element="type")
    loops = []
    for number, pair in enumerate(pairs, start=1):
        if not isinstance(pair, list) or len(pair) != 2:
            raise FormatError(f"a pair of frame names is needed, not {short_repr(pair)}", element=loop_element(number))
        frames = [name(frame, loop_element(number)) for frame in pair]
        title = _pair_name(*frames, [loop.name for loop in loops])
        kind = str(kinds[number - 1]).lower() if kinds else "6d"
        if kind not in _KINDS:
            raise FormatError(f"the type {short_repr(kind)} is neither 3d nor 6d", element=loop_element(number, title))
        loops.append(Loop(title, _KINDS[kind], *frames))
    joints, types = _names(record, "joint_name"), items(record, "joint_type")
    if len(joints) != len(types) or len(set(joints)) != len(joints):
        raise FormatError(f"{len(types)} types for {len(set(joints))} different joints", element="joint_type")
    joint_types = {joint: check_type(kind) for joint, kind in zip(joints, types, strict=True)}
    actuated = [new for motor in _names(record, "name_mot") for new in new_names(motor, joint_types.get(motor, ""))]
    return LoopFile(tuple(loops), actuated=tuple(actuated), joint_types=joint_types)


def _listed(record, path):
    """The content of a list of loops of an exporter; robot_data.yaml has much that says nothing about loops."""
    if "closing_joints" not in record:
        for key in set(record) - set(loop_lists.LOOP_CLOSURES):
            warn(f"{path}: the key {key!r} is not known and has no effect{near(key, loop_lists.LOOP_CLOSURES)}")
    loops, actuated, types, ignored = loop_lists.read(record)
    return LoopFile(loops, actuated=actuated, joint_types=types, ignored=ignored)


def _pair_name(frame1, frame2, taken):
    """'knee_A', 'knee_B' → 'knee'; or 'a-b' if more than the last characters differ, or 'knee' is taken."""
    short = frame1[:-1].rstrip("_-. ") if frame1[:-1] == frame2[:-1] else ""
    title = short if short and short not in taken else f"{frame1}-{frame2}"
    return title if title not in taken else f"{title} ({len(taken) + 1})"


def _names(record, key):
    return tuple(name(value, key) for value in items(record, key))
