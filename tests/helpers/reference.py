"""The equations of a mechanism by Pinocchio, and the laws of forces by hand: nothing of it is compiled."""

import numpy as np
import pinocchio as pin

from helpers.laws import derivatives_by_hand, torques_by_hand
from pinconsist.mechanism.axes import rnea_derivatives
from pinconsist.mechanism.forces import model_forces
from pinconsist.mechanism.joint_constraints import Coupling, Drive
from pinconsist.mechanism.loops import Length, Loop, Position, RotationVector
from pinconsist.mechanism.system import MechanismSystem


class ByPinocchio(MechanismSystem):
    """The same equations as in C++, to be compared with them."""

    def evaluate(self, t, p, v, a):
        f = pin.rnea(self.model, self.data, p, v, a) - torques_by_hand(self.mechanism, t, p, v)
        phi, J = self._kept(t, p)
        return f, phi, J.T, J @ v + self.rows.time_rate(t, p)[self.kept]

    def linearize(self, t, p, v, a, lam, c, A):
        f_q, f_v = rnea_derivatives(self.model, self.data, p, v, a)
        M = self.data.M.copy()
        for record in (*model_forces(self.model), *self.mechanism.forces):
            by_q, by_v = derivatives_by_hand(record, self.model, t, p, v)
            f_q -= by_q
            f_v -= by_v
        A[:] = M + c * (f_v + c * f_q)
        return self._kept(t, p)[1]

    def constraint(self, t, p, rate):
        phi, J = self._kept(t, p)
        return phi, J @ rate + self.rows.time_rate(t, p)[self.kept]

    def acceleration_bias(self, t, p, v):
        pin.forwardKinematics(self.model, self.data, p, v, np.zeros(self.nv))
        return np.concatenate([np.zeros(0), *(self._bias(each, t, p, v) for each in self.rows.closures)])[self.kept]

    def _kept(self, t, q):
        pin.computeJointJacobians(self.model, self.data, q)
        parts = [self._rows(*each, t, q) for each in self.kept_rows._closures]
        return stacked(parts, self.nv)

    def _rows(self, closure, local, near, t, q):
        if near:  # combinations of the rows of Pinocchio's constraints
            rows = [(matrix @ phi, matrix @ J) for matrix, ends in near for phi, J in [self._constraint(matrix, ends)]]
            return sum(phi for phi, _ in rows), sum(J for _, J in rows)
        if isinstance(closure.loop, Coupling):
            return coupling(self.model, closure.loop, q)
        if isinstance(closure.loop, Drive):
            return drive(self.model, closure.loop, q, t)
        if isinstance(closure.loop, Loop):
            d, J = self._constraint(np.eye(3), closure.ends())
            length = closure.translation.length
            return np.array([(d @ d - length**2) / (2 * length)]), (d @ J / length)[None]
        phi, J = closure.evaluate(q, t)
        return phi[local], J[local]

    def _constraint(self, matrix, ends):
        record = pin.PointAnchorConstraintModel if matrix.shape[1] == 3 else pin.FrameAnchorConstraintModel
        constraint = record(self.model, ends[0], pin.SE3(ends[1]), ends[2], pin.SE3(ends[3]))
        own = constraint.createData()
        constraint.calc(self.model, self.data, own)
        J = constraint.jacobian(self.model, self.data, own).reshape(-1, self.nv)
        return np.array(own.constraint_position_error), np.array(J)

    def _bias(self, closure, t, q, v):
        if isinstance(closure.loop, Coupling):
            return coupling_bias(self.model, closure.loop, q, v)
        if isinstance(closure.loop, Drive):
            return np.array([-derivative(closure.loop, "acceleration", t)])
        if not isinstance(closure.loop, Loop):
            return closure.acceleration_bias(t, q, v)
        p1, R1, v1, w1, a1, b1 = self._motion(closure.joint1, closure.place1)
        p2, R2, v2, w2, a2, b2 = self._motion(closure.joint2, closure.place2)
        r, rd, W1 = p2 - p1, v2 - v1, pin.skew(w1)
        d, dd = R1.T @ r, R1.T @ (rd - W1 @ r)
        ddd = R1.T @ (a2 - a1 - pin.skew(b1) @ r - 2 * W1 @ rd + W1 @ (W1 @ r))
        R, W, rate = R1.T @ R2, pin.skew(R1.T @ (w2 - w1)), R1.T @ (b2 - b1 - W1 @ w2)
        if isinstance(closure.translation, Length):
            return np.array([(dd @ dd + d @ ddd) / closure.translation.length])
        assert isinstance(closure.translation, Position)
        found = [closure.translation.directions @ ddd]
        if isinstance(closure.rotation, RotationVector):
            found.append(rate)
        elif closure.rotation is not None:
            a = R @ closure.rotation.axis2
            found.append(closure.rotation.directions @ (W @ (W @ a) + pin.skew(rate) @ a))
        return np.concatenate(found)

    def _motion(self, joint, placement):
        """Position, axes, velocity, spin, classical acceleration and spin rate of an anchor, in world axes."""
        pose, where = self.data.oMi[joint] * placement, (joint, placement, pin.LOCAL_WORLD_ALIGNED)
        velocity = pin.getFrameVelocity(self.model, self.data, *where)
        acceleration = pin.getFrameClassicalAcceleration(self.model, self.data, *where)
        return pose.translation, pose.rotation, *velocity.np.reshape(2, 3), *acceleration.np.reshape(2, 3)


def _sum(model, shares, q):
    """Σ share · q of joints that count their turns or not, and its gradient."""
    value, gradient = 0.0, np.zeros(model.nv)
    for joint, share in shares.items():
        i = model.getJointId(joint)
        at = model.idx_qs[i]
        value += share * (q[at] if model.nqs[i] == 1 else np.arctan2(q[at + 1], q[at]))
        gradient[model.idx_vs[i]] = share
    return value, gradient


def _law(loop):
    return np.polynomial.Polynomial([loop.offset, loop.ratio, *loop.higher])


def coupling(model, loop, q):
    """Φ, to the nearest turn if the first joint does not count them, and J."""
    (mine, J), (other, slope) = (_sum(model, shares, q) for shares in loop.shares)
    gap = mine - _law(loop)(other)
    if model.nqs[model.getJointId(next(iter(loop.shares[0])))] == 2:
        gap = np.remainder(gap + np.pi, 2 * np.pi) - np.pi
    return np.array([gap]), (J - _law(loop).deriv()(other) * slope)[None]


def coupling_bias(model, loop, q, v):
    other, gradient = _sum(model, loop.shares[1], q)
    return np.array([-_law(loop).deriv(2)(other) * (gradient @ v) ** 2])


def drive(model, loop, q, t):
    """Φ, to the nearest turn if the joint does not count them, and J."""
    at, J = _sum(model, {loop.joint: 1.0}, q)
    gap = at - loop.curve(t)
    if model.nqs[model.getJointId(loop.joint)] == 2:
        gap = np.remainder(gap + np.pi, 2 * np.pi) - np.pi
    return np.array([gap]), J[None]


def derivative(loop, field, t):
    """The rate or acceleration of a drive's curve, of which there are functions."""
    return (getattr(loop, field) or getattr(loop.curve, field))(t)


def stacked(parts, nv):
    if not parts:
        return np.zeros(0), np.zeros((0, nv))
    return tuple(np.concatenate(each) for each in zip(*parts, strict=True))
