"""The rows that a system integrates, as fast as Python can ask Pinocchio for them.

Where a loop is closed (d = 0, R = 1) the exact Jacobian of :mod:`pinconsist.mechanism.loops` is a selection of the
rows of Pinocchio's own, and Φ has the zeros of Pinocchio's own position error. Newton's solution is closed, so both
pairs have the same solution; the selection costs no arithmetic. Only what the kept rows need is evaluated: a hinge
whose tilts cannot occur (a planar loop) costs what a point costs.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .loops import LoopRows, anchor_constraint


class KeptRows:
    """Φ and J of some rows of the loops of a model, for use near closed configurations.

    Parameters
    ----------
    model : pin.Model
    rows : LoopRows
        All rows of the loops.
    kept : ndarray of int
        Indices of the rows wanted, ascending.
    """

    def __init__(self, model: pin.Model, rows: LoopRows, kept):
        self.model, self._rows, self._kept = model, rows, kept
        self._models, self._datas, indices, size, selects = (
            pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData(), [], 0, True,
        )  # fmt: skip
        for closure in rows.closures:
            start = rows.slices[closure.loop.name].start
            local = [row - start for row in kept if 0 <= row - start < len(closure.loop.rows)]
            if not local:
                continue
            if closure.moving:
                selects = False
                continue
            rotates = max(local) > 2
            selects &= closure.loop.kind == "frame" or (closure.loop.kind in ("point", "hinge") and not rotates)
            self._models.append(pin.ConstraintModel(anchor_constraint(model, closure, rotates)))
            indices += [size + row for row in local]
            size += 6 if rotates else 3
        if not selects:  # tilts, distances, drives: the exact rows
            self.evaluate = self._evaluate_exact
        for constraint in self._models:
            self._datas.append(constraint.createData())
        self._pairs = list(zip(self._models, self._datas, strict=True))
        self._values = [data.extract() for data in self._datas]  # references, which calc refreshes
        self._index = _as_slice(np.array(indices, dtype=int))

    @property
    def constraints(self):
        """Pinocchio's constraint models and data behind the fast rows."""
        return self._models, self._datas

    def evaluate(self, data: pin.Data, q, t):
        """(Φ, J), shapes (nc,) and (nc, nv), after ``pin.computeJointJacobians`` on `data`."""
        values = self._values
        if not values:
            return np.zeros(0), np.zeros((0, self.model.nv))
        for constraint, constraint_data in self._pairs:
            constraint.calc(self.model, data, constraint_data)
        J = pin.getConstraintsJacobian(self.model, data, self._models, self._datas)
        if len(values) == 1:
            phi = values[0].constraint_position_error
        else:
            phi = np.concatenate([value.constraint_position_error for value in values])
        return phi[self._index], J[self._index]

    def _evaluate_exact(self, data, q, t):
        phi, J = self._rows.evaluate(data, q, t)
        return phi[self._kept], J[self._kept]


def _as_slice(indices):
    """A slice where the indices are equidistant (a view instead of a copy), else the indices themselves."""
    steps = set(np.diff(indices).tolist())
    if len(indices) and len(steps) <= 1:
        step = steps.pop() if steps else 1
        return slice(int(indices[0]), int(indices[-1]) + 1, step)
    return indices
