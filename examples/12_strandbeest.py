"""A leg of Theo Jansen's beach animals: seven links, three loops, one driven crank, and the path of its foot."""

import numpy as np
import pinocchio as pin

import pinconsist as pc


def run():
    """One revolution of the crank, which is driven at constant speed by a drive of the model."""
    mech = pc.load("jansen_leg")
    return mech, pc.simulate(mech, (0.0, 1.0), t_eval=np.linspace(0, 1, 121))


def main() -> float:
    """Return the length of the stride, m."""
    mech, sol = run()
    data, foot = mech.model.createData(), mech.model.getFrameId("foot")
    path = []
    for q in sol.q:
        pin.framesForwardKinematics(mech.model, data, q)
        path.append(data.oMf[foot].translation.copy())
    lift = np.ptp(np.array(path)[:, 2])
    (motor,) = [loop.name for loop in mech.loops if loop.kind == "drive"]
    print(f"the foot rises {lift:.3f} m; the {motor} needs up to {np.abs(sol.reaction(motor).torque).max():.2f} N·m")
    return float(np.ptp(np.array(path)[:, 0]))


if __name__ == "__main__":
    print(f"{main():.6f} m")
