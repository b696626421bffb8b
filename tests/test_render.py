"""Films and drawings: what is painted is where the mechanism is, and files that other programs read."""

from __future__ import annotations

import dataclasses
import re
import sys
from functools import partial
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers.command_line import called

import pinconsist as pc
from pinconsist.view.commands import draw, y_up
from pinconsist.view.render import render
from pinconsist.view.shapes import ball as ball_shape
from pinconsist.view.shapes import cylinder
from pinconsist.view.solids import Stage, _hull

SVG = "{http://www.w3.org/2000/svg}"


@pytest.fixture(scope="module")
def mech():
    """Drawn by simple shapes: a ball at each joint."""
    return dataclasses.replace(pc.load("crank_rocker"), geometry=None)


@pytest.fixture(scope="module")
def sol(mech):
    return pc.simulate(mech, (0.0, 0.4), v0={"crank": 12.0})


def groups(file):
    """The positions of a drawing, and its lines below them."""
    root = ElementTree.parse(file).getroot()
    return root.findall(f"{SVG}g"), [text.text for text in root.findall(f"{SVG}text")]


def ball(group, name):
    """Centre of the largest circle of a body, pixels."""
    found = [each for each in group.iter(f"{SVG}circle") if each.findtext(f"{SVG}title") == name]
    largest = max(found, key=lambda each: float(each.get("r")))
    return np.array([float(largest.get(key)) for key in ("cx", "cy")])


def test_a_drawing_shows_the_mechanism_at_the_chosen_times(sol, mech, tmp_path):
    times = [0.0, 0.1, 0.123]
    shown, below = groups(sol.render(tmp_path / "run.svg", at=times, forces=True))
    assert [group.get("id") for group in shown] == [f"t={t:g}" for t in times]
    assert len(below) == 1 and re.fullmatch(r"\S+ N\s+force on the rocker_bar", below[0])
    at = pc.simulate(mech, (0.0, 0.4), v0={"crank": 12.0}, t_eval=times)
    pins = {name: at.frame(name).position[:, [0, 2]] for name in mech.joints}
    for k, group in enumerate(shown):  # one scale, and up is up
        crank = ball(group, "coupler_bar") - ball(group, "crank_bar")
        scale = np.linalg.norm(crank) / 0.25
        for name in ("coupler", "rocker"):
            away = pins[name][k] - pins["crank"][k]
            np.testing.assert_allclose(
                ball(group, f"{name}_bar") - ball(group, "crank_bar"), scale * away * (1, -1), atol=0.3
            )


def test_positions_stand_apart(sol, tmp_path):
    shown, _ = groups(sol.render(tmp_path / "run.svg", at=[0.0, 0.1, 0.2, 0.3, 0.4]))
    corners = [ball(group, "crank_bar") for group in shown]
    assert np.diff([x for x, _ in corners[:4]]) == pytest.approx(400.0, abs=0.1)
    assert corners[4][0] == pytest.approx(corners[0][0], abs=0.1) and corners[4][1] > corners[0][1] + 100


def test_arrows_that_are_cut_are_said_to_be_without_their_sizes(tmp_path):
    sol = pc.simulate(pc.load("jansen_leg"), (0.0, 1.0))
    _, below = groups(sol.render(tmp_path / "run.svg", forces=True))
    assert any(re.search(r"; cut at \S+ N$", text) for text in below)


def test_a_saved_run_and_one_backwards_are_drawn(sol, mech, tmp_path):
    back = pc.simulate(mech, (0.4, 0.0), q0=sol.q[-1], v0=sol.v[-1])
    kept = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    ways = [groups(each.render(tmp_path / f"{k}.svg", mech, at=[0.2]))[0][0] for k, each in enumerate((kept, back))]
    one, other = (ball(group, "rocker_bar") - ball(group, "crank_bar") for group in ways)
    np.testing.assert_allclose(one, other, atol=0.5)
    with pytest.raises(pc.InputError, match="needs its mechanism"):
        kept.render(tmp_path / "no.svg")


