"""The referee against closed forms, MuJoCo's own numbers, and errors that are put in on purpose."""

import csv
import json
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers.command_line import called

import pinconsist as pc
from benchmarks.referee import judged
from pinconsist.judging.contestants import MuJoCo, Own, Pinocchio, Task, rows_of
from pinconsist.judging.judge import errors_of
from pinconsist.judging.mjcf import from_mujoco, joints_of, scene_of, to_mujoco
from pinconsist.judging.reference import Measure, even_times, reference_of
from pinconsist.mechanism.rigid import contact_models

mujoco = pytest.importorskip("mujoco")

LENGTH, MASS, G = 0.8, 2.0, 9.81


def body(inertia=(0.02, 0.03, 0.04), lever=(0.1, -0.05, 0.2), mass=MASS):
    return pin.Inertia(mass, np.array(lever), np.diag(inertia))


def tree(joint, placement=None):
    """A hinge on an oblique axis, then the joint."""
    model, place = pin.Model(), pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.2, 0.5), np.array([0.1, 0.2, 0.3]))
    parent = 0
    if not isinstance(joint, pin.JointModelFreeFlyer):
        axis = np.array([1.0, 2.0, -1.0]) / np.sqrt(6.0)
        parent = model.addJoint(0, pin.JointModelRevoluteUnaligned(axis), place, "first")
        model.appendBodyToJoint(parent, body(), pin.SE3.Identity())
    index = model.addJoint(parent, joint, place, "joint")
    model.appendBodyToJoint(index, body(lever=(0.3, 0.1, 0.0)), pin.SE3.Identity())
    return pc.Mechanism(model)


JOINTS = {
    "revolute": pin.JointModelRY(),
    "unbounded": pin.JointModelRUBZ(),
    "prismatic": pin.JointModelPrismaticUnaligned(np.array([0.6, 0.0, 0.8])),
    "ball": pin.JointModelSpherical(),
    "free": pin.JointModelFreeFlyer(),
    "planar": pin.JointModelPlanar(),
    "translation": pin.JointModelTranslation(),
    "euler angles": pin.JointModelSphericalZYX(),
    "universal": pin.JointModelUniversal(np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])),
}


@pytest.mark.parametrize("name", JOINTS)
def test_a_tree_moves_the_same_way_in_mujoco(name):
    """Masses, axes, placements and the axes of velocities: the energies and 0.2 s of motion agree."""
    mech, rng = tree(JOINTS[name]), np.random.default_rng(1)
    q0 = pin.integrate(mech.model, pin.neutral(mech.model), rng.uniform(-0.6, 0.6, mech.nv))
    v0 = rng.uniform(-1, 1, mech.nv)
    task = Task(mech, q0, v0, np.linspace(0.0, 0.2, 21), ())
    contestant = MuJoCo(task)
    model = contestant._model(contestant.setting("RK4", 1e-3, (0.02, 1.0), (0.9,) * 2 + (0.001, 0.5, 2.0), ""))
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    joints = joints_of(mech.model)
    data.qpos[:], data.qvel[:] = to_mujoco(joints, q0, v0)
    mujoco.mj_forward(model, data)
    own = pin.computeKineticEnergy(mech.model, mech.model.createData(), q0, v0)
    assert data.energy[1] == pytest.approx(own, rel=1e-12)
    for mine, back in zip((q0, v0), from_mujoco(joints, mech.nq, data.qpos, data.qvel), strict=True):
        np.testing.assert_allclose(back, mine, atol=1e-14)
    rows = contestant.run(contestant.setting("RK4", 2e-4, (0.02, 1.0), (0.9, 0.9, 0.001, 0.5, 2.0), ""))
    true = pc.simulate(mech, (0.0, 0.2), q0, v0, rtol=1e-11, atol=1e-12).at(rows.t)
    apart = [pin.difference(mech.model, a, b) for a, b in zip(rows.q, true.q, strict=True)]
    assert np.abs(apart).max() < 1e-8 and np.abs(rows.v - true.v).max() < 1e-7


