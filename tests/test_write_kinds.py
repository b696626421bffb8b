"""Mechanisms written as SDF, MJCF and USD: the same motion, files that other programs read, refusals by name."""

from __future__ import annotations

from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.formats import saying
from pinconsist.mechanism.joint_constraints import Coupling

SUFFIXES = (".sdf", ".xml", ".usda")
BOX = pin.Inertia(1.3, np.array([0.1, -0.02, 0.03]), np.diag([0.011, 0.013, 0.017]) + 0.001)


def model(*joints):
    """Bodies in a row: (name, joint model, parent or None for the one before)."""
    made = pin.Model()
    made.name = "row"
    turned = pin.SE3(pin.exp3(np.array([0.3, -0.5, 0.2])), np.array([0.3, 0.05, -0.1]))
    for name, kind, parent in joints:
        at = made.njoints - 1 if parent is None else parent
        joint = made.addJoint(at, kind, turned if at else pin.SE3.Identity(), name)
        made.appendBodyToJoint(joint, BOX, pin.SE3.Identity())
    return made


def hinge(x=0.0, y=1.0, z=0.0):
    return pin.JointModelRevoluteUnaligned(*(np.array([x, y, z]) / np.linalg.norm([x, y, z])).tolist())


def looped(kind, **more):
    """Seven joints and a loop at a closed configuration; its axis lies anywhere in both frames."""
    kinds = [hinge(0.2, 1.0, 0.1), hinge(1.0, 0.3, 0.0), hinge(0.0, 0.2, 1.0)] * 2
    made = model(*[(f"j{i}", each, None) for i, each in enumerate(kinds)])
    q = np.array([0.3, -0.4, 0.5, 0.2, -0.3, 0.1])
    data = made.createData()
    pin.forwardKinematics(made, data, q)
    end = pin.SE3(np.eye(3), np.array([0.2, 0.0, 0.1]))
    there = data.oMi[6] * end
    made.addFrame(pin.Frame("tip", 6, 0, end, pin.FrameType.OP_FRAME))
    made.addFrame(pin.Frame("post", 0, 0, there, pin.FrameType.OP_FRAME))
    if kind == "distance":
        more = {"length": 0.3, "xyz2": (0.0, 0.3, 0.0)}
    return pc.Mechanism(made, [pc.Loop("closing", kind, "tip", "post", **more)], guess=q)


LOOPS = {
    "point": {}, "frame": {}, "hinge": {"axis": (0.3, -1.0, 0.2)}, "slider": {"axis": (0.3, 0.1, 2.0)},
    "cylinder": {"axis": (0.3, 0.1, 2.0)}, "plane": {"axis": (0.1, 0.1, 1.0)},
    "universal": {"axis": (1.0, 0.0, 0.0), "axis2": (0.0, 0.6, 0.8)}, "distance": {},
}  # fmt: skip
UNSAID = {
    ".sdf": {"cylinder", "plane"},
    ".xml": {"slider", "cylinder", "plane", "universal"},
    ".usda": set(),
}


def same(tmp_path, mech, suffix, tolerance=1e-12):
    """Write, read again, and compare accelerations; the mechanism that was read."""
    path = pc.write(mech, tmp_path / f"machine{suffix}")
    floats = suffix == ".sdf" and "root_joint" in mech.joints
    back = pc.load(path, free_flyer=floats)
    if suffix == ".sdf":
        from pinconsist.formats.write_sdf import require_same

        require_same(mech, back)
    else:
        saying.require_same_motion(mech, back, tolerance=tolerance)
    return back


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize(
    "name", ["four_bar", "crank_rocker", "slider_crank", "five_bar", "bricard", "double_pendulum", "chain_5"]
)
def test_built_in_models(tmp_path, name, suffix):
    back = same(tmp_path, pc.load(name), suffix)
    assert back.name == "machine"


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", LOOPS)
def test_every_kind_of_loop(tmp_path, kind, suffix):
    mech = looped(kind, **LOOPS[kind])
    if kind not in UNSAID[suffix]:
        assert same(tmp_path, mech, suffix).nv == mech.nv
        return
    with pytest.raises(pc.InputError, match=rf"'closing', of kind .{kind}"):
        pc.write(mech, tmp_path / f"machine{suffix}")
    assert not list(tmp_path.iterdir())


