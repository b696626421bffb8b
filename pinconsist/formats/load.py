"""Files, names and Pinocchio's own objects → Mechanism."""

import os
from collections.abc import Mapping
from dataclasses import replace
from importlib import import_module
from pathlib import Path

import numpy as np
import pinocchio as pin

from ..errors import FormatError, InputError, warn
from ..mechanism.checks import choice, flag, number, several
from ..mechanism.contacts import Contact, DryFriction, Stop
from ..mechanism.file_laws import FRICTION, LIMITS, with_dry_friction, with_limits, without_stopped
from ..mechanism.loops import GROUND, Loop, anchor
from ..mechanism.mechanism import Geometry, Mechanism
from ..mechanism.names import is_revolute
from . import catalogue, loopfile
from .closures import closed
from .ground import ground_contacts, still_ignored
from .plausible import warn_of_degrees, warn_of_inertias, warn_of_units
from .reading import located

_CLOSURES = ("point", "frame", "hinge")
_THEIR_KINDS = {
    "PointAnchorConstraintModel": "point",
    "FrameAnchorConstraintModel": "frame",
    "RigidConstraintModel of type CONTACT_3D": "point",
    "RigidConstraintModel of type CONTACT_6D": "frame",
}
_WITHOUT_SOLIDS = ("usd", "webots", "choreonoid", "ambf")  # readers that leave collision shapes out
_FLOATS = {  # files that define what floats
    "mjcf": "MJCF files, which define what floats: give the body a <freejoint/>",
    "usd": "USD files, which define what floats: a body without joints to the ground",
    "webots": "Webots files, which define what floats: a Robot with Physics",
    "directives": "directives of Drake, which define what floats: models without add_weld",
    "ambf": "bodies of AMBF, which define what floats: those with a mass that no joint connects to one without",
    "choreonoid": "bodies of Choreonoid and OpenHRP, which define what floats: a root of type free",
}
_MUST_VANISH = ("offset", "velocity", "acceleration")  # desired values of a constraint or a contact


