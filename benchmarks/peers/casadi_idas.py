"""CasADi's interface to SUNDIALS IDAS, which takes semi-explicit equations of index 1, written as expressions."""

from __future__ import annotations

import numpy as np

from pinconsist import JointSpring, JointTorque, SpringDamper, Torque
from pinconsist.dae.index1 import solve_acceleration

from .problem import Peer, Rows, SolverFailed, loop_ends, spring_ends

GRID = 500
"""Output times: the interface does not return the steps that IDAS takes."""


class CasadiIdas(Peer):
    """IDAS with exact derivatives: x = (q, v), z = (a, λ), 0 = f(q, v, a) - Jᵀλ, 0 = J a + γ.

    Pinocchio's wheel is built without CasADi, so the equations are written once more, by Newton and Euler's recursion.
    """

    package = module = "casadi"
    name = "CasADi IDAS, index 1"
    loops = ("point", "hinge", "distance")
    forces = (JointSpring, JointTorque, SpringDamper, Torque)

    def prepare(self, problem, tol):
        import casadi

        n = problem.system.nv
        times = np.linspace(*problem.span, GRID + 1)
        equations = _equations(casadi, problem)
        options = {"abstol": tol, "reltol": tol, "max_num_steps": 10_000_000, "disable_internal_warnings": True}
        solver = casadi.integrator("run", "idas", equations, times[0], list(times[1:]), options)
        x0 = np.concatenate((problem.q0, problem.v0))
        a, lam = solve_acceleration(problem.system, problem.span[0], problem.q0, problem.v0)
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


def _equations(casadi, problem):
    mechanism, system = problem.mechanism, problem.system
    n, m = system.nv, system.nc
    q, v, a = (casadi.SX.sym(name, n) for name in "qva")
    lam, t = casadi.SX.sym("lam", m), casadi.SX.sym("t")
    tree = _Tree(casadi, mechanism.model, q)
    rows = []
    for closure in system.rows.closures:
        one, two = (tree.point(*end) for end in loop_ends(closure))
        gap = two - one
        if closure.loop.kind == "distance":
            L = closure.loop.length
            rows.append((casadi.dot(gap, gap) - L**2) / (2 * L))
        else:
            local = (tree.R[closure.joint1] @ closure.place1.rotation).T @ gap
            rows += [local[0], local[1], local[2]] + [casadi.SX(0)] * (len(closure.loop.rows) - 3)
    phi = casadi.vertcat(*[rows[i] for i in system.kept])
    velocity = casadi.jtimes(phi, q, v)
    gamma = casadi.jtimes(velocity, q, v)
    dynamics = (
        tree.inverse_dynamics(v, a) - _torque(casadi, mechanism, tree, t, q, v) - casadi.jtimes(phi, q, lam, True)
    )
    closing = casadi.jtimes(phi, q, a) + gamma
    return {
        "x": casadi.vertcat(q, v), "z": casadi.vertcat(a, lam), "t": t,
        "ode": casadi.vertcat(v, a), "alg": casadi.vertcat(dynamics, closing),
    }  # fmt: skip


def _torque(casadi, mechanism, tree, t, q, v):
    model = mechanism.model
    tau = -casadi.DM(np.array(model.damping)) * v
    for force in mechanism.forces:
        if isinstance(force, JointTorque):
            tau += casadi.DM(force.bind(model).value)
        elif isinstance(force, JointSpring):
            column = mechanism.columns(force.joint).start
            unit = np.eye(len(np.array(model.damping)))[column]
            tau -= casadi.DM(force.stiffness * unit) * (q[column] - force.rest)
        elif isinstance(force, SpringDamper):
            one, two = (tree.point(*end) for end in spring_ends(model, force))
            length = casadi.norm_2(two - one)
            tension = force.stiffness * (length - force.length) + force.damping * casadi.jtimes(length, q, v)
            tau -= casadi.gradient(length, q) * tension
        else:  # a user's law, which must work on expressions
            tau += casadi.vertcat(*force.function(t, q, v))
    return tau


class _Tree:
    """Orientation R and origin p of each body of a tree of hinges and sliders, in world axes, as expressions in q."""

    def __init__(self, casadi, model, q):
        self.casadi, self.model = casadi, model
        self.R, self.p = [casadi.SX.eye(3)], [casadi.SX.zeros(3)]
        self.steps = [None]  # (rotation, translation) from each joint's parent
        for joint in range(1, model.njoints):
            place, kind = model.jointPlacements[joint], model.joints[joint].shortname()[-2:]
            value, axis = q[model.idx_qs[joint]], np.eye(3)["XYZ".index(kind[1])]
            turn, shift = casadi.DM(place.rotation), casadi.DM(place.translation)
            if kind[0] == "R":
                turn = casadi.mtimes(turn, _turning(casadi, axis, value))
            else:
                shift = shift + casadi.mtimes(turn, casadi.DM(axis)) * value
            parent = model.parents[joint]
            self.steps.append((turn, shift))
            self.p.append(self.p[parent] + casadi.mtimes(self.R[parent], shift))
            self.R.append(casadi.mtimes(self.R[parent], turn))

    def point(self, joint, place):
        """World position of a point of a body."""
        return self.p[joint] + self.casadi.mtimes(self.R[joint], self.casadi.DM(place))

    def inverse_dynamics(self, v, a):
        """M a + nle by Newton and Euler's recursion."""
        casadi, model = self.casadi, self.model
        cross, times = casadi.cross, casadi.mtimes
        motion, loads = [(casadi.SX.zeros(3), casadi.SX.zeros(3), -casadi.DM(model.gravity.linear))], [None]
        axes = [None]
        for joint in range(1, model.njoints):
            (turn, shift), kind = self.steps[joint], model.joints[joint].shortname()[-2:]
            axis, column = casadi.DM(np.eye(3)["XYZ".index(kind[1])]), model.idx_vs[joint]
            w, wd, up = motion[model.parents[joint]]
            linear = times(turn.T, up + cross(wd, shift) + cross(w, cross(w, shift)))
            w, wd = times(turn.T, w), times(turn.T, wd)
            if kind[0] == "R":
                wd = wd + cross(w, axis) * v[column] + axis * a[column]
                w = w + axis * v[column]
            else:
                linear = linear + 2 * cross(w, axis) * v[column] + axis * a[column]
            motion.append((w, wd, linear))
            axes.append((kind[0], axis))
            body = model.inertias[joint]
            arm, I = casadi.DM(body.lever), casadi.DM(body.inertia)
            force = body.mass * (linear + cross(wd, arm) + cross(w, cross(w, arm)))
            loads.append([force, times(I, wd) + cross(w, times(I, w)) + cross(arm, force)])
        tau = casadi.SX.zeros(model.nv)
        for joint in range(model.njoints - 1, 0, -1):
            (force, moment), (kind, axis), column = loads[joint], axes[joint], model.idx_vs[joint]
            tau[column] = casadi.dot(axis, moment if kind == "R" else force) + model.armature[column] * a[column]
            if parent := model.parents[joint]:
                turn, shift = self.steps[joint]
                force = times(turn, force)
                loads[parent][0] += force
                loads[parent][1] += times(turn, moment) + cross(shift, force)
        return tau


def _turning(casadi, axis, angle):
    """Rotation matrix about a coordinate axis."""
    K = np.array([[0, -axis[2], axis[1]], [axis[2], 0, -axis[0]], [-axis[1], axis[0], 0]])
    return casadi.DM.eye(3) + casadi.sin(angle) * casadi.DM(K) + (1 - casadi.cos(angle)) * casadi.DM(K @ K)