JOINTS = {
    "hinge": [("a", hinge(0.1, 1, 0.3), None)],
    "slider": [("a", pin.JointModelPrismaticUnaligned(0.6, 0.0, 0.8), None)],
    "ball": [("a", hinge(), None), ("b", pin.JointModelSpherical(), None)],
    "screw": [("a", pin.JointModelHelicalUnaligned(np.array([0.6, 0.0, 0.8]), 0.02), None)],
    "floating": [("float", pin.JointModelFreeFlyer(), None), ("a", hinge(), None)],
    "planar": [("a", pin.JointModelPlanar(), None)],
}


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("kind", JOINTS)
def test_every_kind_of_joint(tmp_path, kind, suffix):
    mech = pc.Mechanism(model(*JOINTS[kind]))
    if kind == "planar" or (kind == "screw" and suffix != ".sdf"):
        with pytest.raises(pc.InputError, match=r"no joint like 'a', which is (planar|helical)"):
            pc.write(mech, tmp_path / f"machine{suffix}")
        return
    path = pc.write(mech, tmp_path / f"machine{suffix}")
    back = pc.load(path, free_flyer=suffix == ".sdf" and kind == "floating")
    assert back.nv == mech.nv


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_numbers_of_joints(tmp_path, suffix):
    made = model(("a", hinge(0.1, 1, 0.3), None), ("b", pin.JointModelPX(), None))
    made.armature[:] = (0.013, 0.17)
    made.damping[:] = (0.3, 0.7)
    made.friction[:] = (0.11, 0.0)
    made.lowerPositionLimit[:], made.upperPositionLimit[:] = (-1.1, -0.3), (0.7, 0.9)
    spring = pc.JointSpring("b", 13.7, 0.123)
    mech = pc.Mechanism(made, forces=[spring]).with_gravity((0.3, -0.2, -3.7))
    back = same(tmp_path, mech, suffix)
    np.testing.assert_allclose(back.model.lowerPositionLimit, made.lowerPositionLimit, rtol=1e-14)
    np.testing.assert_allclose(back.model.upperPositionLimit, made.upperPositionLimit, rtol=1e-14)
    np.testing.assert_allclose(back.model.gravity.linear, mech.model.gravity.linear, atol=1e-15)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_couplings(tmp_path, suffix):
    made = model(("a", hinge(), None), ("b", hinge(1, 0, 0), None))
    mech = pc.Mechanism(made, [Coupling("gear", "b", "a", ratio=-0.7, offset=0.2)], guess=[0.5, 0.2 - 0.35])
    back = same(tmp_path, mech, suffix)
    assert [loop.kind for loop in back.loops] == [mech.loops[0].kind]
    bent = pc.Mechanism(made, [Coupling("cam", "b", "a", ratio=0.5, higher=(0.3,))])
    if suffix == ".xml":
        same(tmp_path, bent, suffix)
    else:
        with pytest.raises(pc.InputError, match="coupling 'cam'"):
            pc.write(bent, tmp_path / f"bent{suffix}")


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_what_cannot_be_said_is_refused_and_nothing_is_written(tmp_path, suffix):
    made = model(("a", hinge(), None))
    refused = {
        "drive such as 'turn'": pc.Mechanism(made, [pc.Drive("turn", "a", lambda t: t)]),
        "'torque a'": pc.Mechanism(made, forces=[pc.JointTorque({"a": np.sin})]),
    }
    for message, mech in refused.items():
        with pytest.raises(pc.InputError, match=message):
            pc.write(mech, tmp_path / f"machine{suffix}")
    assert not list(tmp_path.iterdir())


