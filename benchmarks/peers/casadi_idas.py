"""CasADi's interface to SUNDIALS IDAS, which takes semi-explicit equations of index 1, written as expressions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinconsist import JointSpring, JointTorque, SpringDamper, Torque
from pinconsist.analysis.motor_code import Symbols
from pinconsist.paper.index1 import acceleration

from .problem import Peer, Rows, SolverFailed

GRID = 500
"""Output times: the interface does not return the steps that IDAS takes."""


class CasadiIdas(Peer):
    """IDAS with exact derivatives: x = (q, v), z = (a, λ), 0 = f(q, v, a) - Jᵀλ, 0 = J a + γ.

    Pinocchio's wheel is built without CasADi; the expressions are those of which the package makes C code.
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
