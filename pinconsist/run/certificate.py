"""The certificate of a solution: its residuals, evaluated independently of the integration."""

import re
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from ..engine.norms import largest
from ..mechanism.branches import branch_times
from ..mechanism.custom import Constraint
from ..mechanism.energy import energy_of, event_energies
from ..mechanism.forces.actuators import saturated
from ..mechanism.forces.held import sided
from ..mechanism.names import BeyondLimit, beyond_limits
from ..mechanism.reactions import States, listed, not_determined, shared_loads, undetermined
from ..mechanism.rows import Workspace
from ..mechanism.system import MechanismSystem
from .accuracy import OFF, GlobalError, accelerations, figure, global_error, measured, work_of
from .contact_results import row_units, too_slow
from .impact_errors import ImpactErrors, impact_errors, impact_errors_of

OPEN_LOOP = 1e-8  # m or rad, and m/s or rad/s: a loop with a larger gap is open
UNCLEAR = 0.1 * OFF  # an energy balance that is off by more may be so because rows are few
CONTACT = re.compile("floor|contact pair|colliding|static collision|frictionloss")
"""What is not modelled and changes the motion: bodies would fall through."""
FEW = 4.0  # times the uncertainty of the work: an energy balance that is not off by more shows nothing
ROUNDED = 1e-6  # of the largest multiplier: smaller ones may be the error of the run
SHOWN = 4  # joints outside of their limits