def pendulum(kind="point", angle=1.0):
    """A body that floats in the plane x-z, held at the origin; at an angle from hanging, at rest."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "rod")
    model.appendBodyToJoint(joint, pin.Inertia(MASS, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    extra = {"axis": (0, 1, 0)} if kind == "hinge" else {}
    model.addFrame(pin.Frame("rod", joint, 0, pin.SE3.Identity(), pin.FrameType.BODY))
    loop = pc.Loop("pin", kind, "universe", "rod", xyz2=(0, 0, LENGTH), **extra)
    turn = pin.Quaternion(pin.rpy.rpyToMatrix(0.0, angle, 0.0)).coeffs()
    place = -pin.rpy.rpyToMatrix(0.0, angle, 0.0) @ [0, 0, LENGTH]
    return pc.Mechanism(model, [loop], guess=np.concatenate((place, turn)), name="pendulum")


def test_the_force_of_a_pendulum_in_every_simulator():
    """N = m (g cos θ + l θ'²), and energy gives θ': in MuJoCo, in Pinocchio and here, of the same sign and axes."""
    mech = pendulum()
    judgement = pc.referee(mech, (0.0, 1.0), budget=3.0)
    true = judgement.reference
    place = true.q[:, :3] / LENGTH  # from the pin to the centre of mass
    c, inertia = -place[:, 2], 1e-3 + MASS * LENGTH**2
    speed = 2 * MASS * G * LENGTH * (c - np.cos(1.0)) / inertia
    gravity = np.array([0.0, 0.0, -G])
    turning = MASS * G * LENGTH * np.sqrt(1 - c**2) / inertia  # |θ''|, towards the lowest point
    along = np.column_stack((-place[:, 2], np.zeros(len(c)), place[:, 0])) * -np.sign(place[:, :1])
    a = -LENGTH * speed[:, None] * place + LENGTH * turning[:, None] * along
    exact = MASS * (a - gravity)
    np.testing.assert_allclose(true.reaction("pin").force, exact, atol=1e-6)
    assert not judgement.not_judged and judgement.agreement[1] < 1e-7
    for tool in ("MuJoCo", "Pinocchio", "pinconsist"):
        assert judgement.cheapest[tool].force < 0.01
    assert judgement.of("Pinocchio")[-1].force < 1e-4 and judgement.of("MuJoCo")[-1].gap < 1e-4


@pytest.mark.parametrize("kind", ["frame", "hinge", "distance"])
def test_other_loops_are_the_same_in_mujoco(kind):
    mech = pendulum("point")
    loop = {
        "frame": pc.Loop("pin", "frame", "universe", "rod", xyz2=(0, 0, LENGTH), rpy1=(0, 1.0, 0)),
        "hinge": pc.Loop("pin", "hinge", "universe", "rod", xyz2=(0, 0, LENGTH), axis=(0, 1, 0)),
        "distance": pc.Loop("pin", "distance", "universe", "rod", xyz2=(0, 0, 0.1), length=LENGTH - 0.1),
    }[kind]
    judgement = pc.referee(mech.with_loops(loop), (0.0, 0.3), tools=["mujoco"], budget=2.0, below=1e-3)
    default, *others = judgement.of("MuJoCo")
    assert min(row.gap for row in others) < 1e-3 * max(default.gap, 1e-4)
    assert min(row.joints_turn for row in others) < 1e-3 and min(row.tilt for row in others) < 1e-5
    assert judgement.cheapest["MuJoCo"].force < 0.01


def test_the_weight_of_a_welded_body_is_exact_at_rest():
    mech = pendulum().with_loops(pc.Loop("pin", "frame", "universe", "rod", xyz2=(0, 0, LENGTH), rpy1=(0, 1.0, 0)))
    judgement = pc.referee(mech, (0.0, 0.5), tools=["mujoco", "pinocchio"], budget=1.0)
    np.testing.assert_allclose(judgement.reference.reaction("pin").force[-1], [0, 0, MASS * G], atol=1e-9)
    assert max(row.force_here for row in judgement.of("Pinocchio")) < 1e-6


def own_rows(mech, span, v0=None):
    assembly = pc.assemble(mech, v0=v0)
    reference = reference_of(mech, even_times(span), assembly.q, assembly.v)
    return rows_of(reference.sol), Measure(mech, reference)


def test_errors_that_are_put_in_come_out_in_their_part():
    mech = pc.load("four_bar")
    rows, measure = own_rows(mech, (0.0, 1.0))
    exact = errors_of(rows, measure)
    assert max(exact[name] for name in ("force", "force_here", "force_drift", "energy", "gap")) < 1e-8
    louder = errors_of(replace(rows, loads=1.05 * rows.loads), measure)
    assert louder["force"] == pytest.approx(0.05, rel=1e-6) and louder["force_here"] == pytest.approx(0.05, rel=1e-6)
    assert louder["force_drift"] < 1e-8 and louder["force_peak"] == pytest.approx(0.05, rel=1e-6)
    late = pc.simulate(mech, (0.0, 1.0), measure.reference.sol.q[0] + 0.0, rtol=1e-10, atol=1e-12)
    late = rows_of(late.at(np.clip(rows.t - 0.01, 0.0, None)))  # the true motion, a hundredth of a second too late
    drifted = errors_of(replace(late, t=rows.t), measure)
    assert drifted["force_here"] < 1e-8 and drifted["force_drift"] == pytest.approx(drifted["force"])
    assert drifted["gap"] < 1e-9 and 0.01 < drifted["joints_turn"] < 0.2


def test_the_text_to_paste_is_read_by_mujoco():
    mech = pc.load("crank_rocker")
    judgement = pc.referee(mech, (0.0, 0.5), v0={"crank": 12.0}, tools="mujoco", budget=2.0)
    best = judgement.cheapest["MuJoCo"]
    assert best.force <= 0.01 and best.paste in str(judgement).replace("\n    ", "\n")
    text = f'<mujoco>{best.paste}<worldbody><body name="a"><joint/><geom size="1"/></body></worldbody>'
    text += '<equality><connect body1="a" anchor="0 0 0"/></equality></mujoco>'
    model = mujoco.MjModel.from_xml_string(text)
    assert model.opt.timestep == best.step and model.eq_solimp[0, 0] == 0.9999
    coarse, *_ = judgement.of("MuJoCo")
    assert coarse.setting.startswith("Euler, 2 ms, default") and coarse.force > 0.1 > coarse.force_here


def test_a_hinge_in_space_is_held_by_two_points():
    judgement = pc.referee(pc.load("bricard"), (0.0, 1.0), budget=1.0)
    assert all(judgement.cheapest[tool].force <= 0.01 for tool in ("MuJoCo", "Pinocchio", "pinconsist"))
    assert len(contact_models(pc.load("bricard"), ("hinge5",))) == 2


def test_joints_of_drives_follow_their_curves():
    mech = pc.load("jansen_leg")
    judgement = pc.referee(mech, (0.0, 0.5), tools=["pinocchio", "pinconsist"], budget=2.0)
    assert not any(isinstance(loop, pc.Drive) for loop in judgement.mechanism.loops)
    driven = pc.simulate(mech, (0.0, 0.5), rtol=1e-9, atol=1e-11).at(judgement.t)
    assert np.abs(judgement.reference.q - driven.q).max() < 1e-5
    for loop in ("Q", "S", "T"):
        forces = driven.reaction(loop).force
        off = np.abs(judgement.reference.reaction(loop).force - forces).max()
        assert off < 1e-3 * np.abs(forces).max()


def test_a_motion_is_followed_by_all():
    times = np.linspace(0.0, 1.0, 11)
    table = (times, -1.0 + 0.3 * times**2 * (3 - 2 * times))
    judgement = pc.referee(pc.load("four_bar"), (0.0, 1.0), motion={"crank": table}, tools=["mujoco"], budget=2.0)
    assert judgement.reference.position("crank", judgement.mechanism)[-1] == pytest.approx(-0.7, abs=1e-4)
    assert judgement.of("MuJoCo")[-1].joints_turn < 1e-2


def test_a_motion_on_which_methods_part_is_judged_until_then():
    with pytest.warns(UserWarning, match="no two methods agree"):
        judgement = pc.referee(pc.load("five_bar"), (0.0, 2.0), tools="pinconsist")
    assert 0.5 < judgement.t[-1] < 2.0  # before the end; when, rounding decides at the position where branches cross


def written(path, heads, columns):
    with open(path, "w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(heads)
        writer.writerows(np.column_stack(columns).tolist())
    return path


@pytest.fixture(scope="module")
def run_of_crank_rocker():
    mech = pc.load("crank_rocker")
    sol = pc.simulate(mech, (0.0, 0.5), v0={"crank": 12.0}, rtol=1e-9, atol=1e-11)
    return mech, sol.at(np.linspace(0.0, 0.5, 101))


def test_a_log_of_this_package_is_right(run_of_crank_rocker, tmp_path):
    mech, sol = run_of_crank_rocker
    sol.to_csv(tmp_path / "run.csv", forces=["rocker_ground"])
    judgement = pc.referee(mech, log=tmp_path / "run.csv")
    (row,) = judgement.rows
    assert max(row.force, row.force_here, row.energy, row.joints_turn) < 1e-6 and not judgement.notes
    assert judgement.cheapest == {} and row.setting == "run.csv"


def test_a_log_in_degrees_of_the_other_sign_without_velocities(run_of_crank_rocker, tmp_path):
    mech, sol = run_of_crank_rocker
    q, force = np.degrees(sol.q), -sol.reaction("rocker_ground").force
    heads = [
        "time [ms]",
        *(f"{joint} [deg]" for joint in mech.joints),
        *(f"force.rocker_ground.{k} [kN]" for k in "xyz"),
    ]
    file = written(tmp_path / "log.csv", heads, [1e3 * sol.t, q, 1e-3 * force])
    judgement = pc.referee(mech, log=file)
    (row,) = judgement.rows
    assert row.force_here < 2e-3 and any("opposite sign" in note for note in judgement.notes)
    assert any("velocities" in note for note in judgement.notes)


def test_a_log_in_the_axes_of_an_anchor(run_of_crank_rocker, tmp_path):
    mech, sol = run_of_crank_rocker
    force = sol.reaction("rocker_ground", axes="anchor").force
    heads = ["t", *(f"{part}.{joint}" for part in "qv" for joint in mech.joints)]
    heads += [f"force.rocker_ground.{k}" for k in "xyz"]
    judgement = pc.referee(mech, log=written(tmp_path / "log.csv", heads, [sol.t, sol.q, sol.v, force]))
    assert judgement.rows[0].force_here < 1e-6 and "axes of its anchor 1" in judgement.notes[0]


def test_a_log_of_the_motor_alone(run_of_crank_rocker, tmp_path):
    """The other joints follow from the loops; there are no gaps to see, and no forces to judge."""
    mech, sol = run_of_crank_rocker
    file = written(tmp_path / "log.csv", ["t", "crank", "v.crank"], [sol.t, sol.q[:, 0], sol.v[:, 0]])
    judgement = pc.referee(mech, log=file)
    (row,) = judgement.rows
    assert row.gap < 1e-8 and np.isnan(row.force) and row.joints_turn < 5e-3
    assert "coupler, rocker are not in the log" in judgement.notes[0]


def test_the_commands_of_a_log_act(tmp_path):
    """An actuator's commands and a torque that was held: the true motion is that under both."""
    mech = pc.load("four_bar").add_forces(pc.Actuator("motor", "crank"))
    times = np.linspace(0.0, 0.5, 51)
    command, torque = 3.0 * np.sin(4 * times), np.round(np.cos(9 * times))
    forced = mech.with_control({"motor": (times, command)}).add_forces(pc.HeldTorque(times, torque, joints=["rocker"]))
    sol = pc.simulate(forced, (0.0, 0.5), rtol=1e-9, atol=1e-11).at(times)
    heads = ["t", *(f"q.{j}" for j in mech.joints), *(f"v.{j}" for j in mech.joints), "command.motor", "torque.rocker"]
    file = written(tmp_path / "log.csv", heads, [times, sol.q, sol.v, command, torque])
    assert pc.referee(mech, log=file).rows[0].joints_turn < 1e-6


def test_simulators_beside_a_log(run_of_crank_rocker, tmp_path):
    mech, sol = run_of_crank_rocker
    sol.to_csv(tmp_path / "run.csv")
    judgement = pc.referee(mech, log=tmp_path / "run.csv", tools=["pinocchio"], budget=1.0)
    assert {row.tool for row in judgement.rows} == {"log", "Pinocchio"} and judgement.cheapest["Pinocchio"].force < 0.01
    uneven = written(tmp_path / "u.csv", ["t", "crank"], [sol.t[:50] ** 1.1, sol.q[:50, 0]])
    with pytest.raises(pc.InputError, match="even times"):
        pc.referee(mech, log=uneven, tools=["pinocchio"])


MJCF = """<mujoco model="chain"><option timestep="0.004" integrator="RK4" gravity="0 0 -9.81"/>
  <worldbody>
    <body name="crank"><joint name="crank" axis="0 1 0"/><geom type="capsule" fromto="0 0 0 .3 0 0" size=".02"/>
      <body name="rod" pos=".3 0 0"><joint name="rod" axis="0 1 0" ref="0"/>
        <geom type="capsule" fromto="0 0 0 .6 0 -.3" size=".02"/></body></body>
  </worldbody>
  <equality><connect name="foot" body1="rod" anchor=".6 0 -.3" solref="0.05 1" solimp="0.8 0.9 0.002"/></equality>
</mujoco>"""


def test_the_settings_of_a_file_are_judged_first(tmp_path):
    file = tmp_path / "scene.xml"
    file.write_text(MJCF.replace('name="rod" axis', 'name="rod" stiffness="1" axis'))
    mech = pc.load(file)
    mech = mech.with_loops(pc.Loop("foot", "distance", "rod", xyz1=(0.6, 0, -0.3), length=0.4, xyz2=(0.9, 0, -0.7)))
    judgement = pc.referee(mech.reanchored(), (0.0, 0.4), mjcf=file, tools="mujoco", budget=1.0)
    own, default, *_ = judgement.of("MuJoCo")
    assert own.setting == "RK4, 4 ms, as in its file" and own.step == 0.004
    assert own.gap > default.gap  # softer than the defaults


def controlled(t, q, v):
    return 0.0


def test_refusals(tmp_path):
    four_bar = pc.load("four_bar")
    with pytest.raises(pc.InputError, match="no loops"):
        pc.referee(pc.load("double_pendulum"))
    with pytest.raises(pc.InputError, match="unknown simulator 'bullet'"):
        pc.referee(four_bar, tools=["bullet"])
    with pytest.raises(pc.InputError, match="t_span"):
        pc.referee(four_bar, (1.0, 0.0))
    with pytest.raises(pc.InputError, match="no joint 'crnk'"):
        pc.referee(four_bar, motion={"crnk": ((0, 1), (0, 1))})
    with pytest.raises(pc.InputError, match="those of the log"):
        pc.referee(four_bar, (0, 1), log="x.csv")
    sampled = four_bar.add_forces(pc.Sampled(0.01, controlled, joints=["crank"]))
    judgement = pc.referee(sampled, (0.0, 0.2))
    assert set(judgement.not_judged) == {"mujoco", "pinocchio"} and "memory" in judgement.not_judged["mujoco"]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "it is empty"),
        ("q.crank\n1\n2\n3\n", "no column of times"),
        ("t,q.crank\n0,1\n1,2\n1,3\n", "increasing times"),
        ("t,q.crnk\n0,1\n1,2\n2,3\n", "no joint 'crnk'; similar: crank"),
        ("t,q.crank [furlong]\n0,1\n1,2\n2,3\n", "unknown unit 'furlong'"),
        ("t,q.crank\n0,1\n1,x\n2,3\n", "not a number"),
        ("t,q.crank\n0,1\n1,nan\n2,3\n", "not finite"),
        ("t,v.crank\n0,1\n1,2\n2,3\n", "no position of any joint"),
        ("t,crank,command.knee\n0,1,1\n1,2,1\n2,3,1\n", "no actuator 'knee'"),
        ("t,crank,torque.knee\n0,1,1\n1,2,1\n2,3,1\n", "no joint 'knee'"),
        ("t,crank,force.pin.x\n0,1,1\n1,2,1\n2,3,1\n", "coupler_rocker"),
        ("t,crank,force.coupler_rocker.x\n0,1,1\n1,2,1\n2,3,1\n", "its x, y and z"),
    ],
)
def test_logs_that_are_none(text, words, tmp_path):
    file = tmp_path / "log.csv"
    file.write_text(text)
    with pytest.raises(pc.FormatError, match=r"log\.csv") as caught:
        pc.referee(pc.load("four_bar"), log=file)
    assert words in str(caught.value)


