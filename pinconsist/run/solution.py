"""Solution: the rows of a run, its certificate, and its file."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import InputError
from ..mechanism.checks import finite_array
from ..mechanism.checks import name as checked_name
from ..mechanism.energy import UNCERTAIN, Energy, energy_of, refined
from ..mechanism.forces.actuators import commands, replayed
from ..mechanism.forces.held import sided
from ..mechanism.loops import LOOP_KINDS
from ..mechanism.mechanism import Mechanism
from ..mechanism.reactions import JointForce, Reaction, States, joint_force, reaction
from ..mechanism.rows import Workspace
from .accuracy import FINER_TIME, GlobalError, NotEstimatedError, accelerations, finer_run
from .certificate import Certificate
from .certify import certify
from .contact_results import ContactHistory
from .quantities import Quantity, Series
from .results import ByName
from .solution_file import read, skipped_work, summary_of, write
from .states import states_at

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Solution(ByName):
    """The result of a simulation. Rows are times; arrays are read-only.

    Attributes
    ----------
    t : ndarray, shape (n,)
        Times, s.
    q, v, lam : ndarray, shapes (n, nq), (n, nv), (n, nc)
        Configurations, velocities, multipliers; with redundant rows, the multipliers of smallest norm; after
        those of the loops come those of the contacts, 0 where they are open. Signs, frames
        and units: :mod:`pinconsist.mechanism.loops`. Without ``t_eval`` every accepted step has its row:
        ``lam[0]`` belongs to the start and is the multiplier of the differential equation there; ``lam[1]`` belongs
        to the first step. With variable steps, and with fixed ones of an order above 1, rows of the start
        (``order`` 0) come before the first step of the method itself. Rows of ``t_eval``, and rows at an event
        that ends a step, are interpolated: their loops are closed to the tolerance only, those of steps to rounding.
    success, status : bool, int
        Status 0: end reached; 1: stopped by an event, a callback or Ctrl-C, which is a success as in scipy; -1: failed.
    message : str
        Description of the termination; begins with "interrupted" after Ctrl-C.
    nsteps, nfev, njev, nlu : int
        Accepted steps, residual evaluations, Newton matrices, factorisations.
    rejected : dict
        Rejected attempts by reason.
    h, order : ndarray, shape (n-1,)
        Step and order with which each row was reached; order 0 marks the start of BDF, step 0 the jump at an event.
        Empty with ``t_eval``.
    sol : DenseOutput or None
        ``sol(t) -> (q, v, lam)``, with ``dense_output=True``.
    t_events, q_events, v_events : list of ndarray
        Times and states at which each event occurred.
    method : dict
        Method settings of the run: order, step, consistency, tolerances, skipped work.
    scene : str
        Name of the mechanism; empty for a general problem.
    recipe : dict or None
        How to repeat the run, as plain data, if :func:`pinconsist.record` or a command made it.
    held : dict of str to ndarray, shape (n, 1 + nv)
        Held torques, by the label of their force, see :class:`~pinconsist.Sampled`: the time since which they are held,
        and τ. Where they jump there are two rows at one time (with ``t_eval``, only the one after the jump).
    contacts : ContactHistory or None
        History of the contacts, see :attr:`modes`, :attr:`impacts` and :meth:`contact`.
    versions : dict
        Versions of the packages that computed it, if it was read from a file.
    system
        The system that was integrated (None if read from a file).
    certificate : Certificate or None
        The verdict, once :meth:`check` has computed it; pages and files show the same.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    lam: np.ndarray
    success: bool
    status: int
    message: str
    nsteps: int
    nfev: int
    njev: int
    nlu: int
    rejected: dict
    h: np.ndarray
    order: np.ndarray
    method: dict
    scene: str = ""
    recipe: dict | None = field(default=None, repr=False, compare=False)
    versions: dict = field(default_factory=dict, repr=False, compare=False)
    held: dict = field(default_factory=dict, repr=False, compare=False)
    contacts: ContactHistory | None = field(default=None, repr=False, compare=False)
    sol: Callable | None = field(default=None, repr=False, compare=False)
    t_events: list = field(default_factory=list, repr=False, compare=False)
    q_events: list = field(default_factory=list, repr=False, compare=False)
    v_events: list = field(default_factory=list, repr=False, compare=False)
    system: Any = field(default=None, repr=False, compare=False)
    _events: tuple = field(default=(), repr=False, compare=False)
    _changes: tuple = field(default=(), repr=False, compare=False)
    _run: Solution | None = field(default=None, repr=False, compare=False)  # whose states these are, at other times
    certificate: Certificate | None = field(default=None, init=False, repr=False, compare=False)

    @classmethod
    def _from_trajectory(cls, trajectory, method, events=()) -> Solution:
        """The solution of a trajectory; it is a failure if a dropped row has opened."""
        system = trajectory.system
        if trajectory.opened:
            i, gap, (loop, row) = trajectory.opened
            trajectory.status = -1
            trajectory.message = (
                f"loop {loop!r} row {row} depends on other rows at the start and was dropped, but the loops are open "
                f"by {gap:.1e} at t = {trajectory.t[i]:.6g}: the rows that were kept are not sufficient there. "
                "Start elsewhere, or from a state just before; if numbers in the file are rounded, use "
                "load(…, precision=1e-6)"
            )
        values: dict[str, Any] = {name: np.array(getattr(trajectory, name)) for name in ("t", "v", "lam", "h", "order")}
        values["q"] = np.array(trajectory.p)
        for array in values.values():
            array.setflags(write=False)
        for k, name in enumerate("tqv"):
            values[f"{name}_events"] = [np.array([row[k] for row in rows]) for rows in trajectory.events]
        outcome = ("status", "message", "nsteps", "nfev", "njev", "nlu", "rejected")
        scene, values["held"] = system.mechanism, system.held
        about: dict[str, Any] = {"skipped": skipped_work(trajectory)}
        about |= {"forces": len(scene.forces)} if scene else {}
        about |= {"control": control} if scene and (control := commands(scene)) else {}
        return cls(
            **values, system=system, method=method.describe() | about, scene=scene.name if scene else "",
            success=trajectory.status >= 0, sol=trajectory.dense, contacts=ContactHistory.of(trajectory),
            _events=events, _changes=tuple(trajectory.changes), **{name: getattr(trajectory, name) for name in outcome},
        )  # fmt: skip

    def __repr__(self):
        first = self.message.split(". ")[0]
        lines = [f"Solution of {self.scene or 'a problem'}: {len(self.t)} rows, {self.nsteps} steps, {first!r}"]
        if len(self.t):
            made = self.method.get("method", "")
            sizes = ", ".join(f"{name} {getattr(self, name).shape}" for name in ("q", "v", "lam"))
            lines += [f"  t     {self.t[0]:g} … {self.t[-1]:g} s, {made}", f"  rows  {sizes}"]
        mechanism = self.mechanism
        return "\n".join([*lines, *str(mechanism).splitlines()[1:]])

    def _repr_mimebundle_(self, include=None, exclude=None):
        """For notebooks: the text; for a run of a mechanism also a picture and the page that plays it."""
        bundle, mechanism = {"text/plain": repr(self)}, self.mechanism
        if mechanism is not None and len(self.t) > 1:
            from ..view.page import notebook_html

            bundle["text/html"] = notebook_html(self, mechanism)
        return bundle

    def __getstate__(self):
        """Without system and dense output, which hold Pinocchio's workspaces; `check` then needs a mechanism."""
        return self.__dict__ | {"system": None, "sol": None, "_events": ()}

    @property
    def y(self) -> np.ndarray:
        """[q; v; λ] with times as columns, as in scipy: shape (nq+nv+nc, n)."""
        return np.hstack((self.q, self.v, self.lam)).T

    @property
    def mechanism(self) -> Mechanism | None:
        """The mechanism that was simulated, with the forces of the run.

        None for a general problem, and for a solution read from a file or copied.
        """
        return None if self.system is None else self.system.mechanism

    def check(self, mechanism=None, error=None) -> Certificate:
        """The verdict on the run, and the figures behind it, evaluated in a separate system: see :class:`Certificate`.

        It is computed once: later calls, pages and files show the same. Its ``error`` is the global error, estimated by
        a finer run if that takes less than 3 seconds (otherwise the verdict says so), or, if `error` is True, however
        long it takes. Forces and events are called again for it. If `error` is False, only the residuals of the rows
        are evaluated.

        A solution read from a file has the verdict computed before it was saved. If there is none, or to compute it
        anew, pass the `mechanism` with the forces of the run, including those passed to ``simulate(forces=...)``
        (:meth:`Mechanism.add_forces`). Raises InputError for a missing or different mechanism, one with a different
        number of forces than the run had, and a solution without rows.
        """
        kept = self.certificate
        if mechanism is None and kept is not None and self._suffices(kept, error):
            return kept
        self._require_scene(mechanism, "check")
        replayed = self._replayed(mechanism)
        finer, missing = None, ""
        if error is not False:
            try:
                finer = finer_run(self, replayed, FINER_TIME if error is None else np.inf)
            except NotEstimatedError as why:
                missing = str(why)
        made = certify(self, replayed, finer, missing)
        if (mechanism is None or self.system is None) and (kept is None or error is not False):
            object.__setattr__(self, "certificate", made)
        return made

    @staticmethod
    def _suffices(kept, error) -> bool:
        """Whether a certificate has an error estimate, or none, as it is wanted."""
        if error is False:
            return kept.error is None and not kept.error_missing
        return kept.error is not None or bool(kept.error_missing and error is None)

    @property
    def error(self) -> GlobalError | None:
        """The global error, see :class:`~pinconsist.GlobalError`; None if it cannot be estimated."""
        return self.check(error=True).error

    def at(self, t, mechanism=None) -> Solution:
        """The solution with rows at the times `t`, s, shape (n,), in the order of the run and within it; or at one
        time.

        ``sol.at(times).reaction("pin")`` is the reaction at these times, and so on. At the time of a row it is that
        row, or the later of two. Between rows, q and v have the accuracy of the run, whatever its method and its steps,
        with or without ``dense_output``: the continuous solution is evaluated, or recomputed from the rows. The loops
        are closed to rounding, and multipliers are those of the equations of motion. ``h`` and ``order`` are empty, and
        the verdict is that of the run.

        `mechanism` is as in :meth:`check`. Raises InputError as there, and for times in another order or outside the
        run.
        """
        general = mechanism is None and self.system is not None and self.mechanism is None
        scene = None if general else self._mechanism(mechanism, "at")
        self._require_forces(mechanism)
        times = np.atleast_1d(finite_array(t, "t"))
        if len(self.t) and ((self.t[-1] - self.t[0]) * np.diff(times) < 0).any():
            raise InputError("t must be sorted in the direction of the run")
        columns = dict(zip(("q", "v", "lam"), states_at(self, times, scene), strict=True), t=times.copy())
        for column in columns.values():
            column.setflags(write=False)
        found = replace(self, **columns, h=np.zeros(0), order=np.zeros(0, int), _run=self._run or self)
        object.__setattr__(found, "certificate", self.certificate)
        return found

    def evaluate(self, quantity: str, mechanism=None) -> Any:
        """A `quantity` of the run by its name, such as ``"peak reaction boom_pin"`` or ``"position foot z at 2.5"``.

        The names are those of the command line, of :func:`pinconsist.plot` and of :meth:`Sensitivities.of`. They may be
        preceded by ``min``, ``max``, ``peak`` (the value of largest magnitude, with its sign), ``rms``, ``mean`` or
        ``final``, or followed by ``at`` and a time, s. States between the rows are included, see :meth:`at`. The result
        is then a number, or an array if ``final`` or ``at`` applies to a quantity with several components. Statistics
        of vectors are those of the norm. Otherwise the result is an array with a value for each row, shape (n,) or (n,
        k).

        ============================================  ==================================================================
        ``position``, ``velocity``, ``acceleration``  of a joint, or of a frame: ``"peak velocity foot"``
        ``reaction``, ``moment``                      force and moment of a loop or a joint, :meth:`reaction`; the
                                                      torque of a drive
        ``joint_force``, ``joint_moment``             of a joint of the tree, :meth:`joint_force`
        ``force``, ``length``, ``speed``              of a spring or an actuator, :meth:`force`
        ``torque``, ``power``                         of a force, drive or joint, :meth:`torque`
        ``multipliers``                               of a loop, one for each row
        ``energy``                                    ``total``, ``kinetic``, ``potential``, ``elastic``, or ``error``:
                                                      that of the balance, at rows only
        ``error``                                     ``q``, ``v`` or ``force``: the global error of the run
        ============================================  ==================================================================

        The name may be followed by a component, ``x``, ``y`` or ``z`` in world axes, or a row of multipliers. A colon
        may replace the first space, ``"reaction:pin"``. A name alone means the position of a joint or frame, the
        multipliers of a loop, or the force of an element. `mechanism` is as in :meth:`check`. Raises InputError for
        anything else.
        """
        asked = Quantity.of(quantity, self._mechanism(mechanism, "evaluate"))
        if asked.statistic or asked.what == "error":
            return asked.value(self, mechanism)
        return asked.series(self, mechanism).values

    def series(self, quantity: str, mechanism=None) -> Series:
        """A quantity at the rows with its unit and the names of its components, as plotted by :func:`pinconsist.plot`.

        `quantity` is as in :meth:`evaluate`, without a statistic, `mechanism` as in :meth:`check`. Raises InputError as
        there.
        """
        return Quantity.of(quantity, self._mechanism(mechanism, "series")).curve(self, mechanism)

    def energy(self, mechanism=None) -> Energy:
        """The energies of the rows, power and work of each force, and their balance: see :class:`~pinconsist.Energy`.

        `mechanism` is as in :meth:`check`. Raises InputError as there, and for a general problem.
        """
        self._require_scene(mechanism, "energy")
        mechanism = self._replayed(mechanism) or self.mechanism
        if mechanism is None:
            raise InputError("energy is defined for mechanisms only, not for a general problem")
        workspace = self._workspace(mechanism.model)
        energy = energy_of(self, mechanism, workspace)
        if energy.work_error <= UNCERTAIN:
            return energy
        closed = self.sol is not None and self.method.get("method") == "Radau"  # between rows, too
        states = self.sol if closed else lambda times: states_at(self, times, mechanism)
        return refined(energy, mechanism, states, workspace)

    def reaction(
        self, loop: str, mechanism=None, *, axes: str = "world", compliance: Mapping | None = None
    ) -> Reaction | JointForce:
        """The reaction of a loop: force and moment on body 2, or a motor's torque; see :class:`Reaction`.

        `loop` names a loop, drive, coupling or constraint of the mechanism; there is a row for each row of the
        solution. For a joint of the tree, this is :meth:`joint_force`. A solution read from a file needs the
        `mechanism` that was simulated. `axes` of force and moment are "world", or "anchor": those of the loop's anchor
        1.

        Where loops are redundant, rigid-body dynamics does not determine all reactions; those of smallest norm are
        returned, and ``not_unique`` lists them. A `compliance` determines them: loop or joint → m/N, or (m/N,
        rad/(N·m)); 0 means rigid, as does omission; for drives, couplings and constraints it is one number, for their
        row. The energy Σ c |wrench|² / 2 is then minimal, as between stiff springs.

        Raises InputError for an unknown loop, a missing or different mechanism, a general problem, other axes, and a
        compliance of an unknown item.
        """
        return reaction(self._states(mechanism, "reaction", False), loop, axes, compliance)

    def contact_forces(self, mechanism=None, *, axes: str = "anchor") -> dict[str, np.ndarray]:
        """The forces of all loops with the sign of Pinocchio's contact forces: on body 1, −λ of its loops.

        ``pin.constraintDynamics`` stores such forces in ``contact_force`` of its constraint data. Loop → forces, N,
        shape (n, 3), for points and distances; for other kinds forces and moments, N·m, shape (n, 6), about anchor 2,
        which is at anchor 1 if the loop is closed there. `axes` are "anchor", those of anchor 1 (or ``pin.LOCAL``), or
        "world" (``pin.LOCAL_WORLD_ALIGNED``). `mechanism` is as in :meth:`reaction`; raises InputError as there.
        """
        scene, found = self._mechanism(mechanism, "contact_forces", False), {}
        for loop in scene.anchored_loops:
            its = self.reaction(loop.name, mechanism, axes=axes)
            parts = [its.force, its.moment] if LOOP_KINDS[loop.kind].rotations else [its.force]
            found[loop.name] = -np.hstack([part for part in parts if part is not None])
        return found

    def play(self, viewer, mechanism=None, *, speed: float = 1.0, fps: float = 50.0) -> None:
        """Play the motion in your own viewer, in real time; :meth:`export_html` and :func:`replay` need none.

        Parameters
        ----------
        viewer : object
            Anything with ``display(q)``, such as Pinocchio's ``MeshcatVisualizer``. If it has a ``model``, this may
            store angles in another way than the mechanism, or in another order, or lack joints: joints are found by
            name.
        mechanism : Mechanism, optional
            As in :meth:`check`.
        speed : float
            Seconds of motion per second.
        fps : float
            Frames per second.

        Raises
        ------
        InputError
            Not a viewer, or one with joints that the mechanism does not have.
        """
        from ..view.play import play

        play(self, self._mechanism(mechanism, "play"), viewer, speed, fps)

    def joint_force(
        self, joint: str, mechanism=None, *, axes: str = "world", compliance: Mapping | None = None
    ) -> JointForce:
        """The force and moment that a `joint` of the tree transmits to its child, see :class:`JointForce`.

        They follow from inverse dynamics at each row, with gravity, all forces and all loops. Links that are rigidly
        attached in a file are one body, and have no joint force. `axes` are "world", or "joint": those of its frame on
        the child. `mechanism` is as in :meth:`check`, and `compliance` as in :meth:`reaction`. Raises InputError as
        there.
        """
        mechanism = self._mechanism(mechanism, "joint_force")
        checked_name(joint, "joint_force(): the joint")
        if joint not in mechanism.joints and joint in (loop.name for loop in mechanism.loops):
            raise InputError(
                f"{mechanism.name}: {joint!r} is a loop, not a joint of the tree: use sol.reaction({joint!r})"
            )
        return joint_force(self._states(mechanism, "joint_force"), joint, axes, compliance)

    def _states(self, mechanism, caller, replay=True) -> States:
        """What reactions and joint forces are computed from; accelerations only where they are needed."""
        found = self._mechanism(mechanism, caller, replay)
        workspace = self._workspace(found.model)

        def acting():
            self._require_forces(mechanism)
            return self._mechanism(mechanism, caller)

        def motion(rows):
            v = self.v[rows]
            return v, accelerations(acting(), self, sided(self.t)[rows], self.q[rows], v)

        def at(times):
            q, v, lam = states_at(self, times, acting())
            return States(
                found,
                times,
                q,
                lam,
                workspace,
                lambda rows: (v[rows], accelerations(acting(), self, times, q, v)[rows]),
            )

        return States(found, self.t, self.q, self.lam, workspace, motion, at)

    def _mechanism(self, mechanism, caller, replay=True) -> Mechanism:
        """`mechanism`, by default that of the run; with the recorded torques if the method `caller` needs them."""
        require_mechanism(self, mechanism)
        found = (self._replayed(mechanism) if replay else mechanism) or self.mechanism
        if found is None:
            where = "a solution that was read from a file or copied needs its mechanism here: "
            where += f"sol.{caller}(…, mechanism)"
            raise InputError(where if self.system is None else f"{caller}: a general problem has no loops and joints")
        return found

    def _replayed(self, mechanism):
        """`mechanism`, by default that of the run, with the recorded torques; None if there are none and no default."""
        own = self.mechanism if self.held else None
        return replayed(mechanism or own, self)

    def _workspace(self, model) -> Workspace:
        """A workspace for evaluations, which reuses that of the run if it has the same model."""
        system = self.system if self.system is not None and self.system.model is model else None
        return Workspace(model, system and system.workspace)

    def _require_scene(self, mechanism, method):
        if mechanism is None and self.system is None:
            raise InputError(
                f"a solution that was read from a file or copied needs its mechanism here: sol.{method}(mechanism)"
            )
        if not len(self.t):
            raise InputError(f"the solution has no rows to {'check' if method == 'check' else 'compute energies of'}")
        self._require_forces(mechanism)

    def _require_forces(self, mechanism):
        require_mechanism(self, mechanism)
        forces = self.method.get("forces")
        if mechanism is not None and forces not in (None, len(mechanism.forces)):
            raise InputError(
                f"the run had {forces} forces besides the model's own, but this mechanism has "
                f"{len(mechanism.forces)}: add those of simulate(forces=...) by mechanism.add_forces(...)"
            )

    def plot(self, *pictures: str, file=None, mechanism=None) -> Figure:
        """A matplotlib figure of the solution, with one or several plots below each other.

        Parameters
        ----------
        *pictures : str
            Any of ``"trajectory"``: q and v over time; ``"multipliers"``: λ of each row, and the first twenty steps
            again, magnified; from exact initial values (``consistency="exact"``) the rows after the first have an O(1)
            error, whatever the step size (Arévalo 2008); ``"forces"``: the magnitudes of force, N, and moment, N·m, in
            each loop and joint, with a star where they are not unique; ``"drift"``: the largest magnitude of Φ and of J
            v + Φ_t of each loop; ``"energy"``: energies and work, J, and the error of their balance; ``"steps"``: step
            size, s, and order; ``"phase"``: velocity over configuration of the twelve joints with one degree of freedom
            that move most. Default: trajectory and multipliers.
        file : path, optional
            File to which the figure is written, atomically; an existing file is replaced. The file extension determines
            the format, such as ``.png``, ``.pdf`` or ``.svg``. Default: the figure is only returned.
        mechanism : Mechanism, optional
            As in :meth:`check`; its joints and loop rows name the curves.

        Returns
        -------
        matplotlib.figure.Figure
            A figure without a window, not registered with pyplot; a notebook shows it.

        Raises
        ------
        InputError
            Inconsistent sizes, an unknown plot, one that this solution does not have (``"steps"`` with ``t_eval``), or
            a file extension that matplotlib cannot write.
        MissingExtraError
            matplotlib is not installed.
        OSError
            The file cannot be written.
        """
        from ..view.plots import BOTH, pictures_of

        return pictures_of(self, pictures or BOTH, file, mechanism)

    def render(self, file, mechanism=None, *, speed=1.0, traces=(), forces=False, at=()) -> Path:
        """Write a video, ``.mp4`` or ``.gif``, or drawings of a planar mechanism, ``.svg``, and return the path.

        It is rendered in this process, as on a page but without perspective, and written to `file` atomically. `speed`,
        `traces` and `forces` are as in :func:`pinconsist.export_html`; `at` holds the times to draw in an SVG, s, by
        default the start; `mechanism` is as in :meth:`reaction`. Raises InputError as export_html does, for other file
        extensions, for times outside the run, and for drawings of mechanisms that are not planar; MissingExtraError
        without the extra; OSError if the file cannot be written.
        """
        from ..view.render import render

        return render(
            self._mechanism(mechanism, "render", False), self, file, speed=speed, traces=traces, forces=forces, at=at
        )

    def summary(self) -> str:
        """The message; steps with their sizes and orders; rejected steps by reason; cost of the run; skipped work."""
        return summary_of(self)

    def export_html(self, file, mechanism=None, **options) -> Path:
        """Write the page of :func:`pinconsist.export_html` to a `file`, with its `options`, and return the path.

        `mechanism` is as in :meth:`reaction`.
        """
        from ..view.page import export_html

        return export_html(self._mechanism(mechanism, "export_html"), self, file, **options)

    def save(self, file) -> Path:
        """Write the solution to an npz `file`, atomically, and return its path; ``.npz`` is added if missing.

        An existing file is replaced. The file contains no pickles, no ``system`` and no ``sol``. It contains the times
        and states of events, the verdict of :meth:`check` if it was computed, and the package versions; a run of
        :func:`pinconsist.record` can be repeated and continued from it. Raises OSError if it cannot be written; an
        existing file is then unchanged.
        """
        return write(self, file)

    @classmethod
    def load(cls, file) -> Solution:
        """The solution written by :meth:`save` to this `file`, named with its ``.npz``.

        It has no ``system`` and no ``sol``: :meth:`energy` and :meth:`reaction` need the mechanism, and so does
        :meth:`check` if the verdict was not computed before the run was saved. Raises FormatError, which names the
        file, if it is missing, truncated, damaged, foreign or of another format.
        """
        fields, certificate = read(file)
        found = cls(**fields)
        object.__setattr__(found, "certificate", certificate)
        return found


def require_mechanism(solution, mechanism, who="the solution", hint=""):
    """Raise InputError for an argument that cannot be the mechanism of a solution."""
    if mechanism is None:
        return
    if not isinstance(mechanism, Mechanism):
        raise InputError(f"a Mechanism is needed to read the solution, got {type(mechanism).__name__}")
    sizes = solution.q.shape[1], solution.v.shape[1], solution.lam.shape[1]
    if sizes != (mechanism.nq, mechanism.nv, len(mechanism.row_labels)):
        raise InputError(
            f"{who} has {sizes[0]} position numbers, {sizes[1]} velocities and {sizes[2]} multipliers, mechanism "
            f"{mechanism.name!r} has {mechanism.nq}, {mechanism.nv} and {len(mechanism.row_labels)}: it is not the one "
            f"that was simulated{hint}"
        )