def load(
    source, *, loops=None, closure=None, free_flyer=False, package_dirs=(), ignore=(), precision=0.0, args=None,
    limits="watch", dry_friction="smooth", ground=False,
) -> Mechanism:  # fmt: skip
    """Load a mechanism from the name of a built-in model, a file, a folder or a Pinocchio object.

    Parameters
    ----------
    source : str, path-like, pin.Model or RobotWrapper
        A name of :func:`models`, with a number for ``<n>``; or a file: URDF, SDF (``.sdf``, ``.world``), MJCF
        (``.xml``), xacro, USD, Webots (``.wbt``, ``.proto``), Choreonoid (``.body``), OpenHRP (``.wrl``), AMBF
        (``.yaml``), directives of Drake (``.dmd.yaml``); or a folder that contains one ``.urdf``; or a model in memory;
        or a robot of the pip package example-robot-data: ``"cassie"``, ``"cassie_v2"``, ``"cassie_reduced"``,
        ``"cassie_simple"``, ``"cassie_wo_gearbox_spring"``.
    loops : path-like or sequence, optional
        The loop file. Default: ``<stem>.yaml`` or ``.yml`` beside the URDF, else ``robot.yaml`` or ``.yml`` there, else
        ``loop_closures.yaml`` or ``robot_data.yaml`` there or in the folder above ``urdf/``, else
        the loops of the URDF itself: ``<loop_joint>`` elements, or pairs of frames with closing names
        (:mod:`pinconsist.formats.urdf_loops`), else none (a plain tree). SDF and MJCF files define their own loops
        (:mod:`pinconsist.formats.sdf`, :mod:`pinconsist.formats.mjcf`); no loop file is searched for.
        For a model in memory, a sequence of Pinocchio's constraint models, also those of limits, friction and contacts,
        and of Loop, Drive and Coupling records.
    closure : {"point", "frame", "hinge"}, optional
        Use this kind of :class:`~pinconsist.Loop` for all points, frames and hinges; loops of other kinds are
        unchanged.
    free_flyer : bool
        Let the root link of a file float freely instead of fixing it to the ground at its pose. SDF files are also
        fixed by default, as by Pinocchio's own readers. Not for MJCF, where the file defines which bodies float.
    package_dirs : sequence of path-like
        Folders in which files that a scene names are searched for (meshes, includes), before its own folder.
    ignore : sequence of str
        Elements of a file that have an effect in another program and are not supported here, by tag or name:
        ``"drake:ball_constraint"``, ``"gazebo/joint"``, ``"flexcomp"``. The file is loaded without them instead of
        being rejected.
    args : mapping, optional
        Arguments of a xacro file: name → value.
    precision : float
        Precision of the numbers in the source, m and rad: 1e-6 for a file written with six digits. Loops that lock or
        contradict each other because of smaller errors are made consistent, see :meth:`Mechanism.corrected`. Default:
        the numbers are not changed.
    limits : {"watch", "stops", "off"}
        What the position limits of joints do: watched, certificates name the joints that leave them; or they are
        stops, see :class:`Stop`; or nothing.
    dry_friction : {"smooth", "exact"}
        Whether the dry friction of joints is smoothed near rest, or holds them, see :class:`DryFriction`.
    ground : bool or float
        Whether collision shapes of moving links touch the planes of the file or, if it has none, the plane z = 0; a
        number is the coefficient of friction. Without it that of the file counts, else 1. Spheres, capsules and boxes
        act, the latter by their corners; a sphere does not roll, but pivots about its centre. See :class:`Contact`.

    Returns
    -------
    Mechanism
        Its ``continuous`` joints are plain revolute joints, with one angle that counts full turns. Elements of the file
        without effect here (contacts, limits, plugins, unknown elements) are counted in ``ignored``, and reported in
        one line; unsupported elements that would change the mechanism raise an error.

    Raises
    ------
    InputError
        Unknown name or invalid option.
    MissingExtraError
        The files of a robot, or MuJoCo for an MJCF file, are not installed; the message names the pip package.
    FormatError
        A file that cannot be read as a scene; the message names the file and the element.
    """
    if closure is not None:
        choice(closure, _CLOSURES, "closure")
    choice(limits, LIMITS, "limits")
    choice(dry_friction, FRICTION, "dry_friction")
    free_flyer = flag(free_flyer, "free_flyer")
    package_dirs, ignore = several(package_dirs), several(ignore)
    if not all(isinstance(folder, (str, os.PathLike)) for folder in package_dirs):
        raise InputError(f"package_dirs= needs folders, got {package_dirs!r}")
    if not all(isinstance(tag, str) for tag in ignore):
        raise InputError(f"ignore= needs tags or names of elements, got {ignore!r}")
    if not isinstance(source, (str, os.PathLike)):
        if free_flyer:
            raise InputError("free_flyer= is for files; a model in memory has its root joint already")
        if ignore:
            raise InputError("ignore= is for files; a model in memory has no elements")
        if ground is not False:
            raise InputError("ground= is for files; give a model in memory its contacts by with_contacts()")
        mech = _of_model(source, () if loops is None else loops, closure).corrected(precision)
        return with_dry_friction(with_limits(mech, limits), dry_friction)
    if not (loops is None or isinstance(loops, (str, os.PathLike))):
        reason = f"loops= needs the path of a loop file, got {type(loops).__name__}"
        raise InputError(f"{reason}; add records by load(…).add_loops(…)")
    if args is not None and not isinstance(args, Mapping):
        raise InputError(f"args= needs a mapping of names to values, got {args!r}")
    options = {"free_flyer": free_flyer, "package_dirs": package_dirs, "ignore": ignore, "args": args}
    options |= {"limits": limits, "dry_friction": dry_friction, "ground": ground}
    return read_scene(catalogue.find(source), loops, closure, **options).corrected(precision)