def test_a_joint_that_moves_differently_is_not_written(tmp_path, monkeypatch):
    from pinconsist.formats import write_mjcf

    monkeypatch.setitem(write_mjcf._JOINTS, "revolute", "slide")
    with pytest.raises(pc.InputError, match="moves differently"):
        pc.write(pc.load("four_bar"), tmp_path / "machine.xml")
    assert not list(tmp_path.iterdir())


def test_springs_between_points(tmp_path):
    mech = pc.load("andrews")
    same(tmp_path, mech, ".xml")
    bare = mech.with_forces(*[force for force in mech.forces if isinstance(force, pc.SpringDamper)])
    same(tmp_path, bare, ".sdf")
    with pytest.raises(pc.InputError, match="USD has no force like 'spring D-stage'"):
        pc.write(bare, tmp_path / "refused.usda")


def test_bodies_without_mass(tmp_path):
    mech = pc.load("delta_robot").with_forces()
    for suffix in SUFFIXES:
        same(tmp_path, mech, suffix, tolerance=1e-6)


def test_mujoco_reads_what_was_written(tmp_path):
    """Its accelerations are those of the tree; its loops hold the tips together."""
    mujoco = pytest.importorskip("mujoco")
    mech = pc.load("four_bar")
    theirs = mujoco.MjModel.from_xml_path(str(pc.write(mech, tmp_path / "four_bar.xml")))
    state = mujoco.MjData(theirs)
    mujoco.mj_resetDataKeyframe(theirs, state, 0)
    mujoco.mj_forward(theirs, state)
    np.testing.assert_allclose(state.qpos, mech.guess, atol=1e-15)
    own = pin.nle(mech.model, mech.model.createData(), mech.guess, np.zeros(mech.nv))
    np.testing.assert_allclose(state.qfrc_bias, own, atol=1e-12)
    for _ in range(200):
        mujoco.mj_step(theirs, state)
    gaps = state.efc_pos[: state.ne]
    assert state.ne == 6
    assert np.abs(gaps).max() < 2e-2


def test_usd_core_reads_what_was_written(tmp_path):
    pxr = pytest.importorskip("pxr.Usd")
    from pxr import UsdPhysics

    path = pc.write(pc.load("four_bar"), tmp_path / "four_bar.usda")
    stage = pxr.Stage.Open(str(path))
    bodies = [each for each in stage.Traverse() if each.HasAPI(UsdPhysics.RigidBodyAPI)]
    joints = [each for each in stage.Traverse() if each.IsA(UsdPhysics.Joint)]
    assert (len(bodies), len(joints)) == (3, 4)
    assert {each.GetName() for each in joints} == {"crank", "coupler", "rocker", "coupler_rocker"}


def test_convert(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run = partial(called, capsys)
    assert run("convert", "four_bar", "four_bar.sdf")[:2] == (0, "wrote four_bar.sdf\n")
    assert run("convert", "four_bar.sdf", "again.urdf")[:2] == (0, "wrote again.urdf and again.yaml\n")
    assert run("convert", "again.urdf", "four_bar.xml", "--json")[:2] == (0, '{"written": ["four_bar.xml"]}\n')
    code, _, err = run("convert", "jansen_leg", "leg.xml")
    assert code == 2
    assert "no drive such as 'motor'; --without NAME leaves it out" in " ".join(err.split())
    assert run("convert", "jansen_leg", "leg.xml", "--without", "motor")[0] == 0
    code, _, err = run("convert", "delta_robot", "delta.sdf", "--without", "servo leg1_arm", "--without", "nothing")
    assert code == 2
    assert "no loop, drive, coupling or force 'nothing'" in err
    code, _, err = run("convert", "four_bar", "four_bar.pdf")
    assert code == 2
    assert ".urdf, .sdf" in err
    assert not (tmp_path / "four_bar.pdf").exists()