def test_pages_and_tables(tmp_path):
    judgement = pc.referee(pc.load("four_bar"), (0.0, 0.5), tools=["pinocchio"], budget=0.5)
    page = judgement.to_html(tmp_path / "page.html").read_text("utf-8")
    assert "in the colours of its bodies" in page and "Pinocchio: symplectic Euler" in page
    with open(judgement.to_csv(tmp_path / "table.csv"), newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    assert len(rows) == len(judgement.rows) and float(rows[0]["force"]) == judgement.rows[0].force
    with pytest.raises(pc.InputError, match="no run of another simulator"):
        pc.referee(pc.load("four_bar"), (0.0, 0.1), tools=["pinconsist"]).to_html(tmp_path / "none.html")


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)


def test_the_command(run, tmp_path):
    code, out, err = run("referee", "four_bar", "--until", "0.3", "--budget", "0.3", "--html", "p.html", "--json")
    assert code == 0, err
    found = json.loads(out)
    assert {row["tool"] for row in found["rows"]} == {"MuJoCo", "Pinocchio", "pinconsist"}
    assert (tmp_path / "p.html").exists() and found["below"] == 0.01
    code, out, _ = run("referee", "four_bar", "--until", "0.3", "--tool", "pinconsist")
    assert code == 0 and "force errors of at most 1 %" in out
    written(tmp_path / "m.csv", ["t", "q.crank"], [[0.0, 0.2, 0.4], [-1.0, -0.98, -0.95]])
    code, out, err = run("referee", "four_bar", "--until", "0.4", "--motion", "m.csv", "--tool", "pinconsist")
    assert code == 0, err


