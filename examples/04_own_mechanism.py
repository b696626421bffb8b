"""A mechanism built in code: two rods hinged to the ground, a massless bar between their tips, and a spring."""

import numpy as np
import pinocchio as pin

import pinconsist as pc


def rod(model, name, x, length, mass):
    """A rod along its own x axis, on a hinge about y at (x, 0, 0)."""
    place = pin.SE3(np.eye(3), np.array([x, 0.0, 0.0]))
    joint = model.addJoint(0, pin.JointModelRY(), place, name)
    inertia = np.diag([1e-3, mass * length**2 / 12, mass * length**2 / 12])
    model.appendBodyToJoint(joint, pin.Inertia(mass, np.array([length / 2, 0, 0]), inertia), pin.SE3.Identity())
    tip = pin.SE3(np.eye(3), np.array([length, 0.0, 0.0]))
    model.addFrame(pin.Frame(f"{name}_tip", joint, 0, tip, pin.FrameType.OP_FRAME))


def run():
    """Let the rods fall with a bar of 1.2 m between their tips."""
    model = pin.Model()
    rod(model, "left", 0.0, 1.0, 2.0)
    rod(model, "right", 1.5, 0.8, 1.0)
    bar = pc.Loop("bar", "distance", "left_tip", "right_tip", length=1.2)
    spring = pc.SpringDamper("left_tip", "universe", stiffness=50.0, length=0.5, damping=2.0, xyz2=(0.0, 0.0, 1.0))
    mech = pc.Mechanism(model, [bar], [spring], guess={"left": -1.2, "right": -1.5}, name="own mechanism")
    return mech, pc.simulate(mech, (0.0, 3.0), rtol=1e-8, atol=1e-8)


def main() -> float:
    """Return the tension of the bar after three seconds, N."""
    _, sol = run()
    print(sol.check())
    tension = -sol.lam[:, 0]  # λ < 0 pulls
    print(f"tension {tension.min():.3f} ... {tension.max():.3f} N")
    return float(tension[-1])


if __name__ == "__main__":
    print(f"{main():.4f} N")
