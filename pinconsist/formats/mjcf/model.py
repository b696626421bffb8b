"""MuJoCo's compiled model → the tree of a pin.Model, its loops, and its forces.

Several joints of one body become a chain of joints with massless bodies between them. The position of a joint is
MuJoCo's ``qpos``, which is ``ref`` in the configuration of the file. Source: MuJoCo's "XML Reference", and mjmodel.h.
"""

import numpy as np
import pinocchio as pin
from numpy.polynomial import Polynomial

from ...errors import FormatError, InputError, warn
from ...mechanism.checks import places, workspace
from ...mechanism.forces import Actuator, FluidDrag, FluidEllipsoid, JointSpring, SpringDamper, Wrench
from ...mechanism.joint_constraints import Coupling, Drive
from ...mechanism.loops import GROUND, Loop, anchor
from ...mechanism.motion import Motion
from ..extensions import unique
from ..reading import LARGEST, located

_FREE, _BALL, _SLIDE, _HINGE = range(4)
_KINDS = ("free", "ball", "slide", "hinge")
_EQUALITIES = ("connect", "weld", "joint")
_SITE = 6
_SPHERE, _CAPSULE, _CYLINDER = 2, 3, 5  # kinds of geoms
_TENDON = 3  # a kind of transmission
_WRAPS_JOINT, _WRAPS_SITE = 1, 3  # kinds of tendon elements
_AXES = {(1.0, 0.0, 0.0): "X", (0.0, 1.0, 0.0): "Y", (0.0, 0.0, 1.0): "Z"}
_JOINTS = {_SLIDE: ("P", pin.JointModelPrismaticUnaligned), _HINGE: ("R", pin.JointModelRevoluteUnaligned)}
_POSITIVE = "jnt_stiffness dof_armature dof_damping dof_frictionloss".split()
_FINITE = (
    "body_pos body_quat body_ipos body_iquat body_mass body_inertia body_gravcomp jnt_pos jnt_axis site_pos site_quat "
    "eq_data qpos0 qpos_spring key_qpos"
).split() + _POSITIVE
_ZERO = (
    "jnt_springyield jnt_stiffnesspoly dof_dampingpoly actuator_armature actuator_damping actuator_dampingpoly "
    "tendon_stiffnesspoly tendon_dampingpoly"
).split()
"""Quantities that act on the bodies in MuJoCo and are not supported here; older versions lack some of them."""


