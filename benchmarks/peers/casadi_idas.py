"""CasADi's interface to SUNDIALS IDAS, which takes semi-explicit equations of index 1, written as expressions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from pinconsist import Coupling, Drive, InputError, JointSpring, JointTorque, Loop, SpringDamper, Torque
from pinconsist.analysis.motor_code import motions
from pinconsist.mechanism.checks import spread
from pinconsist.mechanism.forces import JointDamping, JointFriction, model_forces
from pinconsist.mechanism.forces.force import label_of
from pinconsist.mechanism.loops import Length, RotationVector
from pinconsist.mechanism.rows import LoopRows
from pinconsist.paper.index1 import acceleration

from .problem import Peer, Rows, SolverFailed

GRID = 500
"""Output times: the interface does not return the steps that IDAS takes."""


class CasadiIdas(Peer):
    """IDAS with exact derivatives: x = (q, v), z = (a, λ), 0 = f(q, v, a) - Jᵀλ, 0 = J a + γ.

    Pinocchio's wheel is built without CasADi; :class:`Symbols` has the expressions.
    """

    package = module = "casadi"
    name = "CasADi IDAS, index 1"
    loops = ("point", "hinge", "distance")
    forces = (JointSpring, JointTorque, SpringDamper, Torque)

    def prepare(self, problem, tol):
        import casadi

        n = problem.system.nv
        times = np.linspace(*problem.span, GRID + 1)
        options = {"abstol": tol, "reltol": tol, "max_num_steps": 10_000_000, "disable_internal_warnings": True}
        solver = casadi.integrator("run", "idas", _equations(problem), times[0], list(times[1:]), options)
        x0 = np.concatenate((problem.q0, problem.v0))
        a, lam = acceleration(problem.system, problem.span[0], problem.q0, problem.v0)
        z0 = np.concatenate((a, lam))

        def solve():
            try:
                return solver(x0=x0, z0=z0)
            except RuntimeError as error:
                raise SolverFailed(f"IDAS: {str(error).strip().splitlines()[-1]}") from error

        def read(result, thin):
            chosen = thin(len(times))
            x = np.vstack((x0, np.array(result["xf"]).T))[chosen]
            z = np.vstack((z0, np.array(result["zf"]).T))[chosen]
            return Rows(times[chosen], x[:, :n], x[:, n:], problem.multipliers(x[:, :n], z[:, n:]))

        return solve, read


def _equations(problem):
    mechanism = problem.mechanism
    laws = [force for force in mechanism.forces if isinstance(force, Torque)]  # users', which must work on expressions
    symbols = Symbols(replace(mechanism, forces=tuple(force for force in mechanism.forces if force not in laws)))
    ca, still, q, v, a, u = symbols.ca, symbols.still, symbols.q, symbols.v, symbols.a, symbols.u
    lam, t = ca.SX.sym("lam", problem.system.nc), ca.SX.sym("t")
    phi = symbols.rows()[problem.system.kept.tolist()]
    J, gamma = still(ca.jacobian(phi, u)), still(ca.jtimes(ca.jtimes(phi, u, v), u, v))
    tau = symbols.applied() + sum(ca.vertcat(*law.function(t, q, v)) for law in laws)
    f = symbols.inverse_dynamics(v, a, mechanism.model.gravity.linear) - tau
    return {
        "x": ca.vertcat(q, v), "z": ca.vertcat(a, lam), "t": t,
        "ode": ca.vertcat(v, a), "alg": ca.cse(ca.vertcat(f - J.T @ lam, J @ a + gamma)),
    }  # fmt: skip


class Symbols:
    """Expressions in ``q``, ``v`` and ``a`` of a mechanism without moving drives; InputError if one is not possible.

    The expressions are those of joints displaced by a small motion u. Every joint has the pose T(q) E(u),
    E(u) = 1 + S u + (S u)²/2. At u = 0 the first and second derivatives by u are those along the joint's velocities, so
    that J = Φ_u, and J̇ v is the second derivative along v. The rows have the same zeros as those of
    :mod:`pinconsist.mechanism.loops`, and the same first two derivatives there.
    """

    def __init__(self, mechanism):
        import casadi as ca

        self.ca, self.mechanism, self.model = ca, mechanism, (model := mechanism.model)
        self.q = ca.SX.sym("q", model.nq)
        self.v, self.a, self.u = (ca.SX.sym(name, model.nv) for name in "vau")
        self._S, self._standing, self._on_parent = motions(mechanism), [None], [None]  # without u, and with
        for i in range(1, model.njoints):
            shift, turn = ca.vertsplit(ca.mtimes(self._S[i], self._own(self.u, i)), 3)
            X = ca.vertcat(ca.horzcat(ca.skew(turn), shift), ca.SX(1, 4))
            moved = ca.SX.eye(4) + X + 0.5 * ca.mtimes(X, X)
            self._standing.append(ca.mtimes(model.jointPlacements[i].homogeneous, self._pose(i)))
            self._on_parent.append(ca.mtimes(self._standing[i], moved))

    def _own(self, velocities, i):
        return velocities[self.model.idx_vs[i] : self.model.idx_vs[i] + self.model.nvs[i]]

    def _numbers(self, i):
        """The numbers of a joint in q: those of its position and of its rotation; a single axis has only the latter."""
        q = self.ca.vertsplit(self.q[self.model.idx_qs[i] : self.model.idx_qs[i] + self.model.nqs[i]])
        n = int(np.abs(self._S[i][:3]).any(axis=1).sum()) if self._S[i].shape[1] > 1 else 0
        return q[:n], q[n:]

    def _pose(self, i):
        """The pose of a joint at q."""
        ca, S, (place, turn) = self.ca, self._S[i], self._numbers(i)
        shift = ca.vertcat(*place, ca.SX(3 - len(place), 1)) if len(turn) != 1 else S[:3, 0] * turn[0]
        if len(turn) == 4:
            axis, s, c = ca.skew(ca.vertcat(*turn[:3])), 2 * turn[3], 2
        else:
            c, s = turn if len(turn) == 2 else (ca.cos(*turn), ca.sin(*turn)) if turn else (1, 0)
            axis, c = ca.skew(S[3:, -1]), 1 - c
        R = ca.SX.eye(3) + s * axis + c * ca.mtimes(axis, axis)
        return ca.vertcat(ca.horzcat(R, shift), ca.DM([[0, 0, 0, 1]]))

    def beyond(self, joint, target=0.0):
        """The distance of a joint from a target, the shorter way round if it stores (cos, sin)."""
        i, ca = self.model.getJointId(joint), self.ca
        turn, u = self._numbers(i)[1], self._own(self.u, i) - target
        if len(turn) == 1:
            return turn[0] + u
        c, s = ca.cos(u), ca.sin(u)
        return ca.atan2(turn[1] * c + turn[0] * s, turn[0] * c - turn[1] * s)

    def _seen(self, *ends):
        """The poses of places on joints, pairs (joint, pin.SE3), relative to the last joint that carries both."""
        common, poses = max(set.intersection(*(set(self.model.supports[joint]) for joint, _ in ends))), []
        for joint, place in ends:
            pose = self.ca.SX(place.homogeneous)
            while joint != common:
                joint, pose = self.model.parents[joint], self.ca.mtimes(self._on_parent[joint], pose)
            poses.append(pose)
        return poses

    def rows(self):
        """Φ of all rows, in q and u."""
        return self.ca.vertcat(self.ca.SX(0, 1), *map(self._rows, LoopRows.of(self.mechanism).closures))

    def _rows(self, closure):
        ca, loop = self.ca, closure.loop
        if isinstance(loop, Drive):
            return self.beyond(loop.joint, loop.curve(0.0))
        if isinstance(loop, Coupling):
            powers = enumerate((loop.offset, loop.ratio, *loop.higher))
            other = sum(share * self.beyond(joint) for joint, share in loop.shares[1].items())
            law = sum(factor * other**k for k, factor in powers)
            if isinstance(loop.joint, str):
                return self.beyond(loop.joint, law)
            return sum(share * self.beyond(joint) for joint, share in loop.joint.items()) - law
        if not isinstance(loop, Loop):
            raise InputError(f"{self.mechanism.name}: {loop.name!r} is a Python function and has no expression")
        one, two = self._seen((closure.joint1, closure.place1), (closure.joint2, closure.place2))
        d, R = (ca.mtimes(one[:3, :3].T, each) for each in (two[:3, 3] - one[:3, 3], two[:3, :3]))
        if isinstance(closure.translation, Length):
            return (ca.sumsqr(d) / closure.translation.length - closure.translation.length) / 2
        rows, turn = [ca.mtimes(closure.translation.directions, d)], closure.rotation
        if isinstance(turn, RotationVector):
            rows.append(ca.inv_skew((R - R.T) / 2))
        elif turn is not None:
            rows.append(ca.mtimes([turn.directions, R, turn.axis2]))
        return ca.vertcat(*rows)

    def inverse_dynamics(self, v, a, gravity):
        """Inertial forces and weights, (nv,), as by Pinocchio's ``rnea``."""
        ca, model, ways = self.ca, self.model, [None]
        motions, forces, tau = [(ca.SX(6, 1), ca.vertcat(-gravity, ca.SX(3, 1)))], [None], []
        for i in range(1, model.njoints):
            R, (speed, rate) = self._standing[i][:3, :3].T, motions[model.parents[i]]
            ways.append(self._blocks(R, -ca.mtimes(R, ca.skew(self._standing[i][:3, 3]))))
            moving, pushed = (ca.mtimes(self._S[i], self._own(each, i)) for each in (v, a))
            speed = ca.mtimes(ways[i], speed) + moving
            turn = self._blocks(*map(ca.skew, ca.vertsplit(speed, 3)[::-1]))
            rate = ca.mtimes(ways[i], rate) + pushed + ca.mtimes(turn, moving)
            motions.append((speed, rate))
            inertia = pin.Inertia(model.inertias[i]).matrix()
            forces.append(ca.mtimes(inertia, rate) - ca.mtimes([turn.T, inertia, speed]))
        for i in range(model.njoints - 1, 0, -1):
            tau.insert(0, ca.mtimes(self._S[i].T, forces[i]))
            if (parent := model.parents[i]) > 0:
                forces[parent] += ca.mtimes(ways[i].T, forces[i])
        return ca.vertcat(*tau) + model.armature * a

    def _blocks(self, turning, shifting):
        return self.ca.blockcat([[turning, shifting], [self.ca.SX(3, 3), turning]])

    def applied(self):
        """τ of the mechanism's forces at q and v; InputError for a force without an expression."""
        ca, total = self.ca, self.ca.SX(self.model.nv, 1)
        for force in (*model_forces(self.model), *self.mechanism.forces):
            if isinstance(force, JointDamping | JointFriction):
                size = spread(self.model, force.coefficients, "C", alike=True)
                total -= size * (self.v if isinstance(force, JointDamping) else ca.tanh(self.v / force.width))
            elif isinstance(force, JointSpring) and force.plain:
                total -= self._pull(self.beyond(force.joint, force.rest), force.stiffness)
            elif isinstance(force, SpringDamper):
                places = [(joint, pin.SE3(np.eye(3), offset)) for joint, offset in force.bind(self.model).ends]
                one, two = self._seen(*places)
                length = ca.norm_2(two[:3, 3] - one[:3, 3])
                total -= self._pull(length - force.length, force.stiffness, force.damping)
            elif isinstance(force, JointTorque) and (constant := force.bind(self.model).constant) is not None:
                total += constant
            else:
                label = label_of(force)
                raise InputError(f"{self.mechanism.name}: the force {label!r} has no expression")
        return self.still(total)

    def _pull(self, beyond, stiffness, damping=0.0):
        along = self.ca.jacobian(beyond, self.u)
        return along.T * (stiffness * beyond + damping * self.ca.mtimes(along, self.v))

    def still(self, expression):
        """The expression at u = 0."""
        return self.ca.substitute(expression, self.u, self.ca.DM.zeros(self.model.nv))
