"""The names of joints, and where their numbers are in q and v."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import pinocchio as pin

from ..errors import InputError
from .checks import finite_array, near, normalized


class JointNames:
    """The part of a :class:`~pinconsist.Mechanism` that reads and fills states by the names of its joints."""

    model: pin.Model
    name: str

    @cached_property
    def joints(self) -> tuple[str, ...]:
        """Joint names, without the ground."""
        return tuple(self.model.names)[1:]

    def columns(self, joint: str) -> slice:
        """The columns of a `joint` in v, in τ and in J, as a slice; InputError where there is no such joint."""
        start = self.model.idx_vs[i := self.joint_index(joint)]
        return slice(start, start + self.model.nvs[i])

    def joint_index(self, joint: str) -> int:
        """The index of a `joint` in ``model.joints``, from 1 on: the ground is 0. Its place in v is :meth:`columns`.

        Raises InputError where there is no such joint; its message names those there are.
        """
        if joint not in self.joints:
            known = ", ".join(self.joints[:12]) + (", …" if len(self.joints) > 12 else "")
            resembling = near(joint, self.joints) if len(self.joints) > 12 else ""
            raise InputError(f"{self.name}: no joint {joint!r}{resembling}; the joints are {known}")
        return self.model.getJointId(joint)

    def configuration(self, values, base=None) -> np.ndarray:
        """A full configuration (nq,), quaternions and (cos, sin) pairs at unit length. The loops are not closed.

        Parameters
        ----------
        values : mapping or array
            Joint name → value, as many numbers as the joint has in q (one angle, rad, where it stores (cos, sin)); or
            a configuration (nq,).
        base : array, optional
            The configuration (nq,) from which the joints come that a mapping does not name. Default ``pin.neutral``.

        Raises
        ------
        InputError
            Unknown joint, wrong size, NaN, a quaternion or pair of length zero.
        """
        start = pin.neutral(self.model) if base is None else np.array(base, float)
        q = self._fill(values, start, "idx_qs", "nqs", "configuration")
        return normalized(self.model, q, self.name)

    def velocity(self, values) -> np.ndarray:
        """A full velocity (nv,). It is not put on the constraints.

        `values` maps joint names to velocities, rad/s or m/s, as many numbers as the joint has degrees of freedom, the
        other joints at rest; or it is a velocity (nv,), which is copied. Raises InputError for an unknown joint, a
        wrong size, NaN.
        """
        return self._fill(values, np.zeros(self.model.nv), "idx_vs", "nvs", "velocity")

    def _fill(self, values, full, starts, sizes, what):
        if isinstance(values, Mapping):
            for joint, value in values.items():
                i = self.joint_index(joint)
                start, size = getattr(self.model, starts)[i], getattr(self.model, sizes)[i]
                value = finite_array(value, f"{what} of joint {joint!r}").ravel()
                if value.size == self.model.nvs[i] == 1 and size == 2:  # Pinocchio's unbounded revolute: cos, sin
                    value = np.array([np.cos(value[0]), np.sin(value[0])])
                if value.size != size:
                    raise InputError(f"{what} of joint {joint!r} needs {size} number(s), got {value.size}")
                full[start : start + size] = value
            return full
        values = finite_array(values, what)
        if values.shape != full.shape:
            raise InputError(f"{what} needs shape {full.shape} for {self.name!r}, got {values.shape}")
        return values


def require_mechanism(mechanism, caller: str) -> None:
    """Raise InputError for anything but a Mechanism."""
    if not isinstance(mechanism, JointNames):
        raise InputError(f"{caller} needs a Mechanism, got {type(mechanism).__name__}; see pinconsist.load()")


def joints_in(mechanism, variations) -> tuple[str, ...]:
    """The joints that have a considerable share in any of the columns of `variations`, (nv,) or (nv, n)."""
    share = np.abs(variations).reshape(mechanism.nv, -1)
    share = (share / np.maximum(share.max(axis=0), 1e-300)).max(axis=1)
    return tuple(joint for joint in mechanism.joints if share[mechanism.columns(joint)].max(initial=0.0) > 0.3)
