"""Names that are unique: MuJoCo tells bodies, joints and sites apart, Pinocchio calls all of them frames."""

from __future__ import annotations

from .bodies import Body


class FrameNames:
    """The names that joints, bodies and sites get in a model.

    Joints keep their names. A body or a site that has the name of another frame gets ``_body`` or ``_site`` behind it.
    What has no name is called ``body3`` by MuJoCo's number, and ``body3_hinge`` after its body, ``body3_hinge2`` where
    a body has several hinges.

    Attributes
    ----------
    joints : list of list of str
        The joints of each body.
    links : list of str
        The frame of each body.
    bodies, sites : dict[str, str]
        Name in the file → name of the frame.
    """

    def __init__(self, bodies: list[Body]):
        self._taken = {"universe", *(joint.name for body in bodies for joint in body.joints)}
        self.bodies = {body.name: self._free(body.name, "body") for body in bodies if body.name}
        self.sites = {site: self._free(site, "site") for body in bodies for site in body.sites}
        self.links = [
            self.bodies[body.name] if body.name else self._free(f"body{number}", "body")
            for number, body in enumerate(bodies)
        ]
        self.joints = [
            [joint.name or self._free(f"{link}_{_numbered(joint, body)}", "joint") for joint in body.joints]
            for link, body in zip(self.links, bodies, strict=True)
        ]

    def _free(self, name, kind):
        free, number = name, 1
        while free in self._taken:
            free = f"{name}_{kind}" if number == 1 else f"{name}_{kind}{number}"
            number += 1
        self._taken.add(free)
        return free


def _numbered(joint, body):
    """``hinge``, or ``hinge2`` where a body has several of them."""
    alike = [each for each in body.joints if each.kind == joint.kind]
    return joint.kind + (str(alike.index(joint) + 1) if len(alike) > 1 else "")
