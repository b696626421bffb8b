"""A digital controller: PD control at 100 Hz, torques held between samples, turns a parallelogram to an angle."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

CRANK, BASE = 0.2, 0.3  # m
PERIOD, STIFFNESS, DAMPING, TARGET = 1e-2, 4.0, 0.2, 0.5  # s, N·m/rad, N·m·s/rad, rad


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


def law(t, q, v):
    """PD control of the left crank."""
    return STIFFNESS * (TARGET - q[0]) - DAMPING * v[0]


def run():
    """The mechanism, and half a second of its motion."""
    mech = parallelogram()
    controller = pc.Sampled(PERIOD, law, joints="left")
    return mech, pc.simulate(mech, (0.0, 0.5), method="Radau", forces=[controller])


def main() -> float:
    """Return the crank's angle at the end, rad."""
    _, sol = run()
    print(f"{len(sol.held['sampled left'])} samples, {sol.nsteps} steps, forces good to {sol.check().force:.0e}")
    return float(sol.q[-1, 0])


if __name__ == "__main__":
    print(f"{main():.9f} rad")
