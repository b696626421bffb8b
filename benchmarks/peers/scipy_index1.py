"""scipy's solve_ivp on the index-1 equations, by pin.constraintDynamics where it can, else by the KKT system."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.integrate import solve_ivp

from pinconsist.mechanism.forces import bound_forces
from pinconsist.paper import index1

from .problem import Peer, Rows, SolverFailed

MU, ITERATIONS = 1e-12, 10  # of Pinocchio's proximal solver: redundant rows of planar loops need it


class ScipyIvp(Peer):
    """ "DOP853", "LSODA" or "Radau" on v' = a(t, q, v)."""

    package = module = "scipy"

    def __init__(self, method):
        self.method, self.name = method, f"scipy {method}, index 1"

    def prepare(self, problem, tol):
        system, n = problem.system, problem.system.nv
        acceleration = accelerations(problem)
        y0 = np.concatenate((problem.q0, problem.v0))

        def rate(t, y):
            return np.concatenate((y[n:], acceleration(t, y[:n], y[n:])))

        def solve():
            return solve_ivp(rate, problem.span, y0, self.method, rtol=tol, atol=tol)

        def read(sol, thin):
            if not sol.success:
                raise SolverFailed(sol.message)
            rows = thin(len(sol.t))
            t, q, v = sol.t[rows], sol.y[:n, rows].T, sol.y[n:, rows].T
            lam = np.array([index1.acceleration(system, *state)[1] for state in zip(t, q, v, strict=True)])
            return Rows(t, q, v, problem.multipliers(q, lam))

        return solve, read


def accelerations(problem):
    """The function a(t, q, v): Pinocchio's own where its result is right at the start, else the KKT solve."""
    system = problem.system

    def by_kkt(t, q, v):
        return index1.acceleration(system, t, q, v)[0]

    by_pinocchio = _pinocchios(problem)
    if by_pinocchio is None:
        return by_kkt
    start = problem.span[0], problem.q0, problem.v0
    expected, got = by_kkt(*start), by_pinocchio(*start)
    right = np.abs(got - expected).max() <= 1e-8 * (1.0 + np.abs(expected).max())  # NaN where M is singular
    return by_pinocchio if right else by_kkt


def _pinocchios(problem):
    """a(t, q, v) by pin.constraintDynamics, or None where its contact models cannot express the loops."""
    mechanism, system = problem.mechanism, problem.system
    kept = {system.rows.labels[row] for row in system.kept}
    models = pin.StdVec_RigidConstraintModel()
    for loop, closure in zip(mechanism.loops, system.rows.closures, strict=True):
        tilts = {(loop.name, "tilt1"), (loop.name, "tilt2")}
        if loop.kind not in ("point", "hinge", "frame") or (loop.kind == "hinge" and tilts & kept):
            return None
        kind = pin.ContactType.CONTACT_6D if loop.kind == "frame" else pin.ContactType.CONTACT_3D
        ends = (closure.joint1, closure.place1, closure.joint2, closure.place2)
        models.append(pin.RigidConstraintModel(kind, mechanism.model, *ends, pin.ReferenceFrame.LOCAL))
    model, data = mechanism.model, mechanism.model.createData()
    datas = pin.StdVec_RigidConstraintData()
    for one in models:
        datas.append(one.createData())
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, MU, ITERATIONS)
    forced, still = bool(bound_forces(model, mechanism.forces)), np.zeros(model.nv)

    def acceleration(t, q, v):
        tau = system.torque(t, q, v) if forced else still
        return pin.constraintDynamics(model, data, q, v, tau, models, datas, settings).copy()

    return acceleration
