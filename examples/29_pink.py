"""Inverse kinematics by pink: the loop of a five-bar is a task like any other; its tip goes to a point."""

import numpy as np
import pinocchio as pin

import pinconsist as pc

try:
    import pink
    from pink.tasks import FrameTask, PostureTask, RelativeFrameTask
except ImportError as error:
    raise pc.MissingExtraError("this example needs pink: pip install pin-pink quadprog") from error

MECH = pc.load("five_bar")
TARGET = np.array([0.06, 0.0, 0.40])  # m, of the tip
DT, STEPS = 0.01, 200  # s


def loop_task(loop):
    """A loop as a task: anchor 2 seen from anchor 1 does not move away, and does not turn if the loop holds that."""
    turning = 0.0 if loop.kind in ("point", "hinge") else 1.0  # the pins of a planar mechanism turn by themselves
    task = RelativeFrameTask(loop.frame2, loop.frame1, position_cost=1e3, orientation_cost=turning)
    task.set_target(loop.placement1 * loop.placement2.inverse())
    return task


def run():
    """The mechanism, the configurations on the way, and the gaps of the loop there."""
    model = MECH.model
    tip = FrameTask("left_tip", position_cost=1.0, orientation_cost=0.0)
    tip.set_target(pin.SE3(np.eye(3), TARGET))
    posture = PostureTask(cost=1e-6)
    configuration = pink.Configuration(model, model.createData(), pc.assemble(MECH).q)
    posture.set_target_from_configuration(configuration)
    tasks, way = [tip, posture, *map(loop_task, MECH.anchored_loops)], [configuration.q.copy()]
    for _ in range(STEPS):
        velocity = pink.solve_ik(configuration, tasks, DT, solver="quadprog")
        configuration.integrate_inplace(velocity, DT)
        way.append(configuration.q.copy())
    return MECH, np.array(way)


def main() -> float:
    """Return the angle of the left crank at the end, rad, with the loop closed to rounding there."""
    mech, way = run()
    left, right = (way[-1][mech.columns(joint)][0] for joint in mech.actuated)
    q, ok = pc.Actuation(mech, q0=way[-1]).closure({"left_crank": left, "right_crank": right})
    print(f"closed: {ok}; the loop was open by {np.abs(q - way[-1]).max():.1e} rad")
    return float(q[0])


if __name__ == "__main__":
    print(f"{main():.6f} rad")
