"""Mechanism → MJCF. Joints keep their positions; the guess is the keyframe.

MuJoCo holds loops by springs: ``connect``, ``weld`` and ``joint`` give way under load, by an amount that ``solref`` and
``solimp`` say. What is read back here is rigid again. A hinge is two connected points on its axis.
"""

from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np
import pinocchio as pin

from ..mechanism.checks import places
from ..mechanism.forces import Actuator, JointSpring, SpringDamper, Wrench
from ..mechanism.forces.force import label_of
from .reading import text
from .saying import Motion1, Said, Unsaid, in_world, least_inertia, require_same_motion, said

ARM = 0.1  # m, between the two points of a hinge
NO_OTHER_LIMIT = 1e10  # rad or m: the other end of a limit on one side
_JOINTS = {"revolute": "hinge", "prismatic": "slide", "ball": "ball", "free": "free"}


def document(mechanism, name: str, links, frames) -> str:
    """The text of a mechanism; Unsaid for what MJCF cannot say. `frames` are (name, joint, placement)."""
    parts = said(mechanism, "MJCF", links)
    return _Writer(parts, name, frames).document()


def require_same(mechanism, back) -> None:
    """Raise Unsaid unless the file that was read back is the same machine."""
    require_same_motion(mechanism, back, in_world(mechanism))


