"""The motors of a mechanism: their velocity columns, and the closed configurations for their positions."""

from collections.abc import Mapping
from dataclasses import replace
from math import isfinite

import numpy as np
import pinocchio as pin

from ..errors import InputError, SingularSystemError, warn
from ..mechanism.assembly import assemble
from ..mechanism.checks import finite_array, number, require_mechanism, require_no_contacts
from ..mechanism.checks import names as checked_names
from ..mechanism.closing import NEARLY_CLOSED, LoopSolver
from ..mechanism.custom import Constraint
from ..mechanism.forces import Actuator, Servo
from ..mechanism.joint_constraints import Drive
from ..mechanism.lie import difference
from ..mechanism.mechanism import Mechanism
from ..mechanism.motion import Motion
from ..mechanism.names import joints_in, velocity_names
from ..mechanism.rank import HELD
from .coordinates import Coordinates

NOT_CLOSED = 1e-6  # m or rad: largest gap of a configuration to start from
TOO_OPEN = 1e-3  # largest gap of a configuration to evaluate: rows of a run are as open as its tolerance


class Motors:
    """The base of :class:`Actuation`, with the same parameters: the motors, and the closure of the loops."""

    def __init__(self, mech, motors=None, q0=None):
        require_mechanism(mech, "Actuation")
        require_no_contacts(mech, "Actuation")
        joints = mech.actuated if motors is None else checked_names(motors, "motors")
        if not joints:
            raise InputError(f"{mech.name} has no motors: name joints, Actuation(mech, motors=[…]), or set actuated=")
        self.mechanism: Mechanism = _without_motors(mech, joints)
        names, model = velocity_names(mech.model), mech.model
        self._columns = np.concatenate([np.arange(mech.nv)[mech.columns(joint)] for joint in joints])
        self._joints, self.motors = joints, tuple(names[i] for i in self._columns)
        if len(set(self.motors)) < len(self.motors):
            raise InputError(f"Actuation: a motor is named twice in {', '.join(joints)}")
        self._single = len(joints) == len(self._columns)
        self._plain = all(model.nqs[i] == 1 for i in map(model.getJointId, joints))
        self._places = np.array([model.idx_qs[model.getJointId(joint)] for joint in joints])
        self.q, self._reason = assemble(self.mechanism, q0).q, ""
        self._solver = LoopSolver(self.mechanism)
        self._chosen = Coordinates(self._solver, self._columns, self.q)
        n = self._chosen.n_motors
        self.mobility, self._shared = len(self._chosen.columns), n < len(self._columns)
        self.free = tuple(names[i] for i in self._chosen.columns[n:])
        if self._shared:
            self._require_mobile()
        if self.free:
            leave = "leave" + "s" * (len(self.motors) == 1)
            warn(
                f"{mech.name}: {self._counted()} {leave} {len(self.free)} of {self.mobility} motions free, those of "
                f"{', '.join(self.free)}; these are held, and carry no torque. Name more motors, or lock joints"
            )

    def __getstate__(self):
        """Without workspaces, which are made again with the same choice of coordinates."""
        chosen = self._chosen
        return self.__dict__ | {"_solver": None, "_chosen": (chosen.chosen_at, chosen.columns[chosen.n_motors :])}

    def __setstate__(self, state):
        self.__dict__.update(state)
        self._solver = LoopSolver(self.mechanism)
        self._chosen = Coordinates(self._solver, self._columns, *state["_chosen"])

    def __repr__(self):
        share = f"; {len(self.motors) - self._chosen.n_motors} more than needed" if self._shared else ""
        lines = [f"Actuation of {self.mechanism.name}: mobility {self.mobility}, {self._counted()}{share}"]
        lines += [f"  motors  {self._stand()}"] + [f"  free    {', '.join(self.free)}"] * bool(self.free)
        return "\n".join(lines)

    def _stand(self, q=None) -> str:
        return ", ".join(f"{name} = {value:.6g}" for name, value in zip(self.motors, self.positions(q), strict=True))

    def _counted(self) -> str:
        return "1 motor" if len(self.motors) == 1 else f"{len(self.motors)} motors"

    def positions(self, q=None) -> np.ndarray:
        """The positions of the motors in a configuration `q`, rad or m, shape (m,); default: the last one.

        For a joint of several degrees of freedom they are a rotation vector, or a pose in the coordinates of
        Pinocchio's ``difference`` from the neutral configuration.
        """
        model = self.mechanism.model
        return np.array(difference(model, pin.neutral(model), self._q(q))[self._columns])

    def closure(self, positions, q=None) -> tuple[np.ndarray, np.ndarray | bool]:
        """The configuration with the motors at `positions`: (q, ok).

        The motors are moved there from the last configuration, or from `q`, all at once and in steps that keep the
        assembly mode. If that is not possible, `ok` is False, the configuration is the last one on the path, and
        ``message`` gives the reason: a singular configuration, or the end of the reach.

        Parameters
        ----------
        positions : mapping or array
            Motor joint → position, as for :meth:`Mechanism.configuration`, the others are held; or an array (m,), rad
            or m. For a batch, an array (n, m), or a mapping to arrays (n,): each row starts from the one before it.
        q : array (nq,), optional
            A closed configuration to start from.

        Returns
        -------
        q : ndarray, shape (nq,) or (n, nq)
        ok : bool or ndarray, shape (n,)

        Raises
        ------
        InputError
            Names that are not motors, wrong sizes, a `q` that is not closed.
        """
        if q is not None:
            self.q = self._closed(q, NOT_CLOSED)
        if not isinstance(positions, Mapping):
            rows = finite_array(positions, "positions")
            if not self._single:
                raise InputError("positions must map motors to numbers if a motor has several degrees of freedom")
            if rows.ndim not in (1, 2) or rows.shape[-1] != len(self._columns):
                raise InputError(
                    f"positions must map motors to numbers or have {len(self._columns)} columns, got shape {rows.shape}"
                )
            several, goals = rows.ndim == 2, np.atleast_2d(rows)
            if not self._plain:
                goals = [dict(zip(self._joints, goal, strict=True)) for goal in goals]
        else:
            self._require_motors(positions)
            several = self._single and any(np.ndim(value) == 1 and np.size(value) > 1 for value in positions.values())
            goals = _goals(positions) if several else [positions]
        found = [self._lead(self._way(goal)) for goal in goals]
        if not several:
            return self.q.copy(), found[0][1]
        return np.array([q for q, _ in found]), np.array([ok for _, ok in found])

    @property
    def message(self) -> str:
        """The reason why the last closure did not reach its goal; empty if it did."""
        if self._reason is None:
            self._reason = f"the path is blocked {self._singular(self.q)}"
        return self._reason

    def _require_motors(self, names, what=""):
        if wrong := [joint for joint in names if joint not in self._joints]:
            raise InputError(f"{what}{wrong[0]!r} is not a motor; the motors are {', '.join(self._joints)}")

    def _way(self, goal):
        """Increments of the motors to positions, by name or as an array."""
        if isinstance(goal, np.ndarray):
            return goal - self.q[self._places]
        if self._plain:
            way = np.zeros(len(self._columns))
            for joint, value in goal.items():
                i = self._joints.index(joint)
                way[i] = number(np.asarray(value).item(), joint) - self.q[self._places[i]]
            return way
        target = self.mechanism.configuration(goal, base=self.q)
        return difference(self.mechanism.model, self.q, target)[self._columns]

    def _lead(self, way):
        """(q, ok) after increments of the motors."""
        start, left, self._reason, fresh = self.q, 1.0, "", False
        while True:
            chosen = self._chosen
            move = np.zeros(len(chosen.columns))
            move[: chosen.n_motors] = left * way[chosen.own]
            q, share = chosen.follower.follow(self.q, move)
            self.q = q
            if share == 1.0:
                break
            left *= 1.0 - share
            if fresh or not self._choose(q):  # other rows and columns may be better now
                self._reason = None  # computed when it is requested
                return q, False
            fresh = share == 0.0
        return q, self._reached(start, way)

    def _reached(self, start, way) -> bool:
        """Whether dropped rows are closed, and dependent motors are at their goals."""
        if self._shared:
            missed = np.abs(difference(self.mechanism.model, start, self.q)[self._columns] - way)
            if missed.max() > NEARLY_CLOSED:
                worst = self.motors[int(np.argmax(missed))]
                self._reason = f"the positions contradict each other: {worst} misses its position by {missed.max():.3g}"
                return False
        if not self._chosen.system.dropped_are_zero and (gap := self._chosen.gap(self.q)) > NEARLY_CLOSED:
            self._reason = f"rows that depended on others are open by {gap:.2g} m or rad"
            return False
        return True

    def _choose(self, q) -> bool:
        """Choose new coordinates at `q`; False if they are the same, or their numbers would differ.

        The free columns stay the same, as their joints are held.
        """
        old = self._chosen
        fresh = Coordinates(self._solver, self._columns, q, old.columns[old.n_motors :])
        same = np.array_equal(fresh.columns, old.columns) and np.array_equal(fresh.system.kept, old.system.kept)
        if same or fresh.n_motors != old.n_motors or len(fresh.p) != len(old.p) or len(fresh.p) != fresh.system.nc:
            return False
        self._chosen = fresh
        return True

    def _singular(self, q) -> str:
        sizes, motions = self._chosen.weakest(q)
        n = self._chosen.n_motors
        names = ", ".join(joints_in(self.mechanism, motions[:, n - 1 : len(sizes) - len(self.free)]))
        where = f"a singular configuration, condition {sizes[n - 1]:.1e}, where {names} can move with the motors held"
        if self.free:
            held, motions = self._chosen.weakest(q, self._chosen.columns)
            if held[-1] < sizes[n - 1]:
                names = ", ".join(joints_in(self.mechanism, motions[:, -1:]))
                where = f"a position, condition {held[-1]:.1e}, where {names} can move with the motors held, and "
                where += f"{', '.join(self.free)} too"
        return f"at {self._stand(q)}: {where}"

    def condition(self, q=None) -> float:
        """How well the motors determine the motion in a configuration `q` (default: the last one): from 0 to 1.

        The smallest singular value of the map from the motions that the loops allow to the motors: 0 in a singular
        position, where the mechanism can move with its motors held.
        """
        return float(self._chosen.weakest(self._closed(q))[0][self._chosen.n_motors - 1])

    def _q(self, q) -> np.ndarray:
        if q is None:
            return self.q
        model = self.mechanism.model
        if isinstance(q, np.ndarray) and q.shape == (model.nq,) and q.dtype == float:
            if not isfinite(q.sum()):
                raise InputError(f"{self.mechanism.name}: q has a number that is not finite")
            return q
        return self.mechanism.configuration(q, base=self.q)

    def _closed(self, q, most=TOO_OPEN) -> np.ndarray:
        """A copy of :meth:`_q`; InputError for one that is open by more than `most`."""
        q = self._q(q).copy()
        if not (gap := self._chosen.gap(q)) <= most:
            raise InputError(f"{self.mechanism.name}: q is open by {gap:.2g} m or rad; use assemble(mech, q).q")
        return q

    def _of_motors(self, values, what, full=True) -> tuple[bool, np.ndarray]:
        """(whether `values` are those of all joints, the values of all joints or of the motors)."""
        count, nv = len(self._columns), self.mechanism.nv
        if values is None:
            return False, np.zeros(count)
        if isinstance(values, Mapping):
            self._require_motors(values, f"{what}: ")
            return False, self.mechanism.velocity(values)[self._columns]
        values = finite_array(values, what)
        if values.shape not in ((count,), (nv,) if full else (count,)):
            also = f", or ({nv},) of all joints" if full else ""
            raise InputError(f"{what} needs shape ({count},), for {', '.join(self.motors)}{also}; got {values.shape}")
        return values.shape != (count,), values

    def _basis(self, q):
        """Z and B⁻¹ of the coordinates at a closed `q`; other coordinates are chosen if B is singular."""
        phi, J = self._chosen.rows(q)
        if not phi.dot(phi) <= TOO_OPEN**2:
            self._closed(q)
        found = self._chosen.basis(J)
        if found is None and self._choose(q):
            found = self._chosen.basis(self._chosen.rows(q)[1])
        if found is None:
            raise SingularSystemError(f"{self.mechanism.name}, {self._singular(q)}")
        return found

    def _seen(self, Z):
        """The velocities of all motors for unit velocities of those that are coordinates, (m, n_motors)."""
        return Z[self._columns, : self._chosen.n_motors]

    def _require_mobile(self):
        """Raise SingularSystemError if the loops hold some motors fixed."""
        chosen = self._chosen
        Z, _ = chosen.basis(chosen.rows(self.q)[1]) or (np.zeros((self.mechanism.nv, 1)), None)
        still = [name for name, row in zip(self.motors, Z[self._columns], strict=True) if np.abs(row).max() < HELD]
        if still:
            raise SingularSystemError(
                f"{self.mechanism.name}: the loops do not let these motors move: {', '.join(still)}. This is a dead "
                "centre, or they are locked: start elsewhere, Actuation(mech, motors, q0), or omit them",
                names=tuple(still),
            )


