"""Serial equivalents: a closed chain represented by rotor inertia, torque and speed of the joints that it moves.

With v_motors = T v_joints at a configuration, power gives τ_joints = Tᵀ τ_motors, and kinetic energy the inertia
Tᵀ diag(rotors) T. They depend on the configuration and couple the joints; the trees of learning software have one
number for each joint, and the resulting error is measured over a workspace.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import product
from pathlib import Path

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..files import written_whole
from ..mechanism.checks import names as checked_names
from ..mechanism.checks import near, number, require_mechanism, require_no_contacts
from ..mechanism.checks import workspace as data_of
from ..mechanism.mechanism import Mechanism
from ..mechanism.names import velocity_units
from .actuation import Actuation

MOVED = 1e-9  # of the largest speed: a joint slower than this does not move
POINTS_OF_JOINT = 7  # of a workspace, for each joint
MAX_REACH_OF_JOINT = 0.5  # rad or m: largest distance of a default workspace from the configuration
RANGE_SHARE = 0.5  # of the range of a joint that a default workspace covers, in each direction


@dataclass(frozen=True)
class DiagonalCost:
    """The error of using one number for each joint, over a workspace.

    Attributes
    ----------
    workspace : dict
        Joint → (lowest, highest position) examined, rad or m; ``points`` configurations of it could be reached, out of
        ``tried``.
    armature : float
        Largest error of the diagonal rotor inertia, relative to the total inertia reflected to the joints there.
    torque : float
        Smallest share of the box of the torque limits that the motors can exert; 0.5 for a rhombus.
    torque_least, speed_least : dict
        Joint → smallest torque that it can exert alone, and smallest speed alone, in the workspace.
    stiffness, damping : float
        Largest error of the diagonal gains, relative to the true ones; NaN without gains.
    """

    workspace: dict
    points: int
    tried: int
    armature: float
    torque: float
    torque_least: dict
    speed_least: dict
    stiffness: float
    damping: float


@dataclass(frozen=True, eq=False, repr=False)
class SerialEquivalent:
    """Joints of a tree that represent a closed chain; ``print`` shows them as a table.

    Arrays have the order of ``joints``; the unit of a turning joint is rad and N·m, of a sliding one m and N.

    Attributes
    ----------
    joints, motors : tuple of str
        The n joints, and the m motors that move them.
    q : ndarray, shape (nq,)
        The configuration at which matrices are given.
    T : ndarray, shape (m, n)
        Speeds of the motors for unit speeds of the joints; τ_joints = Tᵀ τ_motors.
    rotors, linkage, inertia : ndarray, shape (n, n)
        Inertia reflected to the joints: of the motors' rotors (armature); of the bodies that a tree without the loops
        would not have, such as cranks and rods; and of everything, with all other motors locked.
    armature : ndarray, shape (n,)
        The best constant values for ``rotors + linkage`` over the workspace: their mean diagonal, kg·m² or kg.
    torque_vertices : ndarray, shape (k, n)
        The vertices of the set of feasible joint torques; empty if an effort limit is missing.
    torque : ndarray, shape (n,)
        Largest torque of each joint while the others have none.
    torque_together : ndarray, shape (n,)
        Torques that the joints can exert simultaneously, in all combinations of signs, in the proportions of
        ``torque``.
    speed, speed_together : ndarray, shape (n,)
        The same for speeds.
    position : ndarray, shape (n, 2)
        Range of each joint from `q` with the others locked: limits of joints and motors, and singular configurations.
    stiffness_matrix, damping_matrix : ndarray, shape (n, n), or None
        Tᵀ diag(k) T of the motors' gains.
    stiffness, damping : ndarray, shape (n,), or None
        Their best diagonals over the workspace.
    cost : DiagonalCost
        The error of the constant values.
    """

    joints: tuple[str, ...]
    motors: tuple[str, ...]
    q: np.ndarray
    T: np.ndarray
    rotors: np.ndarray
    linkage: np.ndarray
    inertia: np.ndarray
    armature: np.ndarray
    torque_vertices: np.ndarray
    torque: np.ndarray
    torque_together: np.ndarray
    speed: np.ndarray
    speed_together: np.ndarray
    position: np.ndarray
    stiffness_matrix: np.ndarray | None
    damping_matrix: np.ndarray | None
    stiffness: np.ndarray | None
    damping: np.ndarray | None
    cost: DiagonalCost
    _units: tuple = field(repr=False, default=())

    def __str__(self):
        return _text(self)

    __repr__ = __str__

    def to_yaml(self, file=None) -> str:
        """A YAML text with the numbers of each joint, the matrices and torque vertices; optionally written to `file`.

        Raises OSError if the file cannot be written.
        """
        return _written(_yaml(self), file)

    def to_mjcf(self, file=None) -> str:
        """The joints as MJCF elements, to be merged into those of a tree; optionally written to `file`.

        A ``joint`` has ``armature``, ``range`` and ``actuatorfrcrange``, the torque that it can exert alone; a
        ``position`` actuator has the gains, if there are any. A comment states the error of the constant values. Raises
        OSError if the file cannot be written.
        """
        return _written(_mjcf(self), file)


def serial_equivalent(
    mech: Mechanism, joints, motors=None, q0=None, *, efforts=None, speeds=None, stiffness=None, damping=None,
    workspace=None,
) -> SerialEquivalent:  # fmt: skip
    """The equivalent of a closed chain at the `joints` that it moves: rotor inertia, torques, speeds, ranges and gains.

    For simulation or learning with a tree: an ankle with two motors and rods becomes two joints, pitch and roll, with
    the corresponding inertia, torques and gains.

    Parameters
    ----------
    mech : Mechanism
    joints : sequence of str
        Joints of one degree of freedom that remain in the tree, such as pitch and roll of an ankle.
    motors : sequence of str, optional
        The motors that move them. Default: those of ``mech.actuated`` that move when the joints do, the others locked.
    q0 : mapping or array, optional
        The configuration, closed as by :func:`assemble`. Default: the mechanism's guess.
    efforts, speeds : number or mapping, optional
        Motor → largest torque, N·m or N, and largest speed; a number is that of all. Default: the limits of the model.
    stiffness, damping : number or mapping, optional
        Motor → gain k and d of its servo, N·m/rad and N·m·s/rad.
    workspace : mapping, optional
        Joint → (lowest, highest position), where the error of constant values is measured. Default: half of the range
        of each joint around `q0`, 0.5 rad or m at most.

    Returns
    -------
    SerialEquivalent

    Raises
    ------
    InputError
        Joints that no motor moves, or that move without the motors; unknown names; numbers that are not positive.
    AssemblyError, SingularSystemError
        The loops cannot be closed; a singular configuration.
    """
    require_mechanism(mech, "serial_equivalent")
    require_no_contacts(mech, "serial_equivalent")
    joints = tuple(checked_names(joints, "joints"))
    for joint in joints:
        if mech.model.nvs[mech.joint_index(joint)] != 1:
            raise InputError(f"serial_equivalent: joint {joint!r} has several degrees of freedom")
    chain = _Chain(mech, joints, None if motors is None else checked_names(motors, "motors"), q0)
    limits = [
        chain.limits(given, getattr(mech.model, name), what)
        for given, name, what in ((efforts, "upperEffortLimit", "efforts"), (speeds, "upperVelocityLimit", "speeds"))
    ]
    gains = [None if given is None else chain.numbers(given, what) for given, what in
             ((stiffness, "stiffness"), (damping, "damping"))]  # fmt: skip
    position = chain.position()
    grid = chain.workspace(workspace, position)
    states = chain.reached(grid)
    every = [chain.at(q) for q in states]
    here = chain.at(chain.q)
    torques, speed = (_alone(rule, here.T, limit) for rule, limit in zip((_torque, _speed), limits, strict=True))
    best = [None if gain is None else _mean([_seen(each.T, gain) for each in every]) for gain in gains]
    armature = _mean([each.rotors + each.linkage for each in every])
    matrices = [None if gain is None else _seen(here.T, gain) for gain in gains]
    cost = _cost(chain, grid, every, armature, limits, gains, best)
    return SerialEquivalent(
        joints, chain.motors, chain.q, here.T, here.rotors, here.linkage, here.inertia, armature,
        _corners(here.T, limits[0]), torques, _together(_torque, here.T, limits[0], torques), speed,
        _together(_speed, here.T, limits[1], speed), position,
        matrices[0], matrices[1], best[0], best[1], cost, chain.units,
    )  # fmt: skip


@dataclass(frozen=True)
class _State:
    T: np.ndarray
    rotors: np.ndarray
    linkage: np.ndarray
    inertia: np.ndarray


class _Chain:
    """The chain between joints and motors: its joints are the motors of an Actuation, with all other motors held."""

    def __init__(self, mech, joints, motors, q0):
        self.mech, self.model, self.joints = mech, mech.model, joints
        self.motors = self._moving(mech, joints, q0) if motors is None else tuple(motors)
        if len(self.motors) < len(joints):
            raise InputError(f"{mech.name}: {len(joints)} joints need as many motors, got {', '.join(self.motors)}")
        held = [joint for joint in mech.actuated if joint not in (*joints, *self.motors)]
        self.act = _actuation(mech, [*joints, *held], q0)
        self.q = self.act.q.copy()
        self._columns = [mech.columns(joint).start for joint in joints]
        self._of_motors = [mech.columns(joint).start for joint in self.motors]
        self._require_determined()
        self._side = self._side_joints(self.act.jacobian(self.q)[:, : len(joints)])
        self._bodies = self._side_bodies()
        self._data = data_of(self._bodies), data_of(self.model)
        self.units = tuple(velocity_units(self.model)[column] for column in self._columns)

    @staticmethod
    def _moving(mech, joints, q0) -> tuple[str, ...]:
        """The motors of the file that move the joints."""
        if not mech.actuated:
            raise InputError(f"{mech.name} has no motors: name them, motors=[…]")
        act = _actuation(mech, None, q0)
        A = act.jacobian()
        speeds = np.abs(A[[mech.columns(joint).start for joint in joints]]).max(axis=0)
        found = [motor for motor, speed in zip(act.motors, speeds, strict=True) if speed > MOVED * np.abs(A).max()]
        if len(found) < len(joints):
            known = f"{', '.join(found)} alone" if found else "no motor"
            raise InputError(f"{mech.name}: {known} moves {', '.join(joints)}; name other joints, or motors=[…]")
        return tuple(found)

    def _require_determined(self):
        """Raise InputError if the motors can move while the joints stand."""
        Z = self.act._basis(self.q)[0]
        free = np.abs(Z[self._of_motors, self.act._chosen.n_motors :]).max(axis=0, initial=0.0)
        if (free > MOVED).any():
            joint = self.act.free[int(np.argmax(free))]
            motors, joints = ", ".join(self.motors), ", ".join(self.joints)
            raise InputError(
                f"{self.mech.name}: the motors {motors} can move while {joints} stands: "
                f"name another joint that they move, here {joint!r} is left free, or fewer motors"
            )

    def _side_joints(self, A):
        """The joints that move with those of the tree, and are not among them."""
        fast = np.abs(A).max(axis=1) > MOVED * np.abs(A).max()
        return {
            i
            for i in range(1, self.model.njoints)
            if self.model.names[i] not in self.joints
            and fast[self.model.idx_vs[i] : self.model.idx_vs[i] + self.model.nvs[i]].any()
        }

    def _side_bodies(self):
        """A model with the inertias of the bodies that such joints carry alone."""
        model = self.model.copy()
        model.armature = np.zeros(model.nv)
        for i in range(1, model.njoints):
            if not self._side.intersection(list(model.supports[i])):
                model.inertias[i] = pin.Inertia.Zero()
        return model

    def at(self, q) -> _State:
        """Speeds and inertias at a closed configuration."""
        A = self.act.jacobian(q)[:, : len(self.joints)]
        rotors = np.zeros(self.model.nv)
        for i in self._side.union(map(self.model.getJointId, self.motors)):
            columns = slice(self.model.idx_vs[i], self.model.idx_vs[i] + self.model.nvs[i])
            rotors[columns] = self.model.armature[columns]
        linkage = A.T @ pin.crba(self._bodies, self._data[0], q) @ A
        whole = A.T @ pin.crba(self.model, self._data[1], q) @ A
        T = A[self._of_motors]
        if np.linalg.matrix_rank(T, tol=MOVED * max(np.abs(T).max(initial=0.0), 1.0)) < len(self.joints):
            raise InputError(
                f"{self.mech.name}: {', '.join(self.joints)} can move while the motors {', '.join(self.motors)} stand: "
                "they are not enough"
            )
        return _State(T, A.T @ (rotors[:, None] * A), linkage, whole)

    def numbers(self, given, what) -> np.ndarray:
        """A number for each motor, from one or a mapping."""
        if isinstance(given, Mapping):
            if unknown := [name for name in given if name not in self.motors]:
                raise InputError(f"{what}: {unknown[0]!r} is not among the motors{near(unknown[0], self.motors)}")
            if missing := [name for name in self.motors if name not in given]:
                raise InputError(f"{what}: no number for motor {missing[0]!r}")
            return np.array([number(given[name], f"{what} of {name!r}", least=0.0) for name in self.motors])
        return np.full(len(self.motors), number(given, what, least=0.0))

    def limits(self, given, of_model, what) -> np.ndarray | None:
        """The limits of the motors; None if one of them has none."""
        if given is not None:
            return self.numbers(given, what)
        found = np.abs(np.array(of_model)[self._of_motors])
        return found if ((found > 0.0) & (found < 1e10)).all() else None

    def position(self) -> np.ndarray:
        found = self.act.limits(self.q)[: len(self.joints)]
        return np.array([(each.lower, each.upper) for each in found])

    def workspace(self, given, position) -> dict[str, tuple[float, float]]:
        """Joint → (lowest, highest)."""
        own = self.act.positions(self.q)[: len(self.joints)]
        ends = own[:, None] + np.clip(RANGE_SHARE * (position - own[:, None]), -MAX_REACH_OF_JOINT, MAX_REACH_OF_JOINT)
        found = {joint: (float(low), float(high)) for joint, (low, high) in zip(self.joints, ends, strict=True)}
        if given is None:
            return found
        if not isinstance(given, Mapping) or any(joint not in self.joints for joint in given):
            raise InputError(f"workspace: a mapping of {', '.join(self.joints)} to (lowest, highest), got {given!r}")
        for joint, pair in given.items():
            try:
                low, high = (float(end) for end in pair)
            except (TypeError, ValueError):
                raise InputError(f"workspace of {joint!r}: two numbers, got {pair!r}") from None
            if not low <= high:
                raise InputError(f"workspace of {joint!r}: the lower one first, got {pair!r}")
            found[joint] = low, high
        return found

    def reached(self, grid) -> list[np.ndarray]:
        """The configurations of a workspace that can be reached, row by row from the nearest end of the last one."""
        axes = [np.linspace(low, high, POINTS_OF_JOINT) for low, high in (grid[joint] for joint in self.joints)]
        found, q = [], self.q
        for first in product(*axes[:-1]):
            row = q
            for k, last in enumerate(axes[-1]):
                reached, ok = self.act.closure(dict(zip(self.joints, (*first, last), strict=True)), row)
                if ok:
                    found.append(reached)
                    row = reached
                    q = reached if k == 0 else q
        if not found:
            raise InputError(f"{self.mech.name}: no configuration of the workspace {grid} can be reached")
        return found


def _actuation(mech, motors, q0) -> Actuation:
    """With a warning less: motions that neither joints nor motors determine, as spins of rods, are held."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        return Actuation(mech, motors, q0)


