"""Derivatives of inverse dynamics for all types of joints, also those whose axes depend on their own position.

Such joints are universal ones, spherical ones by angles, ellipsoids and most composite ones. Pinocchio's derivatives
take the motion subspace of each joint as constant in the axes of the moved body, and lack terms in the columns of
these joints. Here these columns are differences. In C++ (``engine/axes.hpp``) the lacking terms are added.
"""

from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from .lie import integrate
from .motion import first

SMOOTH = 5e-3  # step of differences of kinematics, rad or lengths of the mechanism: errors near 1e-13
CONSTANT = 1e-10  # change of a motion subspace that is rounding
_FOUND: WeakKeyDictionary[pin.Model, np.ndarray] = WeakKeyDictionary()


def turning_columns(model: pin.Model) -> np.ndarray:
    """The velocity columns of the joints whose axes depend on their own position, ascending."""
    if (known := _FOUND.get(model)) is None:
        known = _FOUND[model] = np.array(
            [column for joint in list(model.joints)[1:] for column in _turning(joint)], int
        )
    return known


def _turning(joint) -> range:
    """The velocity columns of a joint if its motion subspace is not constant, at three positions; else none."""
    if joint.nv < 2:
        return range(0)
    alone = pin.Model()
    alone.addJoint(0, joint, pin.SE3.Identity(), "joint")
    own, neutral, subspaces = alone.joints[1], pin.neutral(alone), []
    for i in range(3):
        data, way = own.createData(), np.sin(2.3 * np.arange(1, 1 + joint.nv) + 7.0 * i)
        own.calc(data, integrate(alone, neutral, way), np.zeros(joint.nv))
        subspaces.append(np.array(data.S))
    turns = np.ptp(subspaces, axis=0).max() > CONSTANT
    return range(joint.idx_v, joint.idx_v + joint.nv) if turns else range(0)


def rnea_derivatives(model: pin.Model, data: pin.Data, q, v, a) -> tuple[np.ndarray, np.ndarray]:
    """∂f/∂q and ∂f/∂v of f = M a + nle, each (nv, nv); M is in ``data.M`` after it."""
    pin.computeRNEADerivatives(model, data, q, v, a)
    by_q, by_v = data.dtau_dq.copy(), data.dtau_dv.copy()
    columns = turning_columns(model)
    if columns.size:
        M, faster = data.M.copy(), 1.0 + np.abs(v).max()  # f is quadratic in v: differences are exact for any step
        for column in columns:
            unit = np.arange(model.nv) == column
            by_q[:, column] = first(lambda s, e=unit: pin.rnea(model, data, integrate(model, q, s * e), v, a), SMOOTH)
            forward, backward = (pin.rnea(model, data, q, v + side * faster * unit, a) for side in (1.0, -1.0))
            by_v[:, column] = (forward - backward) / (2.0 * faster)
        data.M[:] = M
    return by_q, by_v