def test_what_is_in_front_is_painted_last():
    """A ball behind and one in front of a bar, seen from either side."""
    shapes = [ball_shape(0, (0, depth, 0), 0.1, color=color) for depth, color in ((-1, 0xFF), (1, 0xFF00))]
    shapes.insert(0, cylinder(0, (-5, 0, 0), (5, 0, 0), 0.3, color=0xFF0000))
    commands = [draw(f"/ground/{k}", shape, part="ground", name=str(k)) for k, shape in enumerate(shapes)]
    for back, order in (((0, -1, 0), "201"), ((0, 1, 0), "102")):
        axes = [np.cross((0, 0, 1), back), (0, 0, 1), back]
        view = {"axes": [y_up(axis) for axis in axes], "planar": False, "points": [[-5, 0, 0], [5, 1, 1]]}
        patches = Stage({"view": view, "commands": commands}).patches(0, 100.0, (0.0, 0.0))
        assert list(dict.fromkeys(patch.solid.name for patch in patches)) == list(order)


def test_the_outline_of_points_is_convex():
    points = np.random.default_rng(3).normal(size=(200, 2))
    corners = _hull(points)
    edges = np.roll(corners, -1, axis=0) - corners
    turns = edges[:, 0] * np.roll(edges, -1, axis=0)[:, 1] - edges[:, 1] * np.roll(edges, -1, axis=0)[:, 0]
    assert (turns > 0).all()
    inside = [(edges[:, 0] * (p - corners)[:, 1] - edges[:, 1] * (p - corners)[:, 0]).min() for p in points]
    assert min(inside) > -1e-9


def test_a_gif_plays_the_motion(sol, tmp_path):
    image = pytest.importorskip("PIL.Image")
    short = pc.simulate(pc.load("crank_rocker"), (0.0, 0.2), v0={"crank": 12.0})
    with image.open(short.render(tmp_path / "run.gif", forces=True)) as film:
        assert film.n_frames == 5 and film.info["duration"] == 50 and film.info["loop"] == 0  # 20 a second
        frames = []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(np.asarray(film.convert("RGB"), float))
    assert all(np.abs(a - b).max() > 100 for a, b in pairwise(frames))  # it moves
    colors = {tuple(color) for color in frames[0].reshape(-1, 3)[::7]}
    assert len(colors) > 10 and np.median(frames[0]) > 240  # on paper


def test_an_mp4_has_all_frames(tmp_path):
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    short = pc.simulate(pc.load("four_bar"), (0.0, 0.2))
    film = ffmpeg.read_frames(str(short.render(tmp_path / "run.mp4", speed=2.0)))
    about = next(film)
    assert about["size"] == (1280, 720) and about["fps"] == pytest.approx(30.0) and len(list(film)) == 4


@pytest.mark.parametrize(
    ("file", "options", "message"),
    [
        ("run.avi", {}, r"ends in \.mp4 or \.gif"),
        ("run.gif", {"at": [0.1]}, "selects the times of a drawing"),
        ("run.svg", {"at": [0.5]}, "at=0.5 is outside the run"),
        ("run.svg", {"traces": ["no"]}, "no frame 'no'"),
    ],
)
def test_what_cannot_be_drawn_is_refused(sol, tmp_path, file, options, message):
    with pytest.raises(pc.InputError, match=message):
        sol.render(tmp_path / file, **options)
    assert not list(tmp_path.iterdir())


def test_a_drawing_of_what_moves_in_space_is_refused(tmp_path):
    sol = pc.simulate(pc.load("bricard"), (0.0, 0.1))
    with pytest.raises(pc.InputError, match=r"moves in space.*\.mp4"):
        render(sol.system.mechanism, sol, tmp_path / "run.svg")


def test_what_is_not_installed_is_named(sol, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(pc.MissingExtraError, match=re.escape("pip install 'pinconsist[render]'")):
        sol.render(tmp_path / "run.mp4")


def test_the_command(sol, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = partial(called, capsys)
    scene = ("render", "crank_rocker", "--until", 0.1)
    code, out, _ = run(*scene, "run.svg", "--at", 0.05, 0.1)
    assert code == 0 and out.endswith("written: run.svg\n") and len(groups("run.svg")[0]) == 2
    code, _, err = run("render", "crank_rocker", "run.gif", "--at", 0.1)
    assert code == 2 and "--at selects the times of a drawing" in err
    code, _, err = run("render", "crank_rocker", "nowhere/run.svg")
    assert code == 2 and "nowhere" in err and not Path("nowhere").exists()