def _seen(T, gains):
    return T.T @ (gains[:, None] * T)


def _mean(matrices) -> np.ndarray:
    """The diagonal that is nearest to all of them."""
    return np.mean([np.diagonal(each) for each in matrices], axis=0)


def _torque(T, limit, direction) -> float:
    """The largest c for which the motors can exert c·direction on the joints."""
    if np.linalg.matrix_rank(T) == T.shape[0]:  # as many motors as joints
        needed = np.abs(np.linalg.lstsq(T.T, direction, rcond=None)[0])
        return float(np.min(np.divide(limit, needed, out=np.full(len(limit), np.inf), where=needed > 1e-12)))
    from scipy.optimize import linprog

    m = len(limit)
    result = linprog(
        np.append(np.zeros(m), -1.0), A_eq=np.column_stack((T.T, -direction)), b_eq=np.zeros(T.shape[1]),
        bounds=[*((-each, each) for each in limit), (0.0, None)],
    )  # fmt: skip
    return float(result.x[-1])


def _speed(T, limit, direction) -> float:
    """The largest c for which the motors can follow speeds c·direction of the joints."""
    needed = np.abs(T @ direction)
    return float(np.min(np.divide(limit, needed, out=np.full(len(limit), np.inf), where=needed > 1e-12)))


