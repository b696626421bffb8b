"""The gallery of the site: the commands of its page are run, and each run is drawn, without a browser."""

import re
import shlex
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinconsist as pc
from pinconsist.cli import main
from pinconsist.view.commands import view_axes
from pinconsist.view.motion import body_poses, on_joint, point_in_world
from pinconsist.view.shapes import SPRING, bars, simple_shapes, skeleton, springs

WIDTH, HEIGHT, MARGIN = 360, 250, 14
MOMENTS = {0.44: 0.14, 0.47: 0.22, 0.5: 1.0}  # share of the run that has passed, and how clearly it is drawn
PATH = 0x00838F


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
    """A run in its middle, in the simple shapes of pages, with earlier positions and paths of frames: a small SVG."""
    poses = body_poses(mech.model, sol.q)
    bones = skeleton(mech, poses)
    axes, size = view_axes([bones])[0], float(np.linalg.norm(np.ptp(bones.reshape(-1, 3), axis=0)))
    traced = [on_joint(mech.model, name) for name in traces]
    paths = [point_in_world(poses, joint, place.translation) for joint, place in traced]
    coils = [ends for *_, ends in springs(mech, poses, size)]
    seen = np.concatenate([each.reshape(-1, 3) for each in (bones, *paths, *coils)]) @ axes.T
    middle, half = (seen.max(0) + seen.min(0)) / 2, np.ptp(seen, axis=0) / 2 + 0.03 * size
    scale = min((WIDTH / 2 - MARGIN) / half[0], (HEIGHT / 2 - MARGIN) / half[1])

    def stroke(points, width, color, opacity=1.0, cap="round", dashes=""):  # how near it is, and its element
        flat = (points @ axes.T - middle) * [scale, -scale, 1.0] + [WIDTH / 2, HEIGHT / 2, 0.0]
        way = "L".join(f"{x:.1f} {y:.1f}" for x, y, _ in flat)
        line = f'stroke="#{color:06x}" stroke-width="{max(scale * width, 0.8):.1f}" stroke-linecap="{cap}"'
        return flat[:, 2].mean(), f'<path d="M{way}" {line} opacity="{opacity}" stroke-dasharray="{dashes}"/>'

    def solid(shape, nodes):  # a rod, a block or a ball, whose way has no length
        pose, form = nodes[shape.node] * shape.placement, shape.geometry
        ends = [pose.act(np.array([0.0, y * form.get("height", 0.0) / 2, 0.0])) for y in (-1, 1)]
        width = form.get("width") or 2 * form.get("radius", form.get("radiusBottom", 0.0))
        return stroke(np.array(ends), width, shape.color, shape.opacity, "butt" if "width" in form else "round")

    drawing = [stroke(path, 0.005 * size, PATH)[1] for path in paths]
    shapes = simple_shapes(mech, poses, size)
    for share, opacity in MOMENTS.items():
        row = np.abs(sol.t - sol.t[0] - share * (sol.t[-1] - sol.t[0])).argmin()
        rods = [rod[row] for rod in bars(mech, poses).values()]
        nodes = [pin.XYZQUATToSE3(pose) for pose in (*poses[row], *rods)]
        now = opacity == 1.0
        things = [solid(shape, nodes) for shape in shapes if not shape.on_top and (now or shape.node)]
        things += [
            stroke(np.array([nodes[joint].translation, path[row]]), 0.012 * size, PATH)
            for (joint, _), path in zip(traced, paths, strict=True)
        ]
        things += [stroke(ends[row], 0.03 * size, SPRING, 1.0, "butt", "1.5 2") for ends in coils]
        loops = [solid(shape, nodes)[1] for shape in shapes if shape.on_top and now]
        drawing.append(f'<g opacity="{opacity}">{"".join([element for _, element in sorted(things)] + loops)}</g>')
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" fill="none">{"".join(drawing)}</svg>'
    )
