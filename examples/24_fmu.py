"""A linkage as a functional mock-up unit (FMI 3), which other tools can simulate with their own models; here FMPy."""

import tempfile

import numpy as np

import pinconsist as pc

try:
    from fmpy import simulate_fmu
    from pythonfmu3 import CoSimulation, Float64, Fmi3Causality, Fmi3Slave, Fmi3Variability, FmuBuilder
except ImportError as error:
    raise pc.MissingExtraError("this example needs PythonFMU3 and FMPy: pip install pythonfmu3 fmpy") from error

DT, END, TORQUE = 1e-3, 0.2, 5.0  # s between exchanges, s, N·m


class Linkage(Fmi3Slave, CoSimulation):
    """A parallelogram linkage: the input is the torque on its crank, the outputs are its angle and speed."""

    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.sim = pc.Simulation(pc.load("n_four_bar_1").with_gravity((0.0, 0.0, 0.0)))
        self.time = self.torque = 0.0
        time = {"causality": Fmi3Causality.independent, "variability": Fmi3Variability.continuous}
        self.register_variable(Float64("time", **time))
        self.register_variable(Float64("torque", causality=Fmi3Causality.input, start=0.0))
        self.register_variable(Float64("angle", causality=Fmi3Causality.output))
        self.register_variable(Float64("speed", causality=Fmi3Causality.output))

    angle = property(lambda self: float(self.sim.state.q[0]))
    speed = property(lambda self: float(self.sim.state.v[0]))

    def do_step(self, current_time, step_size):
        """Advance by the time between two exchanges; the torque is held."""
        self.sim.step(step_size, {"crank0": self.torque})
        return True


def run():
    """The mechanism, and the angle and speed of a run in FMPy under a torque that grows with time."""
    with tempfile.TemporaryDirectory() as folder:
        unit = FmuBuilder.build_FMU(__file__, folder)  # a file that other tools can import
        torque = np.array([(0.0, 0.0), (END, TORQUE)], [("time", float), ("torque", float)])
        found = simulate_fmu(
            unit, stop_time=END, step_size=DT, output_interval=DT, input=torque, output=["angle", "speed"]
        )
    return pc.load("n_four_bar_1"), found


def main() -> float:
    """Return the crank's speed at the end, rad/s."""
    _, found = run()
    print(f"{len(found) - 1} exchanges, the crank turned by {found['angle'][-1]:.4f} rad")
    return float(found["speed"][-1])


if __name__ == "__main__":
    print(f"{main():.9f} rad/s")
