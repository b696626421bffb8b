"""Loop files: what closes a tree, in YAML, in two conventions.

The project's own has ``loops``, a list of mappings with the fields of :class:`~pinconsist.mechanism.loops.Loop`, and
``description``, ``guess``, ``actuated``. The other is the ``robot.yaml`` of the example-parallel-robots collection:
``closed_loop`` (pairs of frames), ``type`` (3d or 6d), ``name_mot``, ``joint_name`` and ``joint_type``.
"""

from __future__ import annotations

import dataclasses
import logging
from dataclasses import dataclass, field
from pathlib import Path

import yaml

from ..errors import FormatError, InputError
from ..mechanism.loops import Loop
from .joints import check_type, new_names
from .reading import finite, near, read_bytes, shown

MAX_BYTES = 1_000_000
_OWN_KEYS = ("description", "loops", "guess", "actuated")
_ROBOT_KEYS = ("closed_loop", "type", "name_mot", "joint_name", "joint_type")
_LOOP_KEYS = tuple(each.name for each in dataclasses.fields(Loop))
_KINDS = {"3d": "point", "6d": "frame"}
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoopFile:
    """What a loop file says.

    Attributes
    ----------
    loops : tuple of Loop
        The loop closures.
    actuated : tuple of str
        Motorised joints, by the names they have after replacement.
    guess : dict
        Joint name → value, or list of values, from where assembly starts.
    joint_types : dict[str, str]
        Joints to replace: name → SPHERICAL, FIXED or UJOINT_AB.
    description : str
        One line for lists of models.
    """

    loops: tuple[Loop, ...] = ()
    actuated: tuple[str, ...] = ()
    guess: dict = field(default_factory=dict)
    joint_types: dict[str, str] = field(default_factory=dict)
    description: str = ""


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


def check(record: LoopFile, model, path) -> None:
    """Raise FormatError for frames and joints of a loop file that a model does not have."""
    frames = [frame.name for frame in model.frames]
    for number, loop in enumerate(record.loops, start=1):
        for frame in (loop.frame1, loop.frame2):
            if frame not in frames:
                reason = f"the model has no frame {frame!r}{near(frame, frames)}"
            elif frames.count(frame) > 1:
                reason = f"the name {frame!r} belongs to a link and to a joint; rename one of them"
            else:
                continue
            raise FormatError(reason, path=path, element=_element(number, loop.name))
    joints = tuple(model.names)[1:]
    for element, names in (("guess", record.guess), ("actuated joints", record.actuated)):
        for name in names:
            if name not in joints:
                raise FormatError(f"the model has no joint {name!r}{near(name, joints)}", path=path, element=element)


class _PlainLoader(yaml.SafeLoader):
    """Plain data only: no tags, no aliases (a few lines of them can stand for gigabytes), no key twice."""

    def compose_node(self, parent, index):
        if self.check_event(yaml.AliasEvent):
            raise yaml.MarkedYAMLError(
                problem="aliases (*name) are not read", problem_mark=self.peek_event().start_mark
            )
        return super().compose_node(parent, index)

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
    _known(record, _OWN_KEYS, "")
    loops = []
    for number, entry in enumerate(_list(record, "loops"), start=1):
        loop = _own_loop(number, entry)
        if loop.name in (other.name for other in loops):
            raise FormatError("another loop has this name", element=_element(number, loop.name))
        loops.append(loop)
    guess = record.get("guess") or {}
    if not isinstance(guess, dict):
        raise FormatError("it must map joint names to values", element="guess")
    guess = {joint: _guess_value(joint, value) for joint, value in guess.items()}
    description = record.get("description", "")
    if not isinstance(description, str):
        raise FormatError(f"a line of text is needed, not {shown(description)}", element="description")
    return LoopFile(tuple(loops), tuple(_names(record, "actuated")), guess, {}, description)


def _own_loop(number, entry):
    if not isinstance(entry, dict):
        raise FormatError(f"keys such as name, kind, frame1 are needed, not {shown(entry)}", element=_element(number))
    element = _element(number, entry.get("name"))
    _known(entry, _LOOP_KEYS, element)
    fields = {}
    for key in _LOOP_KEYS:
        value = entry.get(key)
        if value is None:
            if key in ("name", "kind", "frame1"):
                raise FormatError(f"{key!r} is missing", element=element)
        elif key in ("name", "kind", "frame1", "frame2"):
            fields[key] = _name(value, f"{element}: {key}")
        elif key == "length":
            fields[key] = _number(value, f"{element}: {key}")
        elif isinstance(value, list) and len(value) == 3:
            fields[key] = tuple(_number(each, f"{element}: {key}") for each in value)
        else:
            raise FormatError(f"three numbers are needed, not {shown(value)}", element=f"{element}: {key}")
    return _made(element, fields)


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
            raise FormatError(f"a pair of frame names is needed, not {shown(pair)}", element=_element(number))
        frames = [_name(frame, _element(number)) for frame in pair]
        name = _pair_name(*frames, [loop.name for loop in loops])
        kind = str(kinds[number - 1]).lower() if kinds else "6d"
        if kind not in _KINDS:
            raise FormatError(f"the type {shown(kind)} is neither 3d nor 6d", element=_element(number, name))
        element = _element(number, name)
        loops.append(_made(element, dict(name=name, kind=_KINDS[kind], frame1=frames[0], frame2=frames[1])))
    joints, types = _names(record, "joint_name"), _list(record, "joint_type")
    if len(joints) != len(types) or len(set(joints)) != len(joints):
        raise FormatError(f"{len(types)} types for {len(set(joints))} different joints", element="joint_type")
    joint_types = {joint: check_type(kind) for joint, kind in zip(joints, types, strict=True)}
    actuated = [new for name in _names(record, "name_mot") for new in new_names(name, joint_types.get(name, ""))]
    return LoopFile(tuple(loops), tuple(actuated), {}, joint_types, "")


def _pair_name(frame1, frame2, taken):
    """'knee_A', 'knee_B' → 'knee'; 'a-b' where the names differ in more than a last character, or that is taken."""
    short = frame1[:-1].rstrip("_-. ") if frame1[:-1] == frame2[:-1] else ""
    name = short if short and short not in taken else f"{frame1}-{frame2}"
    return name if name not in taken else f"{name} ({len(taken) + 1})"


def _made(element, fields):
    try:
        return Loop(**fields)
    except InputError as error:
        reason = str(error).removeprefix(f"loop {fields['name']!r}: ")
        raise FormatError(reason, element=element) from error


def _element(number, name=None):
    return f"loop {number} {name!r}" if isinstance(name, str) else f"loop {number}"


def _known(record, keys, element):
    for key in record:
        if key not in keys:
            raise FormatError(f"the key {shown(key)} is not known{near(key, keys)}", element=element)


def _list(record, key):
    value = record.get(key)
    if value is None:
        return []
    if not isinstance(value, list):
        raise FormatError(f"a list is needed, not {shown(value)}", element=key)
    return value


def _names(record, key):
    return [_name(value, key) for value in _list(record, key)]


def _name(value, element):
    if not isinstance(value, str) or not value:
        raise FormatError(f"a name is needed, not {shown(value)} (quote names that look like numbers)", element=element)
    return value


def _guess_value(joint, value):
    if isinstance(value, list):
        return [_number(each, f"guess: {joint}") for each in value]
    return _number(value, f"guess: {joint}")


def _number(value, element):
    number = finite(value)
    if number is None:
        raise FormatError(f"a finite number is needed, not {shown(value)}", element=element)
    return number