def test_the_command_refuses(run, tmp_path):
    written(tmp_path / "m.csv", ["t", "q.crank"], [[0.0, 0.2, 0.4], [-1.0, -0.98, -0.95]])
    for arguments, words in (
        (("--log", "m.csv", "--until", "1"), "--until: the start, the times"),
        (("--speed", "2"), "add --html"),
        (("--tool", "gazebo"), "unknown simulator 'gazebo'"),
        (("--motion", "none.csv"), "none.csv"),
    ):
        code, _, err = run("referee", "four_bar", *arguments)
        assert code == 2 and words in err, err


def test_the_table_of_ten_mechanisms():
    """Its own scenes: the rods of an ankle, and the gears of a gripper."""
    scenes = {name: {"until": 0.05} for name in ("ankle", "gripper")}
    for judgement, cases in judged(scenes, 1.0):
        assert {case.tool for case in cases} == {"MuJoCo", "pinconsist"}
        assert all(case.right_force <= 0.01 for case in cases) and set(judgement.not_judged) == {"pinocchio"}


def test_own_and_scene_need_no_other_package():
    """What is judged of this package is its public run."""
    mech = pc.load("four_bar")
    rows, measure = own_rows(mech, (0.0, 0.5))
    task = Task(mech, measure.reference.sol.q[0], measure.reference.sol.v[0], rows.t, ())
    ours = Own(task).run(Own(task).setting(1e-8))
    assert errors_of(ours, measure)["force"] < 1e-6
    assert "connect" in scene_of(mech, ()).text(1e-3, "RK4", (0.02, 1.0), (0.9, 0.95, 0.001, 0.5, 2.0))
    assert Pinocchio(task).ladders()
