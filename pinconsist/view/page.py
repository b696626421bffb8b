"""Replays in meshcat's viewer: one self-contained page, written to a file, or shown in the browser or a notebook.

The page holds meshcat's packaged viewer and its commands. meshcat's own server is not used: it listens on every
network interface, and the pages that it writes run the commands in no certain order.
"""

import logging
from base64 import b64encode
from contextlib import suppress
from html import escape
from io import BytesIO
from pathlib import Path

from ..errors import InputError, MissingExtraError
from ..files import written_whole
from ..mechanism.checks import flag
from .picture import picture
from .plots import BOTH, pictures_of

FPS = 50
PARTS = ("page.html", "page.css", "scene.js", "page.js")
HEIGHT, DOTS = 420, 80  # in a notebook: pixels of the page, dots per inch of the picture
log = logging.getLogger(__name__)


def export_html(
    mech, sol, file, *, speed: float = 1.0, fps: float = FPS, traces=(), forces: bool = False, panel: bool = True,
    over: bool = False,
) -> Path:  # fmt: skip
    """Write the motion as a single page that plays in any browser, even offline.

    Next to the motion are plots of forces, torques, energies, joints, steps, orders and joint forces, with their peaks
    and a draggable cursor at the current time; forces that are not unique have a star. Above it is the verdict of the
    run's certificate, :meth:`Solution.check`. The space bar plays and pauses, arrow keys step; pointing at a body or
    loop shows its name and force. Bodies have the names of their links in the file.

    Shapes come from the mechanism's robot file if their meshes are found, otherwise from joints, inertias and loops. A
    loop is shown as a transparent shell (anchor 1) and a red core (anchor 2): it is closed if the core is in the shell.
    Springs between two points are drawn as coils.

    Parameters
    ----------
    mech : Mechanism or sequence of Mechanism
        The scene; one for all solutions, or one for each. Its forces are those of the run; for a solution read from a
        file, add those passed to :func:`simulate`.
    sol : Solution, or sequence of solutions, or mapping of titles to solutions
        The solution to play, row by row; several are shown side by side, at the same scale and speed. Required are
        ``t``, shape (n,), s, monotone, and ``q``, shape (n, nq); for forces also ``lam``, shape (n, nc), and for those
        of servos and joint torques ``v``, shape (n, nv).
    file : path
        The file of the page; written atomically.
    speed : float
        Seconds of motion per second of playback: 0.1 is slow motion.
    fps : float
        Minimum number of frames per second of playback; increased so that no point is farther from straight lines
        between frames than a thousandth of the size of the mechanism. Reduced (and logged) so that there are at most
        3000.
    traces : sequence of str
        Frames of the model whose paths are drawn.
    forces : bool
        Draw the force of every loop as an arrow at anchor 2, on body 2 (on body 1 if body 2 is the ground), and its
        moment as an arrow that curves around its axis, see :meth:`Solution.reaction`. The torques of drives, and the
        total of the mechanism's servos and joint torques, on joints with one degree of freedom are drawn in the same
        way; for a prismatic joint they are forces. The forces transmitted by the joints of the tree,
        :meth:`Solution.joint_force`, are also drawn, on their children; if there are other forces, only when switched
        on in the page. A scale bar shows the scale of the arrows. The largest force has the longest arrow; only
        outliers are shortened, drawn in orange and labelled with their magnitude. Loops whose forces are not determined
        (:attr:`Reaction.dependence`), and joints that share their loads, are named, not drawn.
    panel : bool
        If False, the page contains only the motion and its player.
    over : bool
        Overlay several solutions instead of showing them side by side: the first one as usual, the others in one
        transparent colour.

    Returns
    -------
    Path
        The page.

    Raises
    ------
    InputError
        A solution that does not fit the mechanism, an unknown frame, a `speed` or `fps` that is not positive.
    MissingExtraError, OSError
        meshcat is not installed; the file cannot be written.
    """
    options = {"speed": speed, "fps": fps, "traces": traces, "forces": forces, "panel": panel, "over": over}
    return write_page(file, mech, sol, **options)