def read_scene(
    scene: catalogue.Source, loops=None, closure=None, *, free_flyer=False, package_dirs=(), ignore=(), args=None,
    limits="watch", dry_friction="smooth", ground=False,
) -> Mechanism:  # fmt: skip
    """The mechanism of a file and of the loop file that belongs to it; see :func:`load`."""
    path, reader = scene.path, catalogue.reader_of(scene.path, scene.content)
    _check_options(path, reader, args, free_flyer, ground)
    is_urdf = reader in ("urdf", "xacro")
    loop_path = None
    if loops is not None:
        loop_path = Path(loops)
    elif is_urdf:
        loop_path = _loop_file_of(scene)
    record = scene.loop_file if loop_path is None else loopfile.read(loop_path)
    if record.joint_types and not is_urdf:
        reason = f"joints can be replaced only in URDF scenes; change the {reader.upper()} file"
        raise FormatError(reason, path=loops)
    options = _reader_options(reader, scene, record, args, free_flyer)
    folders = (*package_dirs, *scene.package_dirs, path.parent)
    with located(path):
        read = import_module(f".{reader}", __package__).read
        robot = read(path, scene.name, folders, ignore=ignore, **options)
    with located(loop_path):
        model = record.applied(robot.model)
        model = loopfile.with_distinct_frames((*robot.loops, *record.loops, *record.forces, *record.contacts), model)
        record.check(model)
    closures = closed(model, (*robot.loops, *record.loops), robot.guess)
    if is_urdf and loop_path is None and not closures:
        from .urdf_loops import closing_frames

        closures = closing_frames(model, path, closure)
    if loop_path is None and not scene.content:
        loopfile.warn_of_other_files(path)
    warn_of_units(path, model)
    warn_of_degrees(loop_path, _angles(record, model))
    closures = _closed_by(closures, closure)
    ignored, touching = without_stopped((*robot.ignored, *record.ignored), model, record.contacts), ()
    if ground is not False:
        friction = None if ground is True else number(ground, "ground", least=0.0)
        rule = min if reader == "sdf" else max
        touching, left = ground_contacts(model, robot.solids, robot.planes, friction, rule)
        ignored = still_ignored(ignored, left)
    with located(loop_path or path):
        mech = Mechanism(
            model,
            (*closures, *robot.couplings),
            (*robot.forces, *record.forces),
            contacts=(*record.contacts, *touching),
            name=scene.name,
            guess=robot.guess | record.guess,
            actuated=tuple(dict.fromkeys((*robot.actuated, *record.actuated))),
            geometry=Geometry(robot.shapes, tuple(str(Path(folder).resolve()) for folder in folders)),
            duration=record.duration,
            ignored=ignored,
        )
        mech = with_dry_friction(with_limits(mech, limits), dry_friction)
    if mech.ignored:
        warn(f"{path}: without effect here: {', '.join(mech.ignored)}")
    return mech


def _check_options(path, reader, args, free_flyer, ground) -> None:
    """Raise InputError for options that do not apply to files of this reader."""
    if args and reader != "xacro":
        raise InputError(f"args= is for xacro files, and {path.name} is not one")
    if free_flyer and reader in _FLOATS:
        raise InputError(f"free_flyer= is not for {_FLOATS[reader]}")
    if ground is not False and reader in _WITHOUT_SOLIDS:
        raise InputError(
            f"ground= is not for {path.name}: the collision shapes of such files are not read; add its contacts by "
            "mech.with_contacts(pc.Contact(…))"
        )


def _loop_file_of(scene) -> Path | None:
    """The path of the loop file next to a URDF scene; None for a built-in scene, and where there is none."""
    found = None if scene.content else loopfile.find_loop_file(scene.path)
    if found is not None and found.stem in loopfile.LISTS:
        warn(f"{scene.path}: its loops are taken from {found}; loops= is for another file")
    return found


def _reader_options(reader, scene, record, args, free_flyer) -> dict:
    """The options that only some readers have."""
    options = {"joint_types": record.joint_types} if reader in ("urdf", "xacro") else {}
    if reader == "urdf":
        options["content"] = scene.content
    if reader == "xacro":
        options["args"] = args
    if reader not in _FLOATS:
        options["free_flyer"] = free_flyer
    return options


def _angles(record, model):
    """(element, angles) of a loop file: those of its anchors, and its guess."""
    for loop in (each for each in record.loops if isinstance(each, Loop)):
        yield f"loop {loop.name!r}: rpy1", loop.rpy1
        yield f"loop {loop.name!r}: rpy2", loop.rpy2
    for joint, value in record.guess.items():
        if is_revolute(model.joints[model.getJointId(joint)]):
            yield f"guess: {joint}", np.ravel(value).tolist()


