"""Loop files: what closes a tree, in YAML, in two conventions.

The project's own has ``loops`` and ``forces``, lists of records (:mod:`pinconsist.formats.loop_records`,
:mod:`pinconsist.formats.force_records`), ``description``, ``guess``, ``actuated``, ``duration`` (for how long commands
simulate that are not told otherwise, s; 5 where it is not said), and what :mod:`pinconsist.formats.model_settings`
reads. The other is the ``robot.yaml`` of the example-parallel-robots collection: ``closed_loop`` (pairs of frames),
``type`` (3d or 6d), ``name_mot``, ``joint_name`` and ``joint_type``.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field
from pathlib import Path

import pinocchio as pin
import yaml

from ..errors import FormatError, InputError
from ..mechanism.constraints.coupling import Coupling
from ..mechanism.constraints.drive import Drive
from ..mechanism.constraints.loops import Loop
from ..mechanism.mechanism import Mechanism
from .force_records import force_element, force_record
from .joints import check_type, new_names
from .loop_records import loop_element, loop_record
from .model_settings import KEYS as SETTINGS
from .model_settings import ModelSettings, model_settings
from .reading import finite, near, read_bytes, shown
from .records import known_keys, name, number_or_numbers

MAX_BYTES = 1_000_000
MAX_VALUE = 10_000  # characters; the time that 1:1:1:... takes, a number to base 60, grows with their square
_OWN_KEYS = ("description", "loops", "forces", "guess", "actuated", "duration", *SETTINGS)
_ROBOT_KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type")
_KINDS = {"3d": "point", "6d": "frame"}
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoopFile:
    """What a loop file says.

    Attributes
    ----------
    loops : tuple of Loop, Coupling and Drive
        What closes, couples and drives.
    forces : tuple
        Records of :mod:`pinconsist.mechanism.forces`.
    actuated : tuple of str
        Motorised joints, by the names they have after replacement.
    guess : dict
        Joint name → value, or list of values, from where assembly starts.
    joint_types : dict[str, str]
        Joints to replace: name → type, see :mod:`pinconsist.formats.joints`.
    settings : ModelSettings
        What else is said of the tree.
    description : str
        One line for lists of models.
    duration : float
        How long its motion is worth a look, s.
    """

    loops: tuple[Loop | Coupling | Drive, ...] = ()
    forces: tuple = ()
    actuated: tuple[str, ...] = ()
    guess: dict = field(default_factory=dict)
    joint_types: dict[str, str] = field(default_factory=dict)
    description: str = ""
    settings: ModelSettings = field(default_factory=ModelSettings)
    duration: float = Mechanism.duration


def read(path) -> LoopFile:
    """A loop file, in either convention.

    Parameters
    ----------
    path : path-like
        The file.

    Raises
    ------
    FormatError
        Not YAML, not plain data, unknown keys or values; names the record at fault.
    """
    path = Path(path)
    content = read_bytes(path, MAX_BYTES)
    try:
        record = _parsed(content)
        if not isinstance(record, dict) or not all(isinstance(key, str) for key in record):
            raise FormatError(f"a loop file holds keys such as {', '.join(_OWN_KEYS)}; this one does not")
        return _robot(record, path) if set(record) & set(_ROBOT_KEYS) else _own(record)
    except FormatError as error:
        raise FormatError(error.reason, path=path, element=error.element) from error.__cause__


def beside_scene(loops, kind: str) -> LoopFile:
    """The loop file named for a scene that is no URDF, empty if none is; it cannot replace joints."""
    record = LoopFile() if loops is None else read(loops)
    if record.joint_types:
        raise FormatError(f"joints can be replaced in URDF scenes only; change the {kind} file", path=loops)
    return record


def told_apart(records, model):
    """A model in which a name that loops or forces use means one frame, where its link and its joint stand alike.

    Link and joint of one name are common in exported files. The joint's frame then gets a name of its own; where the
    two stand apart they stay, and :func:`check` refuses the name.
    """
    used = {getattr(each, field, None) for each in records for field in ("frame", "frame1", "frame2")}
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


def check(record: LoopFile, model, path) -> None:
    """Raise FormatError for frames and joints of a loop file that a model does not have, or not of that kind."""
    frames, joints = [frame.name for frame in model.frames], tuple(model.names)[1:]
    for number, loop in enumerate(record.loops, start=1):
        element = loop_element(number, loop.name)
        if isinstance(loop, Loop):
            for frame in (loop.frame1, loop.frame2):
                _check_frame(frame, frames, path, element)
        else:
            for joint in (loop.joint, loop.other) if isinstance(loop, Coupling) else (loop.joint,):
                _check_joint(joint, joints, path, element)
    for number, force in enumerate(record.forces, start=1):
        try:
            force.bind(model)
        except InputError as error:
            raise FormatError(str(error), path=path, element=force_element(number, force)) from error
    for element, names in (("guess", record.guess), ("actuated joints", record.actuated)):
        for joint in names:
            _check_joint(joint, joints, path, element)


def _check_frame(frame, frames, path, element):
    if frame not in frames:
        raise FormatError(f"the model has no frame {frame!r}{near(frame, frames)}", path=path, element=element)
    if frames.count(frame) > 1:
        reason = f"the name {frame!r} belongs to a link and to a joint that stands elsewhere; rename one of them"
        raise FormatError(reason, path=path, element=element)


def _check_joint(joint, joints, path, element):
    if joint not in joints:
        raise FormatError(f"the model has no joint {joint!r}{near(joint, joints)}", path=path, element=element)


class _PlainLoader(yaml.SafeLoader):
    """Plain data only: no tags, no aliases (a few lines of them can stand for gigabytes), no key twice."""

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not read", problem_mark=self.peek_event().start_mark
            )
        return super().compose_node(parent, index)

    def construct_scalar(self, node):
        value = super().construct_scalar(node)
        if len(value) > MAX_VALUE:
            raise yaml.MarkedYAMLError(problem=f"a value of {len(value)} characters", problem_mark=node.start_mark)
        return value

    def construct_mapping(self, node, deep=False):
        seen = set()
        for key, _ in node.value:
            if isinstance(key, yaml.ScalarNode) and key.value in seen:
                raise yaml.MarkedYAMLError(problem=f"the key {key.value!r} stands twice", problem_mark=key.start_mark)
            seen.add(key.value if isinstance(key, yaml.ScalarNode) else None)
        return super().construct_mapping(node, deep)


def _parsed(content):
    try:
        return yaml.load(content, Loader=_PlainLoader)
    except yaml.MarkedYAMLError as error:
        line = f"line {error.problem_mark.line + 1}" if error.problem_mark else ""
        raise FormatError(f"not usable YAML: {error.problem}", element=line) from error
    except (yaml.YAMLError, ValueError, RecursionError) as error:  # encodings, impossible dates, deep nesting
        reason = str(error).splitlines()[0]
        raise FormatError(f"not usable YAML: {reason}") from error


def _own(record):
    known_keys(record, _OWN_KEYS, "")
    loops = []
    for number, entry in enumerate(_list(record, "loops"), start=1):
        loop = loop_record(number, entry)
        if loop.name in (other.name for other in loops):
            raise FormatError("another loop has this name", element=loop_element(number, loop.name))
        loops.append(loop)
    forces = tuple(force_record(number, entry) for number, entry in enumerate(_list(record, "forces"), start=1))
    guess = record.get("guess") or {}
    if not isinstance(guess, dict):
        raise FormatError("it must map joint names to values", element="guess")
    guess = {joint: number_or_numbers(value, f"guess: {joint}") for joint, value in guess.items()}
    description = record.get("description", "")
    if not isinstance(description, str):
        raise FormatError(f"a line of text is needed, not {shown(description)}", element="description")
    actuated = tuple(_names(record, "actuated"))
    settings, types = model_settings(record)
    duration = finite(given := record.get("duration", Mechanism.duration))
    if duration is None or not duration > 0:
        raise FormatError(f"a positive number of seconds is needed, not {shown(given)}", element="duration")
    return LoopFile(tuple(loops), forces, actuated, guess, types, description, settings, duration)


def _robot(record, path):
    for key in set(record) - set(_ROBOT_KEYS):
        if key in _OWN_KEYS:
            raise FormatError(f"the key {key!r} cannot stand beside those of robot.yaml ({', '.join(_ROBOT_KEYS)})")
        _log.warning("%s: the key %r is not known and has no effect%s", path, key, near(key, _ROBOT_KEYS))
    pairs, kinds = _list(record, "closed_loop"), _list(record, "type")
    if kinds and len(kinds) != len(pairs):
        raise FormatError(f"{len(kinds)} types for {len(pairs)} loops", element="type")
    loops = []
    for number, pair in enumerate(pairs, start=1):
        if not isinstance(pair, list) or len(pair) != 2:
            raise FormatError(f"a pair of frame names is needed, not {shown(pair)}", element=loop_element(number))
        frames = [name(frame, loop_element(number)) for frame in pair]
        element = loop_element(number, title := _pair_name(*frames, [loop.name for loop in loops]))
        kind = str(kinds[number - 1]).lower() if kinds else "6d"
        if kind not in _KINDS:
            raise FormatError(f"the type {shown(kind)} is neither 3d nor 6d", element=element)
        loops.append(Loop(title, _KINDS[kind], *frames))
    joints, types = _names(record, "joint_name"), _list(record, "joint_type")
    if len(joints) != len(types) or len(set(joints)) != len(joints):
        raise FormatError(f"{len(types)} types for {len(set(joints))} different joints", element="joint_type")
    joint_types = {joint: check_type(kind) for joint, kind in zip(joints, types, strict=True)}
    actuated = [new for motor in _names(record, "name_mot") for new in new_names(motor, joint_types.get(motor, ""))]
    return LoopFile(tuple(loops), actuated=tuple(actuated), joint_types=joint_types)


def _pair_name(frame1, frame2, taken):
    """'knee_A', 'knee_B' → 'knee'; 'a-b' where the names differ in more than a last character, or that is taken."""
    short = frame1[:-1].rstrip("_-. ") if frame1[:-1] == frame2[:-1] else ""
    name = short if short and short not in taken else f"{frame1}-{frame2}"
    return name if name not in taken else f"{name} ({len(taken) + 1})"


def _list(record, key):
    value = record.get(key)
    if value is None:
        return []
    if not isinstance(value, list):
        raise FormatError(f"a list is needed, not {shown(value)}", element=key)
    return value


def _names(record, key):
    return [name(value, key) for value in _list(record, key)]
