"""One four-bar written in every way that can be read: one trajectory."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

MODELS = Path(__file__).resolve().parents[1] / "models"
FOUR_BAR = (MODELS / "four_bar.urdf").read_text(encoding="utf-8")
GUESS = np.array([-1.0, 0.6742791460587038, -1.4133851241635729])  # crank, coupler, rocker: closed
LENGTHS = {"crank": 1.0, "coupler": 2.0, "rocker": 1.5}
ABOUT_Y = (GUESS[0], GUESS[0] + GUESS[1], GUESS[2])  # angle of each bar in the world


def loop_file(tmp_path):
    (tmp_path / "four_bar.urdf").write_text(FOUR_BAR)
    (tmp_path / "four_bar.yaml").write_bytes((MODELS / "four_bar.yaml").read_bytes())
    return pc.load(tmp_path / "four_bar.urdf")


def closing_frames(tmp_path):
    path = tmp_path / "four_bar.urdf"
    path.write_text(FOUR_BAR.replace('"coupler_tip"', '"closing_tip_1"').replace('"rocker_tip"', '"closing_tip_2"'))
    return pc.load(path)


def loop_joint(tmp_path):
    path = tmp_path / "four_bar.urdf"
    closure = """<loop_joint name="coupler_rocker" type="revolute">
      <link1 link="coupler_bar" xyz="2 0 0"/><link2 link="rocker_bar" xyz="1.5 0 0"/><axis xyz="0 1 0"/>
    </loop_joint></robot>"""
    path.write_text(FOUR_BAR.replace("</robot>", closure))
    return pc.load(path)


def bars():
    """(name, mass, length, x and z of its near end, angle about y), closed."""
    x = z = 0.0
    for name, angle in zip(LENGTHS, ABOUT_Y, strict=True):
        length = LENGTHS[name]
        if name == "rocker":
            x, z = 2.2, 0.0
        yield name, length, float(x), float(z), float(angle)
        x, z = x + length * np.cos(angle), z - length * np.sin(angle)


def inertia(mass, length):
    """(along, across) of the bars, as models/four_bar.urdf has them."""
    return mass * 0.04**2 / 2, mass * length**2 / 12


def sdf(tmp_path):
    """Links where they stand in the closed configuration, from which SDF counts angles; the last joint closes."""
    links = ""
    for name, length, x, z, angle in bars():
        along, across = inertia(length, length)
        links += f"""<link name="{name}_bar"><pose>{x!r} 0 {z!r} 0 {angle!r} 0</pose>
          <inertial><pose>{length / 2} 0 0 0 0 0</pose><mass>{length}</mass><inertia>
          <ixx>{along!r}</ixx><iyy>{across!r}</iyy><izz>{across!r}</izz><ixy>0</ixy><ixz>0</ixz><iyz>0</iyz>
          </inertia></inertial></link>"""
    joints = ""
    for name, parent, child in (
        ("crank", "world", "crank_bar"),
        ("coupler", "crank_bar", "coupler_bar"),
        ("rocker", "world", "rocker_bar"),
        ("tip", "coupler_bar", "rocker_bar"),
    ):
        place = "<pose>1.5 0 0 0 0 0</pose>" if name == "tip" else ""
        joints += f"""<joint name="{name}" type="revolute">{place}<parent>{parent}</parent><child>{child}</child>
          <axis><xyz>0 1 0</xyz></axis></joint>"""
    path = tmp_path / "four_bar.sdf"
    path.write_text(f'<sdf version="1.7"><model name="four_bar">{links}{joints}</model></sdf>')
    return pc.load(path)


def mjcf(tmp_path):
    """Bodies where they stand in the closed configuration, whose angles `ref` gives; the anchor is in the coupler."""
    text = {}
    for (name, length, x, z, _), own in zip(bars(), GUESS.tolist(), strict=True):
        along, across = inertia(length, length)
        x, z = (1.0, 0.0) if name == "coupler" else (x, z)
        text[name] = f"""<body name="{name}_bar" pos="{x!r} 0 {z!r}" euler="0 {own!r} 0">
          <joint name="{name}" type="hinge" axis="0 1 0" ref="{own!r}"/>
          <inertial pos="{length / 2} 0 0" mass="{length}" diaginertia="{along!r} {across!r} {across!r}"/>"""
    path = tmp_path / "four_bar.xml"
    path.write_text(
        f"""<mujoco model="four_bar"><compiler angle="radian"/><option gravity="0 0 -9.81"/><worldbody>
        {text["crank"]}{text["coupler"]}</body></body>{text["rocker"]}</body></worldbody>
        <equality><connect name="tip" body1="coupler_bar" body2="rocker_bar" anchor="2 0 0"/></equality></mujoco>"""
    )
    return pc.load(path)


def pinocchio_model(tmp_path):
    """Built in code, closed by Pinocchio's own constraint."""
    model, last = pin.Model(), {"crank": 0, "rocker": 0}
    for name, length in LENGTHS.items():
        along, across = inertia(length, length)
        start = {"crank": 0.0, "coupler": 1.0, "rocker": 2.2}[name]
        place = pin.SE3(np.eye(3), np.array([start, 0, 0]))
        joint = model.addJoint(last.get(name, last["crank"]), pin.JointModelRY(), place, name)
        last["crank"] = joint if name == "crank" else last["crank"]
        model.inertias[joint] = pin.Inertia(length, np.array([length / 2, 0, 0]), np.diag([along, across, across]))
    ends = [
        part for joint, length in ((2, 2.0), (3, 1.5)) for part in (joint, pin.SE3(np.eye(3), np.array([length, 0, 0])))
    ]
    return pc.load(model, loops=[pin.PointAnchorConstraintModel(model, *ends)])


def trajectory(mech, offset=0.0):
    """Angles and rates of crank, coupler and rocker over 1 s, from rest in the closed configuration."""
    order = [mech.joints.index(name) for name in LENGTHS]
    start = np.empty(3)
    start[order] = GUESS - offset
    sol = pc.simulate(mech, (0.0, 1.0), start, step=1e-3, order=3)
    assert sol.success
    return sol.q[:, order] + offset, sol.v[:, order]


WAYS = (loop_file, closing_frames, loop_joint, sdf, mjcf, pinocchio_model)


@pytest.fixture(scope="module")
def reference():
    return trajectory(pc.load("four_bar"))


@pytest.mark.parametrize("written_back", [False, True])
@pytest.mark.parametrize("way", WAYS, ids=[way.__name__ for way in WAYS])
def test_one_trajectory(tmp_path, reference, way, written_back):
    q, v = reference
    assert np.abs(v).max() > 3.0
    mech = way(tmp_path)
    if written_back:
        mech = pc.load(pc.write(mech, tmp_path / "written.urdf"))
    offset = GUESS if way is sdf else 0.0
    for mine, theirs in zip(trajectory(mech, offset), (q, v), strict=True):
        np.testing.assert_allclose(mine, theirs, atol=1e-9)