def _of_model(source, loops, closure) -> Mechanism:
    """A mechanism from a ``pin.Model``, or from the model of a RobotWrapper."""
    if isinstance(source, Mechanism):
        raise InputError(
            f"{source.name!r} is already a Mechanism; its with_loops() replaces the loops, its add_loops() adds to them"
        )
    model = source if isinstance(source, pin.Model) else getattr(source, "model", None)
    if not isinstance(model, pin.Model):
        kind = type(source).__name__
        raise InputError(f"load needs a model's name, a path, a pin.Model or a RobotWrapper, got {kind}")
    if isinstance(loops, str) or not hasattr(loops, "__iter__"):
        kind = type(loops).__name__
        raise InputError(f"loops= of a pin.Model needs a sequence of constraint models or Loops, got {kind}")
    bodies = zip(list(model.names)[1:], list(model.inertias)[1:], strict=True)
    title = model.name or "mechanism"
    warn_of_inertias(title, [(f"the body at joint {name!r}", whole.inertia, whole) for name, whole in bodies])
    warn_of_units(title, model)
    loops, contacts, model = loops_of(loops, model)
    return Mechanism(model, _closed_by(loops, closure), contacts=contacts, name=title)


def _closed_by(loops, closure) -> tuple:
    """The loops with the kind `closure`, if given, for points, frames and hinges; other records are unchanged."""

    def closed(loop):
        return replace(loop, kind=closure, axis=loop.axis if closure == "hinge" else None)

    return tuple(closed(loop) if closure and loop.kind in _CLOSURES else loop for loop in loops)


def loops_of(constraint_models, model: pin.Model) -> tuple[list, list, pin.Model]:
    """Loops and contacts equivalent to Pinocchio's constraint models, other records, and the model that they need.

    Point and frame anchors and the legacy rigid constraints in 3D and 6D become loops, limits, friction of joints and
    point contacts become stops, dry friction and contacts; also inside the common constraint model. InputError for
    other kinds, compliance, and desired offsets or motions. Baumgarte gains are ignored. An unnamed constraint is
    called ``loop1``, by its position. If a joint carries an anchor but no frame with a unique name, the model is a copy
    with such a frame added.
    """
    loops, contacts, names = [], [], []
    for given in constraint_models:
        if hasattr(given, "kind") and hasattr(given, "rows"):
            loops.append(given)
            continue
        constraint, number = given.extract() if hasattr(given, "extract") else given, len(names) + 1
        name = getattr(constraint, "name", "") or f"loop{number}"
        if name in names:
            name = f"{name} ({number})"
        names.append(name)
        which = type(constraint).__name__
        if which in _OF_JOINTS:
            _require_rigid(constraint, name)
            contacts += _OF_JOINTS[which](constraint, name, model)
            continue
        kind = None if which == "PointContactConstraintModel" else _kind(constraint, name)
        _require_rigid(constraint, name)
        places = []
        for end in (1, 2):
            joint = getattr(constraint, f"joint{end}_id")
            if not 0 <= joint < model.njoints:
                raise InputError(f"constraint {name!r}: the model has no joint number {joint}")
            model, frame = _with_frame_on(joint, model)
            place = model.frames[model.getFrameId(frame)].placement.actInv(getattr(constraint, f"joint{end}_placement"))
            places.append((frame, place))
        if kind is None:
            contacts.append(_contact(constraint, name, *places))
        else:
            fields = {f"frame{end}": frame for end, (frame, _) in enumerate(places, start=1)}
            loops.append(Loop(name, kind, **fields, **anchor(1, places[0][1]), **anchor(2, places[1][1])))
    return loops, contacts, model