class Tree:
    """The tree of a compiled model; FormatError if something unsupported acts on the bodies."""

    def __init__(self, compiled, name: str):
        import mujoco

        self._m = m = compiled
        _check(m)
        bits = mujoco.mjtDisableBit.__members__.items()
        self.off = {name.removeprefix("mjDSBL_").lower() for name, bit in bits if m.opt.disableflags & bit.value}
        self.off |= {"spring", "damper"} if "passive" in self.off else set()  # the flag of older versions
        self.joints, self.bodies, self.sites = _names(m)
        self.model = model = pin.Model()
        model.name = name
        model.gravity.linear = np.array(m.opt.gravity) * ("gravity" not in self.off)
        self._weightless: list[tuple[int, float]] = []  # joint, mass on it on which gravity does not act
        self._stands = stands = []  # joint, place on it, frame
        for body in range(m.nbody):
            joint, place, frame = stands[m.body_parentid[body]] if body else (0, pin.SE3.Identity(), 0)
            place = place * pose(m.body_pos[body], m.body_quat[body])
            for j in np.flatnonzero(m.jnt_bodyid == body):
                joint, place = self._add_joint(j, joint, place)
                frame = model.addJointFrame(joint, frame)
            stands.append((joint, place, model.addBodyFrame(self.bodies[body], joint, place, frame)))
            if joint:
                inertia = pin.Inertia(m.body_mass[body], np.zeros(3), np.diag(m.body_inertia[body]))
                model.appendBodyToJoint(joint, pose(m.body_ipos[body], m.body_iquat[body]).act(inertia), place)
            if m.body_mocapid[body] >= 0:
                warn(f"{_element(m, 'body', body)}: nothing moves a mocap body here; it stays fixed")
        self.tendons = self._add_tendons()
        for site in np.flatnonzero(self.sites):
            joint, place, frame = stands[m.site_bodyid[site]]
            place = place * pose(m.site_pos[site], m.site_quat[site])
            model.addFrame(pin.Frame(self.sites[site], joint, frame, place, pin.FrameType.OP_FRAME))

    def _add_tendons(self) -> dict[str, dict[str, float]]:
        """Add a slide without mass for each tendon with an inertia or dry friction, whose position is its length.

        Returns the joints of these tendons with their shares; a coupling makes the slide follow them.
        """
        m, model, found = self._m, self.model, {}
        friction = m.tendon_frictionloss * (not {"frictionloss", "constraint"} & self.off)
        for tendon in np.flatnonzero((m.tendon_armature != 0) | (friction != 0)):
            shares = {self.joints[joint]: share for joint, share in self._moved(_TENDON, tendon).items() if share}
            if not shares:
                raise self._tendon_error(tendon, "an armature or frictionloss is supported for fixed tendons only")
            name = m.tendon(tendon).name or f"tendon {tendon + 1}"
            while name in (*model.names, *self.bodies, *self.sites, *found):
                name += "_tendon"
            joint = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), name)
            model.addJointFrame(joint)
            v = places(model, joint)[1]
            model.armature[v] = m.tendon_armature[tendon]
            model.lowerDryFrictionLimit[v], model.upperDryFrictionLimit[v] = -friction[tendon], friction[tendon]
            found[name] = shares
        return found

    def _add_joint(self, j, parent, place):
        """Add a joint to a body at `place` on the parent joint; return the joint, and the body's placement on it."""
        m, model, kind = self._m, self.model, int(self._m.jnt_type[j])
        axis, ref = np.array(m.jnt_axis[j]), m.qpos0[m.jnt_qposadr[j]]
        there = pin.SE3(np.eye(3), np.array(m.jnt_pos[j]))
        before, after = place * there, there.inverse()
        if kind == _HINGE:
            before = before * pin.SE3(pin.AngleAxis(-ref, axis).toRotationMatrix(), np.zeros(3))
        elif kind == _SLIDE:
            before, after = place * pin.SE3(np.eye(3), -ref * axis), pin.SE3.Identity()
        elif kind == _FREE:
            before = after = pin.SE3.Identity()
        if kind not in _JOINTS:
            made = pin.JointModelSpherical() if kind == _BALL else pin.JointModelFreeFlyer()
        else:
            letter, general = _JOINTS[kind]
            along = _AXES.get(tuple(axis))
            made = getattr(pin, f"JointModel{letter}{along}")() if along else general(axis)
        joint = model.addJoint(parent, made, before, self.joints[j])
        q, v = places(model, joint)
        friction = m.dof_frictionloss[v] * (kind != _FREE and not {"frictionloss", "constraint"} & self.off)
        model.armature[v], model.damping[v] = m.dof_armature[v], m.dof_damping[v] * ("damper" not in self.off)
        if kind == _FREE and m.dof_armature[v].any():  # along the world's axes: a mass without weight at the origin
            mass = float(m.dof_armature[v][0])
            model.armature[v] = 0.0
            model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), mass * np.eye(3)), pin.SE3.Identity())
            self._weightless.append((joint, mass))
        model.lowerDryFrictionLimit[v], model.upperDryFrictionLimit[v] = -friction, friction
        if kind in _JOINTS:
            ends = m.jnt_range[j] if m.jnt_limited[j] else (-np.inf, np.inf)
            model.lowerPositionLimit[q], model.upperPositionLimit[q] = ends
        return joint, after

    def configuration(self, qpos) -> np.ndarray:
        """The configuration of a ``qpos``, whose quaternions are ordered w, x, y, z."""
        q = np.array(qpos)
        for kind, start in zip(self._m.jnt_type, self._m.jnt_qposadr, strict=True):
            if kind not in _JOINTS:
                turn = start + 3 * (kind == _FREE) + np.arange(4)
                q[turn] = np.roll(q[turn], -1)
        index = {joint: i for i, joint in enumerate(self.joints)}
        lengths = [
            sum(share * q[self._m.jnt_qposadr[index[joint]]] for joint, share in shares.items())
            for shares in self.tendons.values()
        ]
        return np.concatenate((q, lengths))

    def forces(self):
        """Springs of joints, and forces that compensate gravity."""
        m = self._m
        for j in np.flatnonzero(m.jnt_stiffness) if "spring" not in self.off else ():
            yield JointSpring(self.joints[j], float(m.jnt_stiffness[j]), self._rest(j))
        if (m.opt.density or m.opt.viscosity) and not {"spring", "damper"} <= self.off:
            yield from self._drags()
        for tendon in range(m.ntendon):
            yield from self._tendon(tendon)
        for joint, mass in self._weightless:
            yield Wrench(self.joints[joint - 1], tuple((-mass * self.model.gravity.linear).tolist()))
        if not {"spring", "damper"} <= self.off:  # together, the two flags disable all passive forces
            for body in np.flatnonzero(m.body_gravcomp * m.body_mass):
                force = -m.body_gravcomp[body] * m.body_mass[body] * self.model.gravity.linear
                if self._stands[body][0]:
                    yield Wrench(self.bodies[body], tuple(force), xyz=tuple(m.body_ipos[body]))

    def _drags(self):
        """The drag of each body in the fluid: that of its ellipsoids, or of a box with its mass and inertia."""
        m, wind = self._m, tuple(np.array(self._m.opt.wind).tolist())
        fluid = float(m.opt.density), float(m.opt.viscosity)
        ellipsoids = np.flatnonzero(m.geom_fluid[:, 0] > 0)
        for g in ellipsoids:
            body, (_, *coefficients) = int(m.geom_bodyid[g]), m.geom_fluid[g].tolist()
            if self._stands[body][0]:
                own = _position(pose(m.geom_pos[g], m.geom_quat[g]))
                more = tuple(coefficients[:5]), tuple(coefficients[5:])
                yield FluidEllipsoid(self.bodies[body], _semiaxes(m, g), *fluid, wind, *own, *more)
        for body in sorted(set(range(m.nbody)) - set(m.geom_bodyid[ellipsoids].tolist())):
            if self._stands[body][0] and m.body_mass[body] > 0.0:
                a, b, c = m.body_inertia[body]
                sizes = np.sqrt(np.maximum(6.0 * np.array([b + c - a, a + c - b, a + b - c]) / m.body_mass[body], 0.0))
                own = _position(pose(m.body_ipos[body], m.body_iquat[body]))
                yield FluidDrag(self.bodies[body], tuple(sizes.tolist()), *fluid, wind, *own)

    def _rest(self, j):
        """Where the spring of a joint is unloaded: a number, or those of a ball or free joint in q."""
        m, start = self._m, self._m.jnt_qposadr[j]
        if m.jnt_type[j] in _JOINTS:
            return float(m.qpos_spring[start])
        size = 4 if m.jnt_type[j] == _BALL else 7
        rest = np.array(m.qpos_spring[start : start + size])
        rest[-4:] = np.roll(rest[-4:], -1)
        return tuple(rest.tolist())

    def _tendon(self, tendon):
        """The springs and dampers of a tendon; FormatError for what is not supported."""
        m = self._m
        stiffness = float(m.tendon_stiffness[tendon]) * ("spring" not in self.off)
        damping = float(m.tendon_damping[tendon]) * ("damper" not in self.off)
        if not (stiffness or damping):
            return
        low, high = map(float, m.tendon_lengthspring[tendon])
        rest = low if low == high else (low, high)
        shares = self._moved(_TENDON, tendon)
        if shares:
            joints = {self.joints[joint]: share for joint, share in shares.items()}
            yield JointSpring(joints, stiffness, rest, damping)
            return
        ends = self._sites_of(tendon)
        if stiffness and isinstance(rest, tuple):
            if rest[0] > 0.0 or len(ends) != 2:
                raise self._tendon_error(tendon, "a springlength of two numbers is supported for fixed tendons only")
            raise self._tendon_error(tendon, "a rope that is slack is not supported")
        if len(ends) == 2:
            yield SpringDamper(*ends, stiffness, rest if stiffness else 0.0, damping)
        else:
            reason = "it passes more than two sites, or a geom or a pulley, with a spring or damper"
            raise self._tendon_error(tendon, reason)

    def _tendon_error(self, tendon, reason):
        """The error about a tendon, with what leaves out all that are not supported."""
        m, words = self._m, []
        acting = (m.tendon_stiffness, m.tendon_damping, m.tendon_armature, m.tendon_frictionloss)
        for each in np.flatnonzero(np.any(acting, axis=0) & (m.wrap_type[m.tendon_adr] != _WRAPS_JOINT)):
            ends = m.tendon_lengthspring[each]
            plain = not (m.tendon_armature[each] or m.tendon_frictionloss[each]) and ends[0] == ends[1]
            if not (plain and len(self._sites_of(each)) == 2):
                words.append(m.tendon(each).name or "spatial")
        cure = f"ignore={list(dict.fromkeys(words))} loads the scene without {'them' if len(words) > 1 else 'it'}"
        return FormatError(f"{reason}; {cure}", element=_element(m, "tendon", tendon))

    def _sites_of(self, tendon) -> list[str]:
        """The sites of a spatial tendon; empty if it has geoms or pulleys."""
        m, start = self._m, self._m.tendon_adr[tendon]
        parts = slice(start, start + m.tendon_num[tendon])
        if (m.wrap_type[parts] != _WRAPS_SITE).any():
            return []
        return [self.sites[site] for site in m.wrap_objid[parts].tolist()]

    def actuators(self):
        """(joint, Actuator or None) on joints, (None, Actuator) on fixed tendons; warns if one exerts no force."""
        m, names, none = self._m, set(), np.zeros(self._m.nu)
        alone = np.bincount(m.actuator_trnid[m.actuator_trntype < 2, 0], minlength=m.njnt) == 1
        for i, (kind, (target, *_)) in enumerate(zip(m.actuator_trntype, m.actuator_trnid, strict=True)):
            joints = self._moved(kind, target)
            if not joints:
                warn(f"{_element(m, 'actuator', i)}: it acts on no joint and is left out")
                continue
            group = int(np.clip(m.actuator_group[i], 0, 31))  # all groups from 31 on share a switch
            limited = [joint for joint in joints if m.jnt_actfrclimited[joint]]
            reasons = {
                "its joint has several degrees of freedom": any(m.jnt_type[joint] not in _JOINTS for joint in joints),
                "it has dynamics of its own, or a delay": m.actuator_dyntype[i]
                or getattr(m, "actuator_delay", none)[i],
                "its gain or bias is not affine": m.actuator_gaintype[i] > 1 or m.actuator_biastype[i] > 1,
                "the options disable it": "actuation" in self.off or m.opt.disableactuator >> group & 1,
                "its joint has other actuators, and a limited actuator force": any(not alone[each] for each in limited),
                "the actuator force of its tendon, or of one of its joints, is limited": kind == _TENDON
                and (limited or getattr(m, "tendon_actfrclimited", np.zeros(m.ntendon))[target]),
            }
            joint = self.joints[target] if kind != _TENDON else None
            if why := next((reason for reason, holds in reasons.items() if holds), ""):
                warn(f"{_element(m, 'actuator', i)}: it exerts no force here: {why}")
                yield joint, None
                continue
            name = m.actuator(i).name or joint or m.tendon(target).name or f"actuator {i + 1}"
            names.add(name := name if name not in names else f"{name} {i + 1}")
            yield joint, self._actuator(i, joints, name)

    def _moved(self, kind, target) -> dict[int, float]:
        """Joint → its coefficient in the length of a transmission; empty if this is not a joint or a fixed tendon."""
        if kind != _TENDON:
            return {target: 1.0} if kind < 2 else {}  # joint and jointinparent
        m, start = self._m, self._m.tendon_adr[target]
        parts = slice(start, start + m.tendon_num[target])
        if (m.wrap_type[parts] != _WRAPS_JOINT).any():
            return {}
        return dict(zip(m.wrap_objid[parts].tolist(), m.wrap_prm[parts].tolist(), strict=True))

    def _actuator(self, i, shares, name):
        m, gear = self._m, float(self._m.actuator_gear[i, 0])
        ranges = [
            tuple(getattr(m, f"actuator_{what}range")[i].tolist()) if getattr(m, f"actuator_{what}limited")[i] else ()
            for what in ("ctrl", "force")
        ]
        if m.jnt_actfrclimited[first := next(iter(shares))] and gear:
            ends = sorted(m.jnt_actfrcrange[first] / gear)
            low, high = ranges[1] or (-np.inf, np.inf)
            ranges[1] = float(np.clip(low, *ends)), float(np.clip(high, *ends))
        if "clampctrl" in self.off:
            ranges[0] = ()
        affine = m.actuator_gaintype[i] == 1, m.actuator_biastype[i] == 1
        gain = m.actuator_gainprm[i, :3] * (1.0, affine[0], affine[0])
        bias = m.actuator_biasprm[i, :3] * affine[1]
        holds = gain[0] and bias[1] == -gain[0]  # a position actuator
        rest = gear * sum(share * m.qpos0[m.jnt_qposadr[joint]] for joint, share in shares.items()) if holds else 0.0
        control = m.key_ctrl[0, i] if m.nkey else rest
        numbers = (tuple(each.tolist()) for each in (gain, bias))
        joints = {self.joints[joint]: share for joint, share in shares.items()}
        on = next(iter(joints)) if m.actuator_trntype[i] != _TENDON else joints
        return Actuator(name, on, *numbers, gear, float(control), *ranges)

    def closures(self):
        """Loops, couplings and drives of the active equality constraints, in their order; warns of the others."""
        for tendon, shares in self.tendons.items():
            yield Coupling(tendon, tendon, _plain(shares))
        m, off = self._m, sorted(self.off & {"equality", "constraint"})
        if m.neq:
            data = workspace(self.model)
            pin.framesForwardKinematics(self.model, data, pin.normalize(self.model, self.configuration(m.qpos0)))
        for e in range(m.neq):
            kind = (*_EQUALITIES, "tendon", *["flex"] * 9)[m.eq_type[e]]
            name = unique(m.eq(e).name or f"{kind}{e + 1}", self.tendons)
            if off or not m.eq_active0[e]:
                reason = f"the option's flag {off[0]} is disabled" if off else "it is not active"
                warn(f"equality {name!r}: left out, {reason}")
                continue
            if kind in ("connect", "weld") and self._moves_nothing(e):
                warn(f"equality {name!r}: left out, its bodies do not move relative to each other")
                continue
            with located(element=f"equality {name!r}"):
                if kind == "tendon":
                    yield self._tied(e, name)
                elif kind not in _EQUALITIES:
                    cure = f"ignore=[{name!r}] loads the scene without it"
                    raise InputError(f"equality of {kind}s is not supported; {cure}")
                else:
                    yield self._coupling(e, name) if kind == "joint" else self._loop(e, kind, name, data)

    def _of_sites(self, e) -> bool:
        """Whether an equality is between sites, which older versions of MuJoCo do not have."""
        return getattr(self._m, "eq_objtype", {e: 0})[e] == _SITE

    def _moves_nothing(self, e) -> bool:
        """Whether the bodies or sites of an equality are on one joint, or on the ground."""
        m, ends = self._m, (self._m.eq_obj1id[e], self._m.eq_obj2id[e])
        if self._of_sites(e):
            ends = [m.site_bodyid[i] for i in ends]
        return self._stands[ends[0]][0] == self._stands[ends[1]][0]

    def _loop(self, e, kind, name, data):
        """The loop of a connect or weld, between sites or bodies."""
        values = self._m.eq_data[e]
        ends = self._m.eq_obj1id[e], self._m.eq_obj2id[e]
        if self._of_sites(e):
            frames, places = [self.sites[i] for i in ends], [pin.SE3.Identity()] * 2
        else:
            frames = [self.bodies[i] if i else GROUND for i in ends]
            there = pin.SE3(np.eye(3), np.array(values[:3]))
            one, two = (data.oMf[self.model.getFrameId(frame)] for frame in frames)
            weld = kind == "weld"
            places = [pose(values[3:6], values[6:10]), there] if weld else [there, two.actInv(one) * there]
        kind = "frame" if kind == "weld" and values[10] else "point"
        return Loop(name, kind, *frames, **anchor(1, places[0]), **anchor(2, places[1]))

    def _coupling(self, e, name):
        """q1 - ref1 = Σ a_i (q2 - ref2)^i, multiplied out; without a second joint, the first is held at ref1 + a_0."""
        m, a, ends = self._m, self._m.eq_data[e].tolist(), (self._m.eq_obj1id[e], self._m.eq_obj2id[e])
        (joint, ref1), (other, ref2) = ((self.joints[j], float(m.qpos0[m.jnt_qposadr[j]])) for j in ends)
        if ends[1] < 0:
            return Drive(name, joint, Motion(start=ref1 + a[0]))
        law = Polynomial(a[:5])(Polynomial((-ref2, 1.0))).coef.tolist()  # trailing zeros are dropped
        offset, ratio, *higher = law if len(law) > 1 else (*law, 0.0)
        return Coupling(name, joint, other, ratio=ratio, offset=ref1 + offset, higher=tuple(higher))

    def _tied(self, e, name):
        """L1 - L1(0) = Σ a_i (L2 - L2(0))^i of two tendons, or of one, whose length is then constant."""
        m, a, ends = self._m, self._m.eq_data[e].tolist(), (self._m.eq_obj1id[e], self._m.eq_obj2id[e])
        first = self._moved(_TENDON, ends[0])
        if not first:
            sites = self._sites_of(ends[0])
            if len(sites) == 2 and ends[1] < 0:
                return Loop(name, "distance", *sites, length=float(m.tendon_length0[ends[0]]) + a[0])
            raise InputError("the tendons of an equality must be fixed ones, or a single one between two sites")
        shares = {self.joints[joint]: share for joint, share in first.items() if share}
        length = float(m.tendon_length0[ends[0]])
        if ends[1] < 0:
            (joint, share), *others = shares.items()
            if not others:
                return Drive(name, joint, Motion(start=(length + a[0]) / share))
            rest = {other: -each / share for other, each in others}
            return Coupling(name, joint, rest, 1.0, (length + a[0]) / share)
        second = {self.joints[joint]: share for joint, share in self._moved(_TENDON, ends[1]).items() if share}
        if not second:
            raise InputError("the tendons of an equality must be fixed ones")
        law = Polynomial(a[:5])(Polynomial((-float(m.tendon_length0[ends[1]]), 1.0))).coef.tolist()
        offset, ratio, *higher = law if len(law) > 1 else (*law, 0.0)
        if higher or not shares.keys() & second.keys():
            return Coupling(name, _plain(shares), _plain(second), ratio, length + offset, tuple(higher))
        for joint, share in second.items():
            shares[joint] = shares.get(joint, 0.0) - ratio * share
        (joint, share), *others = ((joint, share) for joint, share in shares.items() if share)
        rest = {other: -each for other, each in others}
        return Coupling(name, _plain({joint: share}), _plain(rest), 1.0, length + offset)