class _Writer:
    def __init__(self, parts: Said, name, frames):
        self.parts, self.model = parts, parts.mechanism.model
        self.root = Element("mujoco", model=name)
        SubElement(self.root, "compiler", angle="radian", autolimits="true", balanceinertia="false")
        gravity = text(*self.model.gravity.linear)
        option = SubElement(self.root, "option", gravity=gravity)
        SubElement(option, "flag", contact="disable")
        self.world = SubElement(self.root, "worldbody")
        self.tendon, self.equality, self.actuator = (Element(tag) for tag in ("tendon", "equality", "actuator"))
        self._nodes, self._controls = {0: self.world}, []
        self._names = {*links_of(parts), *(joint.name for joint in parts.joints), *(frame for frame, _, _ in frames)}
        for joint in parts.joints:
            self._body(joint)
        for frame, joint, place in frames:
            self._site(frame, joint, place)

    def document(self) -> str:
        for loop in self.parts.loops:
            self._loop(loop)
        for coupling in self.parts.couplings:
            self._coupling(coupling)
        for force in self.parts.forces:
            self._force(force)
        for section in (self.tendon, self.equality, self.actuator):
            if len(section):
                self.root.append(section)
        key = SubElement(SubElement(self.root, "keyframe"), "key", name="start")
        key.set("qpos", text(*self._qpos(self.parts.mechanism.guess)))
        if any(self._controls):
            key.set("ctrl", text(*self._controls))
        indent(self.root)
        return tostring(self.root, encoding="unicode") + "\n"

    def _qpos(self, q):
        qpos, convert = np.array(q), in_world(self.parts.mechanism)
        for joint in self.parts.joints:
            own = places(self.model, joint.index)[0]
            qpos[own] = convert(joint.name, qpos[own])
            if joint.kind in ("ball", "free"):
                start = self.model.idx_qs[joint.index] + 3 * (joint.kind == "free")
                qpos[start : start + 4] = np.roll(qpos[start : start + 4], 1)
        return qpos

    def _body(self, joint: Motion1):
        if joint.kind not in _JOINTS:
            raise Unsaid(f"MJCF has no joint like {joint.name!r}, which is {joint.kind}")
        parent = self.model.parents[joint.index]
        if joint.kind == "free" and parent:
            raise Unsaid(f"MJCF has free joints on the ground only, and {joint.name!r} is on a body")
        place = self.model.jointPlacements[joint.index]
        node = SubElement(self._nodes[parent], "body", name=self.parts.links[joint.index], **_place(place))
        self._nodes[joint.index] = node
        own = self.model.inertias[joint.index]
        own = own if own.mass > 0.0 else least_inertia(self.model)
        I = own.inertia
        full = text(I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2])
        SubElement(node, "inertial", pos=text(*own.lever), mass=text(own.mass), fullinertia=full)
        values = {"name": joint.name, "type": _JOINTS[joint.kind]}
        if joint.axis is not None:
            values["axis"] = text(*joint.axis)
        if np.isfinite([joint.lower, joint.upper]).any():
            values["range"] = text(*np.clip([joint.lower, joint.upper], -NO_OTHER_LIMIT, NO_OTHER_LIMIT))
        numbers = {"damping": joint.damping, "frictionloss": joint.friction, "armature": joint.armature}
        values |= {key: text(value) for key, value in numbers.items() if value}
        if joint.stiffness:
            if isinstance(joint.rest, tuple) or joint.axis is None:
                raise Unsaid(f"the spring of joint {joint.name!r} cannot be written as MJCF")
            values |= {"stiffness": text(joint.stiffness), "springref": text(joint.rest)}
        if joint.kind == "free" and (joint.friction or joint.armature):
            raise Unsaid(f"the friction or rotor inertia of the free joint {joint.name!r} cannot be written as MJCF")
        SubElement(node, "joint", values)

    def _site(self, name, joint, place) -> str:
        while name in self._names and name in [each.get("name") for each in self.root.iter("site")]:
            name += "_"
        self._names.add(name)
        SubElement(self._nodes[joint], "site", name=name, **_place(place))
        return name

    def _ends(self, loop, shift=None, label=""):
        """The sites of both anchors, or of points beside them."""
        moved = pin.SE3(np.eye(3), np.zeros(3) if shift is None else np.array(shift))
        found = []
        for end in (1, 2):
            joint, place = self.parts.anchor(loop, end)
            found.append(self._site(f"{loop.name}{label} {end}", joint, place * moved))
        return {"site1": found[0], "site2": found[1]}

    def _loop(self, loop):
        if loop.kind == "point":
            SubElement(self.equality, "connect", name=loop.name, **self._ends(loop))
        elif loop.kind == "frame":
            SubElement(self.equality, "weld", name=loop.name, **self._ends(loop))
        elif loop.kind == "hinge":
            axis = np.array(loop.axis) / np.linalg.norm(loop.axis)
            SubElement(self.equality, "connect", name=loop.name, **self._ends(loop))
            second = self._ends(loop, ARM * axis, " axis")
            SubElement(self.equality, "connect", name=f"{loop.name} axis", **second)
        elif loop.kind == "distance":
            sites = self._ends(loop)
            spatial = SubElement(self.tendon, "spatial", name=loop.name)
            for end in ("site1", "site2"):
                SubElement(spatial, "site", site=sites[end])
            excess = text(loop.length - self._length0(loop))
            SubElement(self.equality, "tendon", name=loop.name, tendon1=loop.name, polycoef=f"{excess} 0 0 0 0")
        else:
            raise Unsaid(f"MJCF has no equality like the loop {loop.name!r}, of kind {loop.kind!r}")

    def _length0(self, loop) -> float:
        """The length of a distance at q = 0, from which MuJoCo counts."""
        data = self.model.createData()
        pin.forwardKinematics(self.model, data, pin.neutral(self.model))
        ends = [self.parts.anchor(loop, end) for end in (1, 2)]
        points = [(data.oMi[joint] * place).translation for joint, place in ends]
        return float(np.linalg.norm(points[1] - points[0]))

    def _coupling(self, coupling):
        law = (coupling.offset, coupling.ratio, *coupling.higher)
        if len(law) > 5:
            raise Unsaid(f"MJCF has powers up to the fourth, and the coupling {coupling.name!r} has more")
        law = text(*law, *[0.0] * (5 - len(law)))
        if isinstance(coupling.joint, str) and isinstance(coupling.other, str):
            ends = {"joint1": coupling.joint, "joint2": coupling.other}
            SubElement(self.equality, "joint", name=coupling.name, polycoef=law, **ends)
            return
        ends = {}
        for number, shares in enumerate(coupling.shares, start=1):
            ends[f"tendon{number}"] = self._fixed(f"{coupling.name} {number}", shares)
        SubElement(self.equality, "tendon", name=coupling.name, polycoef=law, **ends)

    def _fixed(self, name, shares, **values) -> str:
        node = SubElement(self.tendon, "fixed", name=name, **values)
        for joint, share in shares.items():
            SubElement(node, "joint", joint=joint, coef=text(share))
        return name

    def _force(self, force):
        if isinstance(force, SpringDamper):
            values = {"stiffness": text(force.stiffness), "damping": text(force.damping)}
            node = SubElement(self.tendon, "spatial", springlength=text(force.length), **values)
            for number, (joint, point) in enumerate(force.bind(self.model).ends, start=1):
                site = self._site(f"{force.label} {number}", joint, pin.SE3(np.eye(3), np.array(point)))
                SubElement(node, "site", site=site)
        elif isinstance(force, JointSpring):
            shares = dict(force.joint) if not isinstance(force.joint, str) else {force.joint: 1.0}
            rest = force.rest if isinstance(force.rest, tuple) else (force.rest,)
            if len(rest) > 2 or min(rest) < 0.0:  # MuJoCo takes a negative length as that of the configuration
                raise Unsaid(f"the spring {force.label!r} cannot be written as MJCF")
            values = {"stiffness": text(force.stiffness), "damping": text(force.damping), "springlength": text(*rest)}
            self._fixed(force.label, shares, **values)
        elif isinstance(force, Actuator) and not callable(force.control):
            self._motor(force)
        elif isinstance(force, Wrench) and self._compensates(force):
            return
        else:
            label = label_of(force)
            raise Unsaid(f"MJCF has no force like {label!r}; leave it out: mech.with_forces(…)")

    def _compensates(self, force) -> bool:
        """Write a force that carries the weight of a whole body as gravity compensation."""
        frame = self.model.frames[self.model.getFrameId(force.frame)]
        own = self.model.inertias[frame.parentJoint]
        weight, point = own.mass * self.model.gravity.linear, frame.placement.act(np.array(force.xyz))
        plain = not callable(force.force) and not callable(force.moment) and not np.any(force.moment)
        if not plain or force.axes != "world" or not np.allclose(point, own.lever, atol=1e-12):
            return False
        factor = -float(np.dot(force.force, weight)) / max(float(weight @ weight), 1e-300)
        if not np.allclose(np.array(force.force), -factor * weight, rtol=1e-12, atol=1e-12):
            return False
        self._nodes[frame.parentJoint].set("gravcomp", text(factor))
        return True

    def _motor(self, force):
        values = {"name": force.name, "gear": text(force.gear), "gaintype": "affine", "gainprm": text(*force.gain)}
        values |= {"biastype": "affine", "biasprm": text(*force.bias)}
        if isinstance(force.joint, str):
            values["joint"] = force.joint
        else:
            values["tendon"] = self._fixed(f"{force.name} tendon", force.joint)
        for what, ends in (("ctrl", force.control_range), ("force", force.force_range)):
            if ends:
                values[f"{what}range"] = text(*ends)
        SubElement(self.actuator, "general", values)
        self._controls.append(force.control)


def links_of(parts):
    return parts.links[1:]


def _place(place) -> dict[str, str]:
    x, y, z, w = pin.Quaternion(place.rotation).coeffs()
    return {"pos": text(*place.translation), "quat": text(w, x, y, z)}
