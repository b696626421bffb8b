"""A leg of two closed chains falls, lands, stands by servos in both hips, and is pushed; the force that carries it."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

THIGH, SHANK, HIPS = 0.15, 0.25, 0.05  # m; half the distance of the hips
SPREAD, BASE, LINK = 0.9, 4.0, 0.2  # rad; kg
STIFF, DAMP = 60.0, 1.5  # N·m/rad, N·m s/rad


def push(t):
    """N, on the base."""
    return 12.0 if 1.0 <= t < 1.2 else 0.0


def scene() -> pc.Mechanism:
    """A base that moves along x and z, two thighs, two shanks that meet at the foot."""
    model = pin.Model()

    def body(parent, kind, name, place, mass, length=0.0):
        joint = model.addJoint(parent, kind, pin.SE3(np.eye(3), np.array(place)), name)
        turn = np.diag([mass * length**2 / 12.0, mass * length**2 / 12.0, 1e-5]) + 1e-6 * np.eye(3)
        model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([0.0, 0.0, -length / 2]), turn), pin.SE3.Identity())
        tip = pin.SE3(np.eye(3), np.array([0.0, 0.0, -length]))
        model.addFrame(pin.Frame(f"{name}_tip", joint, 0, tip, pin.FrameType.OP_FRAME))
        return joint

    x = body(0, pin.JointModelPX(), "x", (0, 0, 0), 0.0)
    base = body(x, pin.JointModelPZ(), "z", (0, 0, 0), BASE)
    guess = {"z": 0.4}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        thigh = body(base, pin.JointModelRY(), f"{side}_hip", (sign * HIPS, 0, 0), LINK, THIGH)
        body(thigh, pin.JointModelRY(), f"{side}_knee", (0, 0, -THIGH), LINK, SHANK)
        guess |= {f"{side}_hip": -sign * SPREAD, f"{side}_knee": sign * 1.6}
    foot = pc.Loop("foot", "point", "left_knee_tip", "right_knee_tip")
    hips = {f"{side}_hip": -sign * SPREAD for side, sign in (("left", -1.0), ("right", 1.0))}
    servos = [pc.Servo(hip, angle, stiffness=STIFF, damping=DAMP) for hip, angle in hips.items()]
    ground = pc.Contact("ground", "left_knee_tip", friction=0.7)
    return pc.Mechanism(model, [foot], [*servos, {"x": push}], contacts=[ground], name="leg", guess=guess)


def run():
    """Fall, stand, be pushed, stand."""
    mech = scene()
    return mech, pc.simulate(mech, (0.0, 3.0))


def main() -> float:
    """Return the force of the ground at the end, N: the weight."""
    _, sol = run()
    for each in sol.modes:
        print(f"{each.mode:6} from {each.t_begin:.4f} to {each.t_end:.4f} s")
    return float(sol.contact("ground").force[-1, 2])


if __name__ == "__main__":
    print(f"{main():.6f} N")
