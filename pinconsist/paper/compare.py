"""Exact against numerically consistent initial values: the tables of Arévalo (2008), for any system and order."""

from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .consistency import MODES, consistent_history
from .formula import HIGHEST
from .index1 import finite, index3_system, reference_solution, states_at
from .problems import reference_problem
from .solve import solve

OFF = 0.01  # of a force, above which it is wrong
ALONG = 1.0  # degrees: the direction of a wrong force is reported if it differs by more
DIGITS = range(3, 10)  # of forces that are told


@dataclass(frozen=True)
class Run:
    """Errors of a loop's force for one step size: the loop whose error is largest at the first step of the method.

    For constraints without anchors it is the torque, and for general problems a multiplier.

    Attributes
    ----------
    h, order : float, int
        Step, s, and BDF order k.
    loop, of, unit : str
        The loop's name, empty for a multiplier; ``the force in`` it or the like; N or N·m, empty for a multiplier.
    t, exact, consistent, every_step : ndarray, shape (n,)
        Times, and the magnitude of the error of the force from exact values, from consistent ones, with every step
        corrected. For order k the first k rows are the exact start; the first BDF step is row k.
    true, from_exact : ndarray, shape (n, 3) or (n, 1)
        The force on body 2 in world axes, or the torque or multiplier: the exact one, and that of the multipliers from
        exact initial values, at the exact positions.
    q, lam : ndarray, shape (n, nq) and (n, nc)
        The exact positions and multipliers.
    v_given, v_consistent : ndarray, shape (nv,)
        The initial velocity as given, and the numerically consistent one.
    """

    h: float
    order: int
    loop: str
    of: str
    unit: str
    t: np.ndarray
    exact: np.ndarray
    consistent: np.ndarray
    every_step: np.ndarray
    true: np.ndarray
    from_exact: np.ndarray
    q: np.ndarray
    lam: np.ndarray
    v_given: np.ndarray
    v_consistent: np.ndarray

    @property
    def ok(self) -> bool:
        """Whether the error of the first force from exact values is at most 1 %, as when starting from rest."""
        return bool(self.exact[self.order] <= OFF * np.linalg.norm(self.true[self.order]))

    @property
    def wrong(self) -> str:
        """The error of the first force from exact values: ``107 % wrong``."""
        return f"{self._share(self.exact)} wrong"

    @property
    def sizes(self) -> str:
        """The first force from exact values compared with the true one: ``38.4 N instead of 19.1 N``."""
        true, found = self.true[self.order], self.from_exact[self.order]
        if len(true) == 1:
            found, true = self._told(found[0], true[0])
            return f"{found} instead of {true}"
        size, true_size = np.linalg.norm(found), np.linalg.norm(true)
        cosine = found @ true / (size * true_size) if size and true_size else 1.0
        angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
        turned = f", turned by {angle:.0f}°," if angle > ALONG else ""
        size, true_size = self._told(size, true_size)
        return f"{size}{turned} instead of {true_size}"

    @property
    def verdict(self) -> str:
        """One sentence: how wrong the first force is, and how large it should be."""
        return (
            f"h = {self.h:g} s, first step: {self.of} from exact initial values is {self.sizes} ({self.wrong}); "
            f"from consistent ones it is {self._share(self.consistent)} wrong"
        )

    def _share(self, errors) -> str:
        """The error at the first step of the method, relative to the true force."""
        error, size = errors[self.order], np.linalg.norm(self.true[self.order])
        if not size:
            return self._amount(error)
        share = 100 * error / size
        return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"

    def _told(self, found, true) -> tuple[str, str]:
        """Two values, with so many digits that they differ, if there are any."""
        pairs = [(self._amount(found, digits), self._amount(true, digits)) for digits in DIGITS]
        return next((pair for pair in pairs if pair[0] != pair[1]), pairs[0])

    def _amount(self, value, digits=3) -> str:
        return f"{value:.{digits}g} {self.unit}".rstrip()


@dataclass(frozen=True)
class Comparison:
    """Runs for several step sizes.

    Attributes
    ----------
    name : str
    order : int
    runs : tuple of Run
    """

    name: str
    order: int
    runs: tuple[Run, ...]

    def __str__(self):
        lines = [f"{self.name}, BDF of order {self.order}: error of the first forces"]
        lines += [run.verdict for run in self.runs]
        for run in self.runs:
            lines.append(
                f"h = {run.h:g} s, error of {run.of}\n{'t [s]':>10} {'exact':>12} {'consistent':>12} {'every step':>12}"
            )
            rows = zip(run.t[1:], run.exact[1:], run.consistent[1:], run.every_step[1:], strict=True)
            lines += [f"{t:10.6g} {a:12.4e} {b:12.4e} {c:12.4e}" for t, a, b, c in rows]
        return "\n".join(lines)


