"""Actuators of robot files: against MuJoCo's own, their limits and commands."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import sdf_texts
from helpers.warned import told

import pinconsist as pc
from pinconsist.cli.app import main
from pinconsist.engine.systems import compiled_system
from pinconsist.mechanism.system import MechanismSystem
from pinconsist.view.motion import Run

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")

BODIES = """<worldbody><body name="upper"><joint name="hip" axis="0 1 0" ref="0.2"/><geom type="capsule" size=".02"
fromto="0 0 0 0 0 -.4"/><body name="lower" pos="0 0 -.4"><joint name="knee" axis="0 1 0" damping="0.1"/>
<geom type="capsule" size=".02" fromto="0 0 0 .1 0 -.4"/><body pos=".1 0 -.4"><joint name="slide" type="slide"
axis="1 0 0" {slide}/><geom size=".03"/></body></body></body></worldbody>"""
ACTUATORS = {
    "motors": '<motor joint="hip" gear="20"/><motor joint="knee" gear="-3"/>',
    "limited motors": '<motor joint="hip" gear="20" ctrlrange="-0.5 0.5"/><motor joint="knee" ctrlrange="0 .1"/>',
    "position": '<position joint="hip" kp="40"/><position joint="knee" kp="30" kv="2"/>',
    "critically damped": '<position joint="hip" kp="40" dampratio="1"/><position joint="slide" kp="9" dampratio=".5"/>',
    "limited position": '<position joint="hip" kp="40" kv="1" ctrlrange="-.4 .6" forcerange="-5 6" gear="2"/>',
    "velocity": '<velocity joint="hip" kv="3"/><velocity joint="slide" kv="5" forcerange="-2 2"/>',
    "general": '<general joint="knee" gainprm="3" biastype="affine" biasprm=".5 -4 -.3" gear="1.5"/>',
    "affine gain": '<general joint="knee" gaintype="affine" gainprm="2 .3 .1" biastype="affine" biasprm="0 -4 -.3"/>',
    "two on a joint": '<motor name="a" joint="hip"/><position name="b" joint="hip" kp="3"/><motor joint="slide"/>',
    "strong and weak": '<motor joint="hip" gear="5" forcerange="-1 3"/><velocity joint="knee" kv="1" gear="2"/>',
    "limited joint": '<motor joint="slide" gear="-7"/><position joint="knee" kp="8"/>',
    "tendon": '<position tendon="both" kp="7" gear="3"/><motor joint="hip" gear="2"/>',
    "limited tendon": '<motor tendon="both" ctrlrange="-.5 .5"/><velocity tendon="both" kv="2" forcerange="-1 1"/>',
    "damper": '<damper joint="knee" kv="2" ctrlrange="0 3"/>',
}


TENDON = '<tendon><fixed name="both"><joint joint="hip" coef="1.5"/><joint joint="slide" coef="-2"/></fixed></tendon>'


def written(path, actuators, slide="", rest=TENDON):
    text = f"<mujoco>{BODIES.format(slide=slide)}<actuator>{actuators}</actuator>{rest}</mujoco>"
    path.write_text(text, encoding="utf-8")
    return path


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes its warnings to a file in the current folder."""
    monkeypatch.chdir(tmp_path)


def pulled(mech, q, v):
    """The torques of the actuators, (nv,)."""
    bound = [force.bind(mech.model) for force in mech.forces if isinstance(force, pc.Actuator)]
    return sum((each.torque(0.0, q, v) for each in bound), np.zeros(mech.nv))


