"""Closed configurations: close the loops from a guess, project velocities onto the constraints, report the result."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import tau

import numpy as np

from ..errors import AssemblyError, InputError, warn
from .checks import coordinates, number, require_mechanism
from .closing import CLOSED_GAP, NEARLY_CLOSED, LoopSolver
from .correction import hint
from .joint_constraints import Drive
from .lie import difference, integrate
from .loops import LOOP_KINDS
from .names import filled, is_revolute, velocity_units
from .rank import dependencies, weak_text
from .rows import positions

KEPT = 1e-9  # rad or m: a joint farther than this from its value has not kept it
MOST_SHOWN = 6  # joints in one warning
DRIVEN = 1e-6  # rad or m: a given joint value farther than this from that of its drive contradicts the drive
ROUNDED_GAP = 1e-3  # m or rad: larger gaps are not caused by rounded numbers
NEARLY_SINGULAR = 1e-6  # smallest singular value of the loops' kept rows, relative to the largest
FULL_TURN = 7.0  # rad: a little more than a full turn
MAX_REACH = 10.0  # times the size of the mechanism at the guess: no body is meant to slide or to reach that far
FAR_STEPS = 10  # of Newton's method, without a bound: they converge from where the bounded search ended, or not at all


@dataclass(frozen=True, eq=False)
class Assembly:
    """A closed configuration, with its rank and gaps.

    Attributes
    ----------
    q, v : ndarray
        Closed configuration (nq,) and a velocity on the constraints (nv,).
    gaps : dict[str, float]
        Largest |Φ| of each loop, m or rad.
    rows, rank, mobility : int
        Number of constraint rows; number of independent rows at `q`; degrees of freedom left, nv - rank.
    moved : float
        Largest change of a tangent coordinate from the guess, rad or m.
    iterations : int
        Number of iterations of the assembly.
    """

    q: np.ndarray
    v: np.ndarray
    gaps: dict
    rows: int
    rank: int
    mobility: int
    moved: float
    iterations: int
    _rows: tuple = field(repr=False)  # J, its kept rows, and the labels of all rows

    def __str__(self):
        name, gap = self.largest_gap
        where = f" ({name!r})" if name else ""
        return (
            f"closed to {gap:.2g} m or rad{where} in {self.iterations} iterations, {self.moved:.3g} from the guess: "
            f"rank {self.rank} of {self.rows} rows, mobility {self.mobility}\nq = {self.q}\nv = {self.v}"
        )

    @cached_property
    def redundant(self) -> dict[tuple[str, str], dict[tuple[str, str], float]]:
        """Each redundant row → the rows that it is a linear combination of (empty: the row is identically zero)."""
        J, kept, labels = self._rows
        combinations = dependencies(J, kept).items()
        return {labels[row]: {labels[i]: share for i, share in shares.items()} for row, shares in combinations}

    @property
    def largest_gap(self) -> tuple[str, float]:
        """(loop, |Φ|) of the loop with the largest gap; ("", 0.0) for a tree."""
        return max(self.gaps.items(), key=lambda item: item[1], default=("", 0.0))


def assemble(mechanism, q0=None, v0=None, *, fixed=None, t: float = 0.0, tolerance: float = NEARLY_CLOSED) -> Assembly:
    """Find a closed configuration near a guess, and a velocity that satisfies the constraints.

    Parameters
    ----------
    mechanism : Mechanism
    q0 : mapping or array, optional
        Guess: joint name → value (the others from ``mechanism.guess``; the named joints keep their values if the loops
        allow it, else a warning reports the new ones), or a configuration (nq,), all of which may change. If
        ``mechanism.guess`` is closed, the named joints are moved from there in small steps with the loops closed, which
        keeps the assembly mode. If that path is blocked, the loops are closed from the guess, in whichever mode is
        close.
    v0 : mapping or array, optional
        Velocity: joint name → value (these joints keep it, the others follow), or an array (nv,) that is projected
        in the mass metric. Default rest.
    fixed : mapping, optional
        Joint name → value: joints that must have exactly this configuration.
    t : float
        Time at which drives are evaluated, s.
    tolerance : float
        Largest |Φ| of a closed loop, m and rad. Loops are closed to rounding if possible; a gap above 1e-10 causes a
        warning.

    Returns
    -------
    Assembly

    Raises
    ------
    AssemblyError
        The loops cannot be closed; the error names the worst ones with their gaps, and carries the best configuration.
        Or a drive contradicts the value of a joint in `q0` or `fixed`.
    InputError
        Unknown joints, wrong sizes, NaN.
    """
    require_mechanism(mechanism, "assemble")
    return assembled(LoopSolver(mechanism, number(t, "t")), q0, v0, fixed, tolerance)


def assembled(solver: LoopSolver, q=None, v=None, fixed=None, tolerance=NEARLY_CLOSED, advises=True) -> Assembly:
    """:func:`assemble` with a solver that the caller goes on using; `advises` searches for advice, which takes long.

    Many runs start from the same state: the last start of a mechanism, if nothing was to be warned about, is known.
    """
    start = None
    if fixed is None and tolerance is NEARLY_CLOSED and advises and solver.loop_rows.pure:
        start = _start(solver, q, v)
    if start is None:
        return _assembled(solver, q, v, fixed, tolerance, advises)
    known = solver.loop_rows.assemblies
    found = known.get(start)
    if found is None:
        found = _assembled(solver, q, v, fixed, tolerance, advises)
        known.clear()
        if not solver.warned:
            known[start] = found
    return replace(found, q=found.q.copy(), v=found.v.copy(), gaps=dict(found.gaps))


def _start(solver, q, v):
    """What an assembly begins with, as the key of a dictionary; None if it cannot be one."""
    guess = solver.mechanism.guess.tobytes() if q is None or isinstance(q, dict) else None
    keys = _key(q), _key(v)
    return None if None in keys else (solver.t, guess, *keys)


def _key(values):
    """A position or velocity as the key of a dictionary; None if it cannot be one."""
    if values is None:
        return ()
    if type(values) is np.ndarray:
        return values.shape, values.dtype.str, values.tobytes()
    if type(values) is dict and all(type(value) is float for value in values.values()):
        return tuple(values.items())
    return None


def _assembled(solver, q, v, fixed, tolerance, advises) -> Assembly:
    mechanism = solver.mechanism
    if not (fixed is None or isinstance(fixed, Mapping)):
        raise InputError(f"fixed= needs a mapping joint name → value, got {fixed!r}")
    if number(tolerance, "tolerance") <= 0:
        raise InputError(f"tolerance must be positive, got {tolerance!r}")
    fixed = dict(fixed or {})
    named = dict(q) if isinstance(q, Mapping) else {}
    held = {**named, **fixed}
    base = mechanism.guess.copy() if q is None or isinstance(q, Mapping) else mechanism.configuration(q)
    guess = mechanism.configuration(held, base=base) if held else base
    _warn_of_degrees(solver, held)
    best, iterations = _closest(solver, base, guess, held, fixed, tolerance)
    solver.loop_rows.check_derivatives(solver.t, best)
    gaps = solver.gaps(best)
    open_loops = {name: gap for name, gap in gaps.items() if not gap <= tolerance}
    if open_loops:
        raise _not_closed(solver, guess, best, open_loops, fixed)
    if tolerance <= NEARLY_CLOSED:
        _warn_of_gaps(solver, gaps)
    _warn_of_moved_joints(solver, named, guess, best)
    if advises:
        _advise(solver, guess, best)
    J = solver.rows(best)[1]
    kept = solver.kept(best)
    return Assembly(
        q=best,
        v=velocity_on_constraints(solver, best, v),
        gaps=gaps,
        rows=len(J),
        rank=len(kept),
        mobility=mechanism.nv - len(kept),
        moved=float(np.abs(difference(mechanism.model, guess, best)).max(initial=0.0)),
        iterations=iterations,
        _rows=(J, kept, solver.loop_rows.labels),
    )


def _warn(solver, message) -> None:
    """Warn, and note that this assembly must be made again another time, to warn again."""
    solver.warned = True
    warn(message)


def _closest(solver, base, guess, held, fixed, tolerance):
    """The best configuration with the joints `held`, and the iterations; without, if the loops do not close then.

    `guess` has their values, and `base` those of the other joints. Joints of drives leave `held` and `fixed`: their
    values are those of the drives, except for rounding.
    """
    for joint in _driven(solver, held, guess):
        held.pop(joint)
        fixed.pop(joint, None)
    moved = solver.moved(base, guess, solver.free_columns(held)) if held else None
    start = guess if moved is None else solver.mechanism.configuration(held, base=moved)
    best, iterations = solver.close(start, solver.free_columns(held))
    if held.keys() != fixed.keys() and solver.size(best) > tolerance:
        return solver.close(start, solver.free_columns(fixed))
    return best, iterations


def _warn_of_gaps(solver, gaps) -> None:
    """Warn of loops that close, but not to rounding."""
    mechanism = solver.mechanism
    worst = max(gaps, key=gaps.__getitem__, default="")
    if gaps and gaps[worst] > CLOSED_GAP:
        _warn(
            solver,
            f"{mechanism.name}: the loops contradict each other slightly: {worst!r} closes only to "
            f"{gaps[worst]:.1e} m or rad. Most likely the numbers in the file are rounded: load(…, precision=1e-6) or "
            "mechanism.corrected(1e-6) makes them consistent",
        )


def _warn_of_moved_joints(solver, named, guess, best) -> None:
    """Warn of joints of `named` that do not have their values."""
    mechanism = solver.mechanism
    moved = not_kept(mechanism, named, best) if named else []
    if not moved:
        return
    shown = moved[:MOST_SHOWN] if len(named) > MOST_SHOWN else named
    requested = ", ".join(f"{joint} = {_text(coordinates(mechanism.model, joint, guess))}" for joint in shown)
    at = ", ".join(f"{joint} = {_text(coordinates(mechanism.model, joint, best))}" for joint in shown)
    loops = "loops and drives" if solver.loop_rows.moving else "loops"
    _warn(solver, f"{mechanism.name}: the {loops} do not close with {requested}; they do at {at}")


def _advise(solver, guess, best) -> None:
    """Warn of a rank that depends on rounding, of a mechanism that cannot move, and of places far away."""
    mechanism = solver.mechanism
    ranking = solver.ranking(best)
    weak = ranking.weak(solver.loop_rows.labels)
    rank = len(ranking.kept)
    mobility = mechanism.nv - rank
    immobile = not (mobility or solver.loop_rows.moving) and bool(mechanism.anchored_loops)
    advice = hint(mechanism) if weak or immobile else ""
    if advice:
        why = f"rank {rank} and mobility {mobility} depend on rounding: {weak_text(weak)}" if weak else ""
        _warn(solver, f"{mechanism.name}: {why or 'nothing can move'}. Most likely {advice}")
    far = _far_off(solver, guess, best)
    if far:
        _warn(solver, f"{mechanism.name}: the loops close only {far}. Check lengths, units and the directions of axes")
    long = _long_levers(solver, guess)
    if long:
        _warn(solver, f"{mechanism.name}: {long}")


def _warn_of_degrees(solver, named) -> None:
    """Warn of whole numbers of more than a turn, which are hardly radians."""
    mechanism = solver.mechanism
    for joint, value in named.items():
        if np.size(value) != 1 or not is_revolute(mechanism.model.joints[mechanism.joint_index(joint)]):
            continue
        angle = float(np.ravel(value)[0])
        if FULL_TURN < abs(angle) <= 360.0 and angle.is_integer():
            _warn(
                solver,
                f"{mechanism.name}: {joint} = {angle:g} is read in rad, {angle / tau:.1f} turns. For {angle:g} degrees "
                f"write numpy.radians({angle:g}), on the command line --at {joint}={angle:g}deg",
            )


def not_kept(mechanism, named, q, tolerance: float = KEPT) -> list[str]:
    """The joints of `named`, joint → value, that have other values in the configuration `q`."""
    apart = np.abs(difference(mechanism.model, q, mechanism.configuration(named, base=q)))
    return [joint for joint in named if apart[mechanism.columns(joint)].max() > tolerance]


def _driven(solver, held, q) -> set[str]:
    """The joints in `held` that a drive moves; AssemblyError if a drive contradicts their values in `q`."""
    found = set()
    for row in solver.loop_rows.closures:
        if isinstance(row.loop, Drive) and row.loop.joint in held:
            found.add(row.loop.joint)
            (value,) = coordinates(solver.model, row.loop.joint, q)
            (gap,) = solver.rows(q)[0][solver.loop_rows.slices[row.loop.name]]
            if abs(gap) > DRIVEN:
                raise AssemblyError(
                    f"{solver.mechanism.name}: joint {row.loop.joint!r} cannot start at {value:.6g}: drive "
                    f"{row.loop.name!r} holds it at {value - gap:.6g} at t = {solver.t:g} s. Leave the joint out, or "
                    "change the curve",
                    gaps={row.loop.name: abs(gap)},
                    q=q,
                )
    return found


def _text(values) -> str:
    return " ".join(f"{each:.6g}" for each in values)


def velocity_on_constraints(solver: LoopSolver, q, v=None, kept=None, before=None) -> np.ndarray:
    """A velocity with J v + Φ_t = 0 in the rows `kept` at a closed configuration; `v` as in :func:`assemble`.

    With a velocity `before`, joints that are not named in `v` keep theirs as far as possible, in the mass metric: the
    change is that of impulses at the named joints and in the loops.
    """
    mechanism, t, moving = solver.mechanism, solver.t, solver.loop_rows.moving
    start = mechanism.velocity({} if v is None else v)
    if before is not None:
        start = filled(mechanism, v, before.copy(), velocity=True)
    if not (moving or start.any()):  # rest
        return start
    kept = solver.kept(q) if kept is None else kept
    J = solver.rows(q)[1][kept]
    held = ~solver.free_columns(v if isinstance(v, Mapping) else {})
    E = np.vstack((J, np.eye(mechanism.nv)[held]))
    target = np.concatenate((-solver.loop_rows.time_rate(t, q)[kept], start[held]))
    if not (start.any() or target.any()):
        return start
    U, sizes, Vt = np.linalg.svd(E)
    rank = int((sizes > 1e-12 * sizes.max(initial=0.0)).sum())
    result, Z = Vt[:rank].T @ ((U.T @ target)[:rank] / sizes[:rank]), Vt[rank:].T
    if Z.size:  # with least kinetic energy, or least distance from a velocity
        M = solver.mass_matrix(q)
        nearest = before if before is not None else 0.0 if held.any() else start
        result = result + Z @ np.linalg.lstsq(Z.T @ M @ Z, Z.T @ (M @ (nearest - result)), rcond=1e-13)[0]
    miss = np.abs(E @ result - target)
    if miss.max(initial=0.0) > 1e-8 * (1.0 + np.abs(target).max(initial=0.0)):
        names, advice = ", ".join(v) if isinstance(v, Mapping) else "", "name fewer joints"
        if len(s := np.linalg.svd(J, compute_uv=False)) and s[-1] < NEARLY_SINGULAR * s[0]:
            advice = "loop rows are nearly dependent here, near a singular configuration; start a little away from it"
        rows = solver.loop_rows.closures if isinstance(v, Mapping) else ()
        if len(J) == mechanism.nv:
            advice = "loops and drives determine all velocities; leave them out"
        if driven := [row for row in rows if isinstance(row.loop, Drive) and row.loop.joint in v]:
            given = ", ".join(f"{row.loop.name!r} gives {row.loop.joint} {-row.rate(t, q)[0]:.6g}" for row in driven)
            advice = f"drive {given} at t = {t:g} s; leave out the driven joints"
        raise AssemblyError(
            f"{mechanism.name}: the loops do not allow the velocities given for {names} "
            f"(the loops are off by {miss.max():.3g} rad/s or m/s); {advice}"
        )
    return result


def impossible_alone(mechanism, guess, gaps, fixed, t: float = 0.0) -> dict:
    """Loop → smallest gap, for loops of `gaps` that stay open even if all other loops are cut."""
    alone = {}
    for loop in mechanism.loops:
        if not gaps.get(loop.name, 0.0) <= CLOSED_GAP:
            solver = LoopSolver(mechanism.with_loops(loop), t)
            gap = solver.size(solver.close(guess, solver.free_columns(fixed))[0])
            if gap > CLOSED_GAP:
                alone[loop.name] = gap
    return alone


def _far_off(solver, guess, q) -> str:
    """Which joints slide far beyond the size of the mechanism, from `guess` to `q`, in words, or an empty string."""
    mechanism, model, change = solver.mechanism, solver.model, difference(solver.model, guess, q)
    if solver.loop_rows.moving or not np.abs(change).max(initial=0.0) > KEPT:  # drives may go anywhere
        return ""
    slid = np.abs(change) * [unit == "m" for unit in velocity_units(model)]
    bodies, anchors = _points(solver, guess)
    size = _size([*bodies, *anchors.values()])
    if not slid.max(initial=0.0) > MAX_REACH * size > 0.0:
        return ""
    joints = [joint for joint in mechanism.joints if slid[mechanism.columns(joint)].max() > slid.max() / 2]
    at = ", ".join(f"{joint} = {_text(coordinates(model, joint, q))}" for joint in joints[:MOST_SHOWN])
    return f"far away, with {at}, while all bodies and anchors are within {size:.2g} m at the guess"


def _long_levers(solver, guess) -> str:
    """Which anchors are far from the bodies that carry them, in words, or an empty string; at the first guess."""
    known = solver.loop_rows.levers
    if not known:
        known.append(_far_anchors(solver, guess))
    return known[0]


def _far_anchors(solver, guess) -> str:
    bodies, anchors = _points(solver, guess)
    size, origin = _size(bodies), np.mean(bodies, axis=0)
    away = {end: float(np.linalg.norm(point - origin)) for end, point in anchors.items()}
    far = {end: distance for end, distance in away.items() if distance > MAX_REACH * size > 0.0}
    if not far:
        return ""
    (loop, end), distance = max(far.items(), key=lambda item: item[1])
    more = f" (and {len(far) - 1} more)" * (len(far) > 1)
    return (
        f"anchor {end} of loop {loop!r} is {distance:.3g} m away{more}, while all bodies are within {size:.2g} m. "
        f"Is its xyz{end} in millimetres? Lengths are in m"
    )


def _points(solver, q) -> tuple[np.ndarray, dict]:
    """The joints and centres of mass of the bodies, and (loop, 1 or 2) → each anchor on a body; in world axes, m."""
    model = solver.model
    points = [(i, np.zeros(3)) for i in range(1, model.njoints)]
    points += [(i, model.inertias[i].lever) for i in range(1, model.njoints)]
    bodies, ends = len(points), []
    for loop in solver.mechanism.anchored_loops:
        for end, frame, xyz in ((1, loop.frame1, loop.xyz1), (2, loop.frame2, loop.xyz2)):
            carrier = model.frames[model.getFrameId(frame)]
            if carrier.parentJoint:
                points.append((carrier.parentJoint, carrier.placement.act(np.array(xyz))))
                ends.append((loop.name, end))
    found = positions(model, points, q)
    return found[:bodies], dict(zip(ends, found[bodies:], strict=True))


def _size(points) -> float:
    """The diagonal of the box that holds all points, m."""
    return float(np.linalg.norm(np.ptp(points, axis=0)))


def _closed_far_off(solver, guess, best) -> str:
    """Where the loops close beyond the reach of the bounded search that ended at `best`, as :func:`_far_off`."""
    q = best
    for _ in range(FAR_STEPS):
        phi, J = solver.rows(q)
        if np.abs(phi).max() <= NEARLY_CLOSED:
            return _far_off(solver, guess, q)
        q = integrate(solver.model, q, np.linalg.lstsq(J, -phi, rcond=1e-15)[0])
        if not np.isfinite(q).all():
            break
    return ""


def _contradicting(mechanism, open_loops, t) -> str:
    """Which two drives move a joint differently, in words, or an empty string."""
    drives: dict[str, Drive] = {}
    for loop in mechanism.loops:
        if isinstance(loop, Drive) and loop.name in open_loops:
            other = drives.setdefault(loop.joint, loop)
            if other is not loop:
                to = ", ".join(f"{each.name!r} to {float(each.curve(t)):.6g}" for each in (other, loop))
                return f"two drives move the joint {loop.joint!r} at t = {t:.6g} s, {to}"
    return ""


def _not_closed(solver, guess, best, open_loops, fixed):
    mechanism = solver.mechanism
    if drives := _contradicting(mechanism, open_loops, solver.t):
        return AssemblyError(f"{mechanism.name}: {drives}. Leave one of them out", gaps=dict(open_loops))
    held = f" with {', '.join(fixed)} held" if fixed else ""
    if len(mechanism.loops) == 1:
        ((name, gap),) = named = list(open_loops.items())
        worst = int(np.argmax(np.abs(solver.rows(best)[0])))
        unit = "rad" if solver.loop_rows.turns[worst] else "m"
        unit = unit if mechanism.anchored_loops else "m or rad"  # the unit of other rows depends on their joint
        row = mechanism.row_labels[worst][1]
        what = f"loop {name!r} cannot close{held}: a gap of {gap:.3g} {unit} remains in row {row}"
    else:
        alone = impossible_alone(mechanism, guess, open_loops, fixed, solver.t)
        named = sorted((alone or open_loops).items(), key=lambda item: -item[1])
        in_metres = [loop.name for loop in mechanism.anchored_loops if not LOOP_KINDS[loop.kind].rotations]
        listed = ", ".join(f"{name!r} (gap {gap:.3g} m{' or rad' * (name not in in_metres)})" for name, gap in named)
        what = f"the loops cannot close together{held}, although each can close alone; still open: {listed}"
        if alone:
            each, order = ("each ", ", worst first") if len(alone) > 1 else ("", "")
            what = f"loops cannot close{held}, {each}even with all others cut{order}: {listed}"
            what = f"{len(alone)} of {len(mechanism.loops)} {what}"
    if not fixed and (far := _closed_far_off(solver, guess, best)):
        what += f". It would close only {far}" if len(mechanism.loops) == 1 else f". They would close only {far}"
    if long := _long_levers(solver, guess):
        what += f". {long[0].upper()}{long[1:]}"
    if max(open_loops.values()) < ROUNDED_GAP and not fixed and (advice := hint(mechanism)):
        what += f". Most likely {advice}"
    let_go = ", release the fixed joints" if fixed else ""
    return AssemblyError(
        f"{mechanism.name}: {what}. Check lengths, units and anchors; try "
        f'another guess{let_go}, load with closure="point", or use mechanism.reanchored(), which moves the anchors '
        "to the best fit",
        gaps=dict(named),
        q=best,
    )
