"""A cam and its follower, which lifts off where the cam falls away faster than a spring can push, and bounces."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

ECCENTRIC, RADIUS = 0.01, 0.03  # m
MASS, STIFFNESS, PRELOAD = 0.5, 400.0, 8.0  # kg, N/m, N where the follower is lowest
SPEED = 60.0  # rad/s


def run():
    """Two revolutions of the cam."""
    model = pin.Model()
    model.gravity.setZero()
    cam = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "cam")
    model.appendBodyToJoint(cam, pin.Inertia(0.2, np.zeros(3), 1e-4 * np.eye(3)), pin.SE3.Identity())
    centre = pin.SE3(np.eye(3), np.array([0.0, 0.0, ECCENTRIC]))
    model.addFrame(pin.Frame("centre", cam, 0, centre, pin.FrameType.OP_FRAME))
    follower = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "follower")
    model.appendBodyToJoint(
        follower, pin.Inertia(MASS, np.array([0.0, 0.0, 0.02]), 1e-4 * np.eye(3)), pin.SE3.Identity()
    )
    lowest = RADIUS - ECCENTRIC
    spring = pc.JointSpring("follower", STIFFNESS, lowest - PRELOAD / STIFFNESS)
    face = pc.Contact("face", "centre", radius=RADIUS, normal=(0.0, 0.0, -1.0), on="follower")
    guess = {"cam": np.pi, "follower": lowest}
    motor = pc.Drive("motor", "cam", pc.Motion(start=np.pi, speed=SPEED))
    mech = pc.Mechanism(model, [motor], [spring], contacts=[face], name="cam", guess=guess)
    return mech, pc.simulate(mech, (0.0, 4.0 * np.pi / SPEED), v0={"cam": SPEED})


def main() -> float:
    """Return the angle of the cam at which the follower lifts off for the first time, rad from the lowest point."""
    _, sol = run()
    for each in sol.modes:
        print(f"{each.mode:6} from {each.t_begin:.6f} to {each.t_end:.6f} s")
    return SPEED * next(each.t_end for each in sol.modes if each.mode == "closed")


if __name__ == "__main__":
    print(f"{main():.6f} rad")
