"""Reference solutions: the paper's problems in closed form, and scipy on the index-1 equations of any system."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from .dae.hessenberg import HessenbergProblem
from .dae.index1 import Index1
from .dae.start import integrate_index1
from .errors import InputError, PinconsistError
from .mechanism.checks import finite_array
from .mechanism.forces import Torque
from .mechanism.loops import GROUND, Loop
from .mechanism.mechanism import Mechanism
from .simulation import system_of


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


PLACES = 100  # of a reference at which the choice of constraint rows is checked


class Reference(NamedTuple):
    """Rows of a reference solution: t (n,), q (n, nq), v (n, nv), lam (n, nc)."""

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray


def reference_solution(system, t0, p0, v0, times, *, rtol=1e-13, atol=1e-13) -> Reference:
    """Solve the index-1 equations by scipy's DOP853, with a projection at each of the times.

    The equations are those of :func:`pinconsist.simulate`, and so is the one-step method of its first few rows; the
    BDF is not used.

    Parameters
    ----------
    system : Mechanism or HessenbergProblem or Index3System
    t0 : float
        Start, s.
    p0, v0 : array
        Consistent initial values, for instance ``sol.q[0], sol.v[0]``.
    times : array
        Times of the rows, starting from `t0`, monotone.
    rtol, atol : float
        scipy's tolerances.

    Returns
    -------
    Reference
        With the multipliers of all rows of a mechanism, as ``sol.lam`` has them.

    Raises
    ------
    InputError
        Wrong sizes, NaN, or something that cannot be integrated.
    PinconsistError
        scipy's integrator fails, or redundant rows of the loops become inconsistent.
    """
    p0, v0 = finite_array(p0, "p0"), finite_array(v0, "v0")
    system, times = system_of(system, t0, p0, v0), np.atleast_1d(finite_array(times, "times"))
    t, p, v, rows, longest = t0, p0, v0, [], abs(times[-1] - t0) / PLACES if len(times) else 0.0
    for target in times:  # other constraint rows are kept if those kept become a poor choice
        whole = system.dropped_are_zero or not longest
        stops = 1 if whole else max(1, int(np.ceil(abs(target - t) / longest)))
        for stop in np.linspace(t, target, stops + 1)[1:]:
            ((t, p, v, lam),) = integrate_index1(Index1(system), t, p, v, [stop], rtol, atol)
            if opened := system.opened([t], [p]):
                raise PinconsistError(f"no reference: the loops are open by {opened[1]:.1e} at t = {t:.6g}")
            full, system = system.full_multipliers(p, lam), system.reselected(p) or system
        rows.append((t, p, v, full))
    return Reference(*(np.array(column) for column in zip(*rows, strict=True)))


def _problem51():
    """Problem 5.1: x'' = 2y + xλ, y'' = -2x + yλ on the unit circle, mass matrix and Jacobian from Pinocchio."""
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
