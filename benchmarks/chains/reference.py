"""The motion of a mechanism by scipy on the index-1 equations, to be compared with."""

from __future__ import annotations

import time

import numpy as np
import pinocchio as pin
from scipy.integrate import DOP853, Radau
from scipy.linalg import qr
from scipy.linalg.lapack import dgesv

from .equations import force_of, rows_of

TOLERANCE = 1e-12
DEPENDENT = 1e-9
"""Pivots of the rows, relative to the largest, below which they follow from others."""
PIECES = 40
"""Of the span: at the end of each the state is put on the constraints anew."""
STIFF = 30_000
"""Evaluations over the span beyond which Radau takes over from DOP853."""


SINGULAR, TOO_LONG = "singular", "not done in its time"


class Broken(Exception):
    """The reference does not reach the end: a singular configuration, or not within its time."""


class Kinematics:
    """How configurations move, by the numbers of their joints: q' = T(q) v."""

    def __init__(self, model):
        self.plain, self.turning, self.T = [], [], np.zeros((model.nq, model.nv))
        for joint in model.joints[1:]:
            at, along = slice(joint.idx_q, joint.idx_q + joint.nq), slice(joint.idx_v, joint.idx_v + joint.nv)
            if joint.nq == joint.nv:
                self.T[at, along] = np.eye(joint.nv)
                self.plain.append((at, along))
            else:
                kind = _plane if joint.shortname() == "JointModelPlanar" else {2: _circle, 4: _ball, 7: _free}[joint.nq]
                self.turning.append((kind, at, along))

    def rate(self, q, v):
        """q' at a velocity."""
        for kind, at, along in self.turning:
            self.T[at, along] = kind(q[at])
        return self.T @ v

    def difference(self, q0, q1):
        """The small tangent vector at q0 that leads to q1."""
        self.rate(q0, np.zeros(self.T.shape[1]))
        return np.linalg.pinv(self.T) @ (q1 - q0)

    def sizes(self, q):
        """What errors of each tangent coordinate are measured by: its value; 1 rad where turns are not counted."""
        sizes = np.ones(self.T.shape[1])
        for at, along in self.plain:
            sizes[along] = np.abs(q[at])
        for kind, at, along in self.turning:
            if moved := PLACES.get(kind):
                sizes[along][:moved] = np.linalg.norm(q[at][:moved])
        return sizes

    def normalized(self, q):
        q = q.copy()
        for kind, at, _ in self.turning:
            turn = q[at][PLACES.get(kind, 0) :]
            turn /= np.linalg.norm(turn)
        return q


def _circle(q):
    return [[-q[1]], [q[0]]]


def _plane(q):
    c, s = q[2:]
    return [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, -s], [0.0, 0.0, c]]


def _ball(q):
    x, y, z, w = 0.5 * q
    return [[w, -z, y], [z, w, -x], [-y, x, w], [-x, -y, -z]]


def _free(q):
    turn = np.zeros((7, 6))
    turn[:3, :3], turn[3:, 3:] = pin.Quaternion(q[3:]).matrix(), _ball(q[3:])
    return turn


PLACES = {_plane: 2, _free: 3}
"""How many numbers, before those of the turn, are a place."""


class Equations:
    """M v' + nle = τ + Jᵀλ, Φ(t, q) = 0 of a mechanism."""

    def __init__(self, mech):
        self.model = model = mech.model
        self.data, self.other = model.createData(), model.createData()
        self.kinematics = Kinematics(model)
        self.loops = [rows_of(model, loop) for loop in mech.loops]
        self.forces = [force_of(model, force) for force in mech.forces]
        self.still = np.zeros(model.nv)

    def gap(self, t, q):
        """The largest |Φ|, m or rad."""
        return np.abs(self.rows(t, q, self.still)[0]).max(initial=0.0)

    def rows(self, t, q, v):
        """(Φ, J, Φ_t, γ) of all loops."""
        pin.forwardKinematics(self.model, self.data, q, v, self.still)
        pin.computeJointJacobians(self.model, self.data, q)
        parts = [loop(self.data, t, q, v) for loop in self.loops]
        return [np.concatenate(part) for part in zip(*parts, strict=True)]

    def independent(self, J):
        """The rows that do not follow from others."""
        _, R, order = qr(J.T, mode="economic", pivoting=True)
        pivots = np.abs(np.diag(R))
        return np.sort(order[: np.count_nonzero(pivots > DEPENDENT * pivots.max(initial=0.0))])

    def solve(self, t, q, v, kept):
        """(v', Jᵀλ), by the rows that are kept."""
        J, bias = (part[kept] for part in self.rows(t, q, v)[1::2])
        load = -pin.nle(self.model, self.other, q, v)
        for force in self.forces:
            load += force(self.data, t, q, v)
        M = pin.crba(self.model, self.other, q)
        a = _kkt(M, J, load, -bias)
        return a, M @ a - load

    def closed(self, t, q, v):
        """(q, v, kept): a state put on the constraints in the mass metric, and the rows that are independent there."""
        for _ in range(4):
            phi, J, *_ = self.rows(t, q, v)
            kept, M = self.independent(J), pin.crba(self.model, self.other, q)
            move = _kkt(M, J[kept], self.still, -phi[kept])
            q = self.kinematics.normalized(q + self.kinematics.rate(q, move))
        for _ in range(2):
            _, J, rate, _ = self.rows(t, q, v)
            v = v - _kkt(M, J[kept], self.still, (J @ v + rate)[kept])
        return q, v, kept


