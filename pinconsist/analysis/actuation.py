"""Motors → all joints of a closed chain: positions, velocities, forces, and the dynamics reduced to the motors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin

from ..errors import SingularSystemError
from ..mechanism.closing import check_closing
from ..mechanism.rank import MASSLESS, without_inertia
from .coordinates import all_rows_of
from .motor_code import to_c
from .motor_forces import MotorFrame, MotorRange, MotorTorques, ranges, table, torques_for
from .motors import Motors
from .variations import Varied


class Actuation(Motors):
    """The map from the motors of a mechanism to all of its joints, and back.

    If the motors leave degrees of freedom unactuated, such as the spin of a rod between two balls, a warning is issued
    and ``free`` names a joint for each of them: :meth:`closure` and :meth:`jacobian` hold these joints fixed, and in
    the dynamics they carry no torque. If there are more motors than degrees of freedom, the torques of least norm are
    computed.

    Parameters
    ----------
    mech : Mechanism
        Drives, servos and actuators of the motors are removed; all other forces act.
    motors : sequence of str, optional
        Joint names. Default: ``mech.actuated``. A joint with several degrees of freedom has a motor for each. The
        free-flyer of a floating robot must be listed as well.
    q0 : mapping or array, optional
        The initial configuration, closed as by :func:`assemble`. Default: the mechanism's guess.

    Attributes
    ----------
    mechanism : Mechanism
        The mechanism without the drives, servos and actuators of the motors.
    motors, free : tuple of str
        The names of the m motors, and of the free motions: ``joint``, or ``joint[i]`` for a joint of several degrees of
        freedom.
    mobility : int
        Degrees of freedom of the closed mechanism.
    q : ndarray, shape (nq,)
        The last configuration that :meth:`closure` reached.

    Raises
    ------
    InputError
        No motors, unknown joints, a drive or constraint that depends on time.
    AssemblyError
        The loops cannot be closed.
    SingularSystemError
        Some motors cannot move in that configuration; the message names them.
    """

    def jacobian(self, q=None) -> np.ndarray:
        """A = dq/dq_motors, shape (nv, m), in a closed configuration `q`, by default the last one.

        If there are more motors than degrees of freedom, v = A v_motors holds for consistent motor velocities. Raises
        SingularSystemError in a singular configuration; the message names the joints that can move there.
        """
        q = self._q(q)
        Z, _ = self._basis(q)
        A = Z[:, : self._chosen.n_motors]
        return A @ np.linalg.pinv(self._seen(Z)) if self._shared else A

    def jacobian_rate(self, q, v) -> np.ndarray:
        """The accelerations Ȧ v_motors, shape (nv,), for zero accelerations of the motors.

        `q` and `v` are as in :meth:`velocity`. Raises SingularSystemError as :meth:`jacobian` does.
        """
        return self.acceleration(q, v, np.zeros(len(self.motors)))

    def derivatives(self, parameters, q=None) -> np.ndarray:
        """Derivatives of the configuration with respect to parameters, with the motors locked; for calibration.

        Parameters
        ----------
        parameters : sequence of str
            Names, as in :meth:`Mechanism.with_parameters`: anchors, lengths.
        q : array (nq,) or (n, nq), optional
            Closed configurations, such as those of :meth:`closure`; default: the last one.

        Returns
        -------
        ndarray, shape (nv, P) or (n, nv, P)
            Tangent vectors, like velocities; the last index is the parameter.

        Raises
        ------
        InputError
            Unknown parameters; one that opens redundant loops; configurations that are not closed.
        SingularSystemError
            A singular configuration.
        """
        return of_parameters(self, parameters, q)

    def velocity(self, q, v) -> np.ndarray:
        """The velocities of all joints, shape (nv,), for those of the motors.

        `q` is a closed configuration (None: the last one). `v` maps motor joints to velocities, rad/s or m/s (the
        others are at rest), or is an array (m,), or an array (nv,), which is returned. Raises InputError for other
        sizes and names, SingularSystemError as :meth:`jacobian` does.
        """
        full, v = self._of_motors(v, "v")
        return v if full else self.jacobian(q) @ v

    def acceleration(self, q, v, a) -> np.ndarray:
        """The accelerations of all joints, shape (nv,), for those of the motors, `a`, given like `v`.

        `q` and `v` are as in :meth:`velocity`, and so are the errors raised.
        """
        q, v = self._q(q), self.velocity(q, v)
        full, a = self._of_motors(a, "a")
        if full:
            return a
        reduced = self._reduced(q, v, 0.0)
        y = reduced.share @ (a - reduced.drift[self._columns])
        return reduced.Z[:, : len(y)] @ y + reduced.drift

    def limits(self, q=None) -> list[MotorRange]:
        """The range of each motor with the others locked, from a closed configuration `q`, by default the last one.

        See :class:`MotorRange`. Joint limits are those of the file; if a joint is outside its limits, the range is
        empty.
        """
        return ranges(self, self._closed(q))

    def mass_matrix(self, q=None) -> np.ndarray:
        """The mass matrix M_a of the motors, shape (m, m), in a closed configuration `q`, by default the last one.

        It includes all bodies, rods and rotors (armature). M_a a_a + h_a = τ_a, with h_a of :meth:`bias`, are the exact
        equations of motion. Raises SingularSystemError as :meth:`jacobian` does.
        """
        reduced = self._reduced(q, None, 0.0)
        return reduced.share.T @ reduced.M @ reduced.share

    def bias(self, q=None, v=None, *, t: float = 0.0) -> np.ndarray:
        """The torques h_a, shape (m,), N·m or N, that keep the motor velocities constant; by default at rest.

        `q` and `v` are as in :meth:`velocity`. Weights, springs, dampers and all other forces act; those that depend on
        time are evaluated at `t`, s.
        """
        reduced = self._reduced(q, v, t)
        drift = reduced.M @ (reduced.share @ reduced.drift[self._columns])
        return reduced.share.T @ (reduced.h - drift)

    def gravity(self, q=None) -> np.ndarray:
        """The part of :meth:`bias` due to gravity, shape (m,), N·m or N, at `q`, by default the last configuration."""
        q = self._q(q)
        Z, _ = self._basis(q)
        weights = pin.computeGeneralizedGravity(self.mechanism.model, self._chosen.system.data, q)
        return np.linalg.pinv(self._seen(Z)).T @ (Z[:, : self._chosen.n_motors].T @ weights)

    def forward(self, q, v, torques, *, t: float = 0.0) -> np.ndarray:
        """The accelerations of the motors, shape (m,), under their `torques`, an array (m,) or a mapping.

        `q`, `v` and `t` are as in :meth:`bias`. Raises SingularSystemError if a motion has no inertia.
        """
        q = self._q(q)
        tau, reduced = self._of_motors(torques, "torques", full=False)[1], self._reduced(q, v, t)
        inertia = np.linalg.eigvalsh(reduced.M)
        if inertia[0] <= MASSLESS * inertia[-1]:
            raise SingularSystemError(f"{self.mechanism.name}: motors can move without any inertia", names=self.motors)
        y = np.linalg.solve(reduced.M, reduced.seen.T @ tau - reduced.h)
        return reduced.seen @ y + reduced.drift[self._columns]

    def torques(self, q=None, v=None, a=None, *, forces=None, t: float = 0.0) -> MotorTorques:
        """The motor torques for a motion, of least norm if motors share the load, and the reactions of the loops.

        Parameters
        ----------
        q : array (nq,), optional
            A closed configuration; default: the last one.
        v, a : mapping or array, optional
            Velocities and accelerations of the motors, as for :meth:`velocity`, by default zero. The accelerations of
            free motions then follow from the dynamics; with an array `a` (nv,) they are prescribed, too.
        forces : mapping, optional
            Frame → force on its body at its origin, N, or force and moment, N·m, in world axes: three or six numbers.
        t : float
            Time at which forces are evaluated, s.

        Returns
        -------
        MotorTorques

        Raises
        ------
        SingularSystemError
            A singular configuration; or `a` prescribes the accelerations of all joints, and free joints would need
            torques.
        InputError
            Unknown names, wrong sizes.
        """
        return torques_for(self, self._q(q), v, a, forces or {}, t)

    def frame(self, frame: str) -> MotorFrame:
        """The map from the motors to a `frame` of the model, for positions, velocities and forces: a MotorFrame.

        Raises InputError for an unknown frame.
        """
        return MotorFrame(self, frame)

    def table(self, positions, file=None) -> dict[str, np.ndarray]:
        """The closure on a grid of motor positions, as a mapping of arrays, optionally written to `file`.

        Parameters
        ----------
        positions : mapping
            Motor joint → positions, rad or m; the others are held. Each point of the grid is reached from a neighbour.
        file : path, optional
            ``.npz`` with these arrays, or ``.csv`` without the Jacobian and with units in the column headings.

        Returns
        -------
        dict
            ``positions`` (n, m), ``q`` (n, nq), ``ok`` (n,), ``condition`` (n,), ``jacobian`` (n, nv, m). If a point is
            not ok, ``q`` is the last configuration on its path (NaN if no neighbour is ok), and the Jacobian is zero.

        Raises
        ------
        InputError
            Unknown motors; another file extension.
        OSError
            The file cannot be written.
        """
        return table(self, positions, file)

    def to_c(self, file) -> Path:
        """Write the closure, the Jacobian and the reduced dynamics as C99 code for controllers; `file` is ``name.c``.

        Its functions ``name_closure``, ``name_jacobian`` and ``name_dynamics`` (mass matrix and bias) need no libraries
        and no allocation; the head of the file documents their calls. The closure makes a fixed number of Newton
        iterations, so that distant motor positions require several calls.

        Returns
        -------
        Path
            The file.

        Raises
        ------
        OSError
            The file cannot be written.
        InputError
            Motors that share the load or have several degrees of freedom; forces other than damping, dry friction,
            springs and constant torques; user-defined constraints; joints whose axes move relative to each other.
        """
        return to_c(self, file)

    def _reduced(self, q, v, t, loads=0.0) -> Reduced:
        q = self._q(q)
        Z, inverse = self._basis(q)
        full, v = self._of_motors(v, "v")
        if not full:
            v = Z[:, : self._chosen.n_motors] @ (np.linalg.pinv(self._seen(Z)) @ v if self._shared else v)
        M, f, _, bias = self._chosen.dynamics(t, q, v)
        drift = np.zeros(len(v))
        drift[self._chosen.p] = -inverse @ bias
        return Reduced(self, Z, M, f - loads, v, drift)


def of_parameters(act, parameters, q):
    """See :meth:`Actuation.derivatives`."""
    rows = [act._q(each) for each in np.asarray(q, float)] if np.ndim(q) == 2 else [act._q(q)]
    varied, model = Varied(act.mechanism, parameters), act.mechanism.model

    def gaps(mechanism, _):
        compiled = all_rows_of(mechanism)
        return np.array([compiled.rows(each)[0] for each in rows])

    rates = np.array([varied.rate(i, gaps) for i in range(len(varied.names))])  # (P, n, nc)
    found, compiled = np.zeros((len(rows), model.nv, len(rates))), all_rows_of(act.mechanism)
    for each, rate, change in zip(rows, rates.transpose(1, 2, 0), found, strict=True):
        _, inverse = act._basis(each)
        change[act._chosen.p] = -inverse @ rate[act._chosen.system.kept]
        left = compiled.rows(each)[1] @ change + rate
        for i, name in enumerate(varied.names):
            check_closing(name, left[:, i], rate[:, i])
    return found if np.ndim(q) == 2 else found[0]


class Reduced:
    """M ÿ + h = τ in the coordinates of the motors at a state; free coordinates carry no torque.

    ``seen`` (m, n) are the motor velocities for unit velocities of the coordinates, ``drift`` (nv,) the accelerations
    for zero accelerations of the coordinates.
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
            massless = inertia <= MASSLESS * np.abs(M).max()
            pushed = np.abs(motions[:, massless].T @ h[n:]).max(initial=0.0)
            if pushed > 1e-8 * np.abs(h).max():
                why = ", but forces act on them, so their accelerations are not defined"
                raise without_inertia(act.mechanism, Z[:, n:] @ motions[:, massless], why)
            inverse = np.where(massless, 0.0, 1.0 / np.where(massless, 1.0, inertia))
            G = (motions * inverse) @ motions.T
            self._follow = -G @ M[n:, :n], -G @ h[n:]
            self.M, self.h = self.M + M[:n, n:] @ self._follow[0], self.h + M[:n, n:] @ self._follow[1]
        self.share = np.linalg.pinv(self.seen) if act._shared else np.eye(n)

    def coordinates(self, a):
        """The accelerations of all coordinates for those of the motors; free coordinates carry no torque."""
        y = self.share @ (a - self.drift[self._act._columns])
        return y if self._follow is None else np.concatenate((y, self._follow[0] @ y + self._follow[1]))