@pytest.mark.parametrize("kind", ACTUATORS)
def test_forces_are_those_of_mujoco(tmp_path, kind):
    slide = 'actuatorfrcrange="-1.5 2"' if kind == "limited joint" else ""
    path = written(tmp_path / "arm.xml", ACTUATORS[kind], slide)
    mech, model, rng = pc.load(path), mujoco.MjModel.from_xml_path(str(path)), np.random.default_rng(0)
    data, seen = mujoco.MjData(model), set()
    names = [force.name for force in mech.forces if isinstance(force, pc.Actuator)]
    for _ in range(40):
        far = 10.0 ** rng.uniform(-3, 0)
        q, v, u = far * rng.normal(0, 0.7, 3), far * rng.normal(0, 1.5, 3), far * rng.normal(0, 1.6, model.nu)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(model, data)
        asked = mech.with_control(dict(zip(names, u, strict=True)))
        found = pulled(asked, q, v)
        np.testing.assert_allclose(found, data.qfrc_actuator, rtol=1e-10, atol=1e-10)
        seen |= {bool(force.bind(mech.model).at_limit(0.0, q, v)) for force in asked.forces if hasattr(force, "gear")}
    assert seen == {False, True} if "range" in ACTUATORS[kind] + slide else seen == {False}


@pytest.mark.parametrize("kind", ["limited position", "affine gain", "velocity", "position"])
def test_derivatives_are_those_of_the_law(tmp_path, kind):
    mech, rng = pc.load(written(tmp_path / "arm.xml", ACTUATORS[kind])), np.random.default_rng(1)
    for force in (force.bind(mech.model) for force in mech.forces if isinstance(force, pc.Actuator)):
        for _ in range(5):
            q, v, h = rng.normal(0, 0.3, 3), rng.normal(0, 0.3, 3), 1e-6
            for part, by in zip((q, v), force.derivatives(0.0, q, v), strict=True):
                for i in range(3):
                    step = h * np.eye(3)[i]
                    ends = [force.torque(0.0, *(x + s * step * (x is part) for x in (q, v))) for s in (-1.0, 1.0)]
                    np.testing.assert_allclose((ends[1] - ends[0]) / (2 * h), by[:, i], atol=1e-7)


def test_mujoco_makes_the_same_motion(tmp_path):
    path = written(tmp_path / "arm.xml", ACTUATORS["position"])
    control = {"hip": 0.4, "knee": -0.3}
    mech = pc.load(path)
    sol = pc.simulate(mech, (0.0, 0.3), control=control, rtol=1e-8, atol=1e-10)
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.4, -0.3
    mujoco.mj_step(model, data, 3000)
    np.testing.assert_allclose(sol.q[-1], data.qpos, atol=1e-6)


@pytest.mark.parametrize("kind", ["limited position", "limited tendon", "affine gain", "limited motors"])
def test_the_compiled_system_has_the_same_forces(tmp_path, kind):
    """Whatever the command is, and without a call to Python but for a function of the user's."""
    path, rng = written(tmp_path / "arm.xml", ACTUATORS[kind]), np.random.default_rng(4)
    plain = pc.load(path)
    name = next(force.name for force in plain.forces if isinstance(force, pc.Actuator))
    for command in (0.3, ([0.1, 0.4, 0.5], [-2.0, 0.5, 0.2]), pc.Motion(0.1, 3.0), np.sin):
        mech = plain.with_control({name: command})
        system = MechanismSystem(mech, np.zeros(3))
        compiled = compiled_system(system)
        assert compiled.calls_python == (command is np.sin)
        for t in (-1.0, 0.1, 0.3, 0.45, 0.7):
            q, v = rng.normal(size=(2, 3))
            _, f, *_ = compiled.dynamics(t, q, v)
            mine = system.evaluate(t, q, v, np.zeros(3))[0]
            np.testing.assert_allclose(f, mine, atol=1e-12)


def test_locked_joints_of_a_tendon_shift_its_law(tmp_path):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["tendon"]))
    locked = mech.lock("hip", {"hip": 0.4})
    q, v = np.array([0.4, -0.3, 0.2]), np.array([0.0, 0.3, 0.5])
    np.testing.assert_allclose(pulled(locked, q[1:], v[1:]), pulled(mech, q, v)[1:], atol=1e-12)
    assert len(locked.forces) == len(mech.forces) - 1


