"""Modified mechanisms: joints locked or replaced, redundant joints and rows removed, anchors moved."""

import logging
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..errors import InputError, warn
from .assembly import assemble, impossible_alone
from .checks import function_name, places, several
from .closing import CLOSED_GAP, LoopSolver, steady
from .correction import Walk
from .forces import Actuator, Bushing, FluidDrag, Piecewise, SpringDamper, Torque, Wrench
from .forces.force import ForceRecord
from .forces.held import HeldRecord
from .joint_constraints import Coordinate, Drive, JointConstraint
from .lie import difference
from .loops import LOOP_KINDS, Loop
from .names import by_joint
from .rank import RANK_TOLERANCE, free_motions
from .rows import LoopRows

REDUCTION_PLACES = 5  # closed configurations, besides the first, at which joints and rows are examined
IMMOBILE = 1e-7  # share in the free motions, and displacement in rad or m, below which a joint counts as immobile
_LIMITS = [f"{end}{what}Limit" for what in ("DryFriction", "Effort", "Velocity") for end in ("lower", "upper")]
_PER_JOINT = [  # the arrays of a model with an entry for each coordinate, and for each velocity
    ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin"),
    ("armature", "damping", "rotorInertia", "rotorGearRatio", *_LIMITS),
]
_log = logging.getLogger(__name__)


def reduced(mechanism, q=None):
    """See :meth:`Mechanism.reduced`."""
    closed = assemble(mechanism, q).q
    walk = Walk(mechanism.with_loops(*steady(mechanism.loops)), RANK_TOLERANCE)
    places = [closed, *walk.places(1 + REDUCTION_PLACES, closed)[1:]]
    still = _still_joints(walk.solver, places)
    if len(still) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: the loops leave no motion, so the reduced mechanism would have no joints")
    result = mechanism.lock(still, closed) if still else replace(mechanism, guess=closed)
    shares = [by_joint(mechanism, place) for place in places]
    left = [result.configuration({joint: each[joint] for joint in result.joints}) for each in shares]
    if still:
        _log.info("%s: joints that the loops hold still are locked: %s", mechanism.name, ", ".join(still))
    return _with_fewer_rows(result, left)


def _still_joints(solver, places):
    """The joints that no free motion moves at any of the places, and that have the same value at all of them."""
    share, mechanism = np.zeros(solver.model.nv), solver.mechanism
    for place in places[1:] or places:  # the first may be a singular configuration
        free = free_motions(solver.rows(place)[1], solver.loop_rows.turns)
        share = np.maximum(share, np.abs(free).max(axis=1, initial=0.0))
        share = np.maximum(share, np.abs(difference(solver.model, places[0], place)))
    return tuple(joint for joint in mechanism.joints if share[mechanism.columns(joint)].max() < IMMOBILE)


def _with_fewer_rows(mechanism, places):
    """Drop redundant loops, and replace loops whose rotational rows are redundant by points."""
    ranks = _ranks(mechanism, mechanism.loops, places)
    for loop in reversed(mechanism.anchored_loops):
        others = [other for other in mechanism.loops if other is not loop]
        if _ranks(mechanism, others, places) == ranks:
            mechanism = mechanism.with_loops(*others)
            _log.info("%s: loop %r follows from the others and is dropped", mechanism.name, loop.name)
        elif LOOP_KINDS[loop.kind].holds_point and LOOP_KINDS[loop.kind].rotations:
            point = replace(loop, kind="point", axis=None, axis2=None)
            loops = [point if other is loop else other for other in mechanism.loops]
            if _ranks(mechanism, loops, places) == ranks:
                mechanism = mechanism.with_loops(*loops)
                reason = "follow from the others; it becomes a point"
                _log.info("%s: the rotational rows of loop %r %s", mechanism.name, loop.name, reason)
    return mechanism


