"""The gallery: what loads, closes and runs, by file."""

from __future__ import annotations

import pytest
import yaml

import pinconsist as pc
from benchmarks import gallery


def test_a_folder_of_files_good_and_bad(tmp_path):
    pc.write(pc.load("five_bar"), tmp_path / "five.urdf")
    pc.write(pc.load("four_bar"), tmp_path / "four.sdf")
    (tmp_path / "bad.urdf").write_text("<robot")
    (tmp_path / "open.urdf").write_text((tmp_path / "five.urdf").read_text())
    loops = yaml.safe_load((tmp_path / "five.yaml").read_text())
    loops["loops"][0]["xyz1"] = [9.0, 0.0, 0.0]
    (tmp_path / "open.yaml").write_text(yaml.safe_dump(loops))
    rows = {row.file: row for row in gallery.gallery([str(tmp_path)], until=0.05)}
    assert set(rows) == {"bad.urdf", "five.urdf", "four.sdf", "open.urdf"}
    five, bad, apart = rows["five.urdf"], rows["bad.urdf"], rows["open.urdf"]
    assert (five.bodies, five.loops, five.rows, five.rank, five.mobility) == (4, 1, 5, 2, 2)
    assert (five.motors, five.moving) == (2, 2) and five.closed_to < 1e-10 and five.wall > 0.0
    assert bad.verdict.startswith("FormatError") and bad.bodies == 0
    assert apart.verdict.startswith("AssemblyError") and apart.bodies == 4 and apart.wall != apart.wall
    by_kind = {each["kind"]: each for each in gallery.counts([row.__dict__ for row in rows.values()])}
    assert (by_kind["urdf"]["files"], by_kind["urdf"]["load"], by_kind["urdf"]["close"]) == (3, 2, 1)
    assert by_kind["sdf"]["run"] == 1


def test_an_empty_folder_is_told(tmp_path):
    with pytest.raises(pc.InputError, match="no file of a kind that can be read"):
        list(gallery.gallery([str(tmp_path)]))
