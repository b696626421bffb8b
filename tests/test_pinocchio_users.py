"""What users of Pinocchio bring and take: its contact models and forces, forward dynamics, its viewers."""

import numpy as np
import pinocchio as pin
import pytest
from helpers.actuated import five_bar

import pinconsist as pc
from pinconsist.mechanism.rows import LoopRows

SCENES = ("four_bar", "delta_robot", "bricard", "stewart_platform")


def state(mech, seed=0):
    rng = np.random.default_rng(seed)
    assembly = pc.assemble(mech, v0=rng.uniform(-1, 1, mech.nv))
    return assembly.q, assembly.v, rng.uniform(-1, 1, mech.nv)


def theirs(mech, q, v, tau):
    """Acceleration, and contact data, of Pinocchio."""
    model, constraints, _ = mech.to_pinocchio()
    data, models, datas = model.createData(), pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for each in constraints:
        models.append(each)
        datas.append(each.createData())
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-10, 50)
    a = pin.constraintDynamics(model, data, q, v, tau - model.damping * v, models, datas, settings)
    return np.array(a), datas


@pytest.mark.parametrize("name", SCENES)
def test_forward_dynamics_against_constraint_dynamics(name):
    mech = pc.load(name).with_forces()
    q, v, tau = state(mech)
    found = pc.forward_dynamics(mech, q, v, tau)
    a, _ = theirs(mech, q, v, tau)
    np.testing.assert_allclose(found.a, a, atol=1e-8 * np.abs(a).max())
    data = mech.model.createData()
    forces = pin.rnea(mech.model, data, q, v, found.a) - tau + mech.model.damping * v
    J = LoopRows.of(mech).at(q, 0.0)[1]
    np.testing.assert_allclose(J.T @ found.lam, forces, atol=1e-8 * np.abs(forces).max())


def test_forward_dynamics_of_many_states():
    mech = pc.load("bricard")
    sol = pc.simulate(mech, (0.0, 1.0)).at(np.linspace(0.0, 1.0, 7))
    found = pc.forward_dynamics(mech, sol.q, sol.v)
    np.testing.assert_allclose(found.a, sol.acceleration(), atol=1e-6)
    np.testing.assert_allclose(found.lam, sol.lam, atol=1e-6 * np.abs(sol.lam).max())
    one = pc.forward_dynamics(mech, sol.q[3], sol.v[3], 0.1 * np.ones(mech.nv))
    many = pc.forward_dynamics(mech, sol.q, sol.v, 0.1 * np.ones((7, mech.nv)))
    assert one.a.shape == (mech.nv,) and one.lam.shape == (mech.nc,)
    np.testing.assert_allclose(one.a, many.a[3], atol=1e-12)
    torques = pc.forward_dynamics(mech, sol.q[3], sol.v[3], np.eye(mech.nv))
    rest = pc.forward_dynamics(mech, sol.q[3], sol.v[3])
    inverse = torques.a - rest.a  # of the constrained mass matrix, which is symmetric
    np.testing.assert_allclose(inverse, inverse.T, atol=1e-9 * np.abs(inverse).max())


def test_forces_act_in_forward_dynamics():
    mech = pc.load("five_bar")
    q = pc.assemble(mech).q
    by_tau = pc.forward_dynamics(mech, q, None, mech.velocity({"left_crank": 2.0}))
    by_force = pc.forward_dynamics(mech, q, forces={"left_crank": lambda t: t}, t=2.0)
    np.testing.assert_allclose(by_tau.a, by_force.a, atol=1e-12)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (lambda q: (q[:-1],), "q needs shape"),
        (lambda q: (q, np.zeros((3, 2))), "v needs shape"),
        (lambda q: (np.tile(q, (2, 1)), None, np.zeros((3, 3))), "tau needs shape"),
        (lambda q: (np.full(3, np.nan),), "q"),
    ],
)
def test_wrong_states(arguments, words):
    mech = pc.load("four_bar")
    with pytest.raises(pc.InputError, match=words):
        pc.forward_dynamics(mech, *arguments(pc.assemble(mech).q))


def test_an_open_state_is_named():
    mech = pc.load("four_bar")
    q = np.vstack((pc.assemble(mech).q, mech.guess + 0.1))
    with pytest.raises(pc.AssemblyError, match="in state 1 loop 'coupler_rocker' is open by"):
        pc.forward_dynamics(mech, q)


