"""A leg of two closed chains hops: servos stretch it three times a second; flight, impact and stance alternate."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

THIGH, SHANK, HIPS = 0.15, 0.25, 0.05  # m; half the distance of the hips
SPREAD, BASE, LINK = 0.9, 2.0, 0.1  # rad; kg
SWING = 0.35, 3.0  # rad, Hz: of the servos' targets
STIFF, DAMP = 60.0, 0.6  # N·m/rad, N·m·s/rad


def run():
    """Two seconds."""
    model, guess, servos = pin.Model(), {"z": 0.3}, []
    base = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(base, pin.Inertia(BASE, np.zeros(3), 0.01 * np.eye(3)), pin.SE3.Identity())
    for side, sign in (("left", -1.0), ("right", 1.0)):
        parent, place = base, np.array([sign * HIPS, 0.0, 0.0])
        for part, length, angle in (("hip", THIGH, -sign * SPREAD), ("knee", SHANK, sign * 1.6)):
            joint = f"{side}_{part}"
            parent = model.addJoint(parent, pin.JointModelRY(), pin.SE3(np.eye(3), place), joint)
            turn = LINK * length**2 / 12.0 * np.diag([1.0, 1.0, 1e-2])
            inertia = pin.Inertia(LINK, np.array([0.0, 0.0, -length / 2]), turn)
            model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
            place, guess[joint] = np.array([0.0, 0.0, -length]), angle
        model.addFrame(pin.Frame(f"{side}_tip", parent, 0, pin.SE3(np.eye(3), place), pin.FrameType.OP_FRAME))
        target = pc.Motion(start=-sign * SPREAD, amplitude=-sign * SWING[0], frequency=SWING[1])
        servos.append(pc.Servo(f"{side}_hip", target, stiffness=STIFF, damping=DAMP))
    foot = pc.Loop("foot", "point", "left_tip", "right_tip")
    ground = pc.Contact("ground", "left_tip", friction=0.7)
    mech = pc.Mechanism(model, [foot], servos, contacts=[ground], name="hopper", guess=guess)
    return mech, pc.simulate(mech, (0.0, 2.0))


def main() -> float:
    """Return the acceleration of the centre of mass in the last flight, m/s², from its velocities at both ends."""
    mech, sol = run()
    for each in sol.modes:
        print(f"{each.mode:6} from {each.t_begin:.4f} to {each.t_end:.4f} s")
    flight = [each for each in sol.modes if each.mode == "open" and 0.0 < each.t_begin and each.t_end < 2.0][-1]
    times = np.linspace(flight.t_begin, flight.t_end, 12)[1:-1]  # inside
    rows, data = sol.at(times), mech.model.createData()
    speeds = []
    for q, v in zip(rows.q, rows.v, strict=True):
        pin.centerOfMass(mech.model, data, q, v)
        speeds.append(data.vcom[0][2])
    return float((speeds[-1] - speeds[0]) / (times[-1] - times[0]))


if __name__ == "__main__":
    print(f"{main():.9f} m/s²")
