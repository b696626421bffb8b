"""A Gymnasium vector environment: 64 linkages, each with other masses in every episode, turn to random angles."""

import numpy as np

import pinconsist as pc

try:
    import gymnasium
    from gymnasium.vector import AutoresetMode, VectorEnv
except ImportError as error:
    raise pc.MissingExtraError("this example needs gymnasium: pip install gymnasium") from error

DT, MOST, END = 0.02, 20.0, 1.0  # s of an action, N·m, s of an episode


class Cranks(VectorEnv):
    """As example 23; the mass of the coupler is new in each episode, changed in place."""

    metadata = {"autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(self, number=64):
        self.num_envs, box = number, gymnasium.spaces.Box
        self.single_observation_space = box(-np.inf, np.inf, (2,), np.float64)
        self.single_action_space = box(-1.0, 1.0, (1,), np.float64)
        self.observation_space = box(-np.inf, np.inf, (number, 2), np.float64)
        self.action_space = box(-1.0, 1.0, (number, 1), np.float64)
        first = pc.Simulation(pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0)))
        self.start, self.sims = first.state, [first, *(first.copy() for _ in range(number - 1))]
        self.targets, self.masses, self.over = np.zeros(number), np.ones(number), np.zeros(number, bool)

    def reset(self, *, seed=None, options=None):
        """Start new episodes everywhere."""
        super().reset(seed=seed)
        for i in range(self.num_envs):
            self.begin(i)
        return self.observations(), {}

    def begin(self, i):
        """A new episode of one linkage: at rest, with a new target and a new mass."""
        self.targets[i], self.masses[i], self.over[i] = *self.np_random.uniform((-1.0, 0.5), (1.0, 2.0)), False
        self.sims[i].reset(self.start.q, self.start.v)
        self.sims[i].set_parameters({"mass:coupler0": self.masses[i]})

    def step(self, actions):
        """Hold torques for 20 ms; linkages whose episodes were over begin new ones instead."""
        for i, sim in enumerate(self.sims):
            if self.over[i]:
                self.begin(i)
            else:
                sim.step(DT, {"crank0": MOST * float(actions[i, 0])})
        seen = self.observations()
        self.over = np.array([sim.state.t > END - DT / 2 for sim in self.sims])
        return seen, -(seen[:, 0] ** 2) - 0.01 * seen[:, 1] ** 2, np.zeros(self.num_envs, bool), self.over.copy(), {}

    def observations(self):
        """The distances to the targets, and the speeds, (n, 2)."""
        return np.array([[target - sim.state.q[0], sim.state.v[0]]
                         for target, sim in zip(self.targets, self.sims, strict=True)])  # fmt: skip


def run(seed=3):
    """The mechanism, and an episode of all linkages under a fixed policy: returns, targets and masses."""
    env = Cranks()
    seen, total = env.reset(seed=seed)[0], 0.0
    for _ in range(round(END / DT)):
        seen, rewards, *_ = env.step(np.clip(2.0 * seen[:, :1] - 0.5 * seen[:, 1:], -1.0, 1.0))
        total = total + rewards
    return env.sims[0].mechanism, (env.sims[0].solution(), total, env.targets, env.masses)


def main() -> float:
    """Return the mean of the returns."""
    return float(run()[1][1].mean())


if __name__ == "__main__":
    print(f"return {main():.9f}")
