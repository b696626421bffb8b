"""The equations of motion in the coordinates of the motors."""

from __future__ import annotations

import numpy as np

from ..mechanism.singularity import MASSLESS, without_inertia


class Reduced:
    """M ÿ + h = τ of the coordinates of the motors, the free ones without torque, at a state.

    ``seen`` (m, n) has the motors' velocities for unit ones of the coordinates, ``drift`` (nv,) the accelerations with
    those of the coordinates at zero.
    """

    def __init__(self, act, Z, M, f, v, drift):
        self._act, self.Z, self.inertia, self.f, self.v, self.drift = act, Z, M, f, v, drift
        n = act._chosen.n_motors
        self.seen = Z[act._columns, :n]
        M, h = Z.T @ M @ Z, Z.T @ (f + M @ drift)
        self.every = M, h
        self.M, self.h, self._follow = M[:n, :n], h[:n], None
        if len(h) > n:
            inertia, motions = np.linalg.eigh(M[n:, n:])
            weightless = inertia <= MASSLESS * np.abs(M).max()
            pushed = np.abs(motions[:, weightless].T @ h[n:]).max(initial=0.0)
            if pushed > 1e-8 * np.abs(h).max():
                why = ", yet forces act on them: they have no acceleration"
                raise without_inertia(act.mechanism, Z[:, n:] @ motions[:, weightless], why)
            inverse = np.where(weightless, 0.0, 1.0 / np.where(weightless, 1.0, inertia))
            G = (motions * inverse) @ motions.T
            self._follow = -G @ M[n:, :n], -G @ h[n:]
            self.M, self.h = self.M + M[:n, n:] @ self._follow[0], self.h + M[:n, n:] @ self._follow[1]
        self.share = np.linalg.pinv(self.seen) if act._shared else np.eye(n)

    def coordinates(self, a):
        """The accelerations of all coordinates for those of the motors, the free ones following without torque."""
        y = self.share @ (a - self.drift[self._act._columns])
        return y if self._follow is None else np.concatenate((y, self._follow[0] @ y + self._follow[1]))