def _alone(rule, T, limit) -> np.ndarray:
    n = T.shape[1]
    return np.full(n, np.nan) if limit is None else np.array([rule(T, limit, unit) for unit in np.eye(n)])


def _together(rule, T, limit, alone) -> np.ndarray:
    """The largest box in the proportions of what each joint can do alone."""
    if limit is None:
        return np.full(T.shape[1], np.nan)
    signs = product((-1.0, 1.0), repeat=T.shape[1])
    return min(rule(T, limit, alone * np.array(each)) for each in signs) * alone


def _corners(T, limit) -> np.ndarray:
    """The corners of Tᵀ τ for all τ within the limits, in order around the middle for two joints."""
    if limit is None:
        return np.zeros((0, T.shape[1]))
    points = np.array([T.T @ (limit * each) for each in product((-1.0, 1.0), repeat=len(limit))])
    if T.shape[1] == 1:
        return np.array([points.min(axis=0), points.max(axis=0)])
    from scipy.spatial import ConvexHull

    return points[ConvexHull(points).vertices]


def _share(T, limit) -> float:
    """The volume of the torques in the box of those of each joint alone, relative to it; 1 for independent joints."""
    alone = _alone(_torque, T, limit)
    if len(alone) == 1:
        return 1.0
    from scipy.spatial import ConvexHull, HalfspaceIntersection

    n = len(alone)
    sides = np.vstack((np.hstack((np.eye(n), np.full((n, 1), -1.0))), np.hstack((-np.eye(n), np.full((n, 1), -1.0)))))
    hull = ConvexHull(_corners(T, limit) / alone)
    within = HalfspaceIntersection(np.vstack((hull.equations, sides)), np.zeros(n)).intersections
    return float(ConvexHull(within).volume / 2**n)


