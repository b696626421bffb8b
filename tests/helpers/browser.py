"""A replay's page in a real headless browser: what it reports, and what it complains of."""

import json
import re
import shutil
import subprocess

import pytest

BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
needs_browser = pytest.mark.skipif(BROWSER is None, reason="no chromium, chromium-browser or google-chrome found")

WATCH = """<script>
const report = {errors: []};
window.addEventListener("error", event => report.errors.push(String(event.message)));
console.error = (...words) => report.errors.push(words.join(" "));
</script>"""
ASK = """<script>
setTimeout(() => {
  report.playing = viewer.animator.playing && viewer.animator.time > 0;
  viewer.animator.pause();
  QUESTIONS
  viewer.capture_image();
  document.title = JSON.stringify(report);
}, 1000);
</script></body>"""
FLAGS = """--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --disable-sync
--disable-component-update --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader
--virtual-time-budget=4000 --dump-dom"""


def reported(page, questions, folder):
    """Open a page, let it play for a second, pause it, run `questions`, which fill in `report`; return that."""
    text = page.read_text(encoding="utf-8").replace("<head>", "<head>" + WATCH, 1)
    page.write_text(ASK.replace("QUESTIONS", questions).join(text.rsplit("</body>", 1)), encoding="utf-8")
    command = [BROWSER, *FLAGS.split(), f"--user-data-dir={folder / 'profile'}", page.as_uri()]
    dom = subprocess.run(command, capture_output=True, text=True, timeout=60).stdout
    found = re.search(r"<title>(\{.*?)</title>", dom)
    assert found, "the page did not come to its end in the browser"
    return json.loads(found[1])