def _plain(shares):
    """One joint with share 1 by its name."""
    return next(iter(shares)) if list(shares.values()) == [1.0] else shares


def _position(place):
    """(xyz, rpy) of a pose."""
    return tuple(place.translation.tolist()), tuple(pin.rpy.matrixToRpy(place.rotation).tolist())


def _semiaxes(m, g) -> tuple[float, ...]:
    """Half the axes of the ellipsoid that stands for a geom in a fluid."""
    radius, half, _ = size = m.geom_size[g].tolist()
    kind = int(m.geom_type[g])
    if kind == _SPHERE:
        return radius, radius, radius
    if kind in (_CAPSULE, _CYLINDER):
        return radius, radius, half + radius * (kind == _CAPSULE)
    return tuple(size)


def pose(pos, quat) -> pin.SE3:
    """The pose of a position and a quaternion w, x, y, z."""
    return pin.SE3(pin.Quaternion(*quat).toRotationMatrix(), np.array(pos))


def _check(m) -> None:
    """FormatError for invalid numbers, and for anything unsupported that acts on the bodies."""
    for key in _FINITE:
        _refuse(m, key, ~(np.abs(getattr(m, key)) <= LARGEST), f"not finite, or above {LARGEST:g}")
    for key in _POSITIVE:
        _refuse(m, key, getattr(m, key) < 0, "negative")
    for key in _ZERO:
        _refuse(m, key, getattr(m, key, np.zeros(0)) != 0, "not supported")
    _refuse(m, "body_plugin", m.body_plugin >= 0, "not supported")
    _refuse(m, "jnt_actgravcomp", m.jnt_actgravcomp & m.jnt_actfrclimited, "not supported with an actuatorfrcrange")
    if m.nv == 0:
        raise FormatError("nothing can move: no body has a joint")


