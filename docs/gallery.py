"""The gallery of the site: the commands of its page are run, and each run is drawn, without a browser."""

import re
import shlex
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np

import pinconsist as pc
from pinconsist.cli import main
from pinconsist.view.picture import picture
from pinconsist.view.solids import Stage

SIZE, SHARE = np.array([360, 250]), 0.92  # of a drawing, and of the motion in it
FRAMES = 100
MOMENTS = {44: 0.14, 47: 0.22, 50: 1.0}  # frames that are drawn, and how clearly
EDGE = 0.6  # of a colour, round what is drawn flat


def run(arguments) -> str:
    """What a command of pinconsist prints; an error if it fails."""
    with redirect_stdout(StringIO()) as printed, redirect_stderr(printed):
        try:
            main([str(each) for each in arguments])
        except SystemExit as end:
            if end.code:
                raise RuntimeError(f"pinconsist {arguments}\n{printed.getvalue()}") from None
    return printed.getvalue()


def live(text: str, outdir: Path) -> str:
    """The gallery: every command is run; its page stands behind a drawing of the run."""
    (folder := outdir / "live").mkdir(parents=True, exist_ok=True)
    for command, scene in re.findall(r"^pinconsist (simulate (\w+) .*)--html .*$", text, flags=re.MULTILINE):
        arguments, saved = shlex.split(command), folder / f"{scene}.npz"
        run([*arguments, "--html", folder / f"{scene}.html", "--out", saved])
        drawing = thumbnail(pc.load(scene), pc.Solution.load(saved), re.findall(r"--trace (\w+)", command))
        (folder / f"{scene}.svg").write_text(drawing, encoding="utf-8")
        saved.unlink()
        shown = f'<a class="live" href="live/{scene}.html"><img src="live/{scene}.svg" alt="{scene}: play it"/></a>'
        text = text.replace(f"```bash\npinconsist {command}", f"{shown}\n\n```bash\npinconsist {command}")
    return text


def thumbnail(mech, sol, traces=()) -> str:
    """A run in its middle, painted as its films are, with earlier positions and paths of frames: a small SVG."""
    rate = FRAMES / abs(sol.t[-1] - sol.t[0])
    stage = Stage(picture(mech, sol, speed=1.0, fps=rate, traces=traces, forces=False, beside=False))
    place = SHARE * float(np.min(SIZE / stage.extent)), SIZE / 2
    paths = [(points, color) for points, color, joined in stage.lines if joined > 1]  # else the grid of the floor
    parts = [f'<path d="M{_way(stage.pixels(points, *place))}" stroke="{_hex(color)}"/>' for points, color in paths]
    for frame, opacity in MOMENTS.items():
        flat, parts = stage.planar or opacity < 1.0, [*parts, f'<g opacity="{opacity}">']
        for patch in stage.patches(frame, *place, outlines=flat):
            if opacity == 1.0 or "/bodies/" in patch.solid.path:
                look = f'fill="{_hex(patch.color)}" stroke="{_hex((EDGE if flat else 1.0) * patch.color)}"'
                parts.append(f'<path d="M{_way(patch.points)}Z" {look} opacity="{patch.opacity:g}"/>')
        parts.append("</g>")
    size = " ".join(map(str, SIZE))
    look = 'fill="none" stroke-width="0.6" stroke-linejoin="round"'
    return f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {size}" {look}>{"".join(parts)}</svg>'


def _way(points) -> str:
    return "L".join(f"{x:.1f} {y:.1f}" for x, y in points)


def _hex(color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*np.asarray(color).astype(int))
