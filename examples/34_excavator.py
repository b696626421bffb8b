"""An excavator whose boom and arm sink until their hydraulic cylinders reach their ends, which carry them."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

BOOM, ARM, BACK = 3.0, 2.0, 0.5  # m: lengths, and the lever of the arm behind its hinge
MASSES = {"boom": 300.0, "arm": 150.0, "barrel": 20.0, "rod": 10.0}  # kg
BASES = {"boom": (0.5, -0.5), "arm": (1.4, 0.5)}  # m: hinges of the barrels, on the ground and on the boom
PINS = {"boom": 1.3, "arm": -BACK}  # m along boom and arm: hinges of the rods
ENDS = {"boom": (1.1, 1.6), "arm": (1.3, 1.65)}  # m: lengths of the cylinders
VALVES = {"boom": 3e4, "arm": 6e3}  # N·s/m, the oil that has to flow out
ANGLES = {"boom": 0.9, "arm": -1.2}  # rad, at the start: of the boom above the ground, of the arm above the boom


def run():
    """Three seconds with open valves."""
    model, guess, loops, bodies = pin.Model(), {}, [], {"ground": 0}

    def body(on, name, kind, place, mass, length):
        joint = model.addJoint(bodies[on], kind, pin.SE3(np.eye(3), np.array([place[0], 0.0, place[1]])), name)
        turn = pin.Inertia(
            mass, np.array([0.5 * length, 0.0, 0.0]), mass * length**2 / 12.0 * np.diag([1e-2, 1.0, 1.0])
        )
        model.appendBodyToJoint(joint, turn, pin.SE3.Identity())
        bodies[name] = joint

    def point(on, name, x):
        frame = pin.Frame(name, bodies[on], 0, pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), pin.FrameType.OP_FRAME)
        model.addFrame(frame)

    body("ground", "boom", pin.JointModelRY(), (0.0, 0.0), MASSES["boom"], BOOM)
    body("boom", "arm", pin.JointModelRY(), (BOOM, 0.0), MASSES["arm"], ARM)
    point("arm", "bucket", ARM)
    for part, base in (("arm", "boom"), ("boom", "ground")):
        body(base, f"{part}_barrel", pin.JointModelRY(), BASES[part], MASSES["barrel"], 0.8)
        body(f"{part}_barrel", f"{part}_cylinder", pin.JointModelPX(), (0.0, 0.0), MASSES["rod"], -0.8)
        point(f"{part}_cylinder", f"{part}_rod", 0.0)
        point(part, f"{part}_lug", PINS[part])
        loops.append(pc.Loop(f"{part}_pin", "point", f"{part}_rod", f"{part}_lug"))
        hinge, angle = np.array([BOOM, 0.0]) * (part == "arm"), ANGLES[part]
        way = hinge + PINS[part] * np.array([np.cos(angle), np.sin(angle)]) - BASES[part]
        guess |= {part: -angle, f"{part}_barrel": -np.arctan2(way[1], way[0]), f"{part}_cylinder": np.hypot(*way)}
    stops = [pc.Stop(f"{part}_cylinder", *ends, restitution=0.1) for part, ends in ENDS.items()]
    oil = pc.JointDamping({f"{part}_cylinder": valve for part, valve in VALVES.items()})
    mech = pc.Mechanism(model, loops, [oil], contacts=stops, name="excavator", guess=guess)
    return mech, pc.simulate(mech, (0.0, 3.0))


def main() -> float:
    """Return the force of the boom's stop at the end, N."""
    _, sol = run()
    for each in sol.modes:
        print(f"{each.contact:20} {each.mode:6} from {each.t_begin:.4f} to {each.t_end:.4f} s")
    return float(sol.contact("boom_cylinder").force[-1])


if __name__ == "__main__":
    print(f"{main():.3f} N")
