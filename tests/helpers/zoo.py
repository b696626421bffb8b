"""Problems with answers that do not come from pinconsist: hand-derived rods in a plane, reduced to one coordinate.

Absolute angles φ about +y; a rod points along e(φ) = (cos φ, -sin φ) in the x-z plane, gravity along -z.
"""

from __future__ import annotations

import numpy as np
from scipy.integrate import solve_ivp

import pinconsist as pc

G = 9.81


def e(phi):
    return np.array([np.cos(phi), -np.sin(phi)])


def de(phi):
    return np.array([-np.sin(phi), -np.cos(phi)])


class _TwoRods:
    """A crank and a rod in series, in absolute angles, and the position of their end from a third coordinate."""

    T = np.array([[1.0, 0, 0], [1.0, 1.0, 0], [0, 0, 1.0]])  # absolute angles from q

    def mass(self, x):
        (l1, l2, *_), (m1, m2, *_) = self.l, self.m
        c = m2 * l1 * l2 / 2 * np.cos(x[0] - x[1])
        return np.array([[m1 * l1**2 / 3 + m2 * l1**2, c, 0], [c, m2 * l2**2 / 3, 0], [0, 0, self.third_mass]])

    def bias(self, x, xd):
        (l1, l2, *_), (m1, m2, *_) = self.l, self.m
        s = m2 * l1 * l2 / 2 * np.sin(x[0] - x[1])
        weight = G * np.array([m1 * l1 / 2 + m2 * l1, m2 * l2 / 2, self.third_moment])
        return np.array([s * xd[1] ** 2, -s * xd[0] ** 2, 0]) - weight * np.cos(x)

    def constraint(self, x):
        return self.l[0] * e(x[0]) + self.l[1] * e(x[1]) - self.third(x[2])[0]

    def jacobian(self, x):
        return np.column_stack([self.l[0] * de(x[0]), self.l[1] * de(x[1]), -self.third(x[2])[1]])

    def jacobian_rate(self, x, xd):
        return np.column_stack([-self.l[i] * e(x[i]) * xd[i] for i in (0, 1)] + [-self.third(x[2])[2] * xd[2]])


class FourBar(_TwoRods):
    """Crank 1 m, coupler 2 m, rocker 1.5 m on 2.2 m; q = (crank, coupler relative to it, rocker)."""

    l, m, ground = (1.0, 2.0, 1.5), (1.0, 2.0, 1.5), 2.2
    third_mass = property(lambda self: self.m[2] * self.l[2] ** 2 / 3)
    third_moment = property(lambda self: self.m[2] * self.l[2] / 2)

    def third(self, angle):
        """The position of the rocker's end, and its first two derivatives."""
        return np.array([self.ground, 0]) + self.l[2] * e(angle), self.l[2] * de(angle), -self.l[2] * e(angle)


class SliderCrank(_TwoRods):
    """Crank 0.3 m, rod 0.9 m, piston along x; q = (crank, rod relative to it, piston)."""

    third_moment = 0.0

    def __init__(self, masses, lengths=(0.3, 0.9)):
        self.m, self.l, self.third_mass = masses, lengths, masses[2]

    def third(self, place):
        """The position of the piston, and its first two derivatives."""
        return np.array([place, 0]), np.array([1.0, 0]), np.zeros(2)


def reduced_motion(linkage, q0, rate0, span):
    """A function of times that returns rows (q, v, Jᵀλ), by scipy's DOP853 on the crank angle only, rtol 1e-12.

    The other two coordinates follow from the closed loop by Newton's method; Jᵀλ = M q'' + bias in coordinates q.
    """
    follow = {"x": linkage.T @ q0}

    def close(angle):
        x = follow["x"].copy()
        x[0] = angle
        for _ in range(50):
            gap = linkage.constraint(x)
            if np.abs(gap).max() < 1e-15:
                break
            x[1:] -= np.linalg.solve(linkage.jacobian(x)[:, 1:], gap)
        follow["x"] = x
        return x

    def kinematics(angle, rate):
        x = close(angle)
        C = linkage.jacobian(x)
        k = np.concatenate(([1.0], -np.linalg.solve(C[:, 1:], C[:, 0])))
        xd = k * rate
        kd = np.concatenate(([0.0], -np.linalg.solve(C[:, 1:], linkage.jacobian_rate(x, xd) @ k)))
        return x, xd, k, kd

    def acceleration(angle, rate):
        x, xd, k, kd = kinematics(angle, rate)
        M, b = linkage.mass(x), linkage.bias(x, xd)
        angular = -k @ (M @ kd * rate + b) / (k @ M @ k)
        return angular, x, xd, k * angular + kd * rate

    angle_and_rate = solve_ivp(
        lambda t, y: [y[1], acceleration(*y)[0]],
        span, [q0[0], rate0], "DOP853", dense_output=True, rtol=1e-12, atol=1e-13,
    ).sol  # fmt: skip
    S = np.linalg.inv(linkage.T)

    def rows_at(times):
        follow["x"] = linkage.T @ q0
        rows = []
        for angle, rate in angle_and_rate(times).T:
            _, x, xd, xdd = acceleration(angle, rate)
            forces = linkage.T.T @ (linkage.mass(x) @ xdd + linkage.bias(x, xd))
            rows.append((S @ x, S @ xd, forces))
        return tuple(np.array(column) for column in zip(*rows, strict=True))

    return rows_at


def reduced_solution(linkage, q0, rate0, times):
    """The rows of `reduced_motion` at times from the first to the last."""
    return reduced_motion(linkage, q0, rate0, (times[0], times[-1]))(times)


def scaled_bead():
    """(problem, exact): a bead driven round the unit circle; its velocity has units that depend on t and p."""
    alpha = 0.8  # rad/s²

    def scale(t, p):
        return 1.5 + p[0] / 2 + t / 4

    def F(t, p, v):
        s = scale(t, p)
        return alpha * np.array([-p[1], p[0]]) / s - v * (s * v[0] / 2 + 1 / 4) / s

    def exact(t):
        angle, speed = t + alpha * t**2 / 2, 1 + alpha * t
        p = np.array([np.cos(angle), np.sin(angle)])
        return p, speed * np.array([-p[1], p[0]]) / scale(t, p), -(speed**2)

    problem = pc.HessenbergProblem(
        U=lambda t, p, v: scale(t, p) * v,
        F=F,
        G=lambda t, p, v: p[:, None] / scale(t, p),
        R=lambda t, p: np.array([(p @ p - 1) / 2]),
        R_p=lambda t, p: p[None],
    )
    return problem, exact
