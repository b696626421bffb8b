"""The rows that a system integrates, as fast as Python can ask Pinocchio for them.

Where a loop is closed the exact Jacobian of :mod:`pinconsist.mechanism.constraints.loops` is a selection of the rows of
Pinocchio's own constraints or a fixed linear map of them, and Φ has the zeros of the same rows of Pinocchio's own
position errors. Newton's solution is closed, so both pairs have the same solution; the selection costs no arithmetic.
Only what the kept rows need is evaluated: a hinge whose tilts cannot occur (a planar loop) costs what a point costs.

What an axis of body 2 does is read from a point on it, 1 m from the anchor: R axis2 = d(that point) − d(anchor).
Distances, drives, couplings and constraints of the user's own are no such maps; they are evaluated as they stand.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from .loop_rows import Length, Place, Turn
from .loops import LoopRows, anchor_constraint, point_constraint

POSE, ZERO = None, np.zeros(3)


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
        self.model, self._closures = model, []
        self._models, self._datas = pin.StdVec_ConstraintModel(), pin.StdVec_ConstraintData()
        self._pieces, size = [], 0  # what gives the rows in their order, from Pinocchio's rows stacked
        for closure in rows.closures:
            start = rows.slices[closure.loop.name].start
            local = [row - start for row in kept if 0 <= row - start < len(closure.turns)]
            if not local:
                continue
            self._closures.append((closure, local))
            if not isinstance(getattr(closure, "place", None), Place):
                self._pieces.append(_Exact(closure, local))
                continue
            parts = _near_closed(closure, local)
            for shift, _ in parts:
                self._models.append(pin.ConstraintModel(_constraint(model, closure, shift)))
            matrix = np.hstack([matrix for _, matrix in parts])
            self._add_mapped(matrix, size)
            size += matrix.shape[1]
        for constraint in self._models:
            self._datas.append(constraint.createData())
        self._pairs = [(one.extract(), data.extract()) for one, data in zip(self._models, self._datas, strict=True)]
        self._values = [data.constraint_position_error for _, data in self._pairs]  # views, which calc refreshes
        self.evaluate = self._fastest()
        """(Φ, J) of (data, q, t), shapes (nc,) and (nc, nv), after ``pin.computeJointJacobians`` on `data`."""

    def _add_mapped(self, matrix, offset):
        """Rows ``matrix @ (Pinocchio's rows from offset on)``; selections that follow each other become one."""
        if not _selects(matrix):
            self._pieces.append(_Map(matrix, offset))
            return
        indices = offset + np.argmax(matrix, axis=1)
        if self._pieces and isinstance(self._pieces[-1], _Selection):
            indices = np.concatenate((self._pieces.pop().indices, indices))
        self._pieces.append(_Selection(indices))

    @property
    def constraints(self):
        """Pinocchio's constraint models and data behind the fast rows."""
        return self._models, self._datas

    def hand_over(self, twin) -> None:
        """Tell the compiled twin of these rows; what it has not got it asks the closures for."""
        for closure, local in self._closures:
            if isinstance(place := getattr(closure, "place", None), Place):
                for i, (shift, matrix) in enumerate(_near_closed(closure, local)):
                    shifted = closure.place2 if shift is POSE else closure.place2 * pin.SE3(np.eye(3), shift)
                    ends = closure.joint1, closure.place1.homogeneous, closure.joint2, shifted.homogeneous
                    twin.add_anchored(*ends, matrix, i == 0)
            elif isinstance(place, Length):
                ends = closure.joint1, closure.place1.homogeneous, closure.joint2, closure.place2.homogeneous
                twin.add_distance(*ends, place.length)
            elif not (hasattr(closure, "hand_over") and closure.hand_over(twin)):
                twin.add_python_rows(closure, local, closure.moving)

    def _fastest(self):
        """The leanest function that evaluates these rows."""
        if not self._pieces:
            return self._evaluate_nothing
        if len(self._pieces) > 1 or self.model.nv == 1 or not isinstance(self._pieces[0], _Selection):
            return self._evaluate_pieces
        self._index = self._pieces[0].compact()
        return self._evaluate_one if len(self._values) == 1 else self._evaluate_selection

    def _evaluate_nothing(self, data, q, t):
        return np.zeros(0), np.zeros((0, self.model.nv))

    def _evaluate_one(self, data, q, t):
        constraint, constraint_data = self._pairs[0]
        constraint.calc(self.model, data, constraint_data)
        J = constraint.jacobian(self.model, data, constraint_data)
        return self._values[0][self._index], J[self._index]

    def _evaluate_selection(self, data, q, t):
        phi, J = self._pinocchios(data)
        return phi[self._index], J[self._index]

    def _evaluate_pieces(self, data, q, t):
        phi, J = self._pinocchios(data) if self._values else (None, None)
        if len(self._pieces) == 1:
            return self._pieces[0].rows(data, q, t, phi, J)
        values, jacobians = zip(*[piece.rows(data, q, t, phi, J) for piece in self._pieces], strict=True)
        return np.concatenate(values), np.concatenate(jacobians)

    def _pinocchios(self, data):
        for constraint, constraint_data in self._pairs:
            constraint.calc(self.model, data, constraint_data)
        J = pin.getConstraintsJacobian(self.model, data, self._models, self._datas)
        return np.concatenate(self._values), J.reshape(-1, self.model.nv)  # Pinocchio gives one column flat


class _Selection:
    """Some of Pinocchio's rows."""

    def __init__(self, indices):
        self.indices = indices

    def compact(self):
        """The indices; as a slice where they are equidistant, which gives a view instead of a copy."""
        steps = set(np.diff(self.indices).tolist())
        if len(steps) > 1:
            return self.indices
        return slice(int(self.indices[0]), int(self.indices[-1]) + 1, steps.pop() if steps else 1)

    def rows(self, data, q, t, phi, J):
        return phi[self.indices], J[self.indices]


class _Map:
    """Fixed linear combinations of Pinocchio's rows."""

    def __init__(self, matrix, offset):
        self.matrix, self.stretch = matrix, slice(offset, offset + matrix.shape[1])

    def rows(self, data, q, t, phi, J):
        return self.matrix.dot(phi[self.stretch]), self.matrix.dot(J[self.stretch])


class _Exact:
    """Rows that Pinocchio's constraints do not give."""

    def __init__(self, closure, local):
        self.closure, self.all = closure, len(local) == len(closure.turns)
        self.local = np.array(local)

    def rows(self, data, q, t, phi, J):
        phi, J = self.closure.evaluate(data, q, t)
        return (phi, J) if self.all else (phi[self.local], J[self.local])


def _near_closed(closure, local):
    """What the rows `local` of a loop are made of: pairs (shift, matrix), whose rows add up.

    `matrix` is applied to the position of the point at `shift` from anchor 2, or, where this is POSE, to the pose.
    """
    place, turn = closure.place, closure.turn
    n = len(place.directions)
    if turn is None or max(local) < n:
        return [(ZERO, place.directions[local])]
    if isinstance(turn, Turn) and n == 3:
        return [(POSE, np.eye(6)[local])]
    if isinstance(turn, Turn):
        matrix = np.zeros((n + 3, 9))
        matrix[:n, :3], matrix[n:, 6:] = place.directions, np.eye(3)
        return [(ZERO, matrix[local, :3]), (POSE, matrix[local, 3:])]
    matrix = np.zeros((n + len(turn.directions), 6))
    matrix[:n, :3], matrix[n:, :3], matrix[n:, 3:] = place.directions, -turn.directions, turn.directions
    return [(ZERO, matrix[local, :3]), (turn.axis2, matrix[local, 3:])]


def _constraint(model, closure, shift):
    """Pinocchio's constraint between the anchors of a closure, of the pose or of a point."""
    return anchor_constraint(model, closure) if shift is POSE else point_constraint(model, closure, shift)


def _selects(matrix) -> bool:
    """Whether every row picks one column as it stands."""
    return bool(np.isin(matrix, (0.0, 1.0)).all() and (matrix.sum(axis=1) == 1.0).all())
