"""A ball on a rail bounces off a wall: an event that changes the velocity, after which the run starts afresh."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

BOUNCE = 0.8  # velocity after over velocity before


def main() -> float:
    """Let the ball fall 1 m and bounce; return the time of the third impact, s."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(slide, pin.Inertia(1.0, np.zeros(3), np.eye(3) * 1e-3), pin.SE3.Identity())
    impact = pc.Event(lambda t, q, v, lam: q[0], direction=-1, terminal=3, apply=lambda t, q, v: -BOUNCE * v)
    sol = pc.simulate(pc.Mechanism(model), (0.0, 5.0), {"height": 1.0}, events=impact, rtol=1e-9, atol=1e-9)
    print(sol.message)
    print("impacts at", sol.t_events[0])
    return float(sol.t_events[0][2])


if __name__ == "__main__":
    print(f"{main():.6f} s")
