"""A gripper closes on a part, which slides until both pads hold it, and lifts it by friction."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

BAR, BASE, PALM, WIDTH = 0.06, 0.03, 0.015, 0.05  # m: crank, base of a parallelogram, half the palm, the part
REACH, MASS, TORQUE = 0.11, 0.3, 0.6  # m from the palm down to the table; kg; N·m of the motor on the left crank
LIFT, BEGIN = 0.05, 0.5  # m, in one second from then on


def height(t):
    """Of the palm, m: smooth up to its second derivative."""
    x = np.clip(t - BEGIN, 0.0, 1.0)
    return REACH + LIFT * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)


def run():
    """Close, lift, hold."""
    model, guess, loops = pin.Model(), {"palm": REACH, "x": 0.006}, []

    def body(parent, name, kind, place, mass=0.0, down=0.0):
        joint = model.addJoint(parent, kind, pin.SE3(np.eye(3), np.array(place)), name)
        inertia = pin.Inertia(mass, np.array([0.0, 0.0, -down]), 2e-5 * np.eye(3))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return joint

    def point(joint, name, *place):
        model.addFrame(pin.Frame(name, joint, 0, pin.SE3(np.eye(3), np.array(place)), pin.FrameType.OP_FRAME))

    palm = body(0, "palm", pin.JointModelPZ(), (0, 0, 0), 0.3)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        crank = body(palm, f"{side}_crank", pin.JointModelRY(), (sign * PALM, 0, 0), 0.05, BAR / 2)
        pad = body(crank, f"{side}_pad", pin.JointModelRY(), (0, 0, -BAR), 0.05, 0.02)
        point(pad, f"{side}_outer", sign * BASE, 0, 0)
        point(pad, f"{side}_tip", 0, 0, -0.04)
        follower = body(palm, f"{side}_follower", pin.JointModelRY(), (sign * (PALM + BASE), 0, 0), 0.05, BAR / 2)
        point(follower, f"{side}_end", 0, 0, -BAR)
        loops.append(pc.Loop(side, "hinge", f"{side}_end", f"{side}_outer", axis=(0, 1, 0)))
        guess |= {f"{side}_crank": -0.6 * sign, f"{side}_pad": 0.6 * sign, f"{side}_follower": -0.6 * sign}
    part = body(body(0, "x", pin.JointModelPX(), (0, 0, 0)), "z", pin.JointModelPZ(), (0, 0, 0), MASS)
    contacts = [pc.Contact("table", "z", friction=0.2)]
    for side, sign in (("left", -1.0), ("right", 1.0)):
        point(part, f"{side}_face", sign * WIDTH / 2, 0, 0.02)
        contacts.append(pc.Contact(f"{side} pad", f"{side}_face", on=f"{side}_pad", normal=(-sign, 0, 0), friction=0.5))
    loops += [pc.Coupling("gears", "right_crank", "left_crank", ratio=-1.0), pc.Drive("lift", "palm", height)]
    forces = [{"left_crank": -TORQUE}, pc.JointDamping({"left_crank": 0.2})]
    mech = pc.Mechanism(model, loops, forces, contacts=contacts, name="gripper", guess=guess)
    return mech, pc.simulate(mech, (0.0, 2.0))


def main() -> float:
    """Return the force by which the pads carry the part at the end, N: its weight."""
    _, sol = run()
    return float(sum(sol.contact(f"{side} pad").force[-1, 2] for side in ("left", "right")))


if __name__ == "__main__":
    print(f"{main():.6f} N")