def test_without_a_command_a_position_actuator_holds_its_reference(tmp_path):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"]))
    hip, knee = (force for force in mech.forces if isinstance(force, pc.Actuator))
    assert hip.control == pytest.approx(np.radians(0.2)) and knee.control == 0.0  # ref
    key = '<keyframe><key qpos="0 0 0" ctrl="0.7 -0.1"/></keyframe>'
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"], rest=key))
    assert [force.control for force in mech.forces if isinstance(force, pc.Actuator)] == [0.7, -0.1]
    key = '<keyframe><key time="1"/><key ctrl="0.5 0.2"/></keyframe>'  # positions are those of the file
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"], rest=key))
    assert [force.control for force in mech.forces if isinstance(force, pc.Actuator)] == [0.5, 0.2]
    assert (mech.guess == pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"])).guess).all()


def test_limits_are_reported_and_commands_may_change(tmp_path):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["limited position"]))
    sol = pc.simulate(mech, (0.0, 0.2), control={"hip": 2.0})
    certificate = sol.check(error=False)
    assert certificate.saturated["hip"] == 1.0
    assert "actuators are at the limits of their commands or forces: hip in 100% of the rows" in str(certificate)
    assert np.abs(sol.torque("hip")).max() <= 2 * 6.0 + 1e-12
    knee = pc.simulate(pc.load(written(tmp_path / "b.xml", ACTUATORS["general"])), (0.0, 0.1))
    np.testing.assert_allclose(knee["knee"].torque, knee.torque("knee") - 0.1 * knee.velocity("knee"))  # its damping
    quiet = pc.simulate(mech, (0.0, 0.1), control={"hip": 0.4}).check(error=False)
    assert quiet.saturated == {} or quiet.saturated["hip"] < 1.0
    table = [[0.0, 0.1], [0.2, 0.4]]
    for command in (lambda t: 0.2 + 2 * t, table, pc.Motion(0.2, 2.0)):
        there = pc.simulate(mech, (0.0, 0.1), control={"hip": command}).q[-1]
        np.testing.assert_allclose(
            there, pc.simulate(mech, (0.0, 0.1), control={"hip": lambda t: 0.2 + 2 * t}).q[-1], atol=1e-7
        )


@pytest.mark.parametrize(
    ("control", "message"),
    [
        ({"hipp": 1.0}, "no actuator 'hipp'; similar: hip; available: hip, knee"),
        ({"hip": [1.0, 2.0]}, r"\(times, values\)"),
        ({"hip": float("nan")}, "control"),
        (0.4, "needs a mapping"),
    ],
)
def test_wrong_commands(tmp_path, control, message):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"]))
    with pytest.raises(pc.InputError, match=message):
        pc.simulate(mech, (0.0, 0.1), control=control)
    with pytest.raises(pc.InputError, match="several actuators act on joint 'hip'"):
        pc.load(written(tmp_path / "arm.xml", ACTUATORS["two on a joint"])).with_control({"hip": 1.0})


def test_what_exerts_no_force_is_said(tmp_path, recwarn):
    actuators = '<intvelocity joint="hip" kp="3"/><muscle joint="knee" lengthrange="0 1"/><motor joint="slide"/>'
    off = '<motor name="off" joint="slide" group="2"/>'  # MuJoCo's own force of it is zero
    path = written(tmp_path / "arm.xml", actuators + off, rest='<option actuatorgroupdisable="2 3"/>')
    mech = pc.load(path)
    assert [force.name for force in mech.forces if isinstance(force, pc.Actuator)] == ["slide"]
    assert mech.actuated == ("hip", "knee", "slide") and len(recwarn) == 4
    assert [str(each.message).split(": ")[-1] for each in recwarn] == [
        "it has dynamics of its own, or a delay",
        "it has dynamics of its own, or a delay",
        "the options disable it",
        "2 colliding geoms",
    ]