@pytest.mark.parametrize("name", ["delta_robot", "four_bar"])
def test_contact_forces_are_pinocchios(name):
    mech = pc.load(name).with_forces()
    sol = pc.simulate(mech, (0.0, 0.2)).at([0.1, 0.2])
    for row in (0, 1):
        _, datas = theirs(mech, sol.q[row], sol.v[row], np.zeros(mech.nv))
        ours = sol.contact_forces()
        for loop, data in zip(mech.loops, datas, strict=True):
            np.testing.assert_allclose(ours[loop.name][row, :3], data.contact_force.linear, atol=1e-5)
    world = sol.contact_forces(axes="world")
    for loop in mech.loops:
        np.testing.assert_allclose(world[loop.name][:, :3], -sol.reaction(loop.name).force)
        assert ours[loop.name].shape == (2, 3 if loop.kind == "point" else 6)


def test_a_weld_and_its_contact_force():
    """Six rows: force and moment about the anchor."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "body")
    model.appendBodyToJoint(joint, pin.Inertia(2.0, np.array([0.3, 0, 0]), np.eye(3)), pin.SE3.Identity())
    mech = pc.Mechanism(model, [pc.Loop("weld", "frame", "body", "universe", rpy2=(0.3, 0.0, 0.0))])
    sol = pc.simulate(mech, (0.0, 0.1))
    _, (data,) = theirs(mech, sol.q[-1], sol.v[-1], np.zeros(6))
    np.testing.assert_allclose(sol.contact_forces()["weld"][-1], data.contact_force.vector, atol=1e-6)


def test_there_and_back():
    mech = pc.load("delta_robot")
    model, constraints, motors = mech.to_pinocchio()
    back = pc.load(model, loops=constraints)
    assert motors == mech.actuated and [loop.name for loop in back.loops] == [loop.name for loop in mech.loops]
    q, v, tau = state(mech.with_forces())
    one, two = (pc.forward_dynamics(each, q, v, tau) for each in (mech.with_forces(), back))
    np.testing.assert_allclose(one.a, two.a, atol=1e-9)
    model.gravity.linear[:] = 0.0
    assert mech.model.gravity.linear[2] == -9.81  # a copy


def test_what_pinocchio_has_no_contact_for():
    with pytest.raises(pc.InputError, match="'motor' is of kind 'drive'"):
        pc.load("jansen_leg").to_pinocchio()


def slide():
    """1 kg on a vertical slide, and its model."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "slide")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    return model


def made(make):
    try:
        return make()
    except Exception:  # signatures differ between versions of Pinocchio
        pytest.skip("this version of Pinocchio makes it otherwise")


def test_limits_of_joints_are_stops():
    model = pc.load("four_bar").model
    low, high = np.array([-0.5, -0.6, -0.7]), np.array([0.5, 0.6, np.inf])
    mech = pc.load(model, loops=[made(lambda: pin.JointLimitConstraintModel(model, [1, 3], low, high))])
    assert [(each.joint, each.lower, each.upper) for each in mech.contacts] == [
        (model.names[1], -0.5, 0.5),
        (model.names[3], -0.7, None),
    ]


def test_a_limit_stops_a_fall():
    model = slide()
    limit = made(lambda: pin.JointLimitConstraintModel(model, [1], np.array([-0.3]), np.array([np.inf])))
    sol = pc.simulate(pc.load(model, loops=[pin.ConstraintModel(limit)]), (0.0, 1.0))
    assert sol.q.min() == pytest.approx(-0.3, abs=1e-8) and sol.q[-1, 0] == pytest.approx(-0.3, abs=1e-8)


def test_friction_of_joints_is_dry_friction():
    model = slide()
    for friction, falls in ((12.0, 0.0), (8.0, 0.5 * 1.81)):
        limits = np.array([-friction]), np.array([friction])
        constraint = made(lambda limits=limits: pin.JointFrictionConstraintModel(model, [1], *limits))
        sol = pc.simulate(pc.load(model, loops=[constraint]), (0.0, 1.0))
        assert -sol.q[-1, 0] == pytest.approx(falls, abs=1e-7)
    uneven = made(lambda: pin.JointFrictionConstraintModel(model, [1], np.array([-1.0]), np.array([2.0])))
    with pytest.raises(pc.InputError, match="from -1 to 2"):
        pc.load(model, loops=[uneven])


