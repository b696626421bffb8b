"""Inverse dynamics: the motor torques for a motion that is determined by its driven joints. No integration."""

from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from ..errors import AssemblyError, InputError, SingularSystemError
from ..mechanism.assembly import assemble
from ..mechanism.checks import finite_array, require_no_contacts
from ..mechanism.joint_constraints import Drive
from ..mechanism.mechanism import Mechanism, with_added_forces
from ..mechanism.names import joints_in
from ..mechanism.rank import dependencies
from ..mechanism.reactions import HasReactions
from ..mechanism.system import MechanismSystem
from .variations import Derivatives, Locked, TangentSpace, Varied, closed_near, of_state, step_sizes

WIDEST = 0.05  # rad, or lengths of the mechanism: largest error of a prediction; otherwise the step is halved
STEP_HALVINGS = 30


@dataclass(frozen=True, eq=False)
class InverseDynamics(Locked, HasReactions):
    """A motion, and the torques and multipliers that it requires. Rows are times.

    Attributes
    ----------
    mechanism : Mechanism
        The mechanism, with all forces that act.
    t : ndarray, shape (n,)
        Times, s.
    q, v, a : ndarray, shapes (n, nq), (n, nv), (n, nv)
        Configurations, velocities, accelerations.
    lam : ndarray, shape (n, nc)
        Multipliers of all rows; those of smallest norm if loops have redundant rows.
    torques : dict[str, ndarray]
        Drive → its motor torque, shape (n,), N·m (or N), positive along the joint's velocity.
    """

    mechanism: Mechanism = field(repr=False)
    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    lam: np.ndarray
    torques: dict[str, np.ndarray]

    def _motion(self):
        return self.v, self.a

    def derivatives(self, parameters, theta=None) -> Derivatives:
        """Differentiate the motion and the torques with respect to parameters of the mechanism.

        Parameters and errors as :meth:`Equilibrium.derivatives`: `parameters`, `theta`.

        Returns
        -------
        Derivatives
            Of ``"q"``, ``"v"``, ``"a"``, (n, nv, P), ``"lam"``, (n, nc, P), and ``"torques.DRIVE"``, (n, P); the last
            index is the parameter.
        """
        varied, rows = Varied(self.mechanism, parameters, theta), []
        for state in zip(self.t, self.q, self.v, self.a, self.lam, strict=True):
            rows.append(of_state(varied, *state, still=False))
        values = dict(zip(("q", "v", "a", "lam"), map(np.array, zip(*rows, strict=True)), strict=True))
        for i, (name, _) in enumerate(self.mechanism.row_labels):
            if name in self.torques:
                values[f"torques.{name}"] = values["lam"][:, i]
        return Derivatives(varied.names, values)


def inverse_dynamics(mechanism, times, q0=None, *, forces=()) -> InverseDynamics:
    """Compute the motor torques of a chain whose drives determine its motion.

    At each time the loops and the drives determine the configuration, their derivatives the velocity and the
    acceleration, and the equations of motion the multipliers and the motor torques. Between the times the configuration
    is tracked, with smaller steps where it changes fast, so that it stays on its branch.

    Parameters
    ----------
    mechanism : Mechanism
        A mechanism with a :class:`Drive` for each motion that its loops leave free.
    times : array, shape (n,)
        Times, s.
    q0 : mapping or array, optional
        Guess at the first time, as in :func:`assemble`. Default: the mechanism's guess.
    forces : sequence
        Additional forces, as in :func:`simulate`; friction, damping and all others act with the motion's velocities.

    Returns
    -------
    InverseDynamics

    Raises
    ------
    SingularSystemError
        The drives leave some joints free, or are at a dead centre, or outnumber the degrees of freedom and contradict
        each other. The message names the joints and the time.
    AssemblyError
        The loops cannot follow the drives; the message gives the time, and the error carries the last configuration.
    InputError
        Invalid arguments.
    """
    mechanism = with_added_forces(mechanism, forces, "inverse_dynamics")
    require_no_contacts(mechanism, "inverse_dynamics")
    times = np.atleast_1d(finite_array(times, "times"))
    if times.ndim != 1 or not times.size:
        raise InputError(f"times must be a sequence of times, got shape {times.shape}")
    drives = [loop.name for loop in mechanism.loops if isinstance(loop, Drive)]
    if not drives:
        raise InputError(f"{mechanism.name} has no driven joint; add drives: mechanism.add_loops(Drive(...))")
    start = assemble(mechanism, q0, t=times[0]).q
    system = MechanismSystem(mechanism, start, times[0])
    state, rows = _state(system, times[0], start), []
    for t in times:
        state = _follow(system, state, t)
        rows.append(state)
    t, q, v, a, lam = (np.array(column) for column in zip(*rows, strict=True))
    torques = {name: lam[:, system.rows.slices[name].start] for name in drives}
    return InverseDynamics(mechanism, t, q, v, a, lam, torques)


def _state(system, t, q):
    """(t, q, v, a, λ) of the motion that loops and drives determine at a closed configuration."""
    space, name = TangentSpace(system, q, t), system.mechanism.name
    if space.Z.size:
        names = joints_in(system.mechanism, space.Z)
        raise SingularSystemError(
            f"{name}: loops and drives do not determine the motion of {', '.join(names)} at t = {t:.6g} s: drive or "
            "lock as many joints as the mobility, or avoid dead centres",
            names=names,
        )
    dependent = {row for dropped, kept in dependencies(space.J, space.kept).items() for row in (dropped, *kept)}
    labels = [system.rows.labels[row][0] for row in sorted(dependent)]
    twice = tuple(loop.name for loop in system.rows.loops if isinstance(loop, Drive) and loop.name in labels)
    if twice:
        raise SingularSystemError(
            f"{name}: the drives {', '.join(twice)} are more than the motions that the loops leave free, so they "
            "contradict each other, or their torques are not determined. Drive fewer joints",
            names=twice,
        )
    v = -space.P @ system.rows.time_rate(t, q)
    a = -space.P @ system.rows.acceleration_bias(t, q, v)
    return t, q, v, a, space.multipliers(pin.rnea(system.model, system.data, q, v, a) - system.torque(t, q, v))


def _follow(system, state, t):
    """The state at another time on the same branch, predicted by Taylor series in sufficiently small steps."""
    h = t - state[0]
    smallest = abs(h) / 2**STEP_HALVINGS
    while state[0] != t:
        now, q, v, a, _ = state
        sizes = step_sizes(system, q)
        if not abs(h) > smallest:
            raise AssemblyError(
                f"{system.mechanism.name}: the loops cannot follow the drives beyond t = {now:.6g} s: the positions "
                "are out of reach, or at a dead centre",
                q=q,
            )
        t_next = t if abs(t - now) <= abs(h) else now + h
        move = (t_next - now) * v + (t_next - now) ** 2 / 2 * a
        predicted = system.integrate(q, move)
        found = closed_near(system, t_next, predicted) if np.max(np.abs(move) / sizes) < 1.0 else None
        if found is None or np.max(np.abs(system.difference(predicted, found)) / sizes) > WIDEST:
            h /= 2
            continue
        try:
            state, h = _state(system, t_next, found), 2 * h
        except SingularSystemError:  # this step happens to end at a dead centre
            if t_next == t:
                raise
            h /= 2
    return state
