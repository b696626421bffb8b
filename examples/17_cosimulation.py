"""Co-simulation: the current of a motor, integrated elsewhere, turns a parallelogram linkage, 1 ms at a time."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

CRANK, BASE = 0.2, 0.3  # m
DT, VOLTAGE, RESISTANCE, INDUCTANCE, CONSTANT = 1e-3, 6.0, 2.0, 5e-3, 0.2  # s, V, Ω, H, N·m/A (V·s/rad)


def parallelogram():
    """Two cranks and a coupler that does not turn, without weight: its inertia is the same at each angle."""
    model = pin.Model()
    model.gravity.setZero()

    def body(parent, name, place, mass, inertia):
        joint = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array(place)), name)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.zeros(3), inertia * np.eye(3)), pin.SE3.Identity())
        return joint

    def point(joint, name, place):
        place = pin.SE3(np.eye(3), np.array(place))
        model.addFrame(pin.Frame(name, joint, 0, place, pin.FrameType.OP_FRAME))

    left = body(0, "left", (0, 0, 0), 0.5, 2e-3)
    point(body(left, "coupler", (0, 0, CRANK), 0.4, 1e-3), "end", (BASE, 0, 0))
    point(body(0, "right", (BASE, 0, 0), 0.5, 2e-3), "tip", (0, 0, CRANK))
    loop = pc.Loop("corner", "hinge", "end", "tip", axis=(0, 1, 0))
    return pc.Mechanism(model, [loop], name="parallelogram")


def circuit(current, speed):
    """The current after DT at constant speed: the other program."""
    final = (VOLTAGE - CONSTANT * speed) / RESISTANCE
    return final + (current - final) * np.exp(-RESISTANCE / INDUCTANCE * DT)


def run():
    """The mechanism, and a fifth of a second of its motion."""
    sim, current = pc.Simulation(parallelogram()), 0.0
    for _ in range(200):
        torque, current = CONSTANT * current, circuit(current, sim.state.v[0])
        sim.step(DT, {"left": torque})
    return sim.mechanism, sim.solution()


def main() -> float:
    """Return the crank's speed at the end, rad/s."""
    _, sol = run()
    print(f"{sol.nsteps} steps, the loop closed to {sol.check().position:.0e} m")
    return float(sol.v[-1, 0])


if __name__ == "__main__":
    print(f"{main():.9f} rad/s")