def test_the_motors_of_an_actuation_are_without_their_actuators(tmp_path):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"]))
    act = pc.Actuation(mech, ["hip", "knee", "slide"])
    np.testing.assert_allclose(act.bias(), act.gravity(), atol=1e-12)


def test_runs_that_are_saved_on_the_way_obey_their_commands(tmp_path):
    path = written(tmp_path / "arm.xml", ACTUATORS["limited position"])
    options = {"control": {"hip": 0.3}, "t_eval": [0.05, 0.1]}
    sol = pc.record(pc.load(path), (0.0, 0.1), "run.npz", save_every=0.03, **options)
    np.testing.assert_allclose(sol.q, pc.simulate(pc.load(path), (0.0, 0.1), **options).q, atol=1e-5)
    assert sol.recipe["options"]["control"] == {"hip": 0.3}


def test_commands_of_time_are_those_of_the_run(tmp_path):
    mech = pc.load(written(tmp_path / "arm.xml", ACTUATORS["position"]))
    for command in (([0.0, 0.1], [0.0, 0.4]), lambda t: 4.0 * t):
        sol = pc.simulate(mech, (0.0, 0.1), control={"hip": command})
        kept = pc.Solution.load(sol.save("run.npz"))
        told = mech.with_control({"hip": command}) if callable(command) else mech
        for run, scene in ((sol, mech), (kept, told)):  # the plain mechanism commands something else
            np.testing.assert_array_equal(run.torque("hip", scene), sol.torque("hip"))
        drawn = Run.of(mech, sol, forces=True).mech
        assert callable(next(force for force in drawn.forces if force.label == "hip").control)
    with pytest.raises(pc.InputError, match="the command of 'hip' was a function of time"):
        kept.torque("hip", mech)
    np.testing.assert_array_equal(kept.position("hip", mech), sol.position("hip"))  # for which no force matters


def test_one_number_for_an_actuator(tmp_path, capsys):
    path = written(tmp_path / "arm.xml", ACTUATORS["position"].replace("<position", '<position name="up"', 1))
    for words, message in ((["hip=1,2"], "hip needs one number"), (["hip=1", "hip=2"], "names actuator 'hip' twice")):
        with pytest.raises(SystemExit):
            main(["simulate", str(path), "--control", *words])
        assert message in capsys.readouterr().err
    with pytest.raises(pc.InputError, match="'up' and 'hip' are the same actuator"):
        pc.load(path).with_control({"up": 1.0, "hip": 1.0})


def test_commands_on_the_command_line(tmp_path, capsys):
    path = written(tmp_path / "arm.xml", ACTUATORS["limited position"])
    with pytest.raises(SystemExit) as ended:
        main(["simulate", str(path), "--until", "0.05", "--control", "hip=30deg", "--out", "run.npz"])
    assert not ended.value.code, capsys.readouterr()
    run = pc.Solution.load("run.npz")
    mine = pc.simulate(pc.load(path), (0.0, 0.05), control={"hip": np.pi / 6})
    np.testing.assert_allclose(run.q[-1], mine.q[-1], atol=1e-12)
    assert pc.rerun("run.npz").same
    np.testing.assert_allclose(run.torque("hip", pc.load(path)), mine.torque("hip"), atol=1e-9)  # the file has them
    assert run.check(pc.load(path), error=False).energy_error < 1e-3


ARM = """<robot name="arm"><link name="base"/><link name="bar"><inertial><mass value="2"/><origin xyz="0.3 0 0"/>
<inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial></link><joint name="j" type="revolute">
<parent link="base"/><child link="bar"/><axis xyz="0 1 0"/>
<limit lower="-3" upper="3" effort="30" velocity="9"/></joint>
<transmission name="t"><type>transmission_interface/SimpleTransmission</type><joint name="j"/>
<actuator name="m"><mechanicalReduction>{reduction}</mechanicalReduction><rotorInertia>{rotor}</rotorInertia></actuator>
</transmission>{rest}</robot>"""