def _ranks(mechanism, loops, places):
    """The rank of these loops, without those that depend on time, at each place."""
    solver = LoopSolver(mechanism.with_loops(*steady(loops)))
    return [len(solver.kept(place)) for place in places]


def reanchored(mechanism, q=None):
    """See :meth:`Mechanism.reanchored`."""
    result, solver = mechanism, LoopSolver(mechanism)
    best, _ = solver.close(mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess))
    anchored = [loop.name for loop in mechanism.anchored_loops]  # a drive has no anchor to move
    to_move = impossible_alone(mechanism, best, solver.gaps(best), {}).keys() & set(anchored)
    while True:  # first the loops that cannot close alone; then, if others stay open, those too
        gaps = solver.gaps(best)
        worst = max((gaps[name] for name in anchored), default=0.0)
        to_move = to_move or {name for name in anchored if worst > CLOSED_GAP and gaps[name] > 1e-3 * worst}
        if not to_move:
            break
        model, data = result.model, result.model.createData()
        pin.framesForwardKinematics(model, data, best)
        loops = (_moved_anchor(model, data, loop) if loop.name in to_move else loop for loop in result.loops)
        result = replace(result, loops=tuple(loops))
        to_move, solver = set(), LoopSolver(result)
        best, _ = solver.close(best)
    pairs = zip(mechanism.loops, result.loops, strict=True)
    moves = [_move(before, after) for before, after in pairs if before != after]
    if moves:
        warn(f"{mechanism.name}: anchor 2 moved to the best fit on loops {', '.join(moves)}")
    return replace(result, guess=best)


def _move(before, after):
    if before.length is not None:
        return f"{before.name!r} by {after.length - before.length:+.3g} m of length"
    turn = before.placement2.rotation.T @ after.placement2.rotation
    move = f"{before.name!r} by {np.linalg.norm(np.subtract(after.xyz2, before.xyz2)):.3g} m"
    return move if not LOOP_KINDS[before.kind].rotations else f"{move} and {np.linalg.norm(pin.log3(turn)):.3g} rad"


def _moved_anchor(model, data, loop):
    """The loop with anchor 2 at the nearest pose that closes it; a distance gets its current length."""
    pose1 = data.oMf[model.getFrameId(loop.frame1)] * loop.placement1
    pose2 = data.oMf[model.getFrameId(loop.frame2)]
    gap = pose1.actInv(pose2 * loop.placement2)
    if loop.length is not None:
        return replace(loop, length=float(np.linalg.norm(gap.translation)))
    translation, rotation = LOOP_KINDS[loop.kind].blocks(loop)
    turned = gap.rotation if rotation is None else rotation.closest(gap.rotation)
    closed = pin.SE3(turned, translation.closest(gap.translation))
    anchor = pose2.actInv(pose1 * closed)
    rpy = loop.rpy2 if rotation is None else tuple(pin.rpy.matrixToRpy(anchor.rotation))
    return replace(loop, xyz2=tuple(anchor.translation), rpy2=rpy)


def lock(mechanism, joints, q=None):
    """See :meth:`Mechanism.lock`."""
    if not (isinstance(joints, str) or hasattr(joints, "__iter__")):
        raise InputError(f"lock needs the name of one joint or of several, got {joints!r}")
    locked = {joint: mechanism.joint_index(joint) for joint in several(joints)}
    if len(locked) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: with all its joints locked, nothing can move")
    full = mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess)
    model, data = mechanism.model, mechanism.model.createData()
    pin.forwardKinematics(model, data, full)
    poses = {joint: model.jointPlacements[i].actInv(data.liMi[i]) for joint, i in locked.items()}
    smaller = rebuilt(model, dict.fromkeys(locked, ()), poses)
    state = _WholeState(model, locked.values(), full)
    loops = [_loop(loop, mechanism, smaller, locked, state) for loop in mechanism.loops]
    loops = tuple(loop for loop in loops if loop is not None)
    forces = (_force(force, mechanism, smaller, locked, state) for force in mechanism.forces)
    return replace(
        mechanism,
        model=smaller,
        loops=loops,
        forces=tuple(force for force in forces if force is not None),
        contacts=_contacts(mechanism, smaller, locked, [loop.name for loop in loops]),
        guess=full[state.q_left],
        actuated=tuple(joint for joint in mechanism.actuated if joint not in locked),
    )