@dataclass(frozen=True)
class Certificate:
    """Residuals of a solution, each the largest over all rows.

    Attributes
    ----------
    position : float
        |Φ|, m or rad: the largest gap of a loop. ``position_at`` names the row and the time.
    velocity : float
        |J v + Φ_t|, m/s or rad/s. With uncorrected BDF (``exact``, ``initial``) it is inherently O(hᵏ).
    force : float
        |Jᵀλ - Jᵀλ*| relative to the largest of all forces: |Jᵀλ*|, weights, inertial forces of the velocities,
        and the sum of these and the other forces. λ* is the multiplier of the differential equation at the same q, v.
        For a general problem, G replaces Jᵀ. Rows of the start of BDF, whose λ is λ* by construction, are excluded.
    force_first : float
        The same at the first step of the multistep method.
    energy_error : float or None
        |E(t) - E(0) - work of the forces| relative to the exchanged energies, see
        :attr:`Energy.balance_error`; None for a general problem. Up to four times ``work_error`` it is not a concern.
    work_error : float
        Uncertainty of the work of the forces due to the small number of rows, see :attr:`Energy.work_error`; 0 if the
        balance is good.
    energy : ndarray or None
        Kinetic, potential and elastic energy of each row, J.
    undetermined : dict of str to float
        Loops whose individual forces are not determined, see :attr:`Reaction.dependence`; empty for a general problem.
    not_unique : dict of str to tuple of str
        Loops and joints that share a statically indeterminate load, and the components of their wrench, see
        :attr:`Reaction.shared_with`. The motion and the sum of the joint forces are correct; the verdict names them.
    beyond_limits : tuple of BeyondLimit
        Joints that exceed the position limits in their file, which are not enforced: ``joint``, first time ``t``, the
        ``value`` farthest outside, ``lower`` and ``upper`` limit.
    corrected_by : float
        The amount by which rounded numbers of the file were changed, m or rad, see :meth:`Mechanism.corrected`.
    fixed_step : bool
        Whether the run had a fixed step, to which suggestions then refer.
    ended_early : bool
        Whether the run could not continue; its message gives the reason and suggestions.
    error : GlobalError or None
        The difference from a finer run; None if there is none.
    error_missing : str
        Why there is no `error` although it was requested.
    saturated : dict of str to float
        Actuators whose command or force was clipped to its limits, and the fraction of rows in which it was.
    speed : float
        The largest velocity of the run, rad/s or m/s, with which `velocity` is compared.
    units : tuple of str
        Of `position` and of `velocity`; empty for a general problem.
    added : dict of str to float
        Events whose velocities violate the constraints and that add energy, and the largest energy added by one of
        their occurrences, relative to the kinetic energy before.
    branches : tuple of float
        Times, s, at which the loops pass a singular configuration, where branches of the motion meet; not computed with
        ``check(error=False)``.
    pulling : dict of str to float
        Unilateral constraints that pull, see :class:`Constraint`, and the first time at which they do, s.
    not_finite : str
        The first non-finite number in the rows, as text; nothing else is judged then.
    not_modelled : tuple of str
        Elements of the mechanism's file that have no effect, see ``Mechanism.ignored``.
    impacts : ImpactErrors or None
        The impacts of contacts, compared one by one with those of the finer run; None if there is none, or if neither
        has impacts.
    impacts_of_run : int
        The number of impacts.
    """

    position: float
    position_at: str
    velocity: float
    force: float
    force_first: float
    energy_error: float | None
    energy: np.ndarray | None = field(repr=False, compare=False)
    work_error: float = 0.0
    undetermined: dict[str, float] = field(default_factory=dict)
    not_unique: dict[str, tuple[str, ...]] = field(default_factory=dict)
    beyond_limits: tuple[BeyondLimit, ...] = ()
    corrected_by: float = 0.0
    fixed_step: bool = field(default=False, repr=False, compare=False)
    ended_early: bool = field(default=False, repr=False, compare=False)
    error: GlobalError | None = None
    error_missing: str = ""
    saturated: dict[str, float] = field(default_factory=dict)
    speed: float = field(default=0.0, repr=False, compare=False)
    units: tuple[str, str] = field(default=("", ""), repr=False, compare=False)
    added: dict[str, float] = field(default_factory=dict)
    branches: tuple[float, ...] = ()
    pulling: dict[str, float] = field(default_factory=dict)
    not_finite: str = ""
    not_modelled: tuple[str, ...] = ()
    impacts: ImpactErrors | None = None
    impacts_of_run: int = 0

    def __str__(self):
        return "\n".join([self.verdict, "", *self._figures(), *(f"note: {concern}" for concern in self.concerns)])

    @property
    def ok(self) -> bool:
        """Whether the certificate has no concerns about what was judged; :attr:`not_judged` names the rest."""
        return not self._named_concerns

    @property
    def not_judged(self) -> list[str]:
        """Quantities that were not checked, although they could be wrong: ``error``, ``energy``, ``impacts``.

        Usually empty.
        """
        unseen = self.impacts_of_run > 0 and self.impacts is None
        return ["error"] * (self.error is None) + ["energy"] * self._too_few_rows + ["impacts"] * unseen

    @property
    def verdict(self) -> str:
        """One line: ``closed to 8e-15 m, forces good to 2e-5, error of q about 1e-6 rad: ok``.

        If there are :attr:`concerns`, it ends with these instead of ``ok``; it ends with neither if nothing shows
        whether the motion is correct, neither an estimate of its error nor its energy. It also names forces that are
        :attr:`not_unique`, quantities that were :attr:`not_judged`, and the contacts among the elements that are
        :attr:`not_modelled`.
        """
        if self.not_finite:
            return f"{self.not_finite} is not a finite number: nothing was judged"
        found = ["no loops"]
        if self.position_at:
            found = [f"closed to {_short(self.position, self.units[0])}", f"forces good to {_short(self._of_forces)}"]
        if self.error is not None:
            found.append(f"error of q about {_short(self.error.q, self.error.units[0])}")
        elif self.energy_error is not None and not self._too_few_rows:
            found.append(f"energy balanced to {_short(self.energy_error)}")
        motion_judged = not {"error", "energy"} <= set(self.not_judged)  # by the error or by the energy
        ends = ["ok"] if self.ok and motion_judged else []
        ends += [f"look at {', '.join(self._named_concerns)}"] if not self.ok else []
        ends += [f"not unique: forces of {listed(self.not_unique)}"] if self.not_unique else []
        ends += [f"not judged: {', '.join(self.not_judged)}"] if self.not_judged else []
        touching = [what for what in self.not_modelled if CONTACT.search(what)]
        ends += [f"not modelled: {', '.join(touching)}"] if touching else []
        return f"{', '.join(found)}: {'; '.join(ends)}"

    @property
    def _too_few_rows(self) -> bool:
        return self.energy_error is not None and OFF < self.energy_error <= FEW * self.work_error

    @property
    def _of_forces(self) -> float:
        return float(np.maximum(self.force, self.error.force if self.error else 0.0))

    def _figures(self) -> list[str]:
        """A line for each figure: its name, size and unit, ``ok`` or ``look``, and where it is largest."""
        if self.not_finite:
            return []
        named, lines = self._named_concerns, ["no loops"]
        if self.position_at:
            lines = [
                figure("loops closed to", self.position, self.units[0], "loops" in named, self.position_at),
                figure("velocity residual", self.velocity, self.units[1], "velocities" in named),
                figure("constraint forces", self.force, "", _above(self.force, OFF), "relative to the largest force"),
                figure("  at the first step", self.force_first, "", _above(self.force_first, OFF)),
            ]
        if self.not_unique:
            why = "redundant loops share their load, see sol.reaction(name)"
            lines.append(f"{'  not unique':<20} those of {listed(self.not_unique)}: {why}")
        if self._too_few_rows:
            lines.append(f"{'energy balance':<20} not judged: there are too few rows to resolve the work of the forces")
        elif self.energy_error is not None:
            where = "relative to the exchanged energy"
            lines.append(figure("energy balance", self.energy_error, "", "energy" in named, where))
        if self.error is not None:
            lines += str(self.error).splitlines()
        elif self.error_missing:
            lines.append(f"{'error of q':<20} not judged: {self.error_missing}")
        if self.impacts is not None:
            lines += self.impacts.figures
        if self.corrected_by:
            lines.append(figure("file's numbers", self.corrected_by, "m, rad", False, "their largest correction"))
        if self.not_modelled:
            lines.append(f"{'not modelled':<20} {', '.join(self.not_modelled)}, which the file has")
        return lines

    @property
    def concerns(self) -> list[str]:
        """Sentences about what to check before trusting the solution; empty if there is nothing."""
        return list(self._named_concerns.values())

    @property
    def _named_concerns(self) -> dict[str, str]:
        """Concerns: short form → sentence."""
        found, advice = {}, "take a smaller step or a higher order" if self.fixed_step else "tighten rtol"
        if self.not_finite:
            return {"numbers": f"{self.not_finite} is not a finite number"}
        if self.ended_early:
            advice = "the run could not continue, see its message"
            found["the end"] = "the run ended early, see its message"
        if _above(self.position, OPEN_LOOP):
            found["loops"] = f"a loop is open by {self.position:.1e} {self.units[0]}".rstrip()
        if _above(self.velocity, max(OFF * self.speed, OPEN_LOOP)):
            found["velocities"] = f"the velocities open a loop by more than 1 % of the largest: {advice}"
        if _above(self._of_forces, OFF):
            found["forces"] = (
                f"the constraint forces are off by more than 1 %: {advice}, or a force jumps within a step"
            )
        if self.energy_error is not None and _above(self.energy_error, OFF) and not self._too_few_rows:
            found["energy"] = (
                f"the energy balance is off by more than 1 %: {advice}, or a force or a drive jumps (restart there "
                "by an event)"
            )
        if self.error is not None and self.error.amplified:
            found["error"] = (
                f"the error is {self.error.tolerances:.0f} times the tolerance: the motion amplifies perturbations, as "
                f"chaotic motions do; {advice} until the accuracy suffices, or trust only the beginning of the run"
            )
        if self.impacts is not None:
            found |= self.impacts.concerns
        if self.undetermined:
            found["undetermined forces"] = (
                f"{not_determined(self.undetermined)}; the motion and the sum of Jᵀλ over all loops are correct. "
                "mechanism.reduced() removes the redundant rows"
            )
        if self.beyond_limits:
            names = [str(each) for each in self.beyond_limits[:SHOWN]]
            names += [f"and {more} more"] if (more := len(self.beyond_limits) - SHOWN) > 0 else []
            found["joint limits"] = f"joints exceed their limits, which are not enforced: {'; '.join(names)}"
        if self.added:
            gains = ", ".join(f"{name or 'without a name'} {share:.2g} times" for name, share in self.added.items())
            found["events"] = (
                "events set velocities that the constraints do not allow, and their projection adds energy; relative "
                f"to the kinetic energy before: {gains}. Let apply return a mapping joint → velocity, or use an Impact"
            )
        if self.branches:
            times = ", ".join(f"{t:.6g}" for t in self.branches[:SHOWN]) + ", …" * (len(self.branches) > SHOWN)
            found["branches"] = (
                f"the loops pass a singular configuration at t = {times} s, where branches of the motion meet: the run "
                "continues straight on, but a small force or a small change of a length decides which branch is taken"
            )
        if self.pulling:
            names = "; ".join(f"{name!r} from t = {t:.6g} s" for name, t in self.pulling.items())
            found["unilateral constraints"] = (
                f"constraints that can only push would have to pull: {names}; in reality the bodies separate there, "
                "and the motion after that is different"
            )
        if self.saturated:
            shares = ", ".join(f"{name} in {share:.0%} of the rows" for name, share in self.saturated.items())
            found["actuators"] = f"actuators are at the limits of their commands or forces: {shares}"
        return found