@pytest.mark.parametrize("ground_first", [True, False])
def test_a_point_contact(ground_first):
    """A block falls onto a slope of 30 degrees, and slides down if the coefficient is below tan 30°."""
    slope = pin.SE3(pin.utils.rotate("y", np.pi / 6), np.array([0.0, 0.0, -0.1]))
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    corner = pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.05]))
    for friction, slides in ((0.7, False), (0.4, True)):
        if ground_first:
            ends = 0, slope, joint, corner
        else:  # z of the first placement points to the other body
            down, up = pin.utils.rotate("x", np.pi), slope.rotation @ pin.utils.rotate("x", np.pi)
            ends = joint, pin.SE3(down, corner.translation), 0, pin.SE3(up, slope.translation)
        constraint = made(lambda ends=ends: pin.PointContactConstraintModel(model, *ends))
        constraint.setFriction(friction)
        mech = pc.load(model, loops=[constraint])
        sol = pc.simulate(mech, (0.0, 1.0), t_eval=np.linspace(0.0, 1.0, 21))
        rests = sol.t > 0.5
        speeds = np.linalg.norm(sol.v[rests], axis=1)
        a = 9.81 * (np.sin(np.pi / 6) - friction * np.cos(np.pi / 6))
        if slides:
            rates = np.polyfit(sol.t[rests], speeds, 1)
            assert rates[0] == pytest.approx(a, rel=1e-6)
        else:
            assert speeds.max() < 1e-6
        gaps = (sol.q + corner.translation - slope.translation) @ slope.rotation[:, 2]
        assert gaps.min() > -1e-8


def test_a_joint_with_several_degrees_of_freedom_has_no_stop():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelTranslation(), pin.SE3.Identity(), "block")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    limit = made(lambda: pin.JointLimitConstraintModel(model, [1], -np.ones(3), np.ones(3)))
    with pytest.raises(pc.InputError, match="'block' has several degrees of freedom"):
        pc.load(model, loops=[limit])


def test_axes_by_pinocchios_names():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.05))
    for theirs, ours in ((pin.LOCAL, "anchor"), ("LOCAL_WORLD_ALIGNED", "world"), (pin.LOCAL_WORLD_ALIGNED, "world")):
        one, two = sol.contact_forces(axes=theirs), sol.contact_forces(axes=ours)
        for name in two:
            np.testing.assert_array_equal(one[name], two[name])
    joint = sol.joint_force("rocker", axes=pin.LOCAL_WORLD_ALIGNED)
    np.testing.assert_array_equal(joint.force, sol.joint_force("rocker", axes="world").force)
    with pytest.raises(pc.InputError, match="is not one of 'world', 'anchor'"):
        sol.contact_forces(axes=pin.WORLD)


class Viewer:
    def __init__(self, model=None):
        self.shown = []
        if model is not None:
            self.model = model

    def display(self, q):
        self.shown.append(np.array(q))


def test_a_run_plays_in_ones_own_viewer():
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.2))
    sol.play(viewer := Viewer(), fps=50)
    assert len(viewer.shown) == 11
    np.testing.assert_allclose(viewer.shown, sol.at(np.linspace(0.0, 0.2, 11)).q, atol=1e-12)
    sol.play(fast := Viewer(mech.model), speed=4.0)
    assert 3 <= len(fast.shown) <= 5
    np.testing.assert_allclose(fast.shown[-1], sol.q[-1], atol=1e-12)


def unbounded(model):
    """The two cranks in another order, with joints that store (cos, sin), as another reader has them."""
    other = pin.Model()
    for name in ("right_crank", "left_crank"):
        i = model.getJointId(name)
        other.addJoint(0, pin.JointModelRUBY(), model.jointPlacements[i], name)
    return other


def test_a_viewer_with_joints_in_another_order_and_storage():
    mech = five_bar()
    sol = pc.simulate(mech, (0.0, 0.1))
    sol.play(viewer := Viewer(unbounded(mech.model)))
    cos, sin, *_ = viewer.shown[-1]
    assert np.arctan2(sin, cos) == pytest.approx(sol.position("right_crank")[-1])
    other = unbounded(mech.model)
    other.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "tail")
    with pytest.raises(pc.InputError, match="has joint 'tail', and five_bar has not"):
        sol.play(Viewer(other))
    with pytest.raises(pc.InputError, match=r"display\(q\)"):
        sol.play(object())
    with pytest.raises(pc.InputError, match="speed"):
        sol.play(Viewer(), speed=0.0)
