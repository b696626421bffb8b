"""Multipliers at high spin, compared with Lagrange's equations of a symmetric top."""

import numpy as np
import pinocchio as pin
import pytest
from scipy.integrate import solve_ivp

import pinconsist as pc

TURNS = 5


class Top:
    """A symmetric top on a point loop, by Lagrange's equations for its tilt θ in the time τ = w t."""

    length, across, along, mass, gravity, tilt, nod = 0.3, 0.03, 0.04, 1.0, 9.81, 0.7, 4.6

    def __init__(self, w):
        self.w, self.inertia = w, self.across + self.mass * self.length**2
        start = [0.0, self.nod / w]
        self.fall = solve_ivp(
            lambda tau, y: [y[1], self.angles(*y)[2] / w**2], (0.0, 2 * np.pi * TURNS), start,
            method="DOP853", rtol=1e-13, atol=1e-15 * start[1], dense_output=True,
        ).sol  # fmt: skip

    def angles(self, u, du):
        """θ', φ', θ'' and φ'' where the tilt has changed by u."""
        theta, falling = self.tilt + u, du * self.w
        sin, cos = np.sin(theta), np.cos(theta)
        dcos = 2.0 * np.sin(u / 2) * np.sin(self.tilt + u / 2)  # cos(tilt) - cos(θ), without cancellation
        around = self.along * self.w * dcos / (self.inertia * sin**2)
        weight = self.mass * self.gravity * self.length
        tipping = around**2 * sin * cos + (weight - self.along * self.w * around) * sin / self.inertia
        turning = (self.along * self.w / self.inertia - 2 * cos * around) * falling / sin
        return falling, around, tipping, turning

    def force(self, t):
        """The force of the ground along e_θ, e_φ and the axis, N."""
        u, du = self.fall(self.w * t)
        falling, around, tipping, turning = self.angles(u, du)
        sin, cos = np.sin(self.tilt + u), np.cos(self.tilt + u)
        sideways, inward = turning * sin + 2 * falling * around * cos, falling**2 + (around * sin) ** 2
        a = self.length * np.array([tipping - around**2 * sin * cos, sideways, -inward])
        return self.mass * (a + self.gravity * np.array([-sin, 0.0, cos]))

    def mechanism(self):
        model = pin.Model()
        joint = model.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "top")
        inertia = pin.Inertia(self.mass, np.array([0, 0, self.length]), np.diag([self.across] * 2 + [self.along]))
        model.appendBodyToJoint(joint, inertia, pin.SE3.Identity())
        return pc.Mechanism(model, [pc.Loop("tip", "point", "top", "universe")])


@pytest.mark.parametrize(
    ("method", "w", "tol"),
    [
        *((method, w, tol) for method in ("BDF", "Radau") for w in (1e3, 1e5) for tol in (1e-4, 1e-6, 1e-8)),
        *(("Radau", 1e6, tol) for tol in (1e-4, 1e-6, 1e-8)),  # at 1e-8 rounding is in the differences of BDF
    ],
)
def test_multipliers_of_a_fast_top(method, w, tol):
    """Within ten tolerances of the largest force, whatever the speed."""
    top, turned = Top(w), pin.Quaternion(pin.exp3(np.array([Top.tilt, 0.0, 0.0])))
    q0, v0 = np.r_[np.zeros(3), turned.coeffs()], np.array([0, 0, 0, top.nod, 0, w])
    sol = pc.simulate(top.mechanism(), (0.0, TURNS * 2 * np.pi / w), q0, v0, rtol=tol, atol=1e-2 * tol, method=method)
    assert sol.success
    errors, sizes = [], []
    for t, q, lam in list(zip(sol.t, sol.q, sol.lam, strict=True))[:: 1 + len(sol.t) // 50]:
        axes = pin.Quaternion(q[3:]).matrix()
        world, axis = axes @ (sol.system.loop_rows(q, t)[1].T @ lam)[:3], axes[:, 2]
        level = np.cross([0, 0, 1], axis) / np.linalg.norm(axis[:2])
        found, true = np.array([world @ np.cross(level, axis), world @ level, world @ axis]), top.force(t)
        errors.append(np.abs(found - true).max())
        sizes.append(np.abs(true).max())
    assert max(errors) <= 10 * tol * max(sizes)