def plain(certificate: Certificate | None) -> dict | None:
    """A certificate as plain data, without the energies of the rows."""
    return None if certificate is None else asdict(replace(certificate, energy=None))


def from_plain(data: dict | None) -> Certificate | None:
    """The certificate of plain data; TypeError or KeyError if it is of something else."""
    if data is None:
        return None
    limits, error = data["beyond_limits"], data["error"]
    shared = {name: tuple(parts) for name, parts in data.get("not_unique", {}).items()}
    return Certificate(
        **data
        | {"beyond_limits": tuple(BeyondLimit(**each) for each in limits), "units": tuple(data["units"])}
        | {"not_unique": shared, "branches": tuple(data["branches"])}
        | {"not_modelled": tuple(data.get("not_modelled", ()))}
        | {"error": error and GlobalError(**error | {"units": tuple(error["units"])})}
        | {"impacts": impact_errors_of(data.get("impacts"))}
    )


def _above(value: float, bar: float) -> bool:
    """Whether a figure is a concern: NaN is."""
    return not value <= bar


def _short(value: float, unit: str = "") -> str:
    """A number in one digit, ``8e-15``."""
    return f"{float(f'{value:.0e}'):g} {unit}".replace("e-0", "e-").rstrip()


def _not_finite(solution) -> str:
    """The first number of the rows that is not finite, with its time; empty if all are."""
    for name in ("q", "v", "lam"):
        rows, columns = np.nonzero(~np.isfinite(getattr(solution, name)))
        if len(rows):
            return f"{name}[{columns[0]}] at t = {solution.t[rows[0]]:.6g} s"
    return ""


