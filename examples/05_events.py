"""A latch that closes at an event: a ballistic pendulum catches a flying ball, and both swing on together."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

LENGTH, ROD, BALL, SPEED = 1.0, 2.0, 0.5, 6.0  # m, kg, kg, m/s
AWAY = 1.5  # m, distance of the throw; the ball arrives flying horizontally


def scene() -> pc.Mechanism:
    """A rod that hangs on a hinge, and a ball that is free to fly in the plane."""
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "hinge")
    across = ROD * LENGTH**2 / 12
    rod = pin.Inertia(ROD, np.array([0, 0, -LENGTH / 2]), np.diag([across, across, 1e-4]))
    model.appendBodyToJoint(hinge, rod, pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([0, 0, -LENGTH]))
    model.addFrame(pin.Frame("tip", hinge, 0, tip, pin.FrameType.OP_FRAME))
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "ball_x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "ball_z")
    model.appendBodyToJoint(z, pin.Inertia(BALL, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("ball", z, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    return pc.Mechanism(model, name="ballistic pendulum")


def run():
    """Fly, catch, swing until the rod comes to rest."""
    apart, options = scene(), {"rtol": 1e-9, "atol": 1e-9}
    fall = 9.81 * AWAY / SPEED  # m/s, the vertical velocity that the ball loses in flight
    start = {"ball_x": -AWAY, "ball_z": -LENGTH - fall**2 / (2 * 9.81)}
    arrives = pc.Event(lambda t, q, v, lam: q[1], terminal=True, name="arrives")
    flight = pc.simulate(apart, (0.0, 1.0), start, {"ball_x": SPEED, "ball_z": fall}, events=arrives, **options)
    # The latch is a loop. simulate projects the velocities onto it in the mass metric, which is the impact.
    caught = apart.with_loops(pc.Loop("latch", "point", "tip", "ball"))
    rests = pc.Event(lambda t, q, v, lam: v[0], terminal=True, name="rests")
    return caught, pc.simulate(caught, (flight.t[-1], 3.0), flight.q[-1], flight.v[-1], events=rests, **options)


def main() -> float:
    """Return the angle to which the rod swings, rad."""
    _, sol = run()
    print(f"caught at {sol.t[0]:.4f} s, at rest at {sol.t[-1]:.4f} s")
    print(sol.reaction("latch"))
    return float(abs(sol.q[-1, 0]))


if __name__ == "__main__":
    print(f"{main():.6f} rad")
