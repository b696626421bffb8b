"""A biped of two closed-chain legs stands, squats by PD control at 1 kHz, and is pushed; the force on each foot."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

THIGH, SHANK, HIPS, STANCE = 0.15, 0.25, 0.05, 0.2  # m: links, half the distance of two hips of a leg and of the legs
BASE, LINK, SPREAD, BEND = 6.0, 0.2, 0.9, 0.25  # kg, kg, rad, rad of the squat
STIFF, DAMP, PERIOD = 150.0, 4.0, 1e-3  # N·m/rad, N·m·s/rad, s
PUSH = pc.Piecewise({"x": lambda t: 25.0 if 1.5 <= t < 1.6 else 0.0}, (1.5, 1.6))  # N


def leg(model, base, name, place, guess):
    """Two hips, two knees, and a foot, where the shanks meet; its loop."""
    for side, sign in (("rear", -1.0), ("front", 1.0)):
        parent, at = base, np.array([place + sign * HIPS, 0.0, 0.0])
        for part, length, angle in (("hip", THIGH, -sign * SPREAD), ("knee", SHANK, sign * 1.6)):
            joint = f"{name}_{side}_{part}"
            parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), at), joint)
            turn = LINK * length**2 / 12.0 * np.diag([1.0, 1.0, 1e-2])
            inertia = pin.Inertia(LINK, np.array([0.0, 0.0, -length / 2]), turn)
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            at, guess[joint] = np.array([0.0, 0.0, -length]), angle
        model.addFrame(pin.Frame(f"{name}_{side}_tip", parent, 0, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME))
    return pc.Loop(f"{name}_foot", "point", f"{name}_rear_tip", f"{name}_front_tip")


def run():
    """Fall by two centimetres, stand, squat, be pushed, stand."""
    model, guess = pin.Model(), {"z": 0.3}
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    z = model.addJoint(x, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    base = model.addJoint(z, pin.JointModelRY(), pin.SE3.Identity(), "pitch")
    model.appendBodyToJoint(base, pin.Inertia(BASE, np.zeros(3), np.diag([0.05, 0.1, 0.1])), pin.SE3.Identity())
    loops = [leg(model, base, name, sign * STANCE, guess) for name, sign in (("left", -1.0), ("right", 1.0))]
    ground = [pc.Contact(f"{name} ground", f"{name}_rear_tip", friction=0.7) for name in ("left", "right")]
    mech = pc.Mechanism(model, loops, contacts=ground, name="biped", guess=guess)
    motors = [joint for joint in mech.joints if joint.endswith("hip")]
    columns = [mech.columns(joint).start for joint in motors]
    stand = np.array([guess[joint] for joint in motors])

    def law(t, q, v):
        """PD control, with a squat from 0.5 to 1.5 s."""
        squat = BEND * np.sin(np.pi * np.clip(t - 0.5, 0.0, 1.0)) ** 2
        return STIFF * (stand + squat * np.sign(stand) - q[columns]) - DAMP * v[columns]

    return mech, pc.simulate(mech, (0.0, 2.5), forces=[pc.Sampled(PERIOD, law, joints=motors), PUSH])


def main() -> float:
    """Return the force on both feet at the end, N: the weight."""
    _, sol = run()
    for each in sol.modes:
        print(f"{each.contact:13} {each.mode:6} from {each.t_begin:.4f} to {each.t_end:.4f} s")
    return float(sum(sol.contact(f"{name} ground").force[-1, 2] for name in ("left", "right")))


if __name__ == "__main__":
    print(f"{main():.6f} N")
