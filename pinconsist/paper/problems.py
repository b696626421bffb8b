"""The two problems of Arévalo (2008), section 5, with their exact solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..engine.hessenberg import HessenbergProblem
from ..errors import InputError

if TYPE_CHECKING:
    from ..mechanism.mechanism import Mechanism


@dataclass(frozen=True)
class ReferenceProblem:
    """An initial value problem with its exact solution.

    Attributes
    ----------
    name : str
    system : Mechanism or HessenbergProblem
    t0 : float
    p0, v0 : ndarray
        Exact initial position and velocity.
    exact : callable
        ``exact(t) -> (p, v, lam)``.
    """

    name: str
    system: Mechanism | HessenbergProblem
    t0: float
    p0: np.ndarray
    v0: np.ndarray
    exact: Callable


def reference_problem(name: str) -> ReferenceProblem:
    """The problems of Arévalo (2008) by name: ``"problem51"`` and ``"problem52"``.

    Parameters
    ----------
    name : {"problem51", "problem52"}
        The first is a mechanism, whose mass matrix and Jacobian Pinocchio evaluates.

    Returns
    -------
    ReferenceProblem

    Raises
    ------
    InputError
        Unknown name.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), section 5.
    """
    if name not in PROBLEMS:
        raise InputError(f"no reference problem {name!r}; choose from {', '.join(PROBLEMS)}")
    system, t0, exact = PROBLEMS[name]()
    p0, v0, _ = exact(t0)
    return ReferenceProblem(name, system, t0, p0, v0, exact)


def _problem51():
    """Problem 5.1: x'' = 2y + xλ, y'' = -2x + yλ on the unit circle, mass matrix and Jacobian from Pinocchio."""
    import pinocchio as pin

    from ..mechanism.forces import Torque
    from ..mechanism.loops import GROUND, Loop
    from ..mechanism.mechanism import Mechanism

    model = pin.Model()
    model.name = "problem51"
    x = model.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "x")
    y = model.addJoint(x, pin.JointModelPY(), pin.SE3.Identity(), "y")
    model.appendBodyToJoint(y, pin.Inertia(1.0, np.zeros(3), np.zeros((3, 3))), pin.SE3.Identity())
    model.addFrame(pin.Frame("mass", y, 0, pin.SE3.Identity(), pin.FrameType.OP_FRAME))
    model.gravity.setZero()
    circle = Loop("circle", "distance", GROUND, "mass", length=1.0)
    field = Torque(_field51, _field51_gradient)
    return Mechanism(model, [circle], [field], name="problem51", guess=[np.sin(1.0), np.cos(1.0)]), 0.0, _exact51


def _field51(t, q, v):
    return np.array([2 * q[1], -2 * q[0]])


def _field51_gradient(t, q, v):
    return np.array([[0.0, 2.0], [-2.0, 0.0]]), None


def _exact51(t):
    s, rate = (1 + t) ** 2, 2 * (1 + t)
    p = np.array([np.sin(s), np.cos(s)])
    return p, rate * np.array([np.cos(s), -np.sin(s)]), np.array([-4 * (1 + t) ** 2])


def _problem52():
    """Problem 5.2 in the general form (4.1): det(R_p U_q G) = -3."""

    def F(t, p, v):
        x, y, z = p
        s = np.sin(t**2)
        return np.array([-y, 2 * x + y * s - 4 * y * t**2, 4 * z * t**2 - s / 2])

    def G(t, p, v):
        x, y, z = p
        return np.array([[x, 0], [0, 2 * y], [2 * z, -1]])

    problem = HessenbergProblem(
        U=lambda t, p, v: np.array([2 * v[0], v[1], v[2] - 1]),
        F=F,
        G=G,
        R=lambda t, p: np.array([p @ p - 1, p[2] - 0.5]),
        R_p=lambda t, p: np.array([2 * p, [0, 0, 1]]),
        R_t=lambda t, p: np.zeros(2),
        U_p=lambda t, p, v: np.zeros((3, 3)),
        U_v=lambda t, p, v: np.diag([2.0, 1.0, 1.0]),
    )
    return problem, 1.0, _exact52


def _exact52(t):
    s, c, root3 = np.sin(t**2), np.cos(t**2), np.sqrt(3.0)
    p = np.array([root3 / 2 * c, root3 / 2 * s, 0.5])
    v = np.array([-root3 / 2 * t * s, root3 * t * c, 1.0])
    return p, v, np.array([-2 * t**2, -s / 2])


PROBLEMS = {"problem51": _problem51, "problem52": _problem52}
