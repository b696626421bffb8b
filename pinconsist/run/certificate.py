"""The certificate of a solution: its residuals, the verdict on them, and what to look at; certify.py evaluates them."""

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from ..mechanism.file_laws import essential
from ..mechanism.names import BeyondLimit
from ..mechanism.reactions import listed, not_determined
from .accuracy import OFF, GlobalError, above, figure
from .impact_errors import ImpactErrors, impact_errors_of

OPEN_LOOP = 1e-8  # m or rad, and m/s or rad/s: a loop with a larger gap is open
FEW = 4.0  # times the uncertainty of the work: an energy balance that is not off by more shows nothing
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
        if missing := essential(self.not_modelled):
            ends.append(f"not modelled: {', '.join(missing)}")
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
                figure("constraint forces", self.force, "", above(self.force, OFF), "relative to the largest force"),
                figure("  at the first step", self.force_first, "", above(self.force_first, OFF)),
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
        if self.not_finite:
            return {"numbers": f"{self.not_finite} is not a finite number"}
        found = {name: sentence for name, find in CONCERNS.items() if (sentence := find(self))}
        return found | ({} if self.impacts is None else self.impacts.concerns)

    @property
    def _advice(self) -> str:
        """What to try for smaller errors."""
        if self.ended_early:
            return "the run could not continue, see its message"
        return "take a smaller step or a higher order" if self.fixed_step else "tighten rtol"


def _early(of: Certificate) -> str:
    return "the run ended early, see its message" if of.ended_early else ""


def _open(of: Certificate) -> str:
    return f"a loop is open by {of.position:.1e} {of.units[0]}".rstrip() if above(of.position, OPEN_LOOP) else ""


def _opening(of: Certificate) -> str:
    if not above(of.velocity, max(OFF * of.speed, OPEN_LOOP)):
        return ""
    return f"the velocities open a loop by more than 1 % of the largest: {of._advice}"


def _forces_off(of: Certificate) -> str:
    if not above(of._of_forces, OFF):
        return ""
    return f"the constraint forces are off by more than 1 %: {of._advice}, or a force jumps within a step"


def _energy_off(of: Certificate) -> str:
    if of.energy_error is None or not above(of.energy_error, OFF) or of._too_few_rows:
        return ""
    cause = "a force or a drive jumps (restart there by an event)"
    return f"the energy balance is off by more than 1 %: {of._advice}, or {cause}"


def _amplified(of: Certificate) -> str:
    if of.error is None or not of.error.amplified:
        return ""
    return (
        f"the error is {of.error.tolerances:.0f} times the tolerance: the motion amplifies perturbations, as chaotic "
        f"motions do; {of._advice} until the accuracy suffices, or trust only the beginning of the run"
    )


def _undetermined(of: Certificate) -> str:
    if not of.undetermined:
        return ""
    return (
        f"{not_determined(of.undetermined)}; the motion and the sum of Jᵀλ over all loops are correct. "
        "mechanism.reduced() removes the redundant rows"
    )


def _beyond(of: Certificate) -> str:
    if not of.beyond_limits:
        return ""
    names = [str(each) for each in of.beyond_limits[:SHOWN]]
    if (more := len(of.beyond_limits) - SHOWN) > 0:
        names.append(f"and {more} more")
    return f"joints exceed their limits, which are not enforced: {'; '.join(names)}"


def _energy_added(of: Certificate) -> str:
    if not of.added:
        return ""
    gains = ", ".join(f"{name or 'without a name'} {share:.2g} times" for name, share in of.added.items())
    return (
        "events set velocities that the constraints do not allow, and their projection adds energy; relative to the "
        f"kinetic energy before: {gains}. Let apply return a mapping joint → velocity, or use an Impact"
    )


def _branching(of: Certificate) -> str:
    if not of.branches:
        return ""
    times = ", ".join(f"{t:.6g}" for t in of.branches[:SHOWN]) + ", …" * (len(of.branches) > SHOWN)
    return (
        f"the loops pass a singular configuration at t = {times} s, where branches of the motion meet: the run "
        "continues straight on, but a small force or a small change of a length decides which branch is taken"
    )


def _pulled(of: Certificate) -> str:
    if not of.pulling:
        return ""
    names = "; ".join(f"{name!r} from t = {t:.6g} s" for name, t in of.pulling.items())
    return (
        f"constraints that can only push would have to pull: {names}; in reality the bodies separate there, and the "
        "motion after that is different"
    )


def _clipped(of: Certificate) -> str:
    if not of.saturated:
        return ""
    shares = ", ".join(f"{name} in {share:.0%} of the rows" for name, share in of.saturated.items())
    return f"actuators are at the limits of their commands or forces: {shares}"


CONCERNS: dict[str, Callable[[Certificate], str]] = {
    "the end": _early,
    "loops": _open,
    "velocities": _opening,
    "forces": _forces_off,
    "energy": _energy_off,
    "error": _amplified,
    "undetermined forces": _undetermined,
    "joint limits": _beyond,
    "events": _energy_added,
    "branches": _branching,
    "unilateral constraints": _pulled,
    "actuators": _clipped,
}
"""Short form → function that words the concern, or returns an empty text."""


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


def _short(value: float, unit: str = "") -> str:
    """A number in one digit, ``8e-15``."""
    return f"{float(f'{value:.0e}'):g} {unit}".replace("e-0", "e-").rstrip()
