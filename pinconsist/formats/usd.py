"""USD files (``pip install 'pinconsist[usd]'``): bodies, joints and drives of UsdPhysics, read by usd-core.

Bodies are prims with PhysicsRigidBodyAPI; a joint without a body, or with a prim that is no body, is on the ground.
What no joint connects to the ground floats. The joints form a graph, which is cut into a tree and loops
(:mod:`.graph`): ``physics:excludeFromArticulation`` requests a cut. Positions are those of USD: zero where the frames
of a joint on both bodies coincide; assembly starts at the poses of the file. A ``PhysicsJoint`` (D6) is free in the
directions that its limits do not lock (low > high); its slides are along the axes of the first body, its turns follow.
Numbers of single precision are the shortest decimal numbers that they stand for: 0.1, not 0.10000000149.

Drives with a stiffness or damping become position actuators, their targets commands; rotor inertias, friction and
damping of joints act as Newton, PhysX and MuJoCo have them, MuJoCo's springs of joints, mimics of Newton and PhysX,
MuJoCo's equalities and gear joints, ``physxRigidBody:disableGravity`` and ``kinematicEnabled``. Masses that are not
given are those of the collision shapes with their density (1000 kg/m³ if none is given). Limits, materials and
collisions are counted.

Layers are composed by usd-core, from files in the folder of the scene and in ``package_dirs`` only. Source: UsdPhysics'
"Rigid Body Physics in USD".
"""

import math
import os
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree.ElementTree import tostring

import numpy as np
import pinocchio as pin

from ..errors import FormatError, MissingExtraError, warn
from ..mechanism.file_laws import COLLISIONS, STATIC, WATCHED
from ..mechanism.forces import Actuator, JointSpring, Wrench
from ..mechanism.joint_constraints import Coupling
from ..mechanism.loops import Loop, unit
from . import solids
from .extensions import unique
from .graph import WORLD, Axis, Body, Joint, JointGraph, Scene, build
from .ignored import Ignored
from .plausible import moving_inertias, warn_of_inertias
from .reading import LARGEST, RobotFile, located, read_bytes, short_repr, text
from .urdf import add_visual, fixed_links

WATER = 1000.0  # kg/m³, the density of UsdPhysics where none is given
MOST_LAYERS = 500
_AXES = {"X": (1.0, 0.0, 0.0), "Y": (0.0, 1.0, 0.0), "Z": (0.0, 0.0, 1.0)}
_TYPES = ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint", "PhysicsSphericalJoint", "PhysicsFixedJoint", "PhysicsJoint")
_TYPES += ("PhysicsDistanceJoint",)
_DIRECTIONS = ("transX", "transY", "transZ", "rotX", "rotY", "rotZ")
_TURNS = {"XY": "YX", "XZ": "ZX", "YZ": "YZ"}
"""Two free turns → the order in which the joints follow: about that of the first body, then about the second's own."""
_GEARS = "PhysxPhysicsGearJoint"
_IN_JOINTS = (
    ("newton:armature", "physxJoint:armature", "mjc:armature"),
    ("newton:friction", "physxJoint:jointFriction", "mjc:frictionloss"),
)
"""Attributes of the rotor inertia and of the dry friction of a joint; the first one that is not zero counts."""
_SOLIDS = {
    "box": solids.box,
    "sphere": lambda radius: solids.ellipsoid(radius, radius, radius),
    "cylinder": solids.cylinder,
    "capsule": solids.capsule,
    "cone": solids.cone,
}
_BESIDE = ("xformOp", "primvars:", "ui:", "userProperties:", "material:", "collection:", "omni:", "drive:", "limit:")
_BESIDE += ("newton:", "mjc:", "physx", "pinconsist:", "extent", "visibility", "purpose", "proxyPrim", "display")
"""Beginnings of properties that only show a prim, are read here, or belong to schemas that are counted."""
_OTHERS = ("Mjc", "Newton", "Physx")  # prims of simulators
_PLAIN = ("Physics", "Geom", "Material", "Semantics", "Visibility", "Isaac", "Shader", "Collection", "CoordSys")
_KNOWN = ("PhysxRigidBodyAPI", "PhysxJointAPI", "PhysxMimicJointAPI", "PhysxArticulationAPI", "PhysxCollisionAPI")
_KNOWN += ("PhysxContactReportAPI", "PhysxConvexHullCollisionAPI", "PhysxLimitAPI", "PhysxTriangleMeshCollisionAPI")
_KNOWN += ("MjcEqualityJointAPI", "MjcJointAPI", "MjcEqualityConnectAPI", "MjcEqualityWeldAPI", "NewtonMimicAPI")
_KNOWN += ("NewtonJointAPI",)
"""Schemas that act, or that say nothing about the motion."""
EXACT = "pinconsist:"  # before the name of an attribute whose value is repeated in double precision
_STARTING = 1e-9  # rad or m: below it, a joint is at zero in the file


def read(path: Path, name: str, folders, *, ignore=()) -> RobotFile:
    """Read a USD file; see the documentation of the module."""
    package()
    from pxr import Tf

    try:
        return _read(path, name, folders, ignore)
    except Tf.ErrorException as error:  # values and targets are composed when they are asked for
        raise FormatError(f"usd-core cannot compose it: {_last_line(error)}") from None


