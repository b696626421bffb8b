"""A solution in a notebook: its text, a picture, and the page that plays it."""

from __future__ import annotations

from base64 import b64encode
from html import escape
from io import BytesIO

from ..errors import MissingExtraError
from .page import page_of
from .plots import plot_solution

HEIGHT = 420  # pixels of the page
DOTS = 80  # per inch of the picture


def html_of(sol, mechanism) -> str:
    """The text of a solution and, where the packages for it are installed, its picture and page."""
    parts = [f"<pre>{escape(repr(sol))}</pre>"]
    for part in _picture, _page:
        try:
            parts.append(part(sol, mechanism))
        except MissingExtraError:
            continue
    return "\n".join(parts)


def _picture(sol, mechanism) -> str:
    figure, image = plot_solution(sol, mech=mechanism), BytesIO()
    figure.savefig(image, format="png", dpi=DOTS)
    return f'<img alt="the solution over time" src="data:image/png;base64,{b64encode(image.getvalue()).decode()}"/>'


def _page(sol, mechanism) -> str:
    document = escape(page_of(mechanism, sol, forces=bool(mechanism.loops)).decode())
    return f'<iframe srcdoc="{document}" style="width: 100%; height: {HEIGHT}px; border: 0"></iframe>'
