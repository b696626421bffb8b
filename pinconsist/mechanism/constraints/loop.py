"""Loop: the record by which a user closes a loop. Its rows: :mod:`pinconsist.mechanism.constraints.loops`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from ...errors import InputError
from ..checks import require_names

ROW_NAMES = {
    "point": ("x", "y", "z"),
    "frame": ("x", "y", "z", "rx", "ry", "rz"),
    "hinge": ("x", "y", "z", "tilt1", "tilt2"),
    "distance": ("length",),
    "slider": ("across1", "across2", "rx", "ry", "rz"),
    "cylinder": ("across1", "across2", "tilt1", "tilt2"),
    "plane": ("normal", "tilt1", "tilt2"),
    "universal": ("x", "y", "z", "cross"),
}
AXES = {
    "hinge": ("axis",),
    "slider": ("axis",),
    "cylinder": ("axis",),
    "plane": ("axis",),
    "universal": ("axis", "axis2"),
}
"""Kinds that have a direction, and the fields that hold it."""
_OWN = AXES | {"distance": ("length",)}
GROUND = "universe"


@dataclass(frozen=True)
class Loop:
    """One loop closure between two frames of a model.

    Parameters
    ----------
    name : str
        Name by which reports, errors and reactions speak of the loop.
    kind : {"point", "frame", "hinge", "distance", "slider", "cylinder", "plane", "universal"}
        What the closure holds together; see the table of :mod:`pinconsist.mechanism.constraints.loops`.
    frame1, frame2 : str
        Names of frames of the model; ``"universe"`` is the ground.
    xyz1, xyz2 : tuple of 3 float
        Position of each anchor in its frame, m.
    rpy1, rpy2 : tuple of 3 float
        Orientation of each anchor in its frame, URDF's roll, pitch, yaw, rad.
    axis : tuple of 3 float
        A direction of any length. The axis of a hinge, slider or cylinder, and the normal of a plane: the same
        components in both anchors. Of a universal, the axis that belongs to body 1, in anchor 1.
    axis2 : tuple of 3 float
        Of a universal, the axis that belongs to body 2, in anchor 2; held perpendicular to ``axis``.
    length : float or None
        Distance L > 0 held by ``kind="distance"``, m.

    Raises
    ------
    InputError
        Unknown kind, numbers that are not finite or of the wrong count, a missing or useless axis or length, or one
        that a loop of this kind does not have.
    """

    name: str
    kind: str
    frame1: str
    frame2: str = GROUND
    xyz1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy1: tuple[float, float, float] = (0.0, 0.0, 0.0)
    xyz2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    rpy2: tuple[float, float, float] = (0.0, 0.0, 0.0)
    axis: tuple[float, float, float] | None = None
    length: float | None = None
    axis2: tuple[float, float, float] | None = None

    def __post_init__(self):
        if not isinstance(self.kind, str) or self.kind not in ROW_NAMES:
            raise InputError(f"loop {self.name!r}: unknown kind {self.kind!r}; known are {', '.join(ROW_NAMES)}")
        require_names(self, f"loop {self.name!r}", "name", "frame1", "frame2")
        self._require_own_fields()
        for field in AXES.get(self.kind, ()):
            if getattr(self, field) is None:
                needs = "its axis, for instance axis = (0, 1, 0)"
                if field == "axis2":
                    needs = "the axis of its body 2 too, for instance axis2 = (1, 0, 0)"
                raise InputError(f"loop {self.name!r}: a {self.kind} needs {needs}")
        given = [field for field in ("axis", "axis2") if getattr(self, field) is not None]
        for field in ("xyz1", "rpy1", "xyz2", "rpy2", *given):
            object.__setattr__(self, field, _triple(getattr(self, field), f"loop {self.name!r}: {field}"))
        for field in AXES.get(self.kind, ()):
            if not 1e-100 < max(map(abs, getattr(self, field))) < 1e100:
                raise InputError(
                    f"loop {self.name!r}: the {self.kind} {field} is the zero vector, or immense: "
                    f"{getattr(self, field)}"
                )
        if self.kind == "distance":
            length = self.length
            if isinstance(length, str | bool) or not np.isscalar(length) or not 0 < length < np.inf:
                raise InputError(f"loop {self.name!r}: kind 'distance' needs length > 0 in m, got {length!r}")
            object.__setattr__(self, "length", float(length))

    def _require_own_fields(self):
        """Raise InputError for a field that another kind has: most likely that kind was meant."""
        own = _OWN.get(self.kind, ())
        for field in ("axis", "axis2", "length"):
            if field not in own and getattr(self, field) is not None:
                kinds = ", ".join(kind for kind, fields in _OWN.items() if field in fields)
                raise InputError(
                    f"loop {self.name!r}: a loop of kind {self.kind!r} has no {field}, which is for {kinds}; beside "
                    f"frames and anchors it has {' and '.join(own) or 'nothing'}"
                )

    @property
    def rows(self) -> tuple[str, ...]:
        """Names of the loop's rows, in their order."""
        return ROW_NAMES[self.kind]

    @property
    def placement1(self) -> pin.SE3:
        """Anchor 1 in ``frame1``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy1), np.array(self.xyz1))

    @property
    def placement2(self) -> pin.SE3:
        """Anchor 2 in ``frame2``."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rpy2), np.array(self.xyz2))


def _triple(value, what: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(number) for number in (() if isinstance(value, str) else value))
    except (TypeError, ValueError):
        raise InputError(f"{what} needs three numbers, got {value!r}") from None
    if not np.isfinite([x, y, z]).all():
        raise InputError(f"{what} has a number that is not finite: {value!r}")
    return x, y, z
