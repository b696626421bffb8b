"""What the stages of Radau IIA miss of forces that change between them."""

from functools import cache

import numpy as np
from numpy.polynomial import legendre

from . import tuning
from .kkt import KKT
from .norms import weighted_norm
from .radau import table
from .radau_control import exponent

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
    M, D, K = stages.end_matrices
    within = KKT(M + h * D + h**2 * K, G, W)
    return max(seen, missed if within.singular else min(missed, error(within)))


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