def _refuse(m, key, bad, reason):
    """FormatError that names the first element with a bad number."""
    if np.any(bad):
        kind, _, what = key.partition("_")
        number = int(np.argmax(bad.reshape(len(bad), -1).any(axis=1)))
        kind, number = ("jnt", m.dof_jntid[number]) if kind == "dof" else (kind, number)
        what = f"nonlinear {what[:-4]}" if what.endswith("poly") else what
        raise FormatError(f"{what} is {reason}", element=_element(m, kind, number))


def _element(m, kind, number) -> str:
    found = getattr(m, kind, None)
    return f"{kind.replace('jnt', 'joint')} {found(number).name or int(number) + (kind != 'body')!r}" if found else ""


def _names(m):
    """The names of joints, bodies and sites, which are all frames in Pinocchio; unnamed sites stay without a name.

    Joints keep their names. ``_body`` or ``_site`` is appended to the name of a body or site if another frame has it.
    Unnamed bodies and joints are called ``body3``, ``body3_hinge``, or ``body3_hinge2`` if a body has several hinges.
    """
    every = ((m.jnt, m.njnt), (m.body, m.nbody), (m.site, m.nsite))
    joints, bodies, sites = ([found(i).name for i in range(count)] for found, count in every)
    if "universe" in (*joints, *bodies, *sites):
        raise FormatError("'universe' is the name of the ground here; rename this element")
    taken = {"universe", *joints}

    def free(name, kind):
        ends = ("", f"_{kind}", *(f"_{kind}{number}" for number in range(2, len(taken) + 2)))
        found = next(name + end for end in ends if name + end not in taken)
        taken.add(found)
        return found

    bodies = [name and free(name, "body") for name in bodies]
    sites = [name and free(name, "site") for name in sites]
    bodies = [name or free(f"body{i}", "body") for i, name in enumerate(bodies)]
    for j, (body, kind) in enumerate(zip(m.jnt_bodyid, m.jnt_type, strict=True)):
        alike = np.flatnonzero((m.jnt_bodyid == body) & (m.jnt_type == kind)).tolist()
        number = alike.index(j) + 1 if len(alike) > 1 else ""
        joints[j] = joints[j] or free(f"{bodies[body]}_{_KINDS[kind]}{number}", "joint")
    return joints, bodies, sites
