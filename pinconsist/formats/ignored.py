"""What a file has that has no effect here: counted, so that one line at load can name it.

Every element, attribute and plugin that can change the motion is acted on, refused by name (:func:`.reading.refuse`) or
counted. Nothing is harmless by default: an unknown element is counted by its tag.
"""

import re
from collections import Counter
from collections.abc import Iterable
from xml.etree.ElementTree import Element

CONTACTS = "contact parameter"
HARMLESS_PLUGINS = re.compile(
    r"state_?publisher|odometry|camera|sensor|imu|lidar|laser|gps|navsat|bumper|p3d|ground_truth|altimeter"
    r"|magnetometer|user_?commands|scene_?broadcaster|pose_?publisher|diagnostic|video|log_?(record|system)",
    re.IGNORECASE,
)
"""Plugins that observe; of others nobody knows what they do."""


class Ignored:
    """A count of what has no effect, in the order in which it is met."""

    def __init__(self):
        self._counts: Counter[str] = Counter()

    def add(self, what: str, count: int = 1) -> None:
        """Count `what`, a noun in the singular, or a text with ``{}`` for the number of joints."""
        if count:
            self._counts[what] += count

    def add_unknown(self, elements: Iterable[Element], known: Iterable[str], where: str = "") -> None:
        """Count the elements whose tags are not in `known`."""
        for element in elements:
            space, _, tag = str(element.tag).rpartition("}")
            prefix = "drake:" if "drake" in space else ""
            foreign = space and not prefix
            if foreign or not {tag, f"{prefix}{tag}", element.tag} & set(known):
                self.add(f"<{prefix}{tag}>{f' of {where}' if where else ''}")

    def add_plugin(self, plugin: Element) -> None:
        """Count a plugin by its name, unless it only observes."""
        name, file = plugin.get("name", ""), plugin.get("filename", "")
        if not HARMLESS_PLUGINS.search(f"{name} {file}"):
            self.add(f"plugin {(name or file)[:60]!r}")

    def lines(self) -> tuple[str, ...]:
        """``5 collision shapes``, ``limits of 3 joints (watched, not enforced)``, …"""
        return tuple(_counted(what, count) for what, count in self._counts.items())


def _counted(what, count):
    if "{}" in what:
        return what.format(f"{count} joint{'s' * (count > 1)}")
    if what.startswith("plugin"):
        return what if count == 1 else f"{count} times {what}"
    return f"{count} {what}{'s' * (count > 1 and not what.startswith('<'))}"