def _kkt(M, J, load, along):
    """The solution a of M a = load + Jᵀλ, J a = along."""
    n, m = len(load), len(along)
    K = np.zeros((n + m, n + m))
    K[:n, :n], K[:n, n:], K[n:, :n] = M, -J.T, J
    *_, x, info = dgesv(K, np.concatenate((load, along)))
    if info or not np.isfinite(x).all():
        raise Broken(SINGULAR)
    return x[:n]


class Reference:
    """The motion of a mechanism from a state, by DOP853 or, where that takes too long, Radau.

    `until` is what it reached, and `why` not the end, or an empty string. `tol` is scipy's tolerance, `seconds` how
    much CPU time it may take. Steps end at the times `ends`, where forces begin and end.
    """

    def __init__(self, mech, q, v, end, *, tol=TOLERANCE, seconds=8.0, ends=()):
        self.equations, self.nq, self.end, self.tol = Equations(mech), mech.nq, end, tol
        self._ends = np.unique(np.append(np.linspace(0.0, end, PIECES + 1)[1:], ends))
        self.until, self.why, self._pieces = 0.0, "", []
        self._due, self._count = time.process_time() + seconds, 0
        try:
            *self.start, self._kept = self.equations.closed(0.0, q, v)
            self._integrate()
        except Broken as broken:
            self.why = str(broken)

    def at(self, t):
        """(q, v, Jᵀλ) at a time not after `until`."""
        i = min(np.searchsorted([dense.t for dense, _ in self._pieces], t), len(self._pieces) - 1)
        dense, kept = self._pieces[i]
        y = dense(t)
        q, v = self.equations.kinematics.normalized(y[: self.nq]), y[self.nq :]
        return q, v, self.equations.solve(t, q, v, kept)[1]

    def _rate(self, t, y):
        self._count += 1
        if self._count % 100 == 0 and time.process_time() > self._due:
            raise Broken(TOO_LONG)
        q, v = y[: self.nq], y[self.nq :]
        try:
            return np.concatenate((self.equations.kinematics.rate(q, v), self.equations.solve(t, q, v, self._kept)[0]))
        except Broken:  # a stage too far away: scipy takes a shorter step
            return np.full(len(y), np.nan)

    def _integrate(self):
        y, method, step = np.concatenate(self.start), DOP853, None
        for end in self._ends:
            q, v, self._kept = self.equations.closed(self.until, y[: self.nq], y[self.nq :])
            y = np.concatenate((q, v))
            while self.until < end:
                solver = self._solver(method, y, end, step)
                while solver.status == "running" and not (method is DOP853 and self._is_stiff()):
                    try:
                        with np.errstate(all="ignore"):
                            solver.step()
                    except ValueError as error:  # scipy's Radau, of derivatives that are not finite
                        raise Broken(SINGULAR) from error
                    if solver.status == "failed":
                        raise Broken("its step size falls to zero")
                    self._pieces.append((solver.dense_output(), self._kept))
                    self.until, y = solver.t, solver.y
                    step = solver.step_size if solver.status == "running" else max(step or 0.0, solver.step_size)
                if solver.status == "running":
                    method, step, self.tol = Radau, None, max(self.tol, 1e-10)

    def _solver(self, method, y, end, step):
        step = step and min(step, end - self.until)
        with np.errstate(all="ignore"):
            return method(self._rate, self.until, y, end, rtol=self.tol, atol=self.tol, first_step=step)

    def _is_stiff(self):
        """Whether an explicit method would need too many evaluations to reach the end."""
        return self._count > STIFF * max(self.until / self.end, 1.0 / PIECES)
