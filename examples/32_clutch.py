"""A clutch: a flywheel grips a load by dry friction, which slips until both turn alike, holds, and slips again."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

MOTOR, LOAD = 0.2, 0.5  # kg m²
SPEED, GRIP = 100.0, (12.0, 10.0)  # rad/s; N·m, at rest and while it slips
BEGIN, RATE = 2.0, 30.0  # s, N·m/s: the load is braked harder and harder


def brake(t):
    """The moment on the load, N·m."""
    return -RATE * max(t - BEGIN, 0.0), 0.0, 0.0


def run():
    """Grip at t = 0, and brake the load from t = 2 s on."""
    model, parent = pin.Model(), 0
    for name, inertia in (("motor", MOTOR), ("clutch", LOAD)):  # that of the clutch is the angle of the load against it
        parent = model.addJoint(parent, pin.JointModelRX(), pin.SE3.Identity(), name)
        body = pin.Inertia(1.0, np.zeros(3), np.diag([inertia, 1.0, 1.0]))
        model.appendBodyToJoint(parent, body, pin.SE3.Identity())
    friction = pc.DryFriction("clutch", GRIP, name="plates")
    mech = pc.Mechanism(model, forces=[pc.Wrench("clutch", moment=brake)], contacts=[friction], name="clutch")
    return mech, pc.simulate(mech, (0.0, 4.0), v0={"motor": SPEED, "clutch": -SPEED})


def main() -> float:
    """Return the time at which the plates hold, s."""
    _, sol = run()
    for each in sol.modes:
        print(f"{each.mode:6} from {each.t_begin:.6f} to {each.t_end:.6f} s")
    return sol.modes[0].t_end


if __name__ == "__main__":
    print(f"{main():.6f} s")