def _stops(constraint, name, model) -> list[Stop]:
    """The stops of a JointLimitConstraintModel: its rows are the limits, and its Jacobian says of which joints."""
    data, found = model.createData(), {}
    pin.forwardKinematics(model, data, pin.neutral(model))
    inside = constraint.createData()
    constraint.calc(model, data, inside)
    rows = np.array(constraint.jacobian(model, data, inside)).reshape(-1, model.nv)
    for row, limit in zip(rows, np.array(constraint.getActivablePositionLimit()), strict=True):
        column = int(np.argmax(np.abs(row)))
        found.setdefault(_joint_of(column, model, name), {})["lower" if row[column] > 0.0 else "upper"] = float(limit)
    return [Stop(joint, **limits) for joint, limits in found.items()]


def _dry_friction(constraint, name, model) -> list[DryFriction]:
    """The dry friction of a JointFrictionConstraintModel; InputError if it differs for both directions."""
    columns, found = list(constraint.getActiveDofs()), []
    limits = zip(columns, constraint.getFrictionLowerLimit(), constraint.getFrictionUpperLimit(), strict=True)
    for column, lower, upper in limits:
        joint = _joint_of(int(column), model, name)
        if not np.isclose(-lower, upper):
            raise InputError(
                f"constraint {name!r}: the friction of joint {joint!r} is from {lower:g} to {upper:g}; dry friction is "
                "the same in both directions here. Leave it out, and give the difference as a constant torque"
            )
        found.append(DryFriction(joint, float(upper)))
    return found


def _joint_of(column, model, name) -> str:
    """The name of the joint with a velocity, which must have one degree of freedom; InputError otherwise."""
    joint = max(i for i in range(1, model.njoints) if model.idx_vs[i] <= column)
    if model.nvs[joint] != 1:
        raise InputError(
            f"constraint {name!r}: joint {model.names[joint]!r} has several degrees of freedom; stops and dry friction "
            "are of joints with one"
        )
    return model.names[joint]


def _contact(constraint, name, one, two) -> Contact:
    """The contact of a PointContactConstraintModel: z of its first placement points from body 1 to body 2.

    The point is that of body 2, and the plane that of body 1; the other way round if body 2 is the ground.
    """
    (on, plane), (frame, point), sign = one, two, 1.0
    if frame == GROUND:
        (on, plane), (frame, point), sign = two, one, -1.0
    normal = sign * plane.rotation[:, 2]
    offset = float(normal @ plane.translation)
    friction = float(constraint.getFriction())
    return Contact(name, frame, tuple(point.translation), normal=tuple(normal), offset=offset, on=on, friction=friction)


_OF_JOINTS = {"JointLimitConstraintModel": _stops, "JointFrictionConstraintModel": _dry_friction}


def _kind(constraint, name):
    """The kind of the loop; InputError for other constraints."""
    which = type(constraint).__name__
    if which == "RigidConstraintModel":
        which += f" of type {constraint.type}"
    if which not in _THEIR_KINDS:
        others = (*_THEIR_KINDS, *_OF_JOINTS, "PointContactConstraintModel")
        raise InputError(f"constraint {name!r}: a {which} cannot be read; {', '.join(others)} can")
    return _THEIR_KINDS[which]


def _require_rigid(constraint, name) -> None:
    """Raise InputError if a constraint is not rigid or its anchors move."""
    for attribute in (f"desired_{of}_{what}" for of in ("constraint", "contact") for what in _MUST_VANISH):
        value = getattr(constraint, attribute, 0.0)
        if np.any(getattr(value, "vector", value)):
            raise InputError(
                f"constraint {name!r}: its {attribute} is not zero, but a loop is closed and its anchors do not move"
            )
    if np.any(constraint.retrieveCompliance()):
        raise InputError(f"constraint {name!r}: it is compliant, but a loop is rigid; use a SpringDamper")


def _with_frame_on(joint, model):
    """The model and the unique name of a frame on this joint; if there is none, it is added to a copy of the model."""
    if joint == 0:
        return model, GROUND
    names = [frame.name for frame in model.frames]
    own = [frame.name for frame in model.frames if frame.parentJoint == joint and names.count(frame.name) == 1]
    if own:
        return model, model.names[joint] if model.names[joint] in own else own[0]
    model, name = model.copy(), model.names[joint]
    while name in names:
        name += "_origin"
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME), False)
    return model, name