def _cost(chain, grid, every, armature, limits, gains, best) -> DiagonalCost:
    def off(matrices, diagonal, wholes):
        return max(
            float(np.linalg.norm(each - np.diag(diagonal), 2) / np.linalg.norm(whole, 2))
            for each, whole in zip(matrices, wholes, strict=True)
        )

    found = []
    for gain, diagonal in zip(gains, best, strict=True):
        matrices = None if gain is None else [_seen(each.T, gain) for each in every]
        found.append(np.nan if matrices is None else off(matrices, diagonal, matrices))
    of_rotors = off([each.rotors + each.linkage for each in every], armature, [each.inertia for each in every])
    efforts, speeds = limits
    share = min(_share(each.T, efforts) for each in every) if efforts is not None else np.nan
    least = [
        dict(zip(chain.joints, np.min([_alone(rule, each.T, limit) for each in every], axis=0).tolist(), strict=True))
        for rule, limit in ((_torque, efforts), (_speed, speeds))
    ]
    tried = POINTS_OF_JOINT ** len(chain.joints)
    return DiagonalCost(grid, len(every), tried, of_rotors, share, least[0], least[1], found[0], found[1])


def _yaml(found) -> str:
    import yaml

    return yaml.safe_dump(_plain(found), sort_keys=False, allow_unicode=True)