def _read(path, name, folders, ignore) -> RobotFile:
    stage = _Stage(path, [Path(folder) for folder in folders], ignore)
    scene = Scene(stage.bodies(), gravity=stage.gravity())
    joints, massless = stage.in_series(list(stage.joints()), scene)
    if not scene.bodies:
        raise FormatError("it has no rigid body (PhysicsRigidBodyAPI)")
    graph = JointGraph(scene, joints)
    inertias = stage.inertias() | massless
    model, guess = build(scene, graph, inertias, name, graph.roots)
    warn_of_inertias(path, moving_inertias("body", inertias, model))
    loops = [*graph.loops(), *stage.distances]
    actuators, couplings = tuple(stage.actuators(model)), tuple(stage.couplings(model))
    forces = (*stage.springs(model), *stage.weights(model), *actuators)
    actuated = tuple(dict.fromkeys(each.joint for each in actuators))
    stage.count_unknown()
    ignored = stage.counted.lines()
    return RobotFile(model, stage.shapes(), tuple(loops), couplings, forces, guess, actuated, ignored)


def package():
    """The modules of usd-core; MissingExtraError if it is not installed."""
    try:
        from pxr import Gf, Sdf, Usd, UsdGeom, UsdPhysics
    except ImportError:
        need = "USD files are read by usd-core; install it with: pip install 'pinconsist[usd]'"
        raise MissingExtraError(need) from None
    return Gf, Sdf, Usd, UsdGeom, UsdPhysics


