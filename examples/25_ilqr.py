"""iLQR swings a five-bar up through torques that are held for 10 ms, with A and B of the steps themselves."""

import numpy as np

import pinconsist as pc

H, N = 0.01, 100  # s, of a sample; samples
EFFORT, GOAL = 0.01, np.diag([1000.0, 1000.0, 10.0, 10.0])  # weights of torques, and of the state at the end
MECH = pc.load("five_bar")
MOTORS = [MECH.columns(joint).start for joint in MECH.actuated]
HANGING = pc.equilibrium(MECH, {"left_crank": 1.2, "right_crank": 1.9}).q
UP = np.array([*(HANGING[MOTORS] - np.pi), 0.0, 0.0])  # positions and velocities of the motors


class Trajectory:
    """Torques (n, 2), the states under them, and A and B of each step in the coordinates of the motors."""

    def __init__(self, sim, torques, around=None, gains=()):
        self.states, self.torques, self.steps = [sim.reset(HANGING, np.zeros(4))], np.array(torques), []
        for k in range(len(torques)):
            if around is not None:
                feedforward, feedback = gains[k]
                self.torques[k] += feedforward + feedback @ (self.at(k) - around.at(k))
            self.states.append(sim.step(H, control=dict(zip(MECH.actuated, self.torques[k], strict=True))))
            found = sim.linearized()
            self.steps.append((found.A_reduced, found.B_reduced))
        self.cost = 0.5 * (EFFORT * (self.torques**2).sum() + (self.at(-1) - UP) @ GOAL @ (self.at(-1) - UP))

    def at(self, k):
        return np.concatenate((self.states[k].q[MOTORS], self.states[k].v[MOTORS]))


def gains(found, damping):
    """(feedforward, feedback) of each step, from the last to the first; damping makes the changes smaller."""
    V, g, out = GOAL, GOAL @ (found.at(-1) - UP), []
    for (A, B), u in zip(reversed(found.steps), reversed(found.torques), strict=True):
        Quu, Qux, Qu = EFFORT * np.eye(2) + B.T @ V @ B, B.T @ V @ A, EFFORT * u + B.T @ g
        damped = Quu + damping * np.eye(2)
        k, K = -np.linalg.solve(damped, Qu), -np.linalg.solve(damped, Qux)
        g = A.T @ g + K.T @ (Quu @ k + Qu) + Qux.T @ k
        V = A.T @ V @ A + K.T @ Quu @ K + K.T @ Qux + Qux.T @ K
        out.append((k, K))
    return out[::-1]


def first_torques():
    """Those of inverse dynamics for cranks that turn together from hanging to upright."""
    t, s = np.linspace(0.0, N * H, 11), np.linspace(0.0, 1.0, 11)
    turned = -np.pi * s**3 * (10 - 15 * s + 6 * s**2)
    drives = [pc.Drive(joint, joint, (t, HANGING[i] + turned)) for joint, i in zip(MECH.actuated, MOTORS, strict=True)]
    found = pc.inverse_dynamics(MECH.add_loops(*drives), H * (0.5 + np.arange(N)), HANGING)
    return np.column_stack([found.torques[joint] for joint in MECH.actuated])


def run():
    """The mechanism, its motion under the torques that were found, and the trajectories of all iterations."""
    sim, damping = pc.Simulation(MECH, rtol=1e-7, atol=1e-9), EFFORT
    every = [Trajectory(sim, first_torques())]
    for _ in range(20):
        other = Trajectory(sim, every[-1].torques, every[-1], gains(every[-1], damping))
        better = other.cost < every[-1].cost
        every, damping = [*every, other] if better else every, damping / 3.0 if better else 10.0 * damping
    torques = pc.HeldTorque(H * np.arange(N), every[-1].torques, joints=MECH.actuated)
    return MECH, (pc.simulate(MECH, (0.0, N * H), HANGING, forces=[torques]), every)


def main() -> float:
    """Return how far the left crank has turned, rad."""
    sol, every = run()[1]
    largest = np.abs(every[-1].torques).max()
    print(f"cost {every[0].cost:.3f} to {every[-1].cost:.3f}, torques to {largest:.2f} N·m")
    return float(sol.position("left_crank")[-1] - HANGING[0])


if __name__ == "__main__":
    print(f"{main():.6f} rad")
