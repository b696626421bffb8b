"""The comparison of motions with MuJoCo's, on the files of its wheel and on small ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks import mujoco_motion

pytest.importorskip("mujoco")

LINKS = """<mujoco><option gravity="0 0 -9.81"/><worldbody>
<body name="a" euler="0 30 0"><joint name="a" axis="0 1 0" damping="0.1"/><geom size="0.1" pos="0 0 -1"/>
  <body name="b" pos="0 0 -1"><joint name="b" type="ball"/><geom type="capsule" size="0.05" fromto="0 0 0 1 0.2 0"/>
  </body></body><body name="c" pos="2 0 0"><freejoint/><geom type="box" size="0.1 0.2 0.3"/></body></worldbody>
<equality>{}</equality></mujoco>"""


def compared(file):
    [row] = [row for row in mujoco_motion.compare([file.parent], 0.1) if row.file == file.name]
    return row


def test_the_files_of_the_wheel():
    rows = {Path(row.file).name: row for row in mujoco_motion.compare(["mujoco"], 0.1)}
    assert "nothing can move" in rows.pop("msh.xml").reason
    for row in rows.values():
        assert not row.reason
        assert row.free < 1e-6 and row.speed > 0.5
        assert row.difference < 3.0 * row.gives_way
        assert row.stiffer_gives_way < 0.1 * row.gives_way
        assert row.stiffer_difference < 0.1 * row.difference


@pytest.mark.parametrize("equality", ["", '<connect body1="b" anchor="1 0.2 0"/>', '<weld body1="b" body2="c"/>'])
def test_trees_and_loops(tmp_path, equality):
    (tmp_path / "m.xml").write_text(LINKS.format(equality))
    row = compared(tmp_path / "m.xml")
    assert row.free < 1e-8 and row.nv == 10
    if equality:
        assert 1e-6 < row.gives_way and row.difference < 10 * row.gives_way
        assert row.stiffer_difference < 0.1 * row.difference


def test_another_machine_is_seen(tmp_path, monkeypatch):
    (tmp_path / "m.xml").write_text(LINKS.format(""))
    load = mujoco_motion.pc.load

    def with_a_rotor(*given, **more):
        return load(*given, **more).with_armature({"a": 1e-3})

    monkeypatch.setattr(mujoco_motion.pc, "load", with_a_rotor)
    assert compared(tmp_path / "m.xml").free > 1e-6