def _without_motors(mech, joints) -> Mechanism:
    """The mechanism without drives and forces of these joints; InputError if anything else depends on time."""
    for joint in joints:
        mech.joint_index(joint)
    loops = [loop for loop in mech.loops if not (isinstance(loop, Drive) and loop.joint in joints)]
    for loop in loops:
        still = isinstance(loop, Drive) and isinstance(loop.curve, Motion) and not any(loop.curve.numbers[1:3])
        if (isinstance(loop, Drive) and not still) or (isinstance(loop, Constraint) and loop.moving):
            raise InputError(f"{mech.name}: {loop.name!r} depends on time; name its joint among the motors, or omit it")
    forces = [force for force in mech.forces if not _on(force).intersection(joints)]
    return replace(mech, loops=tuple(loops), forces=tuple(forces))


def _on(force) -> set:
    return set(force.arms) if isinstance(force, Actuator) else {force.joint} if isinstance(force, Servo) else set()


def _goals(positions):
    """One mapping for each row of a batch."""
    sizes = {joint: np.size(value) for joint, value in positions.items()}
    if len(set(sizes.values()) - {1}) > 1:
        raise InputError(f"positions of a batch must have the same length, or be single numbers; got {sizes}")
    n = max(sizes.values())
    columns = {joint: np.broadcast_to(finite_array(value, joint), (n,)) for joint, value in positions.items()}
    return [{joint: column[i] for joint, column in columns.items()} for i in range(n)]
