"""Problem 5.1 of Arévalo (2008) as a mechanism: a point mass on the unit circle in a force field."""

import numpy as np
import pinocchio as pin

import pinconsist as pc


def field(t, q, v):
    """The force on the mass, N; gravity is switched off below."""
    return np.array([2 * q[1], -2 * q[0]])


def run():
    """One second with BDF of variable step and order, every step corrected."""
    model = pin.Model()
    model.gravity.setZero()
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    y = model.addJoint(x, pin.JointModelPY(), pin.SE3.Identity(), "y")
    model.appendBodyToJoint(y, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("mass", y, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    circle = pc.Loop("circle", "distance", "universe", "mass", length=1.0)
    mech = pc.Mechanism(model, [circle], [field], name="problem 5.1")
    q0, v0 = [np.sin(1), np.cos(1)], [2 * np.cos(1), -2 * np.sin(1)]
    return mech, pc.simulate(mech, (0.0, 1.0), q0, v0, method="BDF", rtol=1e-9, atol=1e-9)


def main() -> float:
    """Print the largest error of the multiplier; return the multiplier at the end, N."""
    _, sol = run()
    error = np.abs(sol.lam[:, 0] + 4 * (1 + sol.t) ** 2)  # exact: λ = -4 (1+t)²
    print(f"{sol.nsteps} steps, largest error of λ {error.max():.1e}, at the first step {error[1]:.1e}")
    return float(sol.lam[-1, 0])


if __name__ == "__main__":
    print(f"{main():.6f} N")
