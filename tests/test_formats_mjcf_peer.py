"""MJCF files as we read them against MuJoCo's own compiler: kinematics, masses, forces, equalities at random states."""

import numpy as np
import pytest
from helpers.mjcf_zoo import JOINTS, ROD, ZOO, body, world

import pinconsist as pc

pytest.importorskip("mujoco", reason="MuJoCo is not installed: pip install mujoco")

from helpers.mujoco_peer import Peer, differences


@pytest.fixture(autouse=True)
def elsewhere(tmp_path, monkeypatch):
    """MuJoCo writes its warnings to a file in the current folder."""
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("text", ZOO.values(), ids=ZOO)
def test_like_mujoco(tmp_path, text):
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{text}</mujoco>")
    found = differences(pc.load(path), path, np.random.default_rng(0))
    assert max(found.values()) < 1e-12, found


def test_the_keyframe_is_mujocos(tmp_path):
    path = tmp_path / "scene.xml"
    bodies = [body(joint + ROD) for joint in (JOINTS["slides and ball"], "<freejoint/>", JOINTS["hinge"])]
    numbers = np.random.default_rng(1).normal(size=6 + 7 + 1)
    key = f'<keyframe><key qpos="{" ".join(map(str, numbers))}"/></keyframe>'
    path.write_text(f"<mujoco>{world(*bodies, rest=key)}</mujoco>")
    mech, peer = pc.load(path), Peer(path)
    np.testing.assert_allclose(peer.qpos(mech.guess), peer.model.key_qpos[0], atol=1e-15)


CORNER = "v 0 0 0\nv 1 0 0\nv 0 2 0\nv 0 0 3\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESHES = {
    "mass": '<geom type="mesh" mesh="corner" euler="10 20 30" pos="1 2 3"/>',
    "fitted": '<geom type="box" mesh="corner" pos="1 0 0"/>',
    "shown too": ROD + '<geom type="mesh" mesh="corner" density="30"/><geom type="mesh" mesh="corner" mass="0"/>',
}


@pytest.mark.parametrize("settings", ["", "<compiler settotalmass='7'/>"], ids=["density", "total mass"])
@pytest.mark.parametrize("geoms", MESHES.values(), ids=MESHES)
def test_masses_of_meshes_are_mujocos(tmp_path, geoms, settings):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "corner.obj").write_text(CORNER)
    asset = '<asset><mesh file="corner.obj" scale="0.1 0.2 0.3" refpos="0.1 0 0" refquat="1 1 0 0"/></asset>'
    scene = world(body(JOINTS["hinge"] + geoms + body("<joint/>" + ROD)))
    path = tmp_path / "scene.xml"
    path.write_text(f'<mujoco>{settings}<compiler meshdir="parts"/>{asset}{scene}</mujoco>')
    found = differences(pc.load(path), path, np.random.default_rng(0))
    assert max(found.values()) < 1e-12, found


def test_attached_models_are_mujocos(tmp_path):
    (tmp_path / "arm" / "parts").mkdir(parents=True)
    (tmp_path / "arm" / "parts" / "corner.obj").write_text(CORNER)
    (tmp_path / "arm" / "more.xml").write_text("<x><compiler angle='radian' meshdir='parts'/></x>")
    arm = body('<joint name="a"/><geom type="mesh" mesh="corner"/>', 'name="upper" euler="0.1 0.2 0.3"')
    (tmp_path / "arm" / "arm.xml").write_text(
        f'<mujoco model="arm"><include file="more.xml"/><asset><mesh file="corner.obj"/></asset>{world(arm)}</mujoco>'
    )
    asset = '<asset><model name="arm" file="arm/arm.xml"/></asset>'
    copies = "".join(f'<frame pos="{i} 0 0"><attach model="arm" body="upper" prefix="{i}_"/></frame>' for i in (1, 2))
    path = tmp_path / "scene.xml"
    path.write_text(f"<mujoco>{asset}{world(body('<joint/>' + ROD), copies)}</mujoco>")
    mech = pc.load(path)
    assert mech.joints == ("body1_hinge", "1_a", "2_a")
    (tmp_path / "arm" / "more.xml").write_text("<x><compiler angle='radian' meshdir='parts'/></x>")
    flat = path.read_text().replace("arm/arm.xml", "flat.xml")  # an include of an attached model, put in its place
    text = (tmp_path / "arm" / "arm.xml").read_text()
    text = text.replace('<include file="more.xml"/>', '<compiler angle="radian" meshdir="arm/parts"/>')
    (tmp_path / "flat.xml").write_text(text)
    (tmp_path / "peer.xml").write_text(flat)
    found = differences(mech, tmp_path / "peer.xml", np.random.default_rng(0))
    assert max(found.values()) < 1e-12, found
