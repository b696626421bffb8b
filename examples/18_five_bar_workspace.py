"""Two motors of a five-bar: the workspace of the tip, its singular curves, and the forces of unit torques."""

import numpy as np

import pinconsist as pc

DISTAL = 0.3  # m, length of the links that meet at the tip; the cranks are 0.25 m long and 0.2 m apart
LEFT, RIGHT = np.radians(np.arange(-270.0, -69.0, 4.0)), np.radians(np.arange(-110.0, 91.0, 4.0))


def five_bar():
    """The built-in five-bar with distal links too short for some crank angles."""
    mech, at = pc.load("five_bar"), (DISTAL, 0.0, 0.0)
    tip = pc.Loop("tip", "hinge", "left_distal_bar", "right_distal_bar", xyz1=at, xyz2=at, axis=(0, 1, 0))
    return mech.with_loops(tip)


def tip_of(act, q):
    """The position of the tip (x, height), and its Jacobian with respect to the motors, (2, 2)."""
    hinge = act.frame("left_distal_bar")
    pose, J = hinge.pose(q), hinge.jacobian(q)
    arm = pose.rotation @ np.array([DISTAL, 0.0, 0.0])
    return (pose.translation + arm)[[0, 2]], (J[:3] + np.cross(J[3:].T, arm).T)[[0, 2]]


def run():
    """The mechanism, and its workspace: tip positions, their condition, blocked ends of paths, force ellipses."""
    mech = five_bar()
    act, tips, condition, ends, ellipses = pc.Actuation(mech), [], [], [], []
    found = act.table({"left_crank": LEFT, "right_crank": RIGHT})
    turns = np.linspace(0.0, 2 * np.pi, 40)
    for i, (q, ok) in enumerate(zip(found["q"], found["ok"], strict=True)):
        if not ok:
            if found["condition"][i] < 1e-2:  # its path ended at a singular configuration
                ends.append(act.frame("left_distal_bar").pose(q).act(np.array([DISTAL, 0.0, 0.0]))[[0, 2]])
            continue
        place, J = tip_of(act, q)
        tips.append(place)
        condition.append(found["condition"][i])
        if i % len(RIGHT) % 7 == i // len(RIGHT) % 7 == 3 and place[1] > 0.1:
            force = np.linalg.solve(J.T, np.array([np.cos(turns), np.sin(turns)]))  # of torques with τ² = 1 (N·m)²
            ellipses.append(place + 0.006 * force.T)
    return mech, [np.array(each) for each in (tips, condition, ends)] + [ellipses]


def main() -> float:
    """Return the left crank's angle, rad, at which the distal links are in line while the right one is at -0.8 rad."""
    act = pc.Actuation(five_bar())
    act.closure({"left_crank": -2.2, "right_crank": -0.8})
    left = act.limits()[0]
    print(left)
    tau = act.torques(forces={"left_distal_bar": [0.0, 0.0, -10.0]}).torques
    print("motor torques that hold 10 N at the left elbow:", {motor: round(each, 3) for motor, each in tau.items()})
    return left.lower


if __name__ == "__main__":
    print(f"{main():.9f} rad")