def _plain(found) -> dict:
    def numbers(values):
        return np.round(np.asarray(values, float), 12).tolist()

    each = {}
    for k, joint in enumerate(found.joints):
        each[joint] = {
            "armature": float(found.armature[k]), "range": numbers(found.position[k]),
            "torque": float(found.torque[k]), "torque_together": float(found.torque_together[k]),
            "speed": float(found.speed[k]), "speed_together": float(found.speed_together[k]),
        }  # fmt: skip
        for name in ("stiffness", "damping"):
            if getattr(found, name) is not None:
                each[joint][name] = float(getattr(found, name)[k])
    cost = found.cost
    names = "T", "rotors", "linkage", "inertia", "torque_vertices"
    matrices = {name: numbers(getattr(found, name)) for name in names}
    for name in ("stiffness_matrix", "damping_matrix"):
        if getattr(found, name) is not None:
            matrices[name] = numbers(getattr(found, name))
    return {
        "joints": each, "motors": list(found.motors), "matrices": matrices,
        "cost": {
            "workspace": {joint: list(ends) for joint, ends in cost.workspace.items()},
            "reached": cost.points, "tried": cost.tried, "armature": cost.armature, "torque": cost.torque,
            "torque_least": cost.torque_least, "speed_least": cost.speed_least,
            "stiffness": cost.stiffness, "damping": cost.damping,
        },
    }  # fmt: skip