def test_a_transmission_of_a_urdf_acts(tmp_path, recwarn):
    path = tmp_path / "arm.urdf"
    both = '<transmission name="d"><joint name="j"/><joint name="k"/><actuator name="x"/></transmission>'
    path.write_text(ARM.format(reduction=50, rotor="1e-4", rest=both), encoding="utf-8")
    mech = pc.load(path)
    assert mech.actuated == ("j",) and "'d': it exerts no force here" in told(recwarn)
    assert mech.model.armature[0] == pytest.approx(2500 * 1e-4)
    sol = pc.simulate(mech, (0.0, 0.05), control={"m": 0.4})
    np.testing.assert_allclose(sol.torque("m"), 20.0)
    inertia = 0.1 + 2 * 0.3**2 + 0.25  # about the hinge, with the rotor
    assert sol.acceleration("j")[0] == pytest.approx((20.0 + 2 * 9.81 * 0.3) / inertia)  # positive is downwards
    strong = pc.simulate(mech, (0.0, 0.05), control={"j": 5.0})
    np.testing.assert_allclose(strong.torque("m"), 30.0)  # the joint's effort limit
    assert strong.check(error=False).saturated == {"m": 1.0}


TWO = """<transmission name="d"><type>transmission_interface/{kind}</type>
<joint name="k"><role>joint2</role><mechanicalReduction>{j2}</mechanicalReduction></joint>
<joint name="j"><role>joint1</role><mechanicalReduction>{j1}</mechanicalReduction></joint>
<actuator name="a"><role>actuator1</role><mechanicalReduction>{a1}</mechanicalReduction>{rotor}</actuator>
<actuator name="b"><role>actuator2</role><mechanicalReduction>{a2}</mechanicalReduction>{rotor}</actuator>
</transmission><link name="tip"><inertial><mass value="1"/>
<inertia ixx=".1" ixy="0" ixz="0" iyy=".1" iyz="0" izz=".1"/></inertial></link>
<joint name="k" type="continuous"><parent link="bar"/><child link="tip"/><axis xyz="1 0 0"/></joint>"""


@pytest.mark.parametrize("kind", ["DifferentialTransmission", "FourBarLinkageTransmission"])
def test_two_motors_on_two_joints(tmp_path, recwarn, kind):
    """Torques are those of ROS; the power of the motors is that of the joints."""
    (j1, j2), (a1, a2), u = (10.0, 50.0), (-2.0, 4.0), (0.3, -0.7)
    path, rotor = tmp_path / "arm.urdf", "<rotorInertia>1e-5</rotorInertia>"
    rest = TWO.format(kind=kind, j1=j1, j2=j2, a1=a1, a2=a2, rotor=rotor)
    path.write_text(ARM.format(reduction=1, rotor="0", rest=rest), encoding="utf-8")
    mech = pc.load(path)
    assert mech.actuated == ("j", "k") and "couple the two joints" in told(recwarn)
    found = pulled(mech.with_control({"a": u[0], "b": u[1]}), pin.neutral(mech.model), np.zeros(2))
    if kind == "DifferentialTransmission":
        expected = j1 * (u[0] * a1 + u[1] * a2), j2 * (u[0] * a1 - u[1] * a2)
        turned = (a1 * j1) ** 2 + (a2 * j1) ** 2, (a1 * j2) ** 2 + (a2 * j2) ** 2
    else:
        expected = j1 * u[0] * a1, j2 * (u[1] * a2 - u[0] * a1 * j1)
        turned = (a1 * j1) ** 2, (a1 * j1 * j2) ** 2 + (a2 * j2) ** 2
    np.testing.assert_allclose(found, expected, rtol=1e-14)
    np.testing.assert_allclose(mech.model.armature, 1e-5 * np.array(turned), rtol=1e-12)