def _shared(solution, mechanism, system, workspace) -> dict[str, tuple[str, ...]]:
    """What :attr:`Certificate.not_unique` is."""
    t, q, v, lam = solution.t, solution.q, solution.v, solution.lam
    if system.base.nc == system.rows.nc:
        return {}

    def motion(rows):
        return v[rows], accelerations(mechanism, solution, sided(t)[rows], q[rows], v[rows])

    return shared_loads(States(mechanism, t, q, lam, workspace, motion))


def _sides(system, t, q, v):
    """The times of rows on the sides of jumps to which they belong."""
    return sided(t, len(t) > 1 and system.jumps_at(t[-1], q[-1], v[-1]))


def certify(solution, mechanism=None, finer=None, missing="") -> Certificate:
    """The certificate of a solution; `mechanism` is needed if the solution does not have its system.

    `finer` is a :class:`~pinconsist.run.accuracy.FinerRun`, or None, and `missing` why.
    """
    system: Any = None if solution.system is None else solution.system.base
    if unknown := _not_finite(solution):
        return Certificate(*(np.nan, unknown, np.nan, np.nan, np.nan, None, None), not_finite=unknown)
    if mechanism is not None:
        system = MechanismSystem(mechanism, solution.q[0], solution.t[0])
    elif isinstance(system, MechanismSystem):
        mechanism = system.mechanism
    workspace = None if mechanism is None else Workspace(system.model, system.workspace)
    made = 1 + np.flatnonzero(solution.order > 0)  # by the method's own steps; with t_eval all rows count
    compared = made if len(made) else slice(None)
    t, q, v = solution.t, solution.q, solution.v
    sides = _sides(system, t, q, v)
    states = sides, q, v, solution.lam
    phi, rho, forces, exact, found, acting = measured(system, states, workspace, solution.contacts)
    phi, exact = np.abs(phi), exact[compared]
    error = np.abs(forces[compared] - exact)
    if solution.contacts is not None:  # friction without a direction
        error[too_slow(mechanism, solution.contacts, sides, q, v)[compared]] = 0.0
    position, where, units, scale = 0.0, "", ("", ""), max(largest(exact), acting) or 1.0
    if phi.size:
        i, row = np.unravel_index(np.argmax(phi), phi.shape)
        position = float(phi[i, row])
        if mechanism is None:
            label = system.describe_row(row)
        else:
            if position > OPEN_LOOP and row < mechanism.nc:  # the compiled rows are valid near closed loops only
                row = np.argmax(gaps := np.abs(system.loop_rows(solution.q[i], solution.t[i])[0]))
                position = float(gaps[row])
            what = "loop" if row < mechanism.nc else "contact"
            label = f"{what} {{!r}} row {{}}".format(*mechanism.row_labels[row])
            of_rows = row_units(mechanism)
            units = of_rows[row], of_rows[np.argmax(np.abs(rho)) % rho.shape[1]]
        where = f"{label} at t = {solution.t[i]:.6g} s"
    energy = None if mechanism is None else energy_of(solution, mechanism, workspace, system, found)
    seen = _seen(solution, finer)
    impacts, apart = None, False
    if finer is not None and solution.contacts is not None:
        impacts, apart = impact_errors(solution, finer)
    balance, work_error = 0.0, 0.0
    if energy is not None:
        balance, work_error = _balance(solution, energy, finer, lambda: solution.energy(mechanism))
    return Certificate(
        position=position,
        position_at=where,
        units=(units[0], units[1] and f"{units[1]}/s"),
        speed=float(largest(v)),
        velocity=float(largest(rho)),
        force=float(np.max(error, initial=0.0) / scale),
        force_first=float(np.max(error[:1], initial=0.0) / scale),
        energy_error=None if energy is None else balance,
        work_error=work_error,
        energy=None if energy is None else energy.total,
        undetermined={} if mechanism is None else undetermined(mechanism, t, q, system.rows),
        not_unique={} if mechanism is None else _shared(solution, mechanism, system, workspace),
        beyond_limits=() if mechanism is None else beyond_limits(mechanism, *seen[:2]),
        corrected_by=0.0 if mechanism is None else mechanism.corrected_by,
        fixed_step=solution.method.get("step") is not None,
        ended_early=solution.status < 0,
        saturated={} if mechanism is None else saturated(mechanism, *seen[:3]),
        error=None if finer is None else global_error(solution, finer, apart),
        error_missing=missing,
        added=_added(solution, energy, system),
        branches=_branches(solution, system, finer) if finer is not None or missing else (),
        pulling={} if mechanism is None else _pulling(mechanism, system.rows, seen[0], seen[3]),
        not_modelled=() if mechanism is None else mechanism.ignored,
        impacts=impacts,
        impacts_of_run=0 if solution.contacts is None else len(solution.contacts.impacts),
    )