def _contacts(mechanism, smaller, locked, loops):
    """The contacts that still can move."""
    left = []
    for each in mechanism.contacts:
        ends = [getattr(each, field, "") for field in ("frame1", "frame2", "frame", "on")]
        bodies = [body_of(smaller, frame) for frame in ends if frame]
        moves = getattr(each, "joint", "") not in locked and (not bodies or bodies[0] != bodies[1])
        if moves and getattr(each, "loop", None) in (None, *loops):
            left.append(each)
    return tuple(left)


def _loop(loop, mechanism, smaller, locked, state):
    """The loop on the smaller model; None if it always holds there; InputError if it cannot be kept."""
    if isinstance(loop, Loop):
        if body_of(smaller, loop.frame1) != body_of(smaller, loop.frame2):
            return loop
    elif isinstance(loop, JointConstraint):
        held = [joint for joint in loop.joints if joint in locked]
        others = [joint for joint in loop.joints if joint not in locked]
        if not held:
            return loop
        refused = f"{mechanism.name}: joint {held[0]!r} cannot be locked"
        if isinstance(loop, Drive):
            raise InputError(f"{refused}: drive {loop.name!r} moves it; remove the drive first, by with_loops()")
        if others:
            raise InputError(f"{refused} alone: coupling {loop.name!r} would also hold {others[0]!r}. Lock both")
    else:
        given = {"jacobian": state.v_left, "rate": None}
        functions = {field: _OfWhole(state, f, only) for field, only in given.items() if (f := getattr(loop, field))}
        return replace(loop, function=_OfWhole(state, loop.function), **functions)
    gap = np.max(np.abs(LoopRows(mechanism.model, [loop]).at(state.full)[0]))
    if gap > CLOSED_GAP:
        raise InputError(
            f"{mechanism.name}: with {', '.join(locked)} locked, loop {loop.name!r} would stay open by {gap:.3g} "
            "(m or rad). Lock the joints in a closed configuration, q = pinconsist.assemble(mechanism).q"
        )
    return None


def _force(force, mechanism, smaller, locked, state):
    """The force on the smaller model; None if all its joints are locked."""
    if isinstance(force, Actuator):
        return _actuator(force, mechanism.model, locked, state)
    if isinstance(force, SpringDamper | Bushing):
        return None if body_of(smaller, force.frame1) == body_of(smaller, force.frame2) else force
    if isinstance(force, Wrench | FluidDrag):
        return None if body_of(smaller, force.frame) == 0 else force
    if isinstance(force, Piecewise):
        left = _force(force.force, mechanism, smaller, locked, state)
        return left and replace(force, force=left)
    if isinstance(force, ForceRecord) and not isinstance(force, HeldRecord):
        left = getattr(force, force._acts_on)
        if isinstance(left, str):
            return None if left in locked else force
        if isinstance(left, Mapping):
            left = {joint: value for joint, value in left.items() if joint not in locked}
        else:
            left = tuple(left[i] for i in state.v_left)
        return replace(force, **{force._acts_on: left}) if left else None
    if hasattr(force, "bind"):
        return force
    names = ("function", "gradient") if isinstance(force, Torque) else ("torque", "derivatives")
    torque, gradient = (getattr(force, name) for name in names)
    left = state.v_left
    return Torque(_OfWhole(state, torque, left), gradient and _OfWhole(state, gradient, np.ix_(left, left)))


