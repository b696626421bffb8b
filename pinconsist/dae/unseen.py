"""Forces that the stages of Radau IIA do not see: stiff ones in the projection, and those that bend between stages."""

from functools import cache

import numpy as np
from numpy.polynomial import legendre

from . import tuning
from .kkt import KKT
from .norms import weighted_norm
from .radau_control import exponent
from .radau_table import table

LARGE = 1e9  # an error whose powers do not overflow


@cache
def gauss(s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss's formula with s + 1 points between s stages: points, weights; integrals of the stages' ℓ_j up to them."""
    points, weights = legendre.leggauss(s + 1)
    between = 0.5 * (1.0 + points)
    return between, 0.5 * weights, table(s).integrals(between)


def crosses(stages) -> bool:
    """Whether velocities cross narrow ranges about zero that are not resolved."""
    V, widths = np.vstack((stages.v, stages.V)), stages.system.widths
    least, most = V.min(axis=0), V.max(axis=0)
    return bool(((least < widths) & (most > -widths) & (most - least > tuning.COARSE * widths)).any())


def unstirred(stages, kkt, G, W, v, weight):
    """The projected velocity `v` without the part of the projection that is along stiff forces; whether there are any.

    The projection moves the velocities as an impulse does. Along stiff forces, of which the stages are free, this is an
    error of the order of the stages, which lasts for a moment only but is felt by the multipliers. With
    A = M + c D + c² K, c = h/STIFF, it is (A⁻¹ (A - M))² Δv, restricted to W x = 0. `kkt` is the matrix of M, `weight`
    are the reciprocal tolerances of velocities.
    """
    if not 0 < W.shape[0] < W.shape[1]:
        return v, False
    (M, stiff), moved = _parts(stages.end_matrices, stages.h / tuning.STIFF), v - stages.V[-1]
    felt = _along(kkt, stiff, len(W), moved)
    if not np.linalg.norm(weight * felt) > tuning.STIFF_PART * np.linalg.norm(weight * moved):
        return v, False  # nothing is stiff, and the order depends on the metric of M
    return _without(M, stiff, G, W, v, moved), True


def held_back(system, t, p, v, a, projected, h):
    """The same at a state (p, v) with the acceleration `a` within a step of size `h` that has stiff forces."""
    _, _, G, _ = system.evaluate(t, p, v, a)
    M, stiff = _parts(system.matrices(t, p, v, a), h / tuning.STIFF)
    return _without(M, stiff, G, system.velocity_jacobian(t, p, v, G), projected, projected - v)


def _along(kkt, stiff, nc, x):
    """What stiff forces do to the velocities after a change by `x`."""
    return kkt.solve(np.concatenate((stiff @ x, np.zeros(nc))))[: len(x)]


def _without(M, stiff, G, W, v, moved):
    """The velocity `v` without what stiff forces hold back of its change by `moved`."""
    within = KKT(M + stiff, G, W)
    return v if within.singular else v - _along(within, stiff, len(W), _along(within, stiff, len(W), moved))


def with_unseen(seen, stages, kkt, G, W, weight) -> float:
    """The larger of an error and of the one from what the stages miss of forces that bend or jump.

    Within a step stiff forces undo most of what other forces do to the velocities they hold. What is missed of a bend
    falls like h²: a power of it falls like the estimate, from which steps are chosen. `kkt` is the matrix of M,
    `weight` are the reciprocal tolerances of velocities.
    """
    nv, h = stages.system.nv, stages.h
    impulse = np.concatenate((h * missed_force(stages), np.zeros(stages.system.nc)))

    def error(kkt):
        size = weighted_norm(kkt.solve(impulse)[:nv], tuning.UNSEEN * weight, nv)
        return min(size, LARGE) ** (0.5 * exponent(stages.table.s))

    if (missed := error(kkt)) <= seen:
        return seen
    within = KKT(sum(_parts(stages.end_matrices, h)), G, W)
    return max(seen, missed if within.singular else min(missed, error(within)))


def _parts(matrices, c):
    """(M, c D + c² K); their sum is the A of :class:`~pinconsist.dae.kkt.KKT`."""
    M, D, K = matrices
    return M, c * D + c**2 * K


def missed_force(stages):
    """The mean over a step of forces that may bend or jump, less what the stages see of it, shape (nv,).

    For smooth forces the difference of these two formulas, Gauss's and Radau's, falls as the error of the step does.
    """
    system, h, (between, weights, reach) = stages.system, stages.h, gauss(stages.table.s)
    V, xi = stages.v + h * reach @ stages.W, h * reach @ stages.U
    P = [system.integrate(stages.p, each) for each in xi]

    def mean(weights, *points):
        return weights @ [system.sharp_force(*point) for point in zip(*points, strict=True)]

    seen = mean(stages.table.A[-1], stages.times, stages.P, stages.V)
    return mean(weights, stages.t + h * between, P, V) - seen
