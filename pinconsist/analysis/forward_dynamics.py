"""Forward dynamics: accelerations and multipliers of states under joint torques, for one state or many."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..engine.index1 import Index1
from ..errors import AssemblyError, InputError
from ..mechanism.checks import finite_array, number, require_no_contacts
from ..mechanism.forces.held import Given
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.system import MechanismSystem

TOO_OPEN = 1e-3  # m or rad: largest gap of a state; runs and logs are as open as their tolerance


class ForwardDynamics(NamedTuple):
    """The accelerations and multipliers of states.

    Attributes
    ----------
    a : ndarray, shape (nv,) or (n, nv)
        Accelerations, rad/s² or m/s².
    lam : ndarray, shape (nc,) or (n, nc)
        Multipliers of all rows of the loops, those of smallest norm if rows are redundant.
    """

    a: np.ndarray
    lam: np.ndarray


def forward_dynamics(mech: Mechanism, q, v=None, tau=None, *, forces=(), t: float = 0.0) -> ForwardDynamics:
    """The accelerations a and multipliers λ of M a + nle = τ + Jᵀλ with closed loops, as a tuple (a, λ).

    Parameters
    ----------
    mech : Mechanism
        The mechanism, with its own forces: damping, springs, actuators.
    q : array, shape (nq,) or (n, nq)
        Configurations in which the loops are closed, to 1e-3 m or rad.
    v : array, shape (nv,) or (n, nv), optional
        Velocities. Default: at rest.
    tau : array, shape (nv,) or (n, nv), optional
        Torques of all joints in addition to the forces, N·m or N.
    forces : sequence
        Forces in addition to those of the mechanism.
    t : float
        Time at which forces and drives are evaluated, s.

    Returns
    -------
    ForwardDynamics

    Raises
    ------
    InputError
        Wrong sizes, NaN.
    AssemblyError
        A loop is open.
    SingularSystemError
        A joint can move without inertia, or the configuration is singular.
    """
    mech = with_added_forces(mech, forces, "forward_dynamics")
    require_no_contacts(mech, "forward_dynamics")
    t = number(t, "t")
    q, v, tau, one = _states(mech, q, v, tau)
    equations = _Equations(mech, q[0], t)
    a, lam = np.empty(v.shape), np.empty((len(q), mech.nc))
    for i, state in enumerate(zip(q, v, tau, strict=True)):
        a[i], lam[i] = equations.at(i, *state)
    return ForwardDynamics(a[0], lam[0]) if one else ForwardDynamics(a, lam)


def _states(mech, q, v, tau):
    """Rows of q, v and τ, and whether there is only one, which is not in a row."""
    q = finite_array(q, "q")
    n = len(q) if q.ndim == 2 else 1
    v = np.zeros(mech.nv) if v is None else finite_array(v, "v")
    tau = np.zeros(mech.nv) if tau is None else finite_array(tau, "tau")
    one = q.ndim == v.ndim == tau.ndim == 1
    rows = []
    for name, values, size in (("q", q, mech.nq), ("v", v, mech.nv), ("tau", tau, mech.nv)):
        if values.shape not in ((size,), (n, size)) and not (n == 1 and values.ndim == 2 and values.shape[1] == size):
            raise InputError(f"{mech.name}: {name} needs shape ({size},) or ({n}, {size}), got {values.shape}")
        rows.append(np.atleast_2d(values))
    most = max(map(len, rows))
    return *(np.broadcast_to(row, (most, row.shape[1])) for row in rows), one


class _Equations:
    """The compiled equations near a state, with torques that are given for each."""

    def __init__(self, mech, q, t):
        self._t, self._mech = t, mech
        self._system = MechanismSystem(mech, mech.configuration(q), t)
        self._given = self._system.forces["the given torques"] = Given(mech.nv)
        self._compile()

    def _compile(self):
        self._index1 = Index1(self._system)

    def at(self, number, q, v, tau):
        system = self._system
        q = self._mech.configuration(q)
        phi, _ = system.loop_rows(q, self._t)
        if np.abs(phi).max(initial=0.0) > TOO_OPEN:
            i = int(np.argmax(np.abs(phi)))
            raise AssemblyError(
                f"{self._mech.name}: in state {number} loop {system.rows.labels[i][0]!r} is open by {abs(phi[i]):.2g}; "
                "pc.assemble closes it",
                q=q,
            )
        fresh = system.reselected(q)
        if fresh is not None:
            self._system = fresh
            self._compile()
        self._given.give(tau)
        a, lam = self._index1.acceleration(self._t, q, v)
        return a, self._system.full_multipliers(q, lam)