def _actuator(force, model, locked, state):
    """The actuator on the remaining joints; its gain and bias include the length of the locked ones."""
    left = {joint: arm for joint, arm in force.arms.items() if joint not in locked}
    if len(left) == len(force.arms) or not left:
        return force if left else None
    still = (joint for joint in force.arms if joint in locked)
    length = sum(force.arms[joint] * Coordinate(model, joint, "lock", "locked").value(state.full) for joint in still)
    gain, bias = ((law[0] + length * law[1], *law[1:]) for law in (force.gain, force.bias))
    return replace(force, joint=left, gear=1.0, gain=gain, bias=bias)


def body_of(model, frame):
    """The joint that carries a frame, named as its body."""
    return model.frames[model.getFrameId(frame)].parentJoint


class _WholeState:
    """Expands the state of the remaining joints to that of the whole mechanism, with the locked joints at rest."""

    def __init__(self, model, locked, full):
        self.full, self.rest = full, np.zeros(model.nv)
        left = [places(model, i) for i in range(1, model.njoints) if i not in set(locked)]
        every = zip(*left, strict=True)
        self.q_left, self.v_left = ([k for at in part for k in range(at.start, at.stop)] for part in every)

    def __call__(self, *state):
        """(q,), or (q, v)."""
        whole = self.full.copy(), self.rest.copy()
        for part, left, values in zip(whole, (self.q_left, self.v_left), state, strict=False):
            part[left] = values
        return whole[: len(state)]


class _OfWhole:
    """A user's function of the whole state as a function of the remaining joints; `only` indexes its last axes."""

    def __init__(self, state, function, only=None):
        self.state, self.function, self.only = state, function, only
        self.__qualname__ = function_name(function)

    def __call__(self, t, *state):
        value = self.function(t, *self.state(*state))
        if self.only is None:
            return value
        if isinstance(self.only, tuple):  # a pair of matrices
            return tuple(None if part is None else np.asarray(part)[self.only] for part in value)
        return np.asarray(value)[..., self.only]


def rebuilt(model: pin.Model, parts: Mapping, poses: Mapping = {}, order: Sequence[int] | None = None) -> pin.Model:
    """A copy of a model with joints replaced; frames keep their names and indices, bodies their inertia.

    `parts` maps a joint name to the (name, joint model) of the joints that replace it, in series; the last one carries
    the body, and all have the damping, friction and armature of the old joint. An empty sequence fixes the joint
    (``pin.buildReducedModel`` would need a frame for it), with its body at `poses` in the joint frame. `order` is the
    order of the joints, parents before children.
    """
    new = pin.Model()
    new.name, new.gravity = model.name, model.gravity
    new.inertias[0] = model.inertias[0]
    carriers = {0: (0, pin.SE3.Identity())}  # old joint → new joint that carries its body, and where
    for old in order or range(1, model.njoints):
        name = model.names[old]
        carrier, place = carriers[model.parents[old]]
        place = place * model.jointPlacements[old]
        replacements = parts.get(name, [(name, model.joints[old])])
        for part, joint in replacements:
            carrier, place = new.addJoint(carrier, joint, place, part), pin.SE3.Identity()
            held = list(zip(_PER_JOINT, places(model, old), places(new, carrier), strict=True))
            for fields, here, there in held[1 if name in parts else 0 :]:
                for field in fields:
                    getattr(new, field)[there] = getattr(model, field)[here]
        if not replacements:
            place = place * poses[name]
        carriers[old] = carrier, place
        own = place.act(model.inertias[old])
        new.inertias[carrier] = own if replacements else new.inertias[carrier] + own
    fixed = {name for name, replacements in parts.items() if not replacements}
    for frame in list(model.frames)[1:]:
        carrier, place = carriers[frame.parentJoint]
        is_fixed = frame.type == pin.FrameType.JOINT and frame.name in fixed
        kind = pin.FrameType.FIXED_JOINT if is_fixed else frame.type
        moved = pin.Frame(frame.name, carrier, frame.parentFrame, place * frame.placement, kind, frame.inertia)
        new.addFrame(moved, False)
    return new
