"""Whatever is added to a file, of which nobody knows, is refused or told: nothing is dropped without a word."""

from __future__ import annotations

import logging
import warnings
from xml.etree import ElementTree

import pytest
from helpers.fuzz_seeds import BODY, MJCF, SDF, URDF, USD, WEBOTS, WRL

import pinconsist as pc

UNKNOWN = "zgadget"
SHOWN_ONLY = (
    "visual",
    "collision",
    "material",
    "geometry",
    "color",
    "transmission",
    "plugin",
    "sensor",
    "light",
    "gui",
)
"""Elements that are not looked into: they are only shown, or are counted as a whole."""


def said(path, caplog):
    """What is said when a file is loaded: its error, or its warnings, its log and what it ignores."""
    caplog.clear()
    caplog.set_level(logging.INFO, "pinconsist")
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        try:
            mech = pc.load(path)
        except pc.PinconsistError as error:
            return str(error)
    return " ".join([*mech.ignored, *(str(each.message) for each in caught), caplog.text])


def spoilt_xml(text):
    """(description, text) with an unknown attribute, or an unknown element, at each place of a file."""
    count = len(list(ElementTree.fromstring(text).iter()))
    for number in range(count):
        for what in ("attribute", "element"):
            root = ElementTree.fromstring(text)
            parents = {child: node for node in root.iter() for child in node}
            node = list(root.iter())[number]
            line = [node]
            while line[-1] in parents:
                line.append(parents[line[-1]])
            tags = [each.tag.rpartition("}")[2] for each in line]
            if set(tags) & set(SHOWN_ONLY):
                continue
            if what == "attribute":
                node.set(UNKNOWN, "1")
            else:
                ElementTree.SubElement(node, UNKNOWN, value="1").text = "1"
            yield f"{what} of {'/'.join(reversed(tags))}", ElementTree.tostring(root, encoding="unicode")


def silent(folder, name, texts, caplog):
    """The places at which something was added without a word."""
    (path := folder / name).write_text("")
    found = []
    for where, text in texts:
        path.write_text(text)
        if UNKNOWN not in said(path, caplog):
            found.append(where)
    return sorted(set(found))


@pytest.mark.parametrize("name", ["scene.urdf", "scene.sdf", "scene.xml"])
def test_elements_and_attributes(tmp_path, caplog, name):
    if name.endswith("xml"):
        pytest.importorskip("mujoco")
    text = {"scene.urdf": URDF, "scene.sdf": SDF, "scene.xml": MJCF}[name]
    found = silent(tmp_path, name, spoilt_xml(text), caplog)
    assert not found, ", ".join(found)


def spoilt_words(text, opening, added):
    """(description, text) with something added behind each `opening`."""
    parts = text.split(opening)
    for number in range(1, len(parts)):
        before, after = opening.join(parts[:number]), opening.join(parts[number:])
        if any(word in before.rpartition("\n")[2] for word in ("Shape", "PROTO", "Visual")):
            continue
        yield before.rstrip().rpartition("\n")[2][-60:], f"{before}{opening} {added} {after}"


def test_fields_of_webots(tmp_path, caplog):
    found = silent(tmp_path, "scene.wbt", spoilt_words(WEBOTS, "{", f"{UNKNOWN} 1 "), caplog)
    found = [each for each in found if not each.endswith(("Box", "geometry Box", "Capsule"))]
    assert not found, "; ".join(found)


def test_fields_of_bodies(tmp_path, caplog):
    found = silent(tmp_path, "scene.wrl", spoilt_words(WRL, "{", f"{UNKNOWN} 1 "), caplog)
    found = [each for each in found if each.strip() != "Transform"]  # of a definition that is not used
    assert not found, "; ".join(found)
    found = silent(tmp_path, "scene.body", spoilt_words(BODY, "{", f"{UNKNOWN}: 1, "), caplog)
    found = [each for each in found if "Shape" not in each and "geometry" not in each]
    assert not found, "; ".join(found)


def test_attributes_of_usd(tmp_path, caplog):
    pytest.importorskip("pxr.Usd")
    for added in (f"double physics:{UNKNOWN} = 1", f"double {UNKNOWN}:stiffness = 1"):
        lines = USD.splitlines()
        places = [i for i, line in enumerate(lines) if "physics:mass" in line or "physics:axis" in line]
        assert places
        texts = [(lines[i], "\n".join([*lines[:i], added, *lines[i:]])) for i in places]
        found = silent(tmp_path, "scene.usda", texts, caplog)
        assert not found, "; ".join(found)