def _seen(solution, finer):
    """t, q, v and λ of the rows and, in long steps between them, of the finer run."""
    rows = solution.t, solution.q, solution.v, solution.lam
    if finer is None:
        return rows
    both = [np.concatenate(pair) for pair in zip(rows, (finer.t, finer.q, finer.v, finer.lam), strict=True)]
    order = np.argsort(both[0] if solution.t[-1] >= solution.t[0] else -both[0], kind="stable")
    return [column[order] for column in both]


def _pulling(mechanism, rows, t, lam) -> dict[str, float]:
    """What :attr:`Certificate.pulling` is; multipliers that are rounding do not count."""
    found = {}
    for loop in mechanism.loops:
        if isinstance(loop, Constraint) and loop.unilateral:
            its = lam[:, rows.slices[loop.name]].min(axis=1)
            pulls = np.flatnonzero(its < -ROUNDED * largest(lam))
            if len(pulls):
                found[loop.name] = float(t[pulls[0]])
    return found


def _added(solution, energy, system) -> dict[str, float]:
    """What :attr:`Certificate.added` is."""
    found: dict[str, float] = {}
    if energy is None or not any(each.altered for each in solution._changes):
        return found
    _, (before, after), kinetic = event_energies(solution, system.forces, Workspace(system.model))
    gains = (after - before) * (1.0 if solution.t[-1] >= solution.t[0] else -1.0)
    for each, gain, size in zip(solution._changes, gains, kinetic, strict=True):
        if each.altered and gain > OFF * energy.exchanged:
            found[each.name] = max(found.get(each.name, 0.0), float(gain / size) if size else np.inf)
    return found


def _branches(solution, system, finer) -> tuple[float, ...]:
    if not isinstance(system, MechanismSystem):
        return ()
    return branch_times(system, solution.t, solution.q) if finer is None else branch_times(system, finer.t, finer.q)


def _balance(solution, energy, finer, by_states):
    """The error of the energy balance, and that of the work in it.

    Where rows are few, the work is that along the finer run, or ``by_states()``, which returns the energies with the
    work by states between the rows.
    """
    balance = energy.balance_error
    if not _above(balance, UNCLEAR):
        return balance, 0.0
    if finer is not None and not (np.diff(solution.t) == 0.0).any():
        total = energy.total[finer.rows]
        work, uncertain = work_of(finer)
        balance = replace(energy, error=total - total[0] - work).balance_error
        return balance, replace(energy, error=uncertain).balance_error if _above(balance, UNCLEAR) else 0.0
    energy = by_states()
    return energy.balance_error, energy.work_error
