"""What a loop file says of the tree itself, because the robot's file has no word for it.

::

    joints:
      hip:   {type: spherical, damping: [0.1, 0.1, 0.2]}   # see pinconsist.formats.joints
      motor: {armature: 0.02}
    gravity: [0, 0, -1.62]
    joint_order: [hip, motor]

``armature``, ``damping`` and ``friction`` replace those of the robot's file: one number for each velocity of the
joint, or one for all of them. ``joint_order`` is the order of the joints in q and v.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import FormatError
from ..mechanism.editing.rebuild import rebuilt
from .joints import check_type
from .reading import near, shown
from .records import known_keys, mapping, name, number_or_numbers, numbers

KEYS = ("joints", "gravity", "joint_order")
VALUES = {
    "armature": ("armature",),
    "damping": ("damping",),
    "friction": ("upperDryFrictionLimit", "lowerDryFrictionLimit"),
}
"""Key of a joint → the vectors of the model that it sets; a second one gets the opposite."""


@dataclass(frozen=True)
class ModelSettings:
    """The settings of one file.

    Attributes
    ----------
    values : dict
        Joint → key of VALUES → number, or a number for each of its velocities.
    gravity : tuple of 3 float or None
        m/s², in world axes.
    order : tuple of str
        All joints, or none.
    """

    values: dict = field(default_factory=dict)
    gravity: tuple[float, float, float] | None = None
    order: tuple[str, ...] = ()

    def applied(self, model: pin.Model, path) -> pin.Model:
        """The model with these settings, which may be `model` itself, changed.

        Raises
        ------
        FormatError
            Unknown joints, wrong numbers of values, an order in which a joint comes before its parent.
        """
        try:
            model = self._ordered(model)
            for joint, given in self.values.items():
                for key, value in given.items():
                    _set(model, joint, key, value)
        except FormatError as error:
            raise FormatError(error.reason, path=path, element=error.element) from error
        if self.gravity is not None:
            model.gravity.linear = np.array(self.gravity)
        return model

    def _ordered(self, model):
        names = list(model.names)[1:]
        if not self.order or list(self.order) == names:
            return model
        if sorted(self.order) != sorted(names):
            strange = [joint for joint in self.order if joint not in names or self.order.count(joint) > 1]
            missing = [joint for joint in names if joint not in self.order]
            reason = f"it must hold each joint once; unknown or twice: {strange}, missing: {missing}"
            raise FormatError(reason, element="joint_order")
        order = [model.getJointId(joint) for joint in self.order]
        for place, joint in enumerate(order):
            parent = model.parents[joint]
            if parent and parent not in order[:place]:
                reason = f"joint {model.names[joint]!r} comes before {model.names[parent]!r}, on which it hangs"
                raise FormatError(reason, element="joint_order")
        return rebuilt(model, {}, order=order)


def model_settings(record: dict) -> tuple[ModelSettings, dict[str, str]]:
    """The settings in a loop file, and the types of joints to replace: name → word of :func:`check_type`."""
    values, types = {}, {}
    for joint, given in mapping(record.get("joints") or {}, "joints", "a joint's name").items():
        element = f"joints: {name(joint, 'joints')}"
        given = mapping(given, element, "type, armature")
        known_keys(given, ("type", *VALUES), element)
        if given.get("type") is not None:
            types[joint] = check_type(given["type"], element)
        values[joint] = {key: _amount(given[key], f"{element}: {key}") for key in VALUES if given.get(key) is not None}
    gravity = record.get("gravity")
    if gravity is not None:
        gravity = numbers(gravity, "gravity")
        if len(gravity) != 3:
            raise FormatError(f"three numbers are needed, not {shown(record['gravity'])}", element="gravity")
    order = record.get("joint_order") or []
    if not isinstance(order, list):
        raise FormatError(f"a list is needed, not {shown(order)}", element="joint_order")
    return ModelSettings(values, gravity, tuple(name(joint, "joint_order") for joint in order)), types


def _amount(value, element):
    amount = number_or_numbers(value, element)
    if min(amount if isinstance(amount, tuple) else (amount,), default=0.0) < 0:
        raise FormatError(f"it is negative: {shown(value)}", element=element)
    return amount


def _set(model, joint, key, value):
    names = tuple(model.names)[1:]
    if joint not in names:
        raise FormatError(f"the model has no joint {joint!r}{near(joint, names)}", element=f"joints: {joint}")
    i = model.getJointId(joint)
    start, size = model.idx_vs[i], model.nvs[i]
    if isinstance(value, tuple) and len(value) != size:
        reason = f"one number or {size} are needed, one for each velocity of the joint; these are {len(value)}"
        raise FormatError(reason, element=f"joints: {joint}: {key}")
    for sign, vector in zip((1, -1), VALUES[key], strict=False):
        getattr(model, vector)[start : start + size] = [
            sign * each for each in (value if isinstance(value, tuple) else (value,) * size)
        ]
