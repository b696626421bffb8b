"""MuJoCo: the mechanism as MJCF, its loops as connect equalities, as stiff as the documentation allows."""

from __future__ import annotations

from xml.sax.saxutils import quoteattr

import numpy as np

from pinconsist import JointSpring, JointTorque, SpringDamper

from .problem import Peer, Rows, SolverFailed, loop_ends


class Mujoco(Peer):
    """Fixed steps of an integrator, by default `implicitfast`, which its documentation recommends, or RK4.

    Constraints are soft by design: ``solref`` has the smallest time constant allowed, two steps; ``solimp`` 0.9999.
    """

    package = module = "mujoco"
    fixed_step = True
    loops = ("point", "hinge")  # connect is 3 rows, weld 6
    forces = (JointSpring, JointTorque, SpringDamper)

    def __init__(self, integrator="implicitfast"):
        self.integrator = integrator
        self.name = f"MuJoCo {integrator}, soft loops"

    def can(self, problem):
        if reason := super().can(problem):
            return reason
        import mujoco

        try:
            mujoco.MjModel.from_xml_string(mjcf(problem, 1e-3, self.integrator))
        except ValueError as error:
            return f"MuJoCo refuses the model: {str(error).splitlines()[0]}"
        return None

    def prepare(self, problem, steps):
        import mujoco

        mujoco.set_mju_user_warning(lambda message: None)  # else it leaves a MUJOCO_LOG.TXT where it runs
        h = float(problem.span[1] - problem.span[0]) / steps
        model = mujoco.MjModel.from_xml_string(mjcf(problem, h, self.integrator))
        data = mujoco.MjData(model)
        n = model.nv
        torques = [force for force in problem.mechanism.forces if isinstance(force, JointTorque)]

        def solve():
            data.qpos[:], data.qvel[:] = problem.q0, problem.v0
            for force in torques:
                data.qfrc_applied[:] = force.bind(problem.mechanism.model).constant
            rows = np.empty((steps + 1, 1 + 2 * n))
            for i in range(steps + 1):
                rows[i, 0] = problem.span[0] + i * h
                rows[i, 1 : 1 + n], rows[i, 1 + n :] = data.qpos, data.qvel
                if i < steps:
                    mujoco.mj_step(model, data)
            return rows

        def forces(q, v):
            data.qpos[:], data.qvel[:] = q, v
            mujoco.mj_forward(model, data)
            return data.qfrc_constraint.copy()

        def read(rows, thin):
            if not np.isfinite(rows).all() or data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number:
                raise SolverFailed("the simulation became unstable")
            rows = rows[thin(len(rows))]
            t, q, v = np.split(rows, (1, 1 + n), axis=1)
            pulls = np.array([forces(*state) for state in zip(q, v, strict=True)])
            return Rows(t[:, 0], q, v, problem.multipliers_of_forces(q, pulls))

        return solve, read


def mjcf(problem, h, integrator="implicitfast") -> str:
    """The MJCF text of a mechanism of hinges and sliders with point loops."""
    mechanism, system = problem.mechanism, problem.system
    model = mechanism.model
    springs = {force.joint: force for force in mechanism.forces if isinstance(force, JointSpring)}
    sites = {joint: [] for joint in range(model.njoints)}
    equalities, tendons = [], []

    def site(joint, point):
        name = f"s{sum(map(len, sites.values()))}"
        sites[joint].append(f'<site name="{name}" pos="{_text(point)}"/>')
        return name

    for closure in system.rows.closures:
        one, two = (site(*end) for end in loop_ends(closure))
        equalities.append(f'<connect site1="{one}" site2="{two}"/>')
    for force in mechanism.forces:
        if isinstance(force, SpringDamper):
            ends = [site(*end) for end in force.bind(model).ends]
            path = "".join(f'<site site="{end}"/>' for end in ends)
            values = f'stiffness="{force.stiffness!r}" springlength="{force.length!r}" damping="{force.damping!r}"'
            tendons.append(f"<spatial {values}>{path}</spatial>")

    def body(joint):
        place, inertia = model.jointPlacements[joint], model.inertias[joint]
        kind, name = model.joints[joint].shortname()[-2:], model.names[joint]
        axis = " ".join("1" if letter == kind[1] else "0" for letter in "XYZ")
        column = model.idx_vs[joint]
        joint_type = "hinge" if kind[0] == "R" else "slide"
        attributes = f'damping="{float(model.damping[column])!r}" armature="{float(model.armature[column])!r}"'
        if name in springs:
            attributes += f' stiffness="{springs[name].stiffness!r}" springref="{springs[name].rest!r}"'
        I = inertia.inertia
        full = _text([I[0, 0], I[1, 1], I[2, 2], I[0, 1], I[0, 2], I[1, 2]])
        children = "".join(body(child) for child in range(1, model.njoints) if model.parents[child] == joint)
        return (
            f'<body pos="{_text(place.translation)}" quat="{_quaternion(place.rotation)}">'
            f'<inertial pos="{_text(inertia.lever)}" mass="{inertia.mass!r}" fullinertia="{full}"/>'
            f'<joint name={quoteattr(name)} type="{joint_type}" axis="{axis}" {attributes}/>'
            f"{''.join(sites[joint])}{children}</body>"
        )

    trees = "".join(body(child) for child in range(1, model.njoints) if model.parents[child] == 0)
    return (
        f'<mujoco><compiler angle="radian" balanceinertia="false"/>'
        f'<option timestep="{h!r}" gravity="{_text(model.gravity.linear)}" integrator="{integrator}"/>'
        f'<default><equality solref="{2 * h!r} 1" solimp="0.9999 0.9999 0.001 0.5 2"/></default>'
        f"<worldbody>{''.join(sites[0])}{trees}</worldbody>"
        f"<equality>{''.join(equalities)}</equality><tendon>{''.join(tendons)}</tendon></mujoco>"
    )


def _text(numbers):
    return " ".join(repr(float(number)) for number in numbers)


def _quaternion(R):
    import pinocchio as pin

    x, y, z, w = pin.Quaternion(R).coeffs()
    return _text((w, x, y, z))
