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


class Cranks(gymnasium.vector.VectorEnv):
    """The same for many cranks, stepped together; an episode that has ended begins anew in the next step."""

    def __init__(self, num_envs):
        self.num_envs = num_envs
        self.single_observation_space, self.single_action_space = Crank.observation_space, Crank.action_space
        self.observation_space = gymnasium.vector.utils.batch_space(self.single_observation_space, num_envs)
        self.action_space = gymnasium.vector.utils.batch_space(self.single_action_space, num_envs)
        self.sims = pc.Simulations(pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0)), num_envs)
        self.ended = np.zeros(num_envs, bool)

    def reset(self, *, seed=None, options=None):
        """Start new episodes: at rest, with new targets."""
        super().reset(seed=seed)
        self.targets, self.ended = self.np_random.uniform(-1.0, 1.0, self.num_envs), np.zeros(self.num_envs, bool)
        self.sims.reset()
        return self.observations(), {}

    def step(self, actions):
        """Hold torques for 20 ms."""
        anew = self.ended
        if anew.any():
            self.sims.reset(anew)
            self.targets[anew] = self.np_random.uniform(-1.0, 1.0, anew.sum())
        self.sims.step(DT, {"crank0": MOST * np.where(anew, 0.0, actions[:, 0])})
        found = self.observations()
        rewards = -(found[:, 0] ** 2) - 0.01 * found[:, 1] ** 2
        failed = self.sims.failed.copy()
        self.ended = failed | (self.sims.state.t > END - DT / 2)
        return found, rewards, failed, self.ended & ~failed, {}

    def observations(self):
        """The distances to the targets, and the speeds."""
        _, q, v = self.sims.state
        return np.column_stack((self.targets - q[:, 0], v[:, 0]))


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
