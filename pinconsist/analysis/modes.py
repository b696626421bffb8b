"""Natural frequencies and mode shapes of a linearised mechanism, which may have massless directions."""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from ..errors import SingularSystemError
from ..mechanism.rank import MASSLESS
from .variations import Locked

STIFFNESS_NOISE = 1e-10  # relative to the stiffness and the forces: smaller values cannot be distinguished from zero


@dataclass(frozen=True, eq=False)
class Modes(Locked):
    """Solutions shape · exp(eigenvalue · t) of a :class:`Linearization`, the slowest first.

    Of each conjugate pair, the eigenvalue with positive imaginary part is returned. A motion with zero stiffness has
    eigenvalue zero.

    Attributes
    ----------
    eigenvalues : ndarray of complex, shape (m,)
        Eigenvalues, 1/s; modes with a positive real part grow.
    shapes : ndarray, shape (nv, m)
        δq of each mode in joint velocities, with largest entry 1; real without damping.
    massless : int
        Number of motions without inertia. Their infinite frequencies are omitted; they follow the others without delay.
    """

    eigenvalues: np.ndarray
    shapes: np.ndarray
    massless: int

    @property
    def frequencies(self) -> np.ndarray:
        """Natural frequencies |eigenvalue|, rad/s; that of a damped oscillation is the imaginary part."""
        return np.abs(self.eigenvalues)

    @property
    def hertz(self) -> np.ndarray:
        """Natural frequencies, Hz."""
        return self.frequencies / (2 * np.pi)

    @property
    def damping_ratios(self) -> np.ndarray:
        """-Re/|eigenvalue|: 0 if undamped, 1 without oscillation, negative if growing; NaN for eigenvalue zero."""
        with np.errstate(invalid="ignore"):
            return np.where(self.eigenvalues == 0, np.nan, 0.0 - self.eigenvalues.real / self.frequencies)

    def __str__(self):
        lines = [f"{'Hz':>12} {'rad/s':>12} {'damping':>9}"]
        rows = zip(self.hertz, self.frequencies, self.damping_ratios, strict=True)
        lines += [f"{hertz:12.6g} {omega:12.6g} {ratio:9.4f}" for hertz, omega, ratio in rows]
        if self.massless:
            lines.append(f"{self.massless} more without inertia, with infinite frequency")
        return "\n".join(lines)


def modes(linear) -> Modes:
    """See :meth:`Linearization.modes`."""
    S = linear._sizes
    M, C, K = (S[:, None] * each * S for each in (linear.mass, linear.damping, linear.stiffness))
    noise = STIFFNESS_NOISE * (np.max(np.abs(K), initial=0.0) + linear._scale * np.max(S, initial=0.0))
    inertia, axes = np.linalg.eigh(M)
    count = int(np.count_nonzero(inertia <= MASSLESS * inertia.max(initial=0.0)))
    light, heavy = axes[:, :count], axes[:, count:]
    conservative = not C.any() and np.abs(K - K.T).max(initial=0.0) <= noise
    solve = _undamped if conservative else _damped
    values, shapes, massless = solve(M, C, K, heavy, light, noise)
    order = np.argsort(np.abs(values), kind="stable")
    shapes = linear.Z @ (S[:, None] * shapes)[:, order]
    largest = np.argmax(np.abs(shapes), axis=0)
    return Modes(values[order], shapes / shapes[largest, range(len(order))], massless)


def _undamped(M, C, K, heavy, light, noise):
    """ω² from a symmetric eigenvalue problem; an unstable motion has a growing and a decaying part."""
    T = heavy - light @ _held(light.T @ K @ light, light.T @ K @ heavy, noise)
    squares, vectors = eigh(T.T @ K @ T, heavy.T @ M @ heavy)
    shapes = T @ vectors
    squares[_idle(K, shapes, noise)] = 0.0
    falling = squares < 0
    roots = np.sqrt(np.abs(squares))
    values = np.concatenate((np.where(falling, roots, 1j * roots), -roots[falling]))
    return values, np.hstack((shapes, shapes[:, falling])), light.shape[1]


def _damped(M, C, K, heavy, light, noise):
    """The pencil E z' = F z with its infinite part removed; z = (y and y' of motions with inertia, y of the others)."""

    def parts(A):
        return heavy.T @ A @ heavy, heavy.T @ A @ light, light.T @ A @ heavy, light.T @ A @ light

    (C11, C12, C21, C22), (K11, K12, K21, K22) = parts(C), parts(K)
    n, m = len(C11), len(C22)
    inertia, damping = heavy.T @ M @ heavy, np.max(np.abs(C)) or 1.0
    E = np.block([
        [np.eye(n), np.zeros((n, n + m))],
        [np.zeros((n, n)), inertia / inertia.max(initial=1e-300), C12 / inertia.max(initial=1e-300)],
        [np.zeros((m, 2 * n)), C22 / damping],
    ])  # fmt: skip
    F = np.block([
        [np.zeros((n, n)), np.eye(n), np.zeros((n, m))],
        [-np.hstack((K11, C11, K12)) / inertia.max(initial=1e-300)],
        [-np.hstack((K21, C21, K22)) / damping],
    ])  # fmt: skip
    U, s, Vt = np.linalg.svd(E)
    rank = int(np.count_nonzero(s > 1e-12 * s.max(initial=0.0)))
    U1, U2, V1, V2 = U[:, :rank], U[:, rank:], Vt[:rank].T, Vt[rank:].T
    T = V1 - V2 @ _held(U2.T @ F @ V2, U2.T @ F @ V1, noise / damping)
    values, vectors = np.linalg.eig(U1.T @ F @ T / s[:rank, None])
    z = T @ vectors
    shapes = heavy @ z[:n] + light @ z[2 * n :]
    idle = np.flatnonzero(_idle(K, shapes, noise))
    values[idle] = 0.0
    nullity = int(np.count_nonzero(np.linalg.svd(K, compute_uv=False) <= noise))
    kept = values.imag >= 0
    kept[[i for i in idle if kept[i]][nullity:]] = False  # zero is a double root: constant position, constant velocity
    return values[kept], shapes[:, kept], m - (rank - 2 * n)


def _idle(K, shapes, noise):
    """The motions without stiffness, as a mask."""
    return np.linalg.norm(K @ shapes, axis=0) <= noise * np.linalg.norm(shapes, axis=0)


def _held(stiffness, load, noise):
    """stiffness⁻¹ load for motions that only the stiffness resists."""
    if np.linalg.svd(stiffness, compute_uv=False).min(initial=np.inf) <= noise:
        raise SingularSystemError("a motion has no inertia, damping or stiffness, so the modes are not determined")
    return np.linalg.solve(stiffness, load)
