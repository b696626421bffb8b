"""A closed-chain gripper: two geared parallelograms close until an event detects contact; the grip force."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

BAR, BASE, PALM, BALL = 0.06, 0.03, 0.015, 0.05  # m: crank, base of a parallelogram, half the palm, ball's diameter
TORQUE = 0.3  # N·m, of the motor on the left crank


def finger(model, side, sign):
    """Crank and follower turn about y on the palm, and the pad on the crank; the loop connects follower and pad."""

    def body(parent, name, place, mass, centre):
        joint = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), np.array(place)), f"{side}_{name}")
        inertia = pin.Inertia(mass, np.array(centre), 2e-5 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return joint

    def point(joint, name, place):
        place = pin.SE3(np.eye(3), np.array(place))
        model.addFrame(pin.Frame(f"{side}_{name}", joint, 0, place, pin.FrameType.OP_FRAME))

    crank = body(0, "crank", (sign * PALM, 0, 0), 0.05, (0, 0, BAR / 2))
    pad = body(crank, "pad", (0, 0, BAR), 0.05, (0, 0, 0.02))
    point(pad, "outer", (sign * BASE, 0, 0))
    point(pad, "contact", (0, 0, 0.04))
    point(body(0, "follower", (sign * (PALM + BASE), 0, 0), 0.05, (0, 0, BAR / 2)), "end", (0, 0, BAR))
    return pc.Loop(side, "hinge", f"{side}_end", f"{side}_outer", axis=(0, 1, 0))


def run():
    """Close on the ball; return the gripper holding it, and the motion up to the contact."""
    model = pin.Model()
    model.gravity.setZero()
    loops = [finger(model, "left", -1), finger(model, "right", 1)]
    gears = pc.Coupling("gears", "right_crank", "left_crank", ratio=-1.0)
    lean = {"left_crank": -0.6, "left_pad": 0.6, "left_follower": -0.6}  # open
    guess = lean | {joint.replace("left", "right"): -angle for joint, angle in lean.items()}
    forces = [{"left_crank": TORQUE}, pc.JointDamping({"left_crank": 0.1})]
    mech = pc.Mechanism(model, [*loops, gears], forces, name="gripper", guess=guess)
    contact = pc.Event(lambda t, q, v, lam: 2 * (PALM - BAR * np.sin(q[0])) - BALL, terminal=True, name="contact")
    sol = pc.simulate(mech, (0.0, 2.0), events=contact)
    ball = pc.Loop("ball", "distance", "left_contact", "right_contact", length=BALL)
    return mech.add_loops(ball), sol


def main() -> float:
    """Return the force on the ball, N."""
    mech, sol = run()
    print(f"contact after {sol.t[-1]:.4f} s at a crank angle of {sol.q[-1, 0]:.4f} rad")
    return float(pc.equilibrium(mech, sol.q[-1]).reaction("ball").force[0, 0])


if __name__ == "__main__":
    print(f"{main():.6f} N")