def write_page(file, mech, sol, **options) -> Path:
    """Write the page of `page_of`, completely or not at all."""
    page = page_of(mech, sol, **options)
    with written_whole(file) as stream:
        stream.write(page)
    return Path(file)


def replay(
    mech, sol, *, speed: float = 1.0, loop: bool = True, traces=(), forces: bool = False, open_browser: bool = True
) -> str:
    """Show the motion in the browser, in real time × `speed`.

    The page of `export_html` is served on the loopback interface, on a free port, by a thread that ends with the
    process. With `open_browser` the call returns when the browser has loaded the page (or after ten seconds); the page
    then plays on without this process; otherwise it returns at once.

    Parameters
    ----------
    mech, sol, speed, traces, forces
        As in `export_html`.
    loop : bool
        Whether to repeat the motion.
    open_browser : bool
        Whether to open the page in the user's browser.

    Returns
    -------
    str
        Address of the page.

    Raises
    ------
    InputError, MissingExtraError
        As in `export_html`; or there is no free port on the loopback interface.
    """
    import webbrowser

    options = {"speed": speed, "fps": FPS, "traces": traces, "forces": forces}
    open_browser = flag(open_browser, "open_browser")
    address, fetched = _serve(page_of(mech, sol, **options, loop=loop))
    log.info("replay at %s", address)
    if open_browser and webbrowser.open(address):
        fetched.wait(timeout=10)
    return address


def page_of(mech, sol, *, fps=FPS, panel=True, **options) -> bytes:
    """The `PARTS` with meshcat's viewer and the commands of :func:`picture`, to which `options` are passed."""
    import json
    from importlib.resources import files
    from string import Template

    commands = picture(mech, sol, fps=fps, beside=panel, smooth=True, **options)
    text = json.dumps(commands, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    title = ", ".join(dict.fromkeys(each.name for each in (mech if isinstance(mech, list | tuple) else [mech])))
    frame, style, *scripts = ((files(__package__) / name).read_text("utf-8") for name in PARTS)
    parts = {"title": escape(title), "style": style, "viewer": _viewer(), "replay": text, "script": "".join(scripts)}
    return Template(frame).substitute(parts).encode()


def notebook_html(sol, mechanism) -> str:
    """The text of a solution and, if the packages are installed, its picture and page."""
    parts = [f"<pre>{escape(repr(sol))}</pre>"]
    with suppress(MissingExtraError):
        image = BytesIO()
        pictures_of(sol, BOTH, mech=mechanism).savefig(image, format="png", dpi=DOTS)
        data = b64encode(image.getvalue()).decode()
        parts.append(f'<img alt="the solution over time" src="data:image/png;base64,{data}"/>')
    with suppress(MissingExtraError):
        document = escape(page_of(mechanism, sol, forces=True).decode())
        style = f"width: 100%; height: {HEIGHT}px; border: 0"
        parts.append(f'<iframe srcdoc="{document}" style="{style}"></iframe>')
    return "\n".join(parts)


def _viewer() -> str:
    """meshcat's packaged viewer; found without importing meshcat, which would import a server and IPython."""
    from importlib.util import find_spec

    found = find_spec("meshcat")
    for folder in found.submodule_search_locations if found else ():
        if (bundle := Path(folder, "viewer", "dist", "main.min.js")).is_file():
            return bundle.read_text(encoding="utf-8")
    raise MissingExtraError("replays need the package meshcat; install it with: pip install meshcat")


def _serve(page: bytes):
    """Serve one page on a free port of the loopback interface; its address, and an event set once it was fetched."""
    import http.server
    import threading

    fetched = threading.Event()

    class OnePage(http.server.BaseHTTPRequestHandler):
        def do_GET(self):
            if self.path != "/":
                return self.send_error(404)
            self.send_response(200)
            self.send_header("Content-Type", "text/html; charset=utf-8")
            self.send_header("Content-Length", str(len(page)))
            self.end_headers()
            self.wfile.write(page)
            fetched.set()

        def log_message(self, format, *args):
            log.debug(format, *args)

    try:
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), OnePage)
    except OSError as error:
        raise InputError(f"no page can be served on 127.0.0.1 here ({error}); write it by export_html") from error
    threading.Thread(target=server.serve_forever, daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/", fetched
