"""A Gymnasium environment: torques turn a parallelogram linkage to random angles, with 50 actions per second."""

import numpy as np

import pinconsist as pc

try:
    import gymnasium
except ImportError as error:
    raise pc.MissingExtraError("this example needs gymnasium: pip install gymnasium") from error

DT, MOST, END = 0.02, 20.0, 1.0  # s of an action, N·m, s of an episode


class Crank(gymnasium.Env):
    """Turn the crank to an angle; the observations are the distance to it and the speed."""

    observation_space = gymnasium.spaces.Box(-np.inf, np.inf, (2,), np.float64)
    action_space = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float64)

    def __init__(self):
        self.sim = pc.Simulation(pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0)))

    def reset(self, *, seed=None, options=None):
        """Start a new episode: at rest, with a new target."""
        super().reset(seed=seed)
        self.target = self.np_random.uniform(-1.0, 1.0)
        self.sim.reset()
        return self.observation(), {}

    def step(self, action):
        """Hold a torque for 20 ms."""
        self.sim.step(DT, {"crank0": MOST * float(action[0])})
        away, speed = self.observation()
        return self.observation(), -(away**2) - 0.01 * speed**2, False, self.sim.state.t > END - DT / 2, {}

    def observation(self):
        """The distance to the target, and the speed."""
        return np.array([self.target - self.sim.state.q[0], self.sim.state.v[0]])


def run(seed=3):
    """The mechanism, an episode under a fixed policy, and its return and target."""
    env, total = Crank(), 0.0
    away, speed = env.reset(seed=seed)[0]
    for _ in range(round(END / DT)):
        (away, speed), reward, *_ = env.step([np.clip(2.0 * away - 0.5 * speed, -1.0, 1.0)])
        total += reward
    return env.sim.mechanism, (env.sim.solution(), total, env.target)


def main() -> float:
    """Return the sum of an episode's rewards."""
    sol, total, target = run()[1]
    print(f"target {target:.6f} rad, reached {sol.q[-1, 0]:.6f} rad")
    return total


if __name__ == "__main__":
    print(f"return {main():.9f}")