class _Stage:
    """The stage of a file, and what is read from it; lengths in m, masses in kg."""

    def __init__(self, path, folders, ignore):
        self.Gf, self.Sdf, self.Usd, self.UsdGeom, self.UsdPhysics = package()
        self.counted, self._ignore = Ignored(), set(ignore)
        read_bytes(path)
        self._stage = self._opened(path, folders)
        self._unit = float(self.UsdGeom.GetStageMetersPerUnit(self._stage))
        self._kilograms = float(self.UsdPhysics.GetStageKilogramsPerUnit(self._stage))
        if not (0.0 < self._unit < LARGEST and 0.0 < self._kilograms < LARGEST):
            raise FormatError(f"metersPerUnit = {self._unit:g}, kilogramsPerUnit = {self._kilograms:g} is not positive")
        self._cache = self.UsdGeom.XformCache(self.Usd.TimeCode.Default())
        prims = self.Usd.PrimRange.Stage(self._stage, self.Usd.TraverseInstanceProxies())
        self._prims = list(prims)
        self._bodies = {}  # path of a prim → name of its body
        for prim in self._prims:
            if self._is_body(prim):
                self._bodies[prim.GetPath()] = unique(_plain(prim.GetName()), self._bodies.values())
        self._names: dict[str, str] = {}  # path of a joint's prim → its name
        self._read: dict[str, Joint] = {}
        self.distances: list[Loop] = []
        self._of_mujoco: set[str] = set()  # joints that MuJoCo wrote

    def _opened(self, path, folders):
        """The composed stage; FormatError for layers outside of the folders, or that are not there."""
        roots = [os.path.realpath(folder) for folder in (path.parent, *folders)]
        waiting, seen, muted = [os.path.abspath(path)], set(), []
        while waiting:
            file = waiting.pop()
            if file in seen:
                continue
            seen.add(file)
            if len(seen) > MOST_LAYERS:
                raise FormatError(f"more than {MOST_LAYERS} layers")
            try:
                layer = self.Sdf.Layer.FindOrOpen(file)
            except Exception as error:  # Tf.ErrorException, of any kind of parser
                raise FormatError(f"usd-core cannot read it: {_last_line(error)}") from None
            if layer is None:
                raise FormatError("usd-core cannot read it")
            if file == os.path.abspath(path):
                layer.Reload(True)  # another file may have had this name
            for asset in layer.GetCompositionAssetDependencies():
                if asset in self._ignore or os.path.basename(asset) in self._ignore:
                    muted.append(layer.ComputeAbsolutePath(asset))
                    continue
                there = self._inside(asset, layer, roots)
                if there:
                    waiting.append(there)
        try:
            stage = self.Usd.Stage.Open(os.path.abspath(path), self.Usd.Stage.LoadNone)
            for each in muted:
                stage.MuteLayer(each)
            stage.Load()
        except Exception as error:
            raise FormatError(f"usd-core cannot compose it: {_last_line(error)}") from None
        for layer in stage.GetUsedLayers():  # nothing that was not seen above
            if layer.realPath and not _is_in(re.sub(r"\[.*", "", layer.realPath), roots):
                raise FormatError(
                    f"it refers to {short_repr(layer.identifier)}, which is outside the folder of the scene"
                )
        return stage

    def _inside(self, asset, layer, roots) -> str:
        """The file of a layer that another one names; FormatError if it is not in the folders."""
        if not asset:
            return ""
        advice = f"ignore=[{asset!r}] loads the scene without it"
        if "://" in asset:
            raise FormatError(f"it refers to {short_repr(asset)}, and nothing is downloaded; {advice}")
        there = layer.ComputeAbsolutePath(asset)
        package, inside, file = there.partition(".usdz[")
        if inside and layer.identifier.startswith(f"{package}.usdz") and ".." not in file:
            return there  # in the same package, which is in the folder
        real = os.path.realpath(there)
        if not _is_in(real, roots):
            raise FormatError(
                f"it refers to {short_repr(asset)}, which is outside the folder of the scene; pass the folder of these "
                f"files as package_dirs=, or {advice}"
            )
        if not os.path.isfile(real):
            raise FormatError(f"it refers to {short_repr(asset)}, and there is no such file; {advice}")
        return there

    # Bodies

    def _is_body(self, prim) -> bool:
        if not prim.HasAPI(self.UsdPhysics.RigidBodyAPI):
            return False
        enabled = _value(self.UsdPhysics.RigidBodyAPI(prim).GetRigidBodyEnabledAttr())
        return enabled is None or bool(enabled)

    def _pose(self, prim) -> tuple[pin.SE3, np.ndarray]:
        """The pose of a prim in the world, and its 4 × 4 matrix (columns), m."""
        matrix = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        matrix[:3, 3] *= self._unit
        if not np.isfinite(matrix).all():
            raise FormatError("its transformation is not finite", element=str(prim.GetPath()))
        u, _, vt = np.linalg.svd(matrix[:3, :3])
        rotation = u @ vt
        if np.linalg.det(rotation) < 0:  # mirrored, as shapes may be
            rotation = u @ np.diag([1.0, 1.0, -1.0]) @ vt
        plain = np.linalg.norm(matrix[:3, :3], axis=0)
        if np.allclose(matrix[:3, :3] / np.where(plain, plain, 1.0), rotation, atol=1e-6):
            rotation = unit_columns(matrix[:3, :3] / plain)
        return pin.SE3(rotation, matrix[:3, 3]), matrix

    def bodies(self) -> dict[str, Body]:
        found = {}
        for path, name in self._bodies.items():
            prim = self._stage.GetPrimAtPath(path)
            kinematic = _value(self.UsdPhysics.RigidBodyAPI(prim).GetKinematicEnabledAttr())
            with located(element=str(path)):
                found[name] = Body(self._pose(prim)[0], bool(kinematic))
            for key in ("linearDamping", "angularDamping"):
                if self._number(prim, f"physxRigidBody:{key}"):
                    self.counted.add(f"physxRigidBody:{key}")
        return found

    def gravity(self) -> np.ndarray:
        up = 2 if str(self.UsdGeom.GetStageUpAxis(self._stage)).upper() == "Z" else 1
        down, size = -np.eye(3)[up], 9.81
        scenes = [prim for prim in self._prims if prim.IsA(self.UsdPhysics.Scene)]
        if len(scenes) > 1:
            warn(f"{len(scenes)} physics scenes; gravity is that of {scenes[0].GetPath()}")
        if scenes:
            scene = self.UsdPhysics.Scene(scenes[0])
            direction = np.array(_exact(scene.GetGravityDirectionAttr()) or (0.0, 0.0, 0.0), float)
            magnitude = _exact(scene.GetGravityMagnitudeAttr())
            if direction.any():
                down = unit(direction)
            if magnitude is not None and math.isfinite(magnitude) and magnitude >= 0.0:
                size = float(magnitude) * self._unit
        return size * down

    def inertias(self) -> dict[str, pin.Inertia]:
        shapes = self._solids()
        return {name: self._inertia(path, name, shapes.get(name, ())) for path, name in self._bodies.items()}

    def _inertia(self, path, name, shapes) -> pin.Inertia:
        """The inertia of a body in its frame: what MassAPI says, the rest from the collision shapes."""
        prim, UsdPhysics = self._stage.GetPrimAtPath(path), self.UsdPhysics
        api = UsdPhysics.MassAPI(prim) if prim.HasAPI(UsdPhysics.MassAPI) else None
        of_shapes = pin.Inertia.Zero()
        for each, density, mass in shapes:
            factor = mass / each.mass if mass and each.mass else density
            of_shapes = of_shapes + solids.scaled(each, factor)
        mass = self._kilograms * _positive(api and _exact(api.GetMassAttr()))
        density = _positive(api and _exact(api.GetDensityAttr())) * self._kilograms / self._unit**3
        if density and not mass and of_shapes.mass:
            of_shapes = sum((solids.scaled(each, density) for each, _, _ in shapes), start=pin.Inertia.Zero())
        if not mass:
            mass = of_shapes.mass
            if not mass:
                warn(f"body {name!r}: it has neither a mass nor collision shapes; it is taken as 1 kg")
                mass = 1.0
        if of_shapes.mass:
            of_shapes = solids.scaled(of_shapes, mass / of_shapes.mass)
        lever, moments = np.array(of_shapes.lever), np.array(of_shapes.inertia)
        scale = np.diag([float(np.linalg.norm(column)) for column in self._pose(prim)[1][:3, :3].T])
        given = api and _exact(api.GetCenterOfMassAttr())
        if given is not None and all(math.isfinite(each) for each in given):
            lever = scale @ np.array(given, float) * self._unit
        diagonal = api and _exact(api.GetDiagonalInertiaAttr())
        if diagonal is not None and any(diagonal):
            turn = np.eye(3)
            axes = _exact(api.GetPrincipalAxesAttr())
            if axes is not None and np.any(axes if isinstance(axes, list) else _rotation(axes)):
                turn = _rotation(axes)
            moments = turn @ np.diag(np.array(diagonal, float)) @ turn.T * self._kilograms * self._unit**2
        elif not of_shapes.mass:
            warn(f"body {name!r}: it has neither an inertia nor collision shapes; it is taken as a point")
        if not (np.isfinite(moments).all() and np.isfinite(lever).all() and 0.0 <= mass < LARGEST):
            raise FormatError("its mass or inertia is not finite, or negative", element=f"body {name!r}")
        found = pin.Inertia.Zero()
        found.mass, found.lever, found.inertia = mass, lever, moments
        return found

    def _solids(self) -> dict[str, list]:
        """Body → (solid of density 1 in its frame, density, mass or 0) of its collision shapes."""
        found: dict[str, list] = {}
        for prim in self._prims:
            if not prim.HasAPI(self.UsdPhysics.CollisionAPI):
                continue
            enabled = _value(self.UsdPhysics.CollisionAPI(prim).GetCollisionEnabledAttr())
            body = self._body_of(prim)
            if enabled is False:
                continue
            self.counted.add(COLLISIONS if body else STATIC)
            if body:
                solid = self._solid(prim, self._of(body).inverse().homogeneous)
                if solid is not None:
                    found.setdefault(body, []).append((solid, *self._density(prim)))
        return found

    def _density(self, prim):
        mass = density = 0.0
        if prim.HasAPI(self.UsdPhysics.MassAPI):
            api = self.UsdPhysics.MassAPI(prim)
            mass, density = (_positive(_exact(each)) for each in (api.GetMassAttr(), api.GetDensityAttr()))
        if not density:
            for relation in prim.GetRelationships():
                if relation.GetName().startswith("material:binding"):
                    for target in relation.GetTargets():
                        material = self._stage.GetPrimAtPath(target)
                        if material and material.HasAPI(self.UsdPhysics.MaterialAPI):
                            api = self.UsdPhysics.MaterialAPI(material)
                            density = _positive(_exact(api.GetDensityAttr()))
        units = self._kilograms / self._unit**3
        return (density * units if density else WATER), mass * self._kilograms

    def _solid(self, prim, to_body) -> pin.Inertia | None:
        """The solid of a shape in the frame of its body."""
        own = np.array(self._cache.GetLocalToWorldTransform(prim)).T
        own[:3] *= self._unit
        if prim.IsA(self.UsdGeom.Mesh):
            solid = self._mesh(prim)
        else:
            kind, sizes = self._primitive(prim)
            if not kind:
                return None
            solid = _SOLIDS[kind](*sizes[: 3 if kind == "box" else 2])
            if kind in ("cylinder", "capsule", "cone"):
                solid = pin.SE3(_toward(sizes[2]), np.zeros(3)).act(solid)
        return solids.moved(solid, to_body @ own) if solid is not None and solid.mass > 0.0 else None

    def _mesh(self, prim):
        shape = self.UsdGeom.Mesh(prim)
        attributes = (shape.GetPointsAttr(), shape.GetFaceVertexCountsAttr(), shape.GetFaceVertexIndicesAttr())
        points, counts, indices = (_value(each) for each in attributes)
        if not points or not counts or not indices:
            return None
        triangles, start, indices = [], 0, list(indices)
        for count in counts:
            triangles += [(indices[start], indices[start + i], indices[start + i + 1]) for i in range(1, count - 1)]
            start += count
        if not triangles or start > len(indices) or not 0 <= min(indices) <= max(indices) < len(points):
            raise FormatError("its faces name points that it does not have", element=str(prim.GetPath()))
        return solids.mesh(np.array(points, float), np.array(triangles, int))

    def _primitive(self, prim):
        """(kind, sizes along its axes) of a primitive; ("", ()) for others."""
        UsdGeom = self.UsdGeom
        if prim.IsA(UsdGeom.Cube):
            size = float(_value(UsdGeom.Cube(prim).GetSizeAttr()))
            return "box", (size, size, size)
        if prim.IsA(UsdGeom.Sphere):
            return "sphere", (float(_value(UsdGeom.Sphere(prim).GetRadiusAttr())),)
        for kind, make in (("cylinder", UsdGeom.Cylinder), ("capsule", UsdGeom.Capsule), ("cone", UsdGeom.Cone)):
            if prim.IsA(make):
                shape = make(prim)
                sizes = float(_value(shape.GetRadiusAttr())), float(_value(shape.GetHeightAttr()))
                return kind, (*sizes, str(_value(shape.GetAxisAttr())))
        return "", ()

    def _path_of(self, body):
        return next(path for path, name in self._bodies.items() if name == body)

    def _body_of(self, prim) -> str:
        """The body to which a prim belongs; empty: the ground."""
        while prim and not prim.IsPseudoRoot():
            if prim.GetPath() in self._bodies:
                return self._bodies[prim.GetPath()]
            prim = prim.GetParent()
        return ""

    # Joints

    def joints(self) -> Iterator[Joint]:
        UsdPhysics = self.UsdPhysics
        for prim in self._prims:
            kind, path = prim.GetTypeName(), str(prim.GetPath())
            if kind == _GEARS:
                continue
            if kind not in _TYPES:
                if kind.endswith("Joint") and kind != "PhysxPhysicsJointInstancer" and path not in self._ignore:
                    raise FormatError(
                        f"a joint of type {kind} is not supported, and without it the mechanism would be different. "
                        f"ignore=[{path!r}] loads the scene without it", element=path
                    )  # fmt: skip
                continue
            joint = UsdPhysics.Joint(prim)
            if _value(joint.GetJointEnabledAttr()) is False or path in self._ignore:
                self.counted.add("disabled joint")
                continue
            with located(element=path):
                made = self._joint(prim, joint, str(kind))
            if made is not None:
                yield made

    def in_series(self, joints, scene) -> tuple[list[Joint], dict[str, pin.Inertia]]:
        """The joints, of which those of MuJoCo between the same bodies follow each other, and bodies between them.

        A body of MuJoCo may have several joints, and moves by the first of them, then by the second. In other files
        joints between the same bodies all hold them.
        """
        groups: dict[tuple[str, str], list[Joint]] = {}
        for joint in (each for each in joints if each.name in self._of_mujoco):
            groups.setdefault((joint.parent, joint.child), []).append(joint)
        replaced: dict[str, Joint] = {}
        massless: dict[str, pin.Inertia] = {}
        for (parent, child), group in groups.items():
            here = pin.SE3.Identity() if parent == WORLD else scene.bodies[parent].pose
            back = scene.bodies[child].pose.inverse() * here
            start = parent
            for number, joint in enumerate(group, start=1):
                end = child if number == len(group) else unique(f"{joint.name}_link", scene.bodies)
                on_start = joint.on_parent if start == parent else back * joint.on_parent
                replaced[joint.name] = replace(joint, parent=start, child=end, on_parent=on_start)
                if end != child:
                    scene.bodies[end] = Body(scene.bodies[child].pose)
                    massless[end] = pin.Inertia.Zero()
                start = end
        return [replaced.get(joint.name, joint) for joint in joints], massless

    def _joint(self, prim, joint, kind):
        ends = [self._end(joint, number) for number in (0, 1)]
        (parent, on_parent), (child, on_child) = ends
        if parent == child:
            if parent == WORLD:
                return None
            raise FormatError(f"it connects the body {parent!r} to itself")
        name, bodies = _plain(prim.GetName()), self._bodies.values()
        name = unique(f"{name}_joint" if name in bodies else name, (*self._names.values(), *bodies))
        self._names[str(prim.GetPath())] = name
        if "MjcJointAPI" in self._schemas(prim):
            self._of_mujoco.add(name)
        if kind == "PhysicsDistanceJoint":
            self._distance(prim, name, ends)
            return None
        axes = self._axes(prim, kind)
        if any(math.isfinite(each) for axis in axes for each in (axis.lower, axis.upper)):
            self.counted.add(WATCHED)
        there = [pose if body == WORLD else self._of(body) * pose for body, pose in ends]
        axes = _started(axes, there[0].actInv(there[1]))
        cut = bool(_value(joint.GetExcludeFromArticulationAttr()))
        single = {
            "PhysicsRevoluteJoint": "revolute",
            "PhysicsPrismaticJoint": "prismatic",
            "PhysicsFixedJoint": "fixed",
        }
        kind = single.get(kind) or ("compound" if axes else "fixed")
        made = self._read[name] = Joint(name, kind, parent, child, on_parent, on_child, axes, must_cut=cut)
        return made

    def _of(self, body) -> pin.SE3:
        return self._pose(self._stage.GetPrimAtPath(self._path_of(body)))[0]

    def _end(self, joint, number):
        """The body of an end of a joint, and the joint's frame on it."""
        relation = joint.GetBody0Rel() if number == 0 else joint.GetBody1Rel()
        position = _exact(joint.GetLocalPos0Attr() if number == 0 else joint.GetLocalPos1Attr())
        rotation = _exact(joint.GetLocalRot0Attr() if number == 0 else joint.GetLocalRot1Attr())
        place = np.array(position if position is not None else (0, 0, 0), float) * self._unit
        turn = _rotation(rotation) if rotation is not None else np.eye(3)
        targets = relation.GetTargets()
        if not targets:
            return WORLD, pin.SE3(turn, place)
        prim = self._stage.GetPrimAtPath(targets[0])
        if not prim:
            raise FormatError(f"body{number} is {targets[0]}, which does not exist")
        pose, matrix = self._pose(prim)
        there = pin.SE3(pose.rotation @ turn, matrix[:3, :3] @ place + matrix[:3, 3])
        body = self._body_of(prim)
        return (body, self._of(body).actInv(there)) if body else (WORLD, there)

    def _axes(self, prim, kind) -> tuple[Axis, ...]:
        if kind in ("PhysicsRevoluteJoint", "PhysicsPrismaticJoint"):
            word = str(self._token(prim, "physics:axis") or "X")
            turns = kind == "PhysicsRevoluteJoint"
            factor = math.pi / 180.0 if turns else self._unit
            lower = self._number(prim, "physics:lowerLimit", -math.inf) * factor
            upper = self._number(prim, "physics:upperLimit", math.inf) * factor
            if lower > upper:
                lower, upper = -math.inf, math.inf
            motion = "revolute" if turns else "prismatic"
            return (Axis(np.array(_AXES[word]), lower=lower, upper=upper, kind=motion, **self._acting(prim, turns)),)
        if kind == "PhysicsSphericalJoint":
            if any((self._number(prim, f"physics:coneAngle{i}Limit", -1.0)) >= 0.0 for i in (0, 1)):
                self.counted.add("cone of a ball joint (not enforced)")
            return (Axis(np.zeros(3), kind="ball", **self._acting(prim, True)),)
        return self._generic(prim) if kind == "PhysicsJoint" else ()

    def _acting(self, prim, turns) -> dict[str, float]:
        """What acts in a joint, as Newton, PhysX and MuJoCo have it: parameters of an Axis."""
        units = self._kilograms * (self._unit**2 if turns else 1.0)
        armature, friction = (next(filter(None, (self._number(prim, key) for key in keys)), 0.0) for keys in _IN_JOINTS)
        damping = self._number(prim, "newton:damping") * (180.0 / math.pi if turns else 1.0)
        zero = self._number(prim, "mjc:springref") - self._number(prim, "mjc:ref")
        return {
            "armature": armature * units,
            "friction": max(friction, 0.0) * self._torque(turns),
            "damping": max(damping or self._number(prim, "mjc:damping"), 0.0) * units,
            "stiffness": max(self._number(prim, "mjc:stiffness"), 0.0) * units,
            "reference": zero * (self._mujoco_angle() if turns else self._unit),
        }

    def _mujoco_angle(self) -> float:
        """The unit of angles in MuJoCo's attributes, rad."""
        words = (self._token(prim, "mjc:compiler:angle") for prim in self._prims if prim.IsA(self.UsdPhysics.Scene))
        return 1.0 if next(filter(None, words), "degree") == "radian" else math.pi / 180.0

    def springs(self, model) -> Iterator[JointSpring]:
        """The springs of MuJoCo in joints that the tree has."""
        for joint in self._read.values():
            for part, axis in zip(joint.parts, joint.axes, strict=False):
                if axis.stiffness and model.existJointName(part):
                    at_rest = (0.0, 0.0, 0.0, 1.0) if axis.kind == "ball" else axis.reference
                    yield JointSpring(part, axis.stiffness, at_rest)

    def _torque(self, turns):
        return self._kilograms * (self._unit**2 if turns else self._unit)

    def _generic(self, prim) -> tuple[Axis, ...]:
        """The free directions of a D6 joint: slides, then turns."""
        free = {}
        for direction in _DIRECTIONS:
            low, high = -math.inf, math.inf
            if prim.HasAPI(self.UsdPhysics.LimitAPI, direction):
                limit = self.UsdPhysics.LimitAPI(prim, direction)
                low, high = (_exact(each) for each in (limit.GetLowAttr(), limit.GetHighAttr()))
                low, high = (-math.inf if low is None else low), (math.inf if high is None else high)
            if low < high:
                factor = self._unit if direction.startswith("trans") else math.pi / 180.0
                free[direction] = low * factor, high * factor
        turns = "".join(each[-1] for each in free if each.startswith("rot"))
        order = [f"rot{letter}" for letter in _TURNS.get(turns, turns)]
        axes = []
        for direction in [each for each in free if each.startswith("trans")] + order:
            slides = direction.startswith("trans")
            if len(turns) == 3 and not slides:
                continue
            low, high = free[direction]
            kind, axis = "prismatic" if slides else "revolute", np.array(_AXES[direction[-1]])
            acting = self._acting(prim, not slides)
            axes.append(Axis(axis, lower=low, upper=high, kind=kind, label=direction, **acting))
        if len(turns) == 3:
            axes.append(Axis(np.zeros(3), kind="ball", label="rot", **self._acting(prim, True)))
        return tuple(axes)

    def _distance(self, prim, name, ends):
        low, high = (self._number(prim, f"physics:{end}Distance", -1.0) * self._unit for end in ("min", "max"))
        if low < 0.0 or high < 0.0 or low != high:
            self.counted.add("distance joint with a range (not enforced)")
            return
        frames = ["universe" if body == WORLD else body for body, _ in ends]
        points = {f"xyz{i}": tuple(pose.translation.tolist()) for i, (_, pose) in enumerate(ends, start=1)}
        self.distances.append(Loop(name, "distance", *frames, **points, length=low))

    # Forces

    def actuators(self, model) -> Iterator[Actuator]:
        """The drives of joints that the tree has."""
        for prim in self._prims:
            name = self._names.get(str(prim.GetPath()))
            joint = self._read.get(name or "")
            if joint is None:
                continue
            for part, axis in zip(joint.parts, joint.axes, strict=False):
                word = axis.label or ("linear" if joint.kind == "prismatic" else "angular")
                if prim.HasAPI(self.UsdPhysics.DriveAPI, word):
                    made = self._drive(prim, word, part, model)
                    if made is not None:
                        yield made

    def _drive(self, prim, word, part, model):
        drive = self.UsdPhysics.DriveAPI(prim, word)
        turns = word == "angular" or word.startswith("rot")
        if not model.existJointName(part) or model.nvs[model.getJointId(part)] != 1:
            warn(f"drive {word} of {part!r}: it exerts no force here, as its joint closes a loop")
            return None
        attributes = (drive.GetStiffnessAttr(), drive.GetDampingAttr(), drive.GetTargetPositionAttr())
        stiffness, damping, target = (float(_exact(each) or 0.0) for each in attributes)
        speed, largest = float(_exact(drive.GetTargetVelocityAttr()) or 0.0), _exact(drive.GetMaxForceAttr())
        angle = 180.0 / math.pi if turns else 1.0
        units = self._kilograms * (self._unit**2 if turns else 1.0) * angle
        k, d = stiffness * units, damping * units
        position, rate = ((each / angle if turns else each * self._unit) for each in (target, speed))
        if str(_value(drive.GetTypeAttr())) == "acceleration" and (k or d):
            warn(f"drive of {part!r}: it prescribes an acceleration, and exerts no force here")
            return None
        limit = float(largest) * self._torque(turns) if largest is not None and 0.0 < largest < LARGEST else 0.0
        ends = (-limit, limit) if limit else ()
        if not (k or d):
            return Actuator(part, part, force_range=ends)
        if not k:
            return Actuator(part, part, (d, 0.0, 0.0), (0.0, 0.0, -d), control=rate, force_range=ends)
        return Actuator(part, part, (k, 0.0, 0.0), (d * rate, -k, -d), control=position, force_range=ends)

    def couplings(self, model) -> Iterator[Coupling]:
        """Mimic joints and gears."""
        for prim in self._prims:
            name = self._names.get(str(prim.GetPath()))
            for direction in _DIRECTIONS if name else ():
                base = f"physxMimicJoint:{direction}"
                reference = prim.GetRelationship(f"{base}:referenceJoint")
                if reference and reference.GetTargets():
                    other = self._names.get(str(reference.GetTargets()[0]))
                    gearing, offset = (self._number(prim, f"{base}:{key}") for key in ("gearing", "offset"))
                    offset *= math.pi / 180.0 if direction.startswith("rot") else self._unit
                    yield self._coupled(f"{name} mimic", name, other, -gearing, -offset, model)
            if name and (made := self._mimic(prim, name, model)):
                yield made
            if prim.GetTypeName() == _GEARS:
                hinges = [prim.GetRelationship(f"physics:hinge{i}") for i in (0, 1)]
                names = [
                    self._names.get(str(each.GetTargets()[0])) if each and each.GetTargets() else None
                    for each in hinges
                ]
                ratio = self._number(prim, "physics:gearRatio", 1.0)
                yield self._coupled(_plain(prim.GetName()), names[1], names[0], -ratio, 0.0, model)

    def _mimic(self, prim, name, model) -> Coupling | None:
        """The coupling of NewtonMimicAPI, or of MuJoCo's equality of joints, which extends it by higher powers."""
        equality = "MjcEqualityJointAPI" in self._schemas(prim)
        own, old = (prim.GetRelationship(key) for key in ("newton:mimicJoint", "mjc:target"))
        targets, old_targets = (each.GetTargets() if each else [] for each in (own, old))
        if not (targets or (equality and old_targets)):
            return None
        if self._token(prim, "newton:mimicEnabled") is False:
            self.counted.add("disabled mimic")
            return None
        if targets:  # its offset is in degrees, that of the older attribute in rad
            unit_of_offset = math.pi / 180.0 if self._read[name].kind == "revolute" else self._unit
            offset = self._number(prim, "newton:mimicCoef0") * unit_of_offset
            ratio = self._number(prim, "newton:mimicCoef1", 1.0)
        else:
            offset, ratio = self._number(prim, "mjc:coef0"), self._number(prim, "mjc:coef1", 1.0)
        other = self._names.get(str((targets or old_targets)[0]))
        made = self._coupled(f"{name} {'equality' if equality else 'mimic'}", name, other, ratio, offset, model)
        higher = tuple(self._number(prim, f"mjc:coef{i}") for i in (2, 3, 4)) if equality else ()
        return replace(made, higher=higher if any(higher) else ())

    def _coupled(self, title, joint, other, ratio, offset, model):
        for each in (joint, other):
            if each is None or not model.existJointName(each):
                raise FormatError(
                    f"it couples {joint!r} to {other!r}, of which one is no joint of the tree", element=title
                )
        return Coupling(title, joint, other, ratio, offset)

    def weights(self, model) -> Iterator[Wrench]:
        """For each body without gravity, the force that carries its weight."""
        for path, name in self._bodies.items():
            off = self._stage.GetPrimAtPath(path).GetAttribute("physxRigidBody:disableGravity")
            frame = model.frames[model.getFrameId(name)] if model.existFrame(name) else None
            if off and _value(off) and frame is not None and frame.parentJoint:
                inertia = self._inertia(path, name, self._solids().get(name, ()))
                yield Wrench(name, tuple((-inertia.mass * model.gravity.linear).tolist()), xyz=tuple(inertia.lever))

    # Shapes

    def shapes(self) -> str:
        """The primitives of the bodies as URDF; meshes are not shown."""
        robot, links = fixed_links(self._bodies.values())
        for prim in self._prims:
            body = self._body_of(prim)
            kind, sizes = self._primitive(prim) if body else ("", ())
            if not kind or kind == "cone":
                continue
            matrix = np.array(self._cache.GetLocalToWorldTransform(prim)).T
            scale = np.linalg.norm(matrix[:3, :3], axis=0) * self._unit
            place = self._of(body).actInv(self._pose(prim)[0])
            if kind == "box":
                add_visual(links[body], place, "box", {"size": text(*(np.array(sizes) * scale))})
            elif kind == "sphere":
                add_visual(links[body], place, "sphere", {"radius": text(sizes[0] * scale[0])})
            else:
                turn = pin.SE3(_toward(sizes[2]), np.zeros(3))
                sizes = {"radius": text(sizes[0] * scale[0]), "length": text(sizes[1] * scale[0])}
                add_visual(links[body], place * turn, "cylinder", sizes)
        return tostring(robot, encoding="unicode")

    def count_unknown(self) -> None:
        """Count prims and schemas of other programs that may act on bodies or joints, and do not here."""
        for prim in self._prims:
            kind, path = str(prim.GetTypeName()), prim.GetPath()
            if kind.startswith(_OTHERS) and not kind.endswith("Joint"):
                self.counted.add(f"<{kind}>")
            if path in self._bodies or str(path) in self._names:
                for schema in self._schemas(prim):
                    plain = schema.partition(":")[0]
                    if not plain.startswith(_PLAIN) and plain not in _KNOWN:
                        self.counted.add(f"<{plain}>")
                for name in self._strange(prim):
                    self.counted.add(f"<{name[:60]}>")

    def _strange(self, prim) -> list[str]:
        """Properties of a body or joint that belong to no schema that it has, and to no program that only shows it."""
        known = set(map(str, prim.GetPrimDefinition().GetPropertyNames()))
        spaces = {schema.partition(":")[0].removesuffix("API").lower() for schema in self._schemas(prim)}
        names = map(str, prim.GetAuthoredPropertyNames())
        return [
            name for name in names
            if name not in known and name.partition(":")[0].lower() not in spaces and not name.startswith(_BESIDE)
        ]  # fmt: skip

    def _schemas(self, prim) -> list[str]:
        """The names of all applied schemas, also of those that usd-core does not know."""
        given = prim.GetMetadata("apiSchemas")
        named = list(given.GetAddedOrExplicitItems()) if given else []
        return list(dict.fromkeys((*map(str, prim.GetAppliedSchemas()), *map(str, named))))

    # Attributes

    def _number(self, prim, key, default=0.0):
        attribute = prim.GetAttribute(key)
        value = _exact(attribute) if attribute else None
        if isinstance(value, (int, float)) and not math.isnan(value):
            return float(value)
        return default

    def _token(self, prim, key):
        attribute = prim.GetAttribute(key)
        return _value(attribute) if attribute else None


