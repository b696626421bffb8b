"""Lie-group formulas where Pinocchio's lose digits: Lie brackets, and turns in a plane without cancellation.

Configurations are moved and compared by :func:`integrate`, :func:`difference` and :func:`interpolate` in all of the
package, never by Pinocchio's functions of the same names.
"""

from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin


def integrate(model: pin.Model, q, xi) -> np.ndarray:
    """q ⊕ ξ, shape (nq,)."""
    if model.nq == model.nv:
        return q + xi
    out = pin.integrate(model, q, xi)
    PlaneTurns.of(model).integrate(q, xi, out)
    return out


def difference(model: pin.Model, q0, q1) -> np.ndarray:
    """ξ with q0 ⊕ ξ = q1, shape (nv,)."""
    if model.nq == model.nv:
        return q1 - q0
    out = pin.difference(model, q0, q1)
    PlaneTurns.of(model).difference(q0, q1, out)
    return out


def interpolate(model: pin.Model, q0, q1, share: float) -> np.ndarray:
    """The configuration at a share of the way from one to another, shape (nq,)."""
    return integrate(model, q0, share * difference(model, q0, q1))


def structure_constants(model: pin.Model):
    """C, shape (nv, nv, nv), with [x, y] = Σ_i x_i C_i y for tangent vectors of a model's configurations: 0, 1 or -1.

    Derivatives of charts are computed from them, as Pinocchio's own (``dDifference``) have errors up to 5e-7 at
    rotations near 1e-3 rad. C_i is the derivative of Ad exp(s e_i) with respect to s, rounded to integers.
    """
    q, nv, s = pin.neutral(model), model.nv, 1e-3
    C = np.zeros((nv, nv, nv))
    for i, unit in enumerate(s * np.eye(nv)):
        turned = [pin.dIntegrate(model, q, sign * unit, pin.ArgumentPosition.ARG0) for sign in (-1.0, 1.0)]
        C[i] = np.round((turned[0] - turned[1]) / (2.0 * s))
    return C


class PlaneTurns:
    """The joints of a model that turn in a plane, as parts of its configurations and tangent vectors.

    These are continuous joints, SO(2), with (cos θ, sin θ), and planar joints, SE(2), with (x, y, cos θ, sin θ), whose
    tangent vector (x, y, w) is in the axes of the first configuration. Turns of about 1e-8 rad are typical of charts
    centred at a prediction: there Pinocchio's logarithm of SO(2) is zero where the cosine is rounded above 1, and its
    exponential and logarithm of SE(2) lose half the digits, and some at 1e-4 rad.
    """

    def __init__(self, model: pin.Model):
        joints = _simple(list(model.joints)[1:]) if model.nq != model.nv else []  # with nq = nv, none has a cosine
        self._continuous = [(joint.idx_q, joint.idx_v) for joint in joints if (joint.nq, joint.nv) == (2, 1)]
        planar = [joint for joint in joints if joint.shortname() == "JointModelPlanar"]
        self._planar = [(slice(joint.idx_q, joint.idx_q + 4), slice(joint.idx_v, joint.idx_v + 3)) for joint in planar]

    @staticmethod
    def of(model: pin.Model) -> "PlaneTurns":
        """Those of a model, found once."""
        return _FOUND.get(model) or _FOUND.setdefault(model, PlaneTurns(model))

    def integrate(self, q, xi, out) -> None:
        """Write the part of planar joints of q ⊕ ξ into `out`."""
        for at, along in self._planar:
            x, y, w = xi[along]
            half = 0.5 * w
            s, k = np.sinc(w / np.pi), np.sin(half) * np.sinc(half / np.pi)  # sin w / w, (1 - cos w) / w
            cos, sin = q[at][2:]
            dx, dy = s * x - k * y, k * x + s * y
            c, s = cos * np.cos(w) - sin * np.sin(w), sin * np.cos(w) + cos * np.sin(w)
            length = np.hypot(c, s)
            out[at] = (q[at][0] + cos * dx - sin * dy, q[at][1] + sin * dx + cos * dy, c / length, s / length)

    def difference(self, q0, q1, out) -> None:
        """Write the part of all of them of ξ with q0 ⊕ ξ = q1 into `out`."""
        for at, along in self._continuous:
            out[along] = _turn(*q0[at : at + 2], *q1[at : at + 2])
        for at, along in self._planar:
            (cos, sin), (c, s) = q0[at][2:], q1[at][2:]
            dx, dy = q1[at][:2] - q0[at][:2]
            x, y = cos * dx + sin * dy, cos * dy - sin * dx
            half = 0.5 * _turn(cos, sin, c, s)
            scale = np.cos(half) / np.sinc(half / np.pi)  # w/2 cot(w/2)
            out[along] = (scale * x + half * y, scale * y - half * x, 2.0 * half)


_FOUND: WeakKeyDictionary[pin.Model, PlaneTurns] = WeakKeyDictionary()


def _simple(joints) -> list:
    """The joints, with the parts of composite ones in their place."""
    found: list = []
    for joint in joints:
        if joint.shortname() == "JointModelComposite":
            found += _simple((joint.extract() if hasattr(joint, "extract") else joint).joints)
        else:
            found.append(joint)
    return found


def _turn(cos, sin, c, s):
    return np.arctan2(cos * s - sin * c, cos * c + sin * s)