def test_a_transmission_without_reduction_is_refused(tmp_path):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.format(reduction=0, rotor="0", rest=""), encoding="utf-8")
    with pytest.raises(pc.FormatError, match="transmission 't': a reduction is zero"):
        pc.load(path)


def test_check_says_what_acts_and_a_scene_keeps_it(tmp_path, capsys):
    path = tmp_path / "arm.urdf"
    path.write_text(ARM.format(reduction=50, rotor="0", rest=""), encoding="utf-8")
    with pytest.raises(SystemExit):
        main(["check", str(path)])
    assert "actuators: m on j (command 0)" in capsys.readouterr().out
    pc.write(pc.load(path), tmp_path / "again.urdf")
    again = pc.load(tmp_path / "again.urdf")
    (motor,) = (force for force in again.forces if isinstance(force, pc.Actuator))
    assert (motor.gear, motor.force_range) == (50.0, (-0.6, 0.6))


PLUGIN = '<plugin filename="x" name="gz::sim::systems::{kind}"><joint_name>{joint}</joint_name>{rest}</plugin>'
CONTROLLERS = {  # (kind, settings) → torque for q, v, u, by Gazebo's documentation
    ("ApplyJointForce", ""): lambda q, v, u: np.clip(u, -2, 2),
    ("JointPositionController", "<p_gain>4</p_gain><i_gain>0</i_gain><d_gain>.5</d_gain>"): (
        lambda q, v, u: np.clip(4 * (u - q) - 0.5 * v, -2, 2)
    ),
    ("JointPositionController", "<cmd_max>.4</cmd_max><cmd_min>-.1</cmd_min><cmd_offset>.2</cmd_offset>"): (
        lambda q, v, u: np.clip(u - q - 0.01 * v + 0.2, -0.1, 0.4)
    ),
    ("JointController", "<use_force_commands>true</use_force_commands><p_gain>3</p_gain>"): (
        lambda q, v, u: np.clip(3 * (u - v), -2, 2)
    ),
}


@pytest.mark.parametrize(("kind", "rest"), CONTROLLERS)
def test_controllers_of_gazebo_act(tmp_path, kind, rest):
    limit = sdf_texts.axis("0 0 1", "<limit><effort>2</effort></limit>")
    scene = sdf_texts.A + sdf_texts.B + sdf_texts.joint("j", "world", "a") + sdf_texts.joint("k", inside=limit)
    mech = pc.load(sdf_texts.write(tmp_path, scene + PLUGIN.format(kind=kind, joint="k", rest=rest)))
    assert mech.actuated == ("k",)
    for q, v, u in np.random.default_rng(0).normal(size=(10, 3)):
        found = pulled(mech.with_control({"k": u}), np.array([0.0, q]), np.array([0.0, v]))
        np.testing.assert_allclose(found, [0.0, CONTROLLERS[kind, rest](q, v, u)], atol=1e-14)


def test_controllers_of_gazebo_that_exert_no_force(tmp_path, recwarn):
    scene = sdf_texts.A + sdf_texts.B + sdf_texts.joint("j", "world", "a") + sdf_texts.joint("k")
    moves = PLUGIN.format(kind="JointController", joint="k", rest="")
    moves += PLUGIN.format(kind="ApplyJointForce", joint="k", rest="<joint_index>3</joint_index>")
    whole = PLUGIN.format(kind="JointPositionController", joint="j", rest="<initial_position>.3</initial_position>")
    mech = pc.load(sdf_texts.write(tmp_path, scene + moves + whole))
    assert [(force.name, force.control) for force in mech.forces] == [("j", 0.3)]
    assert "JointController 'k': it exerts no force here" in told(recwarn)
    assert "JointPositionController 'j': its i_gain of 0.1 is ignored" in told(recwarn)
    with pytest.raises(pc.FormatError, match="there is no joint 'l'"):
        pc.load(sdf_texts.write(tmp_path, scene + PLUGIN.format(kind="ApplyJointForce", joint="l", rest="")))
