"""The contents of a replay: its objects, tracks, arrows and legend."""

import numpy as np
import pinocchio as pin

from pinconsist.view.picture import picture

PLAIN = {"speed": 1.0, "fps": 50, "traces": (), "forces": False, "loop": False, "beside": False}


def shown(mech, sol, **options):
    return picture(mech, sol, **PLAIN | options)


def track(page, path, name):
    """Values of one track of the animation, a row for each frame."""
    (animation,) = [each for each in page["commands"] if each["type"] == "set_animation"]
    (clip,) = [each["clip"] for each in animation["animations"] if each["path"] == path]
    values = {each["name"]: each["values"] for each in clip["tracks"]}
    return np.reshape(values[name], (len(clip["tracks"][0]["times"]), -1))


def arrow(page, path):
    """Start and vector of an arrow at every frame, from its shaft and head: (n, 3) each."""
    start, neck = track(page, f"{path}/shaft", ".position"), track(page, f"{path}/head", ".position")
    turns = [pin.Quaternion(row).matrix()[:, 1] for row in track(page, f"{path}/head", ".quaternion")]
    (head,) = [each["object"]["geometries"][0]["height"] for each in drawn(page, f"{path}/head")]
    tip = neck + turns * (head * track(page, f"{path}/head", ".scale")[:, 1:2])
    np.testing.assert_allclose(
        turns, [pin.Quaternion(row).matrix()[:, 1] for row in track(page, f"{path}/shaft", ".quaternion")]
    )
    np.testing.assert_allclose(start + turns * track(page, f"{path}/shaft", ".scale")[:, 1:2], neck, atol=1e-5)
    return start, tip - start


def drawn(page, start):
    return [each for each in page["commands"] if each["type"] == "set_object" and each["path"].startswith(start)]


def stated(page, kind="N"):
    """Newtons or newton metres per metre, from a bar of the legend."""
    (bar,) = [each["bar"] for each in page["legend"] if "bar" in each and each["bar"]["text"].split()[1] == kind]
    return float(bar["text"].split()[0]) / bar["metres"]
