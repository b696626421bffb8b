"""Films (MP4, GIF) and drawings (SVG) of a motion, painted in the process: no browser, no graphics hardware."""

import tempfile
from collections.abc import Iterator
from html import escape
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..errors import InputError, MissingExtraError
from ..files import as_path, written_whole
from ..mechanism.checks import finite_array
from .motion import playing_times, runs_of
from .picture import picture
from .solids import Stage

FILMS = {".mp4": (1280, 720, 30.0), ".gif": (720, 405, 20.0)}  # width, height, frames per second
FINER = 2  # factor of the resolution in which frames are painted before pixels are averaged
PAPER, INK = (250, 251, 252), (51, 51, 51)
PANEL, ABREAST = 400.0, 4  # width of a position in a drawing; positions in a row
EDGE = 0.6  # brightness of outlines in a drawing, relative to the colour of the shape
MOTION = (0.88, 0.76)  # share of a film's width and height


def render(mech, sol, file, *, speed=1.0, traces=(), forces=False, at=(), watch=None) -> Path:
    """Write a film or a drawing; see :meth:`pinconsist.Solution.render`.

    ``watch(k, n)`` is called when k frames of n are painted.
    """
    at = np.atleast_1d(finite_array(list(at) if hasattr(at, "__iter__") else at, "at"))
    ending = require_file(file, at)
    options = {"speed": speed, "traces": traces, "forces": forces, "beside": False}
    if ending == ".svg":
        content = _drawing(mech, sol, at if at.size else sol.t[:1], options)
    else:
        write = _mp4 if ending == ".mp4" else _gif
        width, height, rate = FILMS[ending]
        page = picture(mech, sol, fps=rate, **options)
        duration, count = page["clock"][2:]
        rate = (count - 1) / duration if count > 1 else rate  # lower for long films
        content = write(_frames(page, width, height, watch), (width, height), rate)
    with written_whole(file) as stream:
        stream.write(content)
    return Path(file)


def require_file(file, at=()) -> str:
    """The ending of `file`; InputError if it cannot be written, MissingExtraError if a package is missing."""
    ending = as_path(file).suffix.lower()
    if ending not in (*FILMS, ".svg"):
        raise InputError(f"{file}: a video ends in .mp4 or .gif, a drawing in .svg")
    if len(at) and ending != ".svg":
        raise InputError(f"at= selects the times of a drawing (.svg); {file} is a video, which shows all times")
    needed = {".mp4": {"PIL": "Pillow", "imageio_ffmpeg": "imageio-ffmpeg"}, ".gif": {"PIL": "Pillow"}, ".svg": {}}
    for module, package in needed[ending].items():
        if find_spec(module) is None:
            how = "install it with: pip install 'pinconsist[render]'"
            raise MissingExtraError(f"videos in {ending} need {package}; {how}")
    return ending


def _frames(page, width, height, watch=None) -> Iterator:
    from PIL import Image, ImageDraw, ImageFont

    stage, (start, pace, duration, count) = Stage(page), page["clock"]
    size = np.array([width, height]) * FINER
    place = float(np.min(size * MOTION / stage.extent)), size / 2
    font = ImageFont.load_default(height / 34 * FINER)
    line = 1.5 * font.size
    behind = Image.new("RGB", tuple(size.tolist()), PAPER)
    draw = ImageDraw.Draw(behind)
    for points, color, thick in stage.lines:
        for part in [points] if thick > 1 else points.reshape(-1, 2, 2):
            draw.line(stage.pixels(part, *place).ravel().tolist(), tuple(color.astype(int)), thick * FINER)
    for row, entry in enumerate(page["legend"], start=1):
        color, text, reach = entry["color"], _about(entry), line / 2
        if bar := entry.get("bar"):
            reach = place[0] * bar["metres"]
        draw.line((line / 2, row * line, line / 2 + reach, row * line), f"#{color:06x}", 3 * FINER)
        draw.text((line + reach, row * line), text, INK, font, anchor="lm")
    digits = int(np.clip(2 - np.floor(np.log10(abs(pace) * duration or 1.0)), 2, 9))  # enough to show the motion
    for frame in range(count):
        image = behind.copy()
        draw = ImageDraw.Draw(image, "RGBA")
        for patch in stage.patches(frame, *place):
            draw.polygon(patch.points.ravel().tolist(), (*patch.color.astype(int).tolist(), round(255 * patch.opacity)))
        t = start + pace * duration * frame / max(count - 1, 1)
        draw.text((line / 2, size[1] - line), f"t = {t:.{digits}f} s", INK, font, anchor="lm")
        yield image.reduce(FINER)
        if watch is not None:
            watch(frame + 1, count)


