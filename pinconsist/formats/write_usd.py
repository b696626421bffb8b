"""Mechanism → USD (UsdPhysics), written by usd-core (``pip install 'pinconsist[usd]'``), in metres and kilograms.

The bodies stand where the loops are closed. The frames of a joint are Xforms on its bodies, in double precision, to
which the joint refers. Numbers that USD has in single precision only are repeated as ``pinconsist:…`` in double
precision if they would change.
"""

import math
import re

import numpy as np
import pinocchio as pin

from ..mechanism.forces import Actuator
from ..mechanism.forces.force import label_of
from ..mechanism.loops import LOOP_KINDS
from ..mechanism.names import is_revolute
from .saying import Motion1, Said, Unsaid, in_world, least_inertia, require_same_motion, said
from .usd import EXACT, package

_DIRECTIONS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
_DEGREES = 180.0 / math.pi


def document(mechanism, name: str, links, frames) -> str:
    """The text of a mechanism; Unsaid for what UsdPhysics cannot say. `frames` are (name, joint, placement)."""
    return _Writer(said(mechanism, "USD", links), name, frames).text()


def require_same(mechanism, back) -> None:
    """Raise Unsaid unless the file that was read back is the same machine."""
    require_same_motion(mechanism, back, in_world(mechanism))


class _Writer:
    def __init__(self, parts: Said, name, frames):
        self.Gf, self.Sdf, Usd, self.UsdGeom, self.UsdPhysics = package()
        self.parts, self.model = parts, parts.mechanism.model
        self.stage = Usd.Stage.CreateInMemory()
        self.UsdGeom.SetStageUpAxis(self.stage, self.UsdGeom.Tokens.z)
        self.UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        self.UsdPhysics.SetStageKilogramsPerUnit(self.stage, 1.0)
        self.root = f"/{_identifier(name)}"
        self.stage.SetDefaultPrim(self.UsdGeom.Xform.Define(self.stage, self.root).GetPrim())
        self._taken: set[str] = set()
        self._joints: dict[str, str] = {}
        self._gravity()
        self._bodies = {0: ""}
        for joint in parts.joints:
            self._body(joint)
        for frame, joint, place in frames:
            if joint:
                self._frame(joint, frame, place)

    def text(self) -> str:
        for joint in self.parts.joints:
            self._joint(joint)
        for loop in self.parts.loops:
            self._loop(loop)
        for coupling in self.parts.couplings:
            self._coupling(coupling)
        for force in self.parts.forces:
            self._force(force)
        return self.stage.GetRootLayer().ExportToString()

    def _path(self, name, under=None) -> str:
        """A path for a name, of the letters that USD allows."""
        base = f"{under or self.root}/{_identifier(name)}"
        path, number = base, 1
        while path in self._taken:
            number += 1
            path = f"{base}_{number}"
        if path.rpartition("/")[2] != name and under is None:
            raise Unsaid(f"USD has no name {name!r}: letters, digits and underscores; rename it")
        self._taken.add(path)
        return path

    def _put(self, attribute, value):
        """Set an attribute; if its single precision changes the value, also the exact one."""
        attribute.Set(value)
        stored = attribute.Get()
        prim, name = attribute.GetPrim(), f"{EXACT}{attribute.GetName()}"
        if isinstance(value, float):
            if float(str(np.float32(stored))) != value:
                prim.CreateAttribute(name, self.Sdf.ValueTypeNames.Double, True).Set(value)
            return
        exact = [*value.GetImaginary(), value.GetReal()] if hasattr(value, "GetImaginary") else list(value)
        own = [*stored.GetImaginary(), stored.GetReal()] if hasattr(stored, "GetImaginary") else list(stored)
        if [float(str(np.float32(each))) for each in own] != exact:
            prim.CreateAttribute(name, self.Sdf.ValueTypeNames.DoubleArray, True).Set(exact)

    def _gravity(self):
        gravity = np.array(self.model.gravity.linear)
        scene = self.UsdPhysics.Scene.Define(self.stage, f"{self.root}/physics")
        size = float(np.linalg.norm(gravity))
        if size:
            self._put(scene.CreateGravityDirectionAttr(), self.Gf.Vec3f(*(gravity / size).tolist()))
            attribute = scene.GetGravityDirectionAttr()
            exact = (gravity / size).tolist()
            name = f"{EXACT}{attribute.GetName()}"
            attribute.GetPrim().CreateAttribute(name, self.Sdf.ValueTypeNames.DoubleArray, True).Set(exact)
        self._put(scene.CreateGravityMagnitudeAttr(), size)

    def _xform(self, path, place):
        xform = self.UsdGeom.Xform.Define(self.stage, path)
        xform.AddTranslateOp(self.UsdGeom.XformOp.PrecisionDouble).Set(self.Gf.Vec3d(*place.translation.tolist()))
        x, y, z, w = pin.Quaternion(place.rotation).coeffs().tolist()
        xform.AddOrientOp(self.UsdGeom.XformOp.PrecisionDouble).Set(self.Gf.Quatd(w, x, y, z))
        return xform.GetPrim()

    def _body(self, joint: Motion1):
        path = self._path(self.parts.links[joint.index])
        self._bodies[joint.index] = path
        prim = self._xform(path, self.parts.poses[joint.index])
        self.UsdPhysics.RigidBodyAPI.Apply(prim)
        own, api = self.model.inertias[joint.index], self.UsdPhysics.MassAPI.Apply(prim)
        own = own if own.mass > 0.0 else least_inertia(self.model)
        moments, axes = np.linalg.eigh(own.inertia)
        if np.linalg.det(axes) < 0.0:
            axes[:, 0] = -axes[:, 0]
        x, y, z, w = pin.Quaternion(axes).coeffs().tolist()
        self._put(api.CreateMassAttr(), float(own.mass))
        self._exact(api.CreateCenterOfMassAttr(), self.Gf.Vec3f, own.lever.tolist())
        self._exact(api.CreateDiagonalInertiaAttr(), self.Gf.Vec3f, moments.tolist())
        api.CreatePrincipalAxesAttr().Set(self.Gf.Quatf(w, x, y, z))
        self._double(api.GetPrincipalAxesAttr(), [x, y, z, w])

    def _exact(self, attribute, make, values):
        attribute.Set(make(*values))
        if [float(str(np.float32(each))) for each in attribute.Get()] != values:
            self._double(attribute, values)

    def _double(self, attribute, values):
        name = f"{EXACT}{attribute.GetName()}"
        attribute.GetPrim().CreateAttribute(name, self.Sdf.ValueTypeNames.DoubleArray, True).Set(values)

    def _frame(self, joint, name, place) -> str:
        """A frame on the body of a joint, or on the ground: its path."""
        path = self._path(name, self._bodies[joint] or self.root)
        self._xform(path, place)
        return path

    def _between(self, make, name, one, two):
        """A joint of a schema between two frames (joint, place)."""
        path = self._path(name)
        prim = make.Define(self.stage, path)
        for number, (joint, place) in enumerate((one, two)):
            frame = self._frame(joint, f"{name}_{number}", place)
            relation = prim.CreateBody0Rel() if number == 0 else prim.CreateBody1Rel()
            relation.SetTargets([frame])
        self._joints[name] = path
        return prim

    def _joint(self, joint: Motion1):
        model, physics = self.model, self.UsdPhysics
        parent, place = model.parents[joint.index], model.jointPlacements[joint.index]
        if joint.kind == "free":
            several = sum(each.kind == "free" for each in self.parts.joints)
            if parent or several > 1:
                raise Unsaid(f"USD has one floating body here, on the ground; {joint.name!r} cannot be written")
            return
        identity = pin.SE3.Identity()
        if joint.kind == "ball":
            self._plain(joint)
            self._between(physics.SphericalJoint, joint.name, (parent, place), (joint.index, identity))
            return
        if joint.kind not in ("revolute", "prismatic"):
            raise Unsaid(f"USD has no joint like {joint.name!r}, which is {joint.kind}")
        turns = joint.kind == "revolute"
        along = _along(joint.axis)
        make = physics.RevoluteJoint if turns else physics.PrismaticJoint
        made = self._between(make, joint.name, (parent, place * along), (joint.index, along))
        made.CreateAxisAttr("X")
        factor = _DEGREES if turns else 1.0
        for value, create in ((joint.lower, made.CreateLowerLimitAttr), (joint.upper, made.CreateUpperLimitAttr)):
            if math.isfinite(value):
                self._put(create(), value * factor)
        prim = made.GetPrim()
        for key, value in (("armature", joint.armature), ("jointFriction", joint.friction)):
            if value:
                self._put(prim.CreateAttribute(f"physxJoint:{key}", self.Sdf.ValueTypeNames.Float, True), value)
        if joint.stiffness or joint.damping:
            if isinstance(joint.rest, tuple):
                raise Unsaid(f"USD has no spring with two positions, as that of joint {joint.name!r}")
            self._drive(prim, turns, joint.stiffness, joint.damping, joint.rest)

    def _plain(self, joint):
        if joint.damping or joint.friction or joint.stiffness or joint.armature:
            raise Unsaid(f"USD has no damping, friction, spring or rotor inertia for the ball {joint.name!r}")

    def _drive(self, prim, turns, stiffness, damping, target, largest=None):
        word, angle = ("angular", _DEGREES) if turns else ("linear", 1.0)
        if prim.HasAPI(self.UsdPhysics.DriveAPI, word):
            raise Unsaid(f"USD has one drive for a joint, and {prim.GetName()!r} has several springs or motors")
        drive = self.UsdPhysics.DriveAPI.Apply(prim, word)
        self._put(drive.CreateStiffnessAttr(), stiffness / angle)
        self._put(drive.CreateDampingAttr(), damping / angle)
        self._put(drive.CreateTargetPositionAttr(), target * angle)
        if largest is not None:
            self._put(drive.CreateMaxForceAttr(), largest)

    def _loop(self, loop):
        if loop.kind == "distance":
            ends = [self.parts.anchor(loop, end) for end in (1, 2)]
            made = self._between(self.UsdPhysics.DistanceJoint, loop.name, *ends)
            self._put(made.CreateMinDistanceAttr(), loop.length)
            self._put(made.CreateMaxDistanceAttr(), loop.length)
        elif LOOP_KINDS[loop.kind].free is not None:
            turn = _along(np.array(loop.axis)) if loop.axis is not None else pin.SE3.Identity()
            turns = [turn, turn]
            if loop.axis2 is not None:
                turns = _cross(loop)
            ends = [(joint, place * own) for (joint, place), own in
                    zip((self.parts.anchor(loop, end) for end in (1, 2)), turns, strict=True)]  # fmt: skip
            made = self._between(self.UsdPhysics.Joint, loop.name, *ends)
            for direction in _DIRECTIONS:
                if direction not in LOOP_KINDS[loop.kind].free:
                    limit = self.UsdPhysics.LimitAPI.Apply(made.GetPrim(), direction)
                    limit.CreateLowAttr(1.0)
                    limit.CreateHighAttr(-1.0)
        else:
            raise Unsaid(f"USD has no joint like the loop {loop.name!r}, of kind {loop.kind!r}")
        made.CreateExcludeFromArticulationAttr(True)

    def _coupling(self, coupling):
        plain = isinstance(coupling.joint, str) and isinstance(coupling.other, str) and not any(coupling.higher)
        paths = [self._joints.get(each) for each in (coupling.joint, coupling.other)] if plain else [None]
        if None in paths:
            raise Unsaid(f"USD has no mimic joint like the coupling {coupling.name!r}: one joint, linear in another")
        prim = self.stage.GetPrimAtPath(paths[0])
        prim.CreateRelationship("newton:mimicJoint").SetTargets([paths[1]])
        turns = is_revolute(self.model.joints[self.model.getJointId(coupling.joint)])
        offset = coupling.offset * (_DEGREES if turns else 1.0)
        for key, value in (("mimicCoef0", offset), ("mimicCoef1", coupling.ratio)):
            prim.CreateAttribute(f"newton:{key}", self.Sdf.ValueTypeNames.Double, True).Set(float(value))

    def _force(self, force):
        plain = isinstance(force, Actuator) and isinstance(force.joint, str) and force.gear == 1.0
        plain = plain and not callable(force.control) and not force.control_range and force.joint in self._joints
        label = label_of(force)
        refused = Unsaid(f"USD has no force like {label!r}; leave it out: mech.with_forces(…)")
        if not plain:
            raise refused
        prim = self.stage.GetPrimAtPath(self._joints[force.joint])
        turns = prim.GetTypeName() == "PhysicsRevoluteJoint"
        low, high = force.force_range or (-math.inf, math.inf)
        largest = high if math.isfinite(high) else None
        if -low != high or (force.gain[0] and force.gain[0] != -force.bias[1] and any(force.bias)):
            raise refused
        if any(force.bias):
            self._drive(prim, turns, force.gain[0], -force.bias[2], force.control, largest)
        else:
            self._drive(prim, turns, 0.0, 0.0, 0.0, largest)


def _identifier(name) -> str:
    plain = re.sub(r"\W", "_", name)
    return plain if re.match(r"[A-Za-z_]", plain) else f"_{plain}"


def _along(axis) -> pin.SE3:
    """The rotation that takes x to an axis."""
    unit = np.array(axis) / np.linalg.norm(axis)
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), unit)
    return pin.SE3(turn.toRotationMatrix(), np.zeros(3))


def _cross(loop) -> list[pin.SE3]:
    """The rotations of both anchors of a universal: y of the first along its axis, x of the second along axis2."""
    e, a = (np.array(each) / np.linalg.norm(each) for each in (loop.axis, loop.axis2))
    first = pin.Quaternion.FromTwoVectors(np.array([0.0, 1.0, 0.0]), e).toRotationMatrix()
    second = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), a).toRotationMatrix()
    return [pin.SE3(first, np.zeros(3)), pin.SE3(second, np.zeros(3))]
