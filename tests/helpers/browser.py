"""A page in a real headless browser, driven by the DevTools protocol: clicks, drags, keys, and their effects."""

import itertools
import json
import os
import shutil
import subprocess
import tempfile
import time
from contextlib import contextmanager
from functools import cache

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome found")
FLAGS = """--headless=new --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-sync
--disable-component-update --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --hide-scrollbars
--remote-debugging-pipe about:blank"""
PATIENCE = 60  # s, for the browser to answer
WATCH = """
window.complaints = [];
window.addEventListener("error", event => complaints.push(String(event.message)));
console.error = (...words) => complaints.push(words.join(" "));
"""


class Browser:
    """A browser of this process; it ends with the pipe."""

    def __init__(self):
        (ours_in, its_out), (its_in, ours_out) = os.pipe(), os.pipe()
        self.folder = tempfile.TemporaryDirectory(prefix="chromium-", ignore_cleanup_errors=True)
        words = [BROWSER, *FLAGS.split(), f"--user-data-dir={self.folder.name}"]
        link = f'exec "$@" 3<&{its_in} 4>&{its_out}'  # the browser reads from 3 and writes to 4
        self.process = subprocess.Popen(
            ["bash", "-c", link, "bash", *words],
            pass_fds=(its_in, its_out),
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        os.close(its_in), os.close(its_out)
        self.to, self.answers, self.numbers, self.rest = ours_out, ours_in, itertools.count(1), b""

    def ask(self, method, session=None, **parameters):
        """The result of a command of the DevTools protocol."""
        number = next(self.numbers)
        words = {"id": number, "method": method, "params": parameters} | ({"sessionId": session} if session else {})
        os.write(self.to, json.dumps(words).encode() + b"\0")
        while True:
            message = self._message()
            if message.get("id") == number:
                assert "error" not in message, message
                return message["result"]

    def _message(self):
        while b"\0" not in self.rest:
            more = os.read(self.answers, 1 << 20)
            assert more, "the browser has gone"
            self.rest += more
        message, self.rest = self.rest.split(b"\0", 1)
        return json.loads(message)


browser = cache(Browser)


class Tab:
    """A page that is open."""

    def __init__(self, size, mobile):
        target = browser().ask("Target.createTarget", url="about:blank")["targetId"]
        session = browser().ask("Target.attachToTarget", targetId=target, flatten=True)["sessionId"]
        self.target, self.session = target, session
        self.ask("Page.enable")
        self.ask("Page.addScriptToEvaluateOnNewDocument", source=WATCH)
        width, height = size
        self.ask("Emulation.setDeviceMetricsOverride", width=width, height=height, deviceScaleFactor=1, mobile=mobile)
        self.ask("Emulation.setTouchEmulationEnabled", enabled=mobile)

    def ask(self, method, **parameters):
        return browser().ask(method, self.session, **parameters)

    def run(self, script):
        """The value of a script's last expression."""
        answer = self.ask("Runtime.evaluate", expression=script, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def wait(self, condition):
        """Wait until an expression is true."""
        end = time.monotonic() + PATIENCE
        while not self.run(condition):
            assert time.monotonic() < end, condition
            time.sleep(0.02)

    def mouse(self, kind, x, y, held=False):
        button = {"button": "left", "buttons": int(held), "clickCount": 1} if held or kind == "mouseReleased" else {}
        self.ask("Input.dispatchMouseEvent", type=kind, x=x, y=y, **button)

    def middle(self, selector):
        """The middle of an element on the screen."""
        return self.run(f"""{{ const box = document.querySelector({json.dumps(selector)}).getBoundingClientRect();
            [box.x + box.width / 2, box.y + box.height / 2] }}""")

    def drag(self, start, end):
        """Press at one point, move in steps, and release at another."""
        self.mouse("mouseMoved", *start)
        self.mouse("mousePressed", *start, held=True)
        for share in (0.3, 0.7, 1.0):
            self.mouse("mouseMoved", *(a + share * (b - a) for a, b in zip(start, end, strict=True)), held=True)
        self.mouse("mouseReleased", *end)

    def touch(self, *points):
        """Put a finger down at the first point, move it over the others, and lift it."""
        for number, (x, y) in enumerate(points):
            kind = "touchMove" if number else "touchStart"
            self.ask("Input.dispatchTouchEvent", type=kind, touchPoints=[{"x": x, "y": y}])
        self.ask("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])

    def click(self, selector):
        x, y = self.middle(selector)
        self.drag((x, y), (x, y))

    def key(self, key):
        text = {"text": key} if len(key) == 1 else {}
        self.ask("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
        self.ask("Input.dispatchKeyEvent", type="keyUp", key=key)


@contextmanager
def opened(page, size=(1280, 800), mobile=False):
    """A page that has been loaded and drawn; at the end it must not have reported an error."""
    tab = Tab(size, mobile)
    tab.ask("Page.navigate", url=page.resolve().as_uri())
    tab.wait("document.readyState == 'complete' && typeof viewer == 'object'")
    yield tab
    assert tab.run("complaints") == []
    browser().ask("Target.closeTarget", targetId=tab.target)
