"""The page of a replay: meshcat's packaged viewer and its commands as text, in one file that needs no network."""

from __future__ import annotations

import html
import json
from importlib.util import find_spec
from pathlib import Path

from ..errors import MissingExtraError
from .camera import ASPECT

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
body {{ margin: 0; display: flex; flex-direction: column; height: 100vh; overflow: hidden; background: #dbe2e8; }}
body, button {{ font: 14px sans-serif; color: #222; }}
#meshcat-pane {{ flex: 1; min-height: 0; overflow: hidden; }}
#notes {{ padding: 4px 14px 10px; line-height: 1.5; }}
#notes i {{ display: inline-block; width: 10px; height: 10px; margin-right: 7px; border-radius: 5px; }}
#time {{ font-size: 17px; font-variant-numeric: tabular-nums; }}
#player {{ display: flex; align-items: center; gap: 10px; }}
#player button {{ width: 38px; height: 30px; }}
#player input {{ width: min(45vw, 420px); }}
.run {{ position: absolute; left: 0; top: 0; font-size: 17px; white-space: nowrap; pointer-events: none; }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="notes"><div id="player">
<button id="play" aria-label="play or pause" title="play or pause: space bar"></button>
<input id="scrub" type="range" min="0" step="any" aria-label="time"><span id="time"></span>
</div></div>
<script>{viewer}</script>
<script id="replay" type="application/json">{replay}</script>
<script>
const replay = JSON.parse(document.getElementById("replay").textContent);
for (const note of replay.legend) {{
  const entry = document.createElement("div");
  entry.appendChild(document.createElement("i")).style.background = "#" + note.color.toString(16).padStart(6, "0");
  entry.append(note.text);
  document.getElementById("notes").append(entry);
}}
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
for (const command of replay.commands) viewer.handle_command(command);
const pane = viewer.dom_element, target = viewer.controls.target.set(...replay.target);
viewer.set_3d_pane_size = () =>  // meshcat's takes the window's height
  MeshCat.Viewer.prototype.set_3d_pane_size.call(viewer, pane.offsetWidth, pane.offsetHeight);
let back = 1;
function fit() {{
  viewer.set_3d_pane_size();
  const before = back;
  back = Math.max(1, {aspect} * pane.offsetHeight / pane.offsetWidth);
  viewer.camera.position.sub(target).multiplyScalar(back / before).add(target);
}}
fit();
window.addEventListener("resize", fit);
viewer.gui.__folders["Scene"].close();

const [time, play, scrub] = ["time", "play", "scrub"].map(id => document.getElementById(id));
const animator = viewer.animator, toggle = () => animator.playing ? animator.pause() : animator.play();
const [start, rate, duration] = replay.clock;
const digits = Math.max(0, Math.min(9, 2 - Math.floor(Math.log10(Math.abs(rate) * Math.min(1, duration || 1)))));
const pace = Math.abs(rate) == 1 ? "" : "  (speed × " + Math.abs(rate) + ")";
const titles = replay.titles.map(title => {{
  const element = document.body.appendChild(document.createElement("div"));
  element.className = "run";
  element.textContent = title.text;
  return {{at: title.at, element}};
}});
play.hidden = scrub.hidden = !duration;
scrub.max = duration;
scrub.addEventListener("input", () => {{ animator.pause(); animator.seek(scrub.valueAsNumber); }});
play.addEventListener("click", toggle);
document.addEventListener("keydown", event => {{
  if (!duration || event.key != " " || event.target.closest("button, .dg")) return;
  event.preventDefault();
  toggle();
}});
const place = target.clone(), canvas = viewer.renderer.domElement;
function follow() {{
  const played = animator.actions.reduce((latest, action) => Math.max(latest, action.time), 0);
  time.textContent = "t = " + (start + rate * Math.min(played, duration)).toFixed(digits) + " s" + pace;
  scrub.value = played;
  scrub.setAttribute("aria-valuetext", time.textContent);
  play.textContent = animator.playing ? "❚❚" : "▶";
  for (const title of titles) {{
    place.set(...title.at).project(viewer.camera);
    const x = (1 + place.x) / 2 * canvas.clientWidth, y = (1 - place.y) / 2 * canvas.clientHeight;
    title.element.style.transform = `translate(${{x}}px, ${{y}}px) translate(-50%, 0)`;
  }}
  requestAnimationFrame(follow);
}}
follow();
</script>
</body>
</html>
"""


def page(title: str, replay: dict) -> bytes:
    """The page that plays what :func:`pinconsist.view.scene.scene` made."""
    text = json.dumps(replay, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return PAGE.format(title=html.escape(title), viewer=_viewer(), replay=text, aspect=ASPECT).encode()


def _viewer() -> str:
    """meshcat's packaged viewer; found without importing meshcat, which brings a server and IPython."""
    found = find_spec("meshcat")
    for folder in found.submodule_search_locations if found else ():
        bundle = Path(folder, "viewer", "dist", "main.min.js")
        if bundle.is_file():
            return bundle.read_text(encoding="utf-8")
    raise MissingExtraError("replays need the package meshcat; install it by: pip install meshcat")
