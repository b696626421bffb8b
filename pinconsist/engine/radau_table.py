"""The tables of Radau IIA, and the polynomials of a step."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.polynomial import legendre

STAGES = 1, 2, 3, 5, 7  # for orders 1, 3, 5, 9, 13


@dataclass(frozen=True)
class Table:
    """Radau IIA with s stages, order 2s - 1.

    Attributes
    ----------
    c : ndarray, shape (s,)
        Nodes, the last one 1.
    A, inverse, inverse2 : ndarray, shape (s, s)
        Weights a_ij = ∫ ℓ_j from 0 to c_i, A⁻¹ and A⁻².
    modes : ndarray, shape (s, s)
        Maps values at the nodes to the coefficients of Legendre polynomials on the step.
    raised : ndarray, shape (s + 1, s + 1)
        The same with a value at the start, before those at the nodes.
    """

    s: int
    c: np.ndarray
    A: np.ndarray
    inverse: np.ndarray
    inverse2: np.ndarray
    modes: np.ndarray
    raised: np.ndarray

    def values(self, theta):
        """(n, s): maps values at the nodes to those of their polynomial at the parts `theta` (n,) of the step."""
        return polynomials(theta, self.s) @ self.modes

    def integrals(self, theta):
        """(n, s): maps values at the nodes to the integrals of their polynomial from 0 to `theta` (n,)."""
        return integrals(theta, self.s) @ self.modes


@cache
def table(s: int) -> Table:
    """The formula with s stages, from its definition: nodes at the zeros of P_{s-1} - P_s, exact for degree s - 1."""
    x = np.real(legendre.legroots([0.0] * (s - 1) + [1.0, -1.0]))  # complex since numpy 2.5
    x[-1] = 1.0
    c = 0.5 * (1.0 + x)
    modes = np.linalg.inv(legendre.legvander(x, s - 1))
    raised = np.linalg.inv(legendre.legvander(np.append(-1.0, x), s))
    A = integrals(c, s) @ modes
    inverse = np.linalg.inv(A)
    parts = c, A, inverse, inverse @ inverse, modes, raised
    for part in parts:
        part.setflags(write=False)
    return Table(s, *parts)


def polynomials(theta, n):
    """(., n): P_k(2x - 1) at x = theta, k < n."""
    return legendre.legvander(2.0 * np.asarray(theta) - 1.0, n - 1)


def integrals(theta, n):
    """(., n): ∫ P_k(2x - 1) dx from 0 to theta, k < n."""
    V = polynomials(theta, n + 1)
    below = np.column_stack([-np.ones(len(V)), V[:, : n - 1]])  # P_{-1} = -1 makes ∫ P_0 = (x + 1)/2
    return 0.5 * (V[:, 1:] - below) / (2.0 * np.arange(n) + 1.0)


@cache
def gauss(s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Gauss's formula with s + 1 points between s stages: points, weights; integrals of the stages' ℓ_j up to them."""
    points, weights = legendre.leggauss(s + 1)
    between = 0.5 * (1.0 + points)
    return between, 0.5 * weights, table(s).integrals(between)


@cache
def eigenvectors(s: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Eigenvalues of A⁻¹, (2, m), eigenvectors (s, 2 m), and the rows (2 m, s) of their inverse.

    Real and imaginary parts are beside or below each other. Of conjugate pairs only one is there.
    """
    values, vectors = np.linalg.eig(table(s).inverse)
    inverse = np.linalg.inv(vectors)
    kept = np.flatnonzero(values.imag >= 0.0)
    values, vectors, inverse = values[kept], vectors[:, kept], inverse[kept]
    beside = np.stack((vectors.real, vectors.imag), axis=2).reshape(s, -1)
    below = np.stack((inverse.real, inverse.imag), axis=1).reshape(-1, s)
    return np.array((values.real, values.imag)), beside, below
