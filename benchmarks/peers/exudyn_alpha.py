"""Exudyn: a kinematic tree in the same coordinates, its loops as joints, generalized-α or trapezoidal index 2."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinconsist import JointSpring, JointTorque, SpringDamper, Torque

from .problem import Peer, Rows, SolverFailed, loop_ends

NEWTON_RELATIVE, NEWTON_ABSOLUTE = 1e-10, 1e-12


class ExudynAlpha(Peer):
    """Fixed steps with the solver's defaults (spectral radius 0.9, modified Newton) but for the Newton tolerances.

    With the default ones its errors stop following h² at small steps. Index 3 is `GeneralizedAlpha`, 2
    `TrapezoidalIndex2`.
    """

    package = module = "exudyn"
    fixed_step = True
    loops = ("point", "hinge", "distance")
    forces = (JointSpring, JointTorque, SpringDamper, Torque)

    def __init__(self, index):
        self.index = index
        self.name = "Exudyn generalized-α, index 3" if index == 3 else "Exudyn trapezoidal, index 2"

    def prepare(self, problem, steps):
        import exudyn

        exudyn.config.printToConsole = False  # its warnings would appear in our output
        tree = _Tree(problem)
        settings = exudyn.SimulationSettings()
        duration = problem.span[1] - problem.span[0]
        run = settings.timeIntegration
        run.startTime, run.endTime = problem.span
        run.numberOfSteps, run.verboseMode = steps, 0
        run.newton.relativeTolerance, run.newton.absoluteTolerance = NEWTON_RELATIVE, NEWTON_ABSOLUTE
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = duration / steps
        kinds = exudyn.DynamicSolverType
        kind = kinds.GeneralizedAlpha if self.index == 3 else kinds.TrapezoidalIndex2

        def solve():
            try:
                return tree.mbs.SolveDynamic(settings, solverType=kind, showHints=False)
            except Exception as error:
                raise SolverFailed(f"SolveDynamic: {error}") from error

        def read(success, thin):
            if not success:
                raise SolverFailed("SolveDynamic did not succeed")
            return tree.rows(thin)

        return solve, read


class _Tree:
    """The mechanism as Exudyn's items."""

    def __init__(self, problem):
        import exudyn
        from exudyn import itemInterface as items

        self.problem, self.items = problem, items
        mechanism = problem.mechanism
        model = mechanism.model
        self.container = exudyn.SystemContainer()
        self.mbs = mbs = self.container.AddSystem()
        self.ground = mbs.AddObject(items.ObjectGround())
        n = model.nv
        node = mbs.AddNode(
            items.NodeGenericODE2(
                numberOfODE2Coordinates=n,
                referenceCoordinates=[0.0] * n,
                initialCoordinates=list(problem.q0),
                initialCoordinates_t=list(problem.v0),
            )
        )
        joints = list(model.joints)[1:]
        places = [model.jointPlacements[joint.id] for joint in joints]
        bodies = [model.inertias[joint.id] for joint in joints]
        names = {"R": "Revolute", "P": "Prismatic"}
        kinds = [joint.shortname().removeprefix("JointModel") for joint in joints]
        self.tree = mbs.AddObject(
            items.ObjectKinematicTree(
                nodeNumber=node,
                gravity=list(model.gravity.linear),
                jointTypes=[getattr(exudyn.JointType, names[kind[0]] + kind[1]) for kind in kinds],
                linkParents=[model.parents[joint.id] - 1 for joint in joints],
                jointTransformations=exudyn.Matrix3DList([place.rotation for place in places]),
                jointOffsets=exudyn.Vector3DList([place.translation for place in places]),
                linkInertiasCOM=exudyn.Matrix3DList([body.inertia for body in bodies]),
                linkCOMs=exudyn.Vector3DList([body.lever for body in bodies]),
                linkMasses=[body.mass for body in bodies],
                **self._joint_forces(mechanism),
            )
        )
        for force in mechanism.forces:
            if isinstance(force, SpringDamper):
                ends = [self._marker(*end) for end in force.bind(model).ends]
                values = {"referenceLength": force.length, "stiffness": force.stiffness, "damping": force.damping}
                mbs.AddObject(items.ObjectConnectorSpringDamper(markerNumbers=ends, **values))
        self.closures = [self._add_loop(closure) for closure in problem.system.rows.closures]
        kinds = exudyn.OutputVariableType
        stored = {"storeInternal": True, "writeToFile": False}
        self.sensors = [
            mbs.AddSensor(items.SensorNode(nodeNumber=node, outputVariableType=kind, **stored))
            for kind in (kinds.Coordinates, kinds.Coordinates_t)
        ]
        self.force_sensors = [
            mbs.AddSensor(items.SensorObject(objectNumber=closure, outputVariableType=kinds.Force, **stored))
            for closure in self.closures
        ]
        mbs.Assemble()

    def _joint_forces(self, mechanism):
        system, n = self.problem.system, mechanism.nv
        if any(isinstance(force, Torque) for force in mechanism.forces):
            return {"forceUserFunction": lambda mbs, t, item, q, v: system.torque(t, np.array(q), np.array(v))}
        stiffness, rest, torque = np.zeros(n), np.zeros(n), np.zeros(n)
        for force in mechanism.forces:
            if isinstance(force, JointSpring):
                column = mechanism.columns(force.joint)
                stiffness[column], rest[column] = force.stiffness, force.rest
            if isinstance(force, JointTorque):
                torque += force.bind(mechanism.model).constant
        damping = np.array(mechanism.model.damping)
        values = {"jointForceVector": list(torque)} if torque.any() else {}
        if stiffness.any() or damping.any():
            values |= {"jointPositionOffsetVector": list(rest), "jointVelocityOffsetVector": [0.0] * n}
            values |= {"jointPControlVector": list(stiffness), "jointDControlVector": list(damping)}
        return values

    def _marker(self, joint, place):
        at, items = list(place), self.items
        if joint == 0:
            return self.mbs.AddMarker(items.MarkerBodyRigid(bodyNumber=self.ground, localPosition=at))
        return self.mbs.AddMarker(
            items.MarkerKinematicTreeRigid(objectNumber=self.tree, linkNumber=joint - 1, localPosition=at)
        )

    def _add_loop(self, closure):
        items, ends = self.items, [self._marker(*end) for end in loop_ends(closure)]
        if closure.loop.kind == "distance":
            return self.mbs.AddObject(items.ObjectConnectorDistance(markerNumbers=ends, distance=closure.loop.length))
        axes = [int(moves) for moves in self._moving_axes(closure)]
        return self.mbs.AddObject(items.ObjectJointSpherical(markerNumbers=ends, constrainedAxes=axes))

    def _moving_axes(self, closure):
        """World axes along which the anchors of a loop can move at all."""
        system, model, rng = self.problem.system, self.problem.mechanism.model, np.random.default_rng(0)
        q = pin.integrate(model, self.problem.q0, rng.uniform(-1, 1, model.nv))
        start = system.rows.slices[closure.loop.name].start
        J = system.loop_rows(q)[1][start : start + 3]
        return np.abs(self._axes_of_anchor1(closure, q) @ J).max(axis=1) > 1e-9

    def _axes_of_anchor1(self, closure, q):
        model = self.problem.mechanism.model
        data = model.createData()
        pin.forwardKinematics(model, data, q)
        return data.oMi[closure.joint1].rotation @ closure.place1.rotation

    def rows(self, thin) -> Rows:
        """What the sensors stored; the joints' forces, which Exudyn gives in world axes, in those of anchor 1."""
        q, v = (np.array(self.mbs.GetSensorStoredData(sensor)) for sensor in self.sensors)
        chosen = thin(len(q))
        t, q, v = q[chosen, 0], q[chosen, 1:], v[chosen, 1:]
        system = self.problem.system
        lam = np.zeros((len(t), system.rows.nc))
        for closure, sensor in zip(system.rows.closures, self.force_sensors, strict=True):
            forces = np.array(self.mbs.GetSensorStoredData(sensor))[chosen, 1:]
            rows = system.rows.slices[closure.loop.name]
            if closure.loop.kind == "distance":
                lam[:, rows] = -forces[:, :1]
                continue
            for i, force in enumerate(forces):
                lam[i, rows.start : rows.start + 3] = -self._axes_of_anchor1(closure, q[i]).T @ force
        return Rows(t, q, v, lam)
