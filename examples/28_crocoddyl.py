"""An action model for Crocoddyl: a step of a closed chain under held torques, with its own A and B."""

import numpy as np

import pinconsist as pc

try:
    import crocoddyl
except ImportError as error:
    raise pc.MissingExtraError("this example needs Crocoddyl: pip install crocoddyl") from error

H, N = 0.02, 40  # s, of a node; nodes
MECH = pc.load("five_bar")
NV, MOTORS = MECH.nv, [MECH.columns(joint).start for joint in MECH.actuated]
HANGING = pc.equilibrium(MECH, {"left_crank": 1.2, "right_crank": 1.9}).q
GOAL = HANGING[MOTORS] + np.array([-0.9, -0.6])  # rad
SEEN = np.concatenate((MOTORS, NV + np.array(MOTORS)))  # of the state (q, v)
AT_END, EFFORT = np.array([1e4, 1e4, 1e2, 1e2]), 1e-2


class Step(crocoddyl.ActionModelAbstract):
    """A step of H s from the state x = (q, v) on the loops, under two torques; the last node has u = None."""

    def __init__(self, sim):
        super().__init__(crocoddyl.StateVector(2 * NV), len(MOTORS))
        self.sim = sim.copy()  # each node linearises its own step

    def calc(self, data, x, u=None):
        if u is None:
            off = x[SEEN] - np.concatenate((GOAL, np.zeros(2)))
            data.cost = 0.5 * float(off @ (AT_END * off))
            return
        self.sim.reset(x[:NV].copy(), x[NV:].copy())
        state = self.sim.step(H, control=dict(zip(MECH.actuated, u, strict=True)))
        data.xnext = np.concatenate((state.q, state.v))
        data.cost = 0.5 * EFFORT * float(u @ u)

    def calcDiff(self, data, x, u=None):  # of Crocoddyl
        if u is None:
            data.Lx, data.Lxx = np.zeros(2 * NV), np.zeros((2 * NV, 2 * NV))
            data.Lx[SEEN] = AT_END * (x[SEEN] - np.concatenate((GOAL, np.zeros(2))))
            data.Lxx[SEEN, SEEN] = AT_END
            return
        data.Fx, data.Fu = self.sim.linearized()
        data.Lu, data.Luu = EFFORT * u, EFFORT * np.eye(2)


def run():
    """The mechanism, the solver, and the run of the plan in one simulation."""
    sim = pc.Simulation(MECH, HANGING)
    start = np.concatenate((HANGING, np.zeros(NV)))
    problem = crocoddyl.ShootingProblem(start, [Step(sim) for _ in range(N)], Step(sim))
    solver = crocoddyl.SolverDDP(problem)
    torques = [np.zeros(2)] * N
    solver.solve(problem.rollout(torques), torques, 50, True)
    for u in solver.us:
        sim.step(H, control=dict(zip(MECH.actuated, u, strict=True)))
    return MECH, (solver, sim.solution())


def main() -> float:
    """Return the angle of the left crank at the end, rad."""
    solver, sol = run()[1]
    print(
        f"cost {solver.cost:.4f} after {solver.iter} iterations, {np.abs(sol.q[-1, MOTORS] - GOAL).max():.1e} rad off"
    )
    return float(sol.q[-1, MOTORS[0]])


if __name__ == "__main__":
    print(f"{main():.6f} rad")