def _value(attribute):
    """The value of an attribute; FormatError if it is not of the type that its schema has."""
    value = attribute.Get()
    if type(value).__name__ == "UnregisteredValue":
        name, kind = attribute.GetName(), attribute.GetTypeName()
        raise FormatError(f"{name} is not of the type {kind}", element=str(attribute.GetPrim().GetPath()))
    return value


def _exact(attribute):
    """The value of an attribute; one of single precision is the shortest decimal number that it stands for.

    What :mod:`.write_usd` wrote has it in double precision beside it, which counts if both agree.
    """
    value = _value(attribute)
    double = attribute.GetPrim().GetAttribute(f"{EXACT}{attribute.GetName()}")
    if double and value is not None:
        exact = _value(double)
        exact = list(exact) if hasattr(exact, "__len__") else exact
        own = [*value.GetImaginary(), value.GetReal()] if hasattr(value, "GetImaginary") else value
        if np.allclose(np.array(own, float), np.array(exact, float), rtol=1e-6, atol=1e-6):
            return exact
    name = str(attribute.GetTypeName())
    if value is None or "double" in name or name == "quatd":
        return value
    if isinstance(value, float):
        return _decimal(value)
    if hasattr(value, "GetImaginary"):
        return [_decimal(each) for each in (*value.GetImaginary(), value.GetReal())]
    return [_decimal(each) for each in value] if hasattr(value, "__len__") and len(value) == 3 else value