def _about(entry) -> str:
    """An entry of the page's legend; the sizes of cut arrows are shown on pages only."""
    text = entry["text"].removesuffix(", with their size beside them")
    return f"{entry['bar']['text']}  {text}" if "bar" in entry else text


def _mp4(frames, size, rate) -> bytes:
    import imageio_ffmpeg

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder, "film.mp4")
        writer = imageio_ffmpeg.write_frames(str(file), size, fps=rate, macro_block_size=1, ffmpeg_log_level="error")
        writer.send(None)
        try:
            for image in frames:
                writer.send(image.tobytes())
        finally:
            writer.close()
        return file.read_bytes()


def _gif(frames, size, rate) -> bytes:
    from io import BytesIO

    first, *others = [image.quantize(64) for image in frames]
    stream, options = BytesIO(), {"duration": 1e3 / rate, "loop": 0, "disposal": 1}
    first.save(stream, "GIF", save_all=True, append_images=others, **options)
    return stream.getvalue()


def _drawing(mech, sol, at, options) -> bytes:
    """Positions of a planar mechanism side by side, each a group of shapes that have the names of their bodies."""
    (run,) = runs_of(mech, sol)
    low, high = sorted(run.t[[0, -1]])
    if outside := [t for t in at if not low <= t <= high]:
        raise InputError(f"at={outside[0]:g} is outside the run, {low:g} … {high:g} s")
    elapsed = np.abs(at - run.t[0])
    times = np.union1d(playing_times([run], 1.0, 30.0), elapsed)
    page = picture(mech, sol, fps=30.0, times=times, **options | {"speed": 1.0})
    stage = Stage(page)
    if not stage.planar:
        raise InputError(f"{mech.name} moves in space; drawings (.svg) are for planar mechanisms: use .mp4 or .gif")
    scale = 0.86 * PANEL / stage.extent.max()
    height, columns = scale * stage.extent[1] + 60.0, min(len(at), ABREAST)
    below = height * -(-len(at) // ABREAST)
    parts, bars = [], [entry for entry in page["legend"] if "bar" in entry]
    for number, (t, frame) in enumerate(zip(at, np.searchsorted(times, elapsed), strict=True)):
        x, y = PANEL * (number % ABREAST) + PANEL / 2, height * (number // ABREAST)
        place = scale, (x, y + 15 + scale * stage.extent[1] / 2)
        parts.append(f'<g id="t={t:g}">')
        parts += [_path(stage.pixels(points, *place), "none", _hex(color)) for points, color, _ in stage.lines]
        parts += [_shape(patch, scale) for patch in stage.patches(int(frame), *place, outlines=True)]
        parts.append(f'<text x="{x:.6g}" y="{y + height - 15:.6g}" text-anchor="middle">t = {t:g} s</text></g>')
    for row, entry in enumerate(bars):
        y, end = below + 25 * row + 10, 20 + scale * entry["bar"]["metres"]
        parts.append(f'<path d="M20 {y:.6g}H{end:.6g}" stroke="#{entry["color"]:06x}" stroke-width="3"/>')
        parts.append(f'<text x="{end + 10:.6g}" y="{y + 6:.6g}">{escape(_about(entry))}</text>')
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {columns * PANEL:g} {below + 25 * len(bars) + 5:.6g}" '
    )
    head += f'font-family="sans-serif" font-size="18" stroke-linejoin="round"><title>{escape(mech.name)}</title>'
    return "\n".join([head, *parts, "</svg>\n"]).encode()


def _shape(patch, scale) -> str:
    """SVG's element of a patch: a ball as a circle, a convex solid as its outline, meshes by their faces."""
    fill, edge, solid = _hex(patch.color), _hex(EDGE * patch.color), patch.solid
    if not solid.convex:
        return _path(patch.points, fill, fill)
    look = f'fill="{fill}" fill-opacity="{patch.opacity:g}" stroke="{edge}"><title>{escape(solid.name)}</title></'
    if solid.radius:
        x, y = (patch.points.min(axis=0) + patch.points.max(axis=0)) / 2
        return f'<circle cx="{x:.2f}" cy="{y:.2f}" r="{scale * solid.radius:.2f}" {look}circle>'
    points = " ".join(f"{x:.2f},{y:.2f}" for x, y in patch.points)
    return f'<polygon points="{points}" {look}polygon>'


def _path(points, fill, stroke) -> str:
    text = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return f'<polyline points="{text}" fill="{fill}" stroke="{stroke}"/>'


def _hex(color) -> str:
    return "#{:02x}{:02x}{:02x}".format(*np.asarray(color).astype(int))
