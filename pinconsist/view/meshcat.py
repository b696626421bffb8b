"""Replays in meshcat's viewer: one self-contained page, written to a file or shown in the browser.

The page holds meshcat's packaged viewer and its commands as text, so that neither meshcat's server nor its Python
side is needed: its server listens on every network interface, and the page that it writes runs the commands in no
certain order.
"""

from __future__ import annotations

import html
import json
import logging
from importlib.util import find_spec
from pathlib import Path

from ..errors import MissingExtraError
from ..files import written_whole
from ..mechanism.mechanism import Mechanism
from .scene import ASPECT, scene

FOREVER = 10**9
log = logging.getLogger(__name__)

PAGE = """<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<title>{title}</title>
<link rel="icon" href="data:,">
<style>
body {{ margin: 0; overflow: hidden; background: linear-gradient(#fafbfc, #dbe2e8); }}
#meshcat-pane {{ width: 100vw; height: 100vh; overflow: hidden; }}
@media (min-width: 700px) {{ #meshcat-pane {{ width: calc(100vw - 245px); }} }}
</style>
</head>
<body>
<div id="meshcat-pane"></div>
<script>{viewer}</script>
<script id="replay" type="application/json">{replay}</script>
<script>
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
const replay = JSON.parse(document.getElementById("replay").textContent);
for (const command of replay.commands) viewer.handle_command(command);
const pane = viewer.dom_element, target = viewer.controls.target.set(...replay.target);
const back = Math.max(1, {aspect} * window.innerHeight / pane.offsetWidth);
viewer.camera.position.sub(target).multiplyScalar(back).add(target);
if (window.innerWidth >= 700) viewer.gui.open();
viewer.gui.__folders["Scene"].close();
</script>
</body>
</html>
"""


def export_html(mech: Mechanism, sol, file, *, speed: float = 1.0, fps: float = 50, traces=()) -> Path:
    """Write the motion as one page that any browser plays, without network, with play, pause and time controls.

    Shapes come from the mechanism's robot file where their meshes are found, else from joints and loops. A loop shows
    as a clear shell (anchor 1) and a red core (anchor 2): it is closed where the core sits in the shell.

    Parameters
    ----------
    mech : Mechanism
        The scene.
    sol : object
        With ``t``, shape (n,), s, monotone, and ``q``, shape (n, nq). Rows are played in their order.
    file : path
        The page; written whole or not at all.
    speed : float
        Seconds of motion per second of playing.
    fps : float
        Frames per second of playing; lowered (and logged) so that the page has at most 3000 frames.
    traces : sequence of str
        Frames of the model whose paths are drawn.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        A solution that does not fit the mechanism, an unknown frame, a `speed` or `fps` that is not positive.
    MissingExtraError
        meshcat is not installed.
    OSError
        The file cannot be written.
    """
    page = _page(mech, scene(mech, sol, speed=speed, fps=fps, traces=traces, repetitions=FOREVER))
    with written_whole(file) as stream:
        stream.write(page)
    return Path(file)


def replay(mech: Mechanism, sol, *, speed: float = 1.0, loop: bool = False, open_browser: bool = True) -> str:
    """Show the motion in the browser, in real time × `speed`.

    The page of `export_html` is served on the loopback interface, by a thread that ends with the process. With
    `open_browser` the call returns when the browser has the page (or after ten seconds), and the page then plays on
    without this process; otherwise it returns at once.

    Parameters
    ----------
    mech, sol, speed
        As in `export_html`.
    loop : bool
        Play again and again.
    open_browser : bool
        Open the page in the user's browser.

    Returns
    -------
    str
        Address of the page.

    Raises
    ------
    InputError, MissingExtraError
        As in `export_html`.
    """
    import webbrowser

    page = _page(mech, scene(mech, sol, speed=speed, fps=50, traces=(), repetitions=FOREVER if loop else 1))
    address, fetched = _serve(page)
    log.info("replay of %s at %s", mech.name, address)
    if open_browser and webbrowser.open(address):
        fetched.wait(timeout=10)
    return address


def _serve(page: bytes):
    """Serve one page on a free port of the loopback interface; its address, and an event set once it was fetched."""
    import http.server
    import threading

    fetched = threading.Event()

    class OnePage(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            if self.path != "/":
                self.send_error(404)
                return
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)
            fetched.set()

        def log_message(self, format, *args):
            log.debug(format, *args)

    server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), OnePage)
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/", fetched


def _page(mech: Mechanism, replay: dict) -> bytes:
    text = json.dumps(replay, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return PAGE.format(title=html.escape(mech.name), viewer=_viewer(), replay=text, aspect=ASPECT).encode()


def _viewer() -> str:
    """meshcat's packaged viewer; found without importing meshcat, which brings a server and IPython."""
    found = find_spec("meshcat")
    for folder in found.submodule_search_locations if found else ():
        bundle = Path(folder, "viewer", "dist", "main.min.js")
        if bundle.is_file():
            return bundle.read_text(encoding="utf-8")
    raise MissingExtraError("replays need the package meshcat; install it by: pip install meshcat")