def _decimal(value) -> float:
    return float(str(np.float32(value)))


def _rotation(quaternion) -> np.ndarray:
    if hasattr(quaternion, "GetImaginary"):
        quaternion = [*quaternion.GetImaginary(), quaternion.GetReal()]
    values = np.array(quaternion, float)
    if not values.any() or not np.isfinite(values).all():
        raise FormatError("a quaternion is zero or not finite")
    return pin.Quaternion(unit(values)).toRotationMatrix()


def unit_columns(matrix) -> np.ndarray:
    """The rotation nearest to a matrix that is one but for rounding."""
    return pin.Quaternion(matrix).normalized().toRotationMatrix()


def _positive(value) -> float:
    return float(value) if value is not None and math.isfinite(value) and value > 0.0 else 0.0


def _plain(name) -> str:
    return str(name) or "prim"


def _is_in(real, roots) -> bool:
    return any(os.path.realpath(real).startswith(root + os.sep) for root in roots)


def _last_line(error) -> str:
    """What usd-core says, without its own files and lines."""
    try:
        text = " ".join(str(error).split())
    except UnicodeDecodeError:  # it quotes the file
        return "it is not UTF-8 text"
    quoted = re.findall(r" : '(.*?)'(?: Error in|$)", text)
    said = (quoted or [text])[-1].strip(" '")
    return re.sub(r"^/\S*/", "", said)[:300] or type(error).__name__


def _started(axes, pose: pin.SE3) -> tuple[Axis, ...]:
    """The axes with their positions in the file, where the second frame has this pose in the first."""
    started, turns = [], [axis for axis in axes if axis.kind == "revolute"]
    for axis in axes:
        if axis.kind == "ball":
            quaternion = pin.Quaternion(pose.rotation).coeffs()
            started.append(replace(axis, initial=tuple(quaternion.tolist())))
            continue
        if axis.kind == "prismatic":
            value = float(axis.direction @ pose.translation)
        elif len(turns) == 1:
            value = float(axis.direction @ pin.log3(pose.rotation))
        else:
            first, second = (each.direction for each in turns)
            if axis is turns[0]:
                value = _angle(first, second, pose.rotation @ second)
            else:
                value = -_angle(second, first, pose.rotation.T @ first)
        started.append(replace(axis, initial=value if abs(value) > _STARTING else 0.0))
    return tuple(started)


def _angle(about, start, end) -> float:
    return math.atan2(float(about @ np.cross(start, end)), float(start @ end))


def _toward(letter) -> np.ndarray:
    """The rotation that takes z to an axis."""
    end = np.array(_AXES[letter.upper()])
    return pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end).toRotationMatrix()