def compare(subject, steps, *, order=1, count=6, q0=None, v0=None) -> Comparison:
    """Errors of the first loop forces from exact and from numerically consistent initial values.

    Parameters
    ----------
    subject : str or Mechanism
        ``"problem51"``, ``"problem52"``, or a mechanism, whose reference is scipy's DOP853 at 1e-13 on the index-1
        equations.
    steps : sequence of float
        Step sizes, s.
    order : int
        BDF order k, 1 to 6.
    count : int
        BDF steps to take.
    q0, v0 : mapping or array, optional
        Start of a mechanism, as in :func:`pinconsist.simulate`.

    Returns
    -------
    Comparison

    Raises
    ------
    InputError
        Arguments that cannot be used; a system without constraints, which has no multipliers.
    AssemblyError
        The loops of a mechanism cannot be closed.
    PinconsistError
        A run or the reference fails.

    References
    ----------
    C. Arévalo, A note on numerically consistent initial values for high index DAEs, ETNA 34 (2008), section 5.
    """
    steps = np.atleast_1d(finite(steps, "steps"))
    if steps.size == 0 or (steps <= 0).any():
        raise InputError(f"steps must be positive numbers of seconds, got {steps}")
    if not 1 <= order <= HIGHEST or count < 1:
        raise InputError(f"order must be 1 to 6 and count at least 1, got {order} and {count}")
    name, system, t0, p0, v0, exact = _subject(subject, q0, v0)
    return Comparison(name, order, tuple(_run(system, t0, p0, v0, exact, float(h), order, count) for h in steps))


def _subject(subject, q0, v0):
    """(name, system, t0, p0, v0, truth) of the subject of a comparison; ``truth(times)`` gives (p, λ)."""
    if isinstance(subject, str):
        if q0 is not None or v0 is not None:
            raise InputError(f"{subject} has its own initial values; q0 and v0 are for mechanisms")
        problem = reference_problem(subject)
        origin = problem.t0, problem.p0, problem.v0

        def exact(times):
            rows = [problem.exact(t) for t in times]
            return np.array([p for p, _, _ in rows]), np.array([lam for _, _, lam in rows])

        return problem.name, index3_system(problem.system, *origin), *origin, exact
    from ..mechanism.assembly import assemble

    assembly = assemble(subject, q0, v0)
    origin = 0.0, assembly.q, assembly.v
    system = index3_system(subject, *origin)

    def truth(times):
        found = reference_solution(system, *origin, times)
        return found.q, found.lam

    return subject.name, system, *origin, truth


def _run(system, t0, p0, v0, exact, h, k, count) -> Run:
    if system.nc == 0:
        raise InputError("there are no loops, so there are no multipliers to compare")
    times = t0 + h * np.arange(k + count)
    span = times[0], times[-1]
    p, lam = exact(times)
    found = [solve(system, span, p0, v0, h, order=k, consistency=mode).lam for mode in MODES]
    true, *others = (_forces(system, times, p, each) for each in (lam, *found))
    first = {each: np.linalg.norm(others[0][each] - force, axis=1)[k] for each, force in true.items()}
    worst = max(first, key=lambda each: first[each])
    errors = [np.linalg.norm(each[worst] - true[worst], axis=1) for each in others]
    history = states_at(system, t0, p0, v0, times[:k])[::-1]
    v = consistent_history(system, history, h, k)[-1].v
    loop, of, unit = worst
    exact_error, consistent_error, corrected_error = errors
    return Run(
        h=h,
        order=k,
        loop=loop,
        of=of,
        unit=unit,
        t=times,
        exact=exact_error,
        consistent=consistent_error,
        every_step=corrected_error,
        true=true[worst],
        from_exact=others[0][worst],
        q=p,
        lam=lam,
        v_given=v0,
        v_consistent=v,
    )


def _forces(system, t, p, lam) -> dict[tuple[str, str, str], np.ndarray]:
    """(loop, of, unit) → values: each loop's force; without anchored loops each torque; else each multiplier."""
    rows = {("", f"multiplier {k}", ""): column[:, None] for k, column in enumerate(lam.T, start=1)}
    mechanism = system.mechanism
    if mechanism is None:
        return rows
    from ..mechanism.reactions import reactions
    from ..mechanism.rows import LoopRows

    every = reactions(mechanism, [loop.name for loop in mechanism.loops], t, p, lam)
    found = [each for each in every if each.dependence is None]  # the others are not determined
    units = dict(zip((loop for loop, _ in mechanism.row_labels), LoopRows.of(mechanism).multiplier_units, strict=True))
    forces = {(each.loop, f"the force in {each.loop}", "N"): each.force for each in found if each.force is not None}
    torques = {
        (each.loop, f"the torque of {each.loop}", units[each.loop]): each.torque[:, None]
        for each in found
        if each.torque is not None
    }
    return forces or torques or rows
