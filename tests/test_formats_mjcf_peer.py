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
