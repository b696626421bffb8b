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
body {{ margin: 0; overflow: hidden; background: linear-gradient(#fafbfc, #dbe2e8); }}
#meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}
#notes, .run {{ position: absolute; font: 14px sans-serif; color: #222; pointer-events: none; }}
#notes {{ left: 14px; bottom: 10px; line-height: 1.5; max-width: calc(100vw - 28px); }}
#notes i {{ display: inline-block; width: 10px; height: 10px; margin-right: 7px; border-radius: 5px; }}
#time {{ font-size: 17px; font-variant-numeric: tabular-nums; }}
@media (min-width: 700px) {{
  #meshcat-pane {{ width: calc(100vw - 245px); }}
  #notes {{ max-width: calc(100vw - 280px); }}
}}
.run {{ left: 0; top: 0; font-size: 17px; white-space: nowrap; }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<div id="notes"><div id="time"></div></div>
<script>{viewer}</script>
<script id="replay" type="application/json">{replay}</script>
<script>
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const replay = JSON.parse(document.getElementById("replay").textContent);
for (const command of replay.commands) viewer.handle_command(command);
const pane = viewer.dom_element, target = viewer.controls.target.set(...replay.target);
let back = 1;
function fit() {{
  const before = back;
  back = Math.max(1, {aspect} * pane.offsetHeight / pane.offsetWidth);
  viewer.camera.position.sub(target).multiplyScalar(back / before).add(target);
}}
fit();
window.addEventListener("resize", fit);
if (window.innerWidth >= 700) viewer.gui.open();
viewer.gui.__folders["Scene"].close();

const time = document.getElementById("time"), [start, rate, duration] = replay.clock;
const digits = Math.max(0, Math.min(9, 2 - Math.floor(Math.log10(Math.abs(rate) * Math.min(1, duration || 1)))));
const pace = Math.abs(rate) == 1 ? "" : "  (speed × " + Math.abs(rate) + ")";
for (const note of replay.legend) {{
  const entry = document.createElement("div");
  entry.appendChild(document.createElement("i")).style.background = "#" + note.color.toString(16).padStart(6, "0");
  entry.append(note.text);
  document.getElementById("notes").append(entry);
}}
const titles = replay.titles.map(title => {{
  const element = document.body.appendChild(document.createElement("div"));
  element.className = "run";
  element.textContent = title.text;
  return {{at: title.at, element}};
}});
const place = target.clone(), canvas = viewer.renderer.domElement;
function follow() {{
  const played = viewer.animator.actions.reduce((latest, action) => Math.max(latest, action.time), 0);
  time.textContent = "t = " + (start + rate * Math.min(played, duration)).toFixed(digits) + " s" + pace;
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