def _mjcf(found) -> str:
    from xml.sax.saxutils import quoteattr

    lines = [f"<!-- {line} -->" for line in _costs(found)]
    for k, joint in enumerate(found.joints):
        name, (low, high) = quoteattr(joint), found.position[k]
        limited = f' range="{low:.6g} {high:.6g}"' if np.isfinite([low, high]).all() else ""
        torque = found.torque[k]
        force = f' actuatorfrcrange="{-torque:.6g} {torque:.6g}"' if np.isfinite(torque) else ""
        lines.append(f'<joint name={name} armature="{found.armature[k]:.6g}"{limited}{force}/>')
    for k, joint in enumerate(found.joints if found.stiffness is not None else ()):
        kv = f' kv="{found.damping[k]:.6g}"' if found.damping is not None else ""
        name = quoteattr(joint)
        lines.append(f'<position name={name} joint={name} kp="{found.stiffness[k]:.6g}"{kv}/>')
    return "\n".join(lines) + "\n"


def _costs(found) -> list[str]:
    cost = found.cost
    where = ", ".join(f"{joint} {low:.3g} to {high:.3g}" for joint, (low, high) in cost.workspace.items())
    lines = [f"single numbers over {where} ({cost.points} of {cost.tried} positions reached):"]
    lines.append(f"the inertia that joints feel is off by up to {100 * cost.armature:.2g} %")
    if np.isfinite(cost.torque):
        pairs = zip(found.joints, found.torque_together, strict=True)
        together = ", ".join(f"{joint} {each:.3g}" for joint, each in pairs)
        least = ", ".join(f"{joint} {each:.3g}" for joint, each in cost.torque_least.items())
        lines.append(f"of the box of torques, {100 * cost.torque:.0f} % can be exerted; together: {together}")
        lines.append(f"torques alone are at least: {least}")
    for name in ("stiffness", "damping"):
        if np.isfinite(off := getattr(cost, name)):
            lines.append(f"{name}: diagonal gains are off by up to {100 * off:.2g} %")
    return lines


def _text(found) -> str:
    lines = [f"{', '.join(found.joints)}, moved by {', '.join(found.motors)}"]
    for k, (joint, unit) in enumerate(zip(found.joints, found._units, strict=True)):
        inertia, force = ("kg·m²", "N·m") if unit == "rad" else ("kg", "N")
        low, high = found.position[k]
        parts = [f"armature {found.armature[k]:.4g} {inertia}", f"range {low:.4g} to {high:.4g} {unit}"]
        if np.isfinite(found.torque[k]):
            parts.append(f"torque ±{found.torque[k]:.4g} {force} alone, ±{found.torque_together[k]:.4g} together")
        if np.isfinite(found.speed[k]):
            parts.append(f"speed ±{found.speed[k]:.4g} {unit}/s alone, ±{found.speed_together[k]:.4g} together")
        for name, sign in (("stiffness", "kp"), ("damping", "kd")):
            if getattr(found, name) is not None:
                parts.append(f"{sign} {getattr(found, name)[k]:.4g}")
        lines.append(f"  {joint}: {', '.join(parts)}")
    return "\n".join([*lines, *(f"  {line}" for line in _costs(found))])


def _written(text, file) -> str:
    if file is not None:
        with written_whole(Path(file)) as stream:
            stream.write(text.encode())
    return text
