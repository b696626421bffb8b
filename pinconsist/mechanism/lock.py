"""Joints fixed where they are: the model without them, and what becomes of loops and forces."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import function_name, places, several
from .closing import CLOSED
from .forces import Actuator, Piecewise, SpringDamper, Torque, Wrench
from .forces.force import ForceRecord
from .forces.held import HeldRecord
from .joint_constraints import Coordinate, Coupling, Drive
from .loops import Loop
from .rows import LoopRows

_LIMITS = [f"{end}{what}Limit" for what in ("DryFriction", "Effort", "Velocity") for end in ("lower", "upper")]
_PER_JOINT = [  # what a model holds for each coordinate, and for each velocity
    ("lowerPositionLimit", "upperPositionLimit", "positionLimitMargin"),
    ("armature", "damping", "rotorInertia", "rotorGearRatio", *_LIMITS),
]


def lock(mechanism, joints, q=None):
    """See :meth:`Mechanism.lock`."""
    if not (isinstance(joints, str) or hasattr(joints, "__iter__")):
        raise InputError(f"lock needs the name of one joint or of several, got {joints!r}")
    locked = {joint: mechanism.joint_index(joint) for joint in several(joints)}
    if len(locked) == len(mechanism.joints):
        raise InputError(f"{mechanism.name}: with all its joints locked nothing can move")
    full = mechanism.guess if q is None else mechanism.configuration(q, base=mechanism.guess)
    model, data = mechanism.model, mechanism.model.createData()
    pin.forwardKinematics(model, data, full)
    poses = {joint: model.jointPlacements[i].actInv(data.liMi[i]) for joint, i in locked.items()}
    smaller = rebuilt(model, dict.fromkeys(locked, ()), poses)
    state = _WholeState(model, locked.values(), full)
    loops = (_loop(loop, mechanism, smaller, locked, state) for loop in mechanism.loops)
    forces = (_force(force, mechanism, smaller, locked, state) for force in mechanism.forces)
    return replace(
        mechanism,
        model=smaller,
        loops=tuple(loop for loop in loops if loop is not None),
        forces=tuple(force for force in forces if force is not None),
        guess=full[state.q_left],
        actuated=tuple(joint for joint in mechanism.actuated if joint not in locked),
    )


def _loop(loop, mechanism, smaller, locked, state):
    """The loop on the smaller model; None if it always holds there; InputError where it cannot be kept."""
    if isinstance(loop, Loop):
        if _body(smaller, loop.frame1) != _body(smaller, loop.frame2):
            return loop
    elif isinstance(loop, Coupling | Drive):
        joints = [loop.joint, loop.other] if isinstance(loop, Coupling) else [loop.joint]
        held, others = [each for each in joints if each in locked], [each for each in joints if each not in locked]
        if not held:
            return loop
        refused = f"{mechanism.name}: joint {held[0]!r} cannot be locked"
        if isinstance(loop, Drive):
            raise InputError(f"{refused}: drive {loop.name!r} moves it; take the drive out first, by with_loops()")
        if others:
            raise InputError(f"{refused} alone: coupling {loop.name!r} then holds {others[0]!r} too. Lock both")
    else:
        given = {"jacobian": state.v_left, "rate": None}
        functions = {field: _OfWhole(state, f, only) for field, only in given.items() if (f := getattr(loop, field))}
        return replace(loop, function=_OfWhole(state, loop.function), **functions)
    data = mechanism.model.createData()
    pin.computeJointJacobians(mechanism.model, data, state.full)
    gap = np.max(np.abs(LoopRows(mechanism.model, [loop]).evaluate(data, state.full)[0]))
    if gap > CLOSED:
        raise InputError(
            f"{mechanism.name}: with {', '.join(locked)} locked, loop {loop.name!r} would stay open by {gap:.3g} "
            "(m or rad). Lock the joints in a closed configuration, q = pinconsist.assemble(mechanism).q"
        )
    return None


def _force(force, mechanism, smaller, locked, state):
    """The force on the smaller model; None if it has nothing left to act on."""
    if isinstance(force, Actuator):
        return _actuator(force, mechanism.model, locked, state)
    if isinstance(force, SpringDamper):
        return None if _body(smaller, force.frame1) == _body(smaller, force.frame2) else force
    if isinstance(force, Wrench):
        return None if _body(smaller, force.frame) == 0 else force
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
    """The actuator on the joints that are left, its law for the length that these have."""
    left = {joint: arm for joint, arm in force.arms.items() if joint not in locked}
    if len(left) == len(force.arms) or not left:
        return force if left else None
    still = (joint for joint in force.arms if joint in locked)
    length = sum(force.arms[joint] * Coordinate(model, joint, "lock", "locked").value(state.full) for joint in still)
    gain, bias = ((law[0] + length * law[1], *law[1:]) for law in (force.gain, force.bias))
    return replace(force, joint=left, gear=1.0, gain=gain, bias=bias)


def _body(model, frame):
    return model.frames[model.getFrameId(frame)].parentJoint


class _WholeState:
    """The whole state of a mechanism from that of the joints that are left; the locked ones are at rest."""

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
    """A user's function of the whole state as one of the joints that are left; of its last axes `only` is taken."""

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


def rebuilt(
    model: pin.Model,
    parts: Mapping[str, Sequence[tuple[str, object]]],
    poses: Mapping[str, pin.SE3] = {},
    order: Sequence[int] | None = None,
) -> pin.Model:
    """A copy of a model with joints replaced; frames keep their names and indices, bodies their inertia.

    `parts`: joint name → the (name, joint model) that replace it, one after the other; the last carries its body, all
    have its damping, friction and armature. An empty sequence fixes the joint (``pin.buildReducedModel`` would need a
    frame for it), with its body at `poses` in the joint frame. `order`: of the joints, parents before children.
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
