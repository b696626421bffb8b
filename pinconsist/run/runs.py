"""Runs that are kept in a file: `record` a run, `resume` it, `rerun` it."""

import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import InputError
from ..files import require_writable, suffixed
from ..mechanism.checks import several
from ..mechanism.description import digests
from ..mechanism.forces import Piecewise
from ..mechanism.forces.held import HeldRecord
from ..mechanism.mechanism import Mechanism, with_added_forces
from .checkpoints import ROWS, STEPS, Recipe, carry_out
from .interrupts import ended_like_ctrl_c
from .scene_source import LOAD_OPTIONS, SceneSource
from .solution import Solution, require_mechanism
from .solution_file import versions

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Rerun:
    """A run repeated from its file, and how it compares.

    Attributes
    ----------
    same : bool
        Whether every number of t, q, v, λ, steps and orders is the same, bit for bit.
    differences : tuple of str
        What has changed: versions, files of the scene, numbers.
    solution : Solution
        The new run; if the one in the file is incomplete, only up to its end.
    """

    same: bool
    differences: tuple[str, ...]
    solution: Solution = field(repr=False)

    def __str__(self):
        rows = f"{len(self.solution.t)} rows up to t = {self.solution.t[-1]:g} s" if len(self.solution.t) else "no rows"
        verdict = f"the same numbers, bit for bit: {rows}" if self.same else "the numbers differ"
        return "\n".join((*self.differences, verdict))


def record(
    scene, t_span, file, q0=None, v0=None, *, load=None, save_every=None, forces=(), callback=None, **options
) -> Solution:
    """Simulate, and record the run in a file from which it can be repeated and continued.

    With `save_every` the file is rewritten at each checkpoint, and always contains a complete run up to that point; a
    process that is killed loses only what came after. (Checkpoints are skipped where saving would take more than a
    tenth of the time.) At every checkpoint the integration restarts from the state there; therefore the numbers depend
    on `save_every` (within the tolerances), and :func:`resume` reproduces exactly those of an uninterrupted run.
    Ctrl-C, SIGTERM and SIGHUP end the run, with the part so far in the file.

    Parameters
    ----------
    scene : str, path-like or Mechanism
        As for :func:`pinconsist.load`; a mechanism in memory must be passed again to `rerun` and `resume`.
    t_span, q0, v0 : optional
        As for :func:`pinconsist.simulate`.
    file : path-like
        The file; ``.npz`` is added to a name without it.
    load : mapping, optional
        Options of :func:`pinconsist.load`: ``loops``, ``closure``, ``free_flyer``, ``package_dirs``.
    save_every : float, optional
        Period of checkpoints, s of simulated time. Choose it much longer than a step: each checkpoint costs a restart
        of the method and writing the run so far to the file.
    forces : sequence
        As for :func:`pinconsist.simulate`. Records, numbers and Motions are stored in the file; Python functions cannot
        be stored, and must be passed again to `rerun` and `resume`.
    callback : callable, optional
        As for :func:`pinconsist.simulate`; an exception in it ends the run as a failure; the rows so far are kept.
    **options
        Other options of :func:`pinconsist.simulate`, but not ``events`` and ``dense_output``: they are not stored.

    Returns
    -------
    Solution
        The solution in the file.

    Raises
    ------
    InputError
        As :func:`pinconsist.simulate`; or a file that cannot be written.
    SavingError
        The end could not be written; the error has the solution as an attribute.
    """
    file = suffixed(file, ".npz")
    require_writable(file)
    mechanism, where, files = _scene(scene, load, file)
    recipe = Recipe.of(where, files, mechanism, t_span, q0, v0, forces, options, save_every)
    recipe.ends()  # refuses too many
    mechanism = with_added_forces(mechanism, forces, "record")
    if save_every is not None and any(isinstance(force, HeldRecord | Piecewise) for force in mechanism.forces):
        raise InputError(
            "save_every: a run with held torques or forces that jump at known times cannot be continued from a "
            "checkpoint, because the file holds neither the state of a controller nor the side of a jump. "
            "Leave it out; the run is then saved at its end"
        )
    with ended_like_ctrl_c():
        return carry_out(recipe, mechanism, file, callback=callback)


def resume(file, *, scene=None, forces=None, callback=None) -> Solution:
    """Continue a run from its file, which :func:`record` wrote, to its end.

    Rows after the last checkpoint are computed again; without checkpoints, this is the whole run. On the same machine
    the result is bit-for-bit identical to an uninterrupted run. A run that reached its end is returned unchanged.

    Parameters
    ----------
    file : path-like
        The file, which is written as by `record`.
    scene : str, path-like or Mechanism, optional
        The scene, if it has moved; needed for a mechanism in memory.
    forces : sequence, optional
        Those of `record`, if one was a Python function.
    callback : callable, optional
        As for `record`.

    Returns
    -------
    Solution
        The whole run.

    Raises
    ------
    FormatError
        The file is not a complete run, or does not say how it was made.
    InputError
        The scene has changed, or forces are missing.
    SavingError
        As `record`.
    """
    solution, recipe, mechanism, changed = _again(file, scene, forces)
    if solution.status == 0:
        return solution
    if changed:
        raise InputError(
            f"{file} cannot be continued, because its scene has changed: {'; '.join(changed)}. See pinconsist rerun"
        )
    require_writable(file)
    if other := _other_versions(solution):
        _log.warning("%s was started with other versions (%s): the last bits may differ", file, "; ".join(other))
    with ended_like_ctrl_c():
        whole = carry_out(recipe, mechanism, file, begun=solution, callback=callback)
    return whole


def rerun(file, *, scene=None, forces=None, callback=None) -> Rerun:
    """Repeat the run in a file, and compare every number.

    Parameters as :func:`resume`: `file`, which is not changed, `scene`, `forces`, `callback`.

    Returns
    -------
    Rerun
        Whether the numbers are the same, and what else has changed: versions, files of the scene, the mechanism.

    Raises
    ------
    FormatError
        The file is not a complete run, or does not say how it was made.
    InputError
        The scene cannot be loaded, or forces are missing.
    """
    old, recipe, mechanism, changed = _again(file, scene, forces)
    forward = recipe.t_span[1] >= recipe.t_span[0]

    def until(t, q, v, lam):
        stop = callback is not None and callback(t, q, v, lam)
        return stop or (t >= old.t[-1] if forward else t <= old.t[-1])

    cut_short = old.status != 0 and len(old.t)  # rows after that are not compared
    new = carry_out(replace(recipe, checkpoint=None), mechanism, None, callback=until if cut_short else callback)
    about, numbers = _other_versions(old), []
    for name in (*ROWS, *STEPS):
        then, now = getattr(old, name), getattr(new, name)
        if then.shape != now.shape:
            numbers.append(f"{name}: the shape was {then.shape}, now it is {now.shape}")
        elif then.tobytes() != now.tobytes():
            most = np.abs(np.subtract(now, then, dtype=float)).max()
            numbers.append(f"{name}: differs by up to {most:.3g}")
    return Rerun(not numbers, (*about, *changed, *numbers), new)


def _other_versions(solution) -> list[str]:
    then, now = solution.versions, versions()
    return [f"{name} was {then[name]}, now it is {now.get(name)}" for name in then if then[name] != now.get(name)]


def changed_files(then, now) -> list[str]:
    changed = [f"{name} has changed" for name in then if name in now and then[name] != now[name]]
    changed += [f"{name} is no longer read" for name in then if name not in now]
    return changed + [f"{name} was not read before" for name in now if name not in then]


def _changed_mechanism(then, now, same_pinocchio) -> list[str]:
    """A sentence if the digests of a mechanism differ; those of models are compared only for the same Pinocchio."""
    parts = {"model": "bodies, joints or gravity", "forces": "own forces"}
    parts |= {part: part for part in ("loops", "guess", "contacts")}
    compared = (part for part in now if part in then and (part != "model" or same_pinocchio))
    other = [parts[part] for part in compared if then[part] != now[part]]
    return [f"the mechanism has different {', different '.join(other)}"] if other else []


def _scene(scene, load, file):
    """The mechanism, its record (None for one in memory), and the hashes of its files."""
    if isinstance(scene, Mechanism):
        if load:
            raise InputError("load= is for scenes that are read from a file; this one is already a Mechanism")
        return scene, None, {}
    if not isinstance(scene, str | os.PathLike):
        raise InputError(f"a scene is a name, a file or a Mechanism, got {type(scene).__name__}")
    load = {} if load is None else load
    if not isinstance(load, Mapping) or set(load) - set(LOAD_OPTIONS):
        known = ", ".join(LOAD_OPTIONS)
        raise InputError(f"load= must map options of load(), which are {known}, to their values; got {load!r}")
    options = {name: value for name, value in load.items() if value is not None}
    for name in {"package_dirs", "ignore"} & set(options):
        options[name] = list(several(options[name]))
    source = SceneSource(os.fspath(scene), **options)
    mechanism, files = source.load_with_hashes()
    return mechanism, source.record(file), files


def _again(file, scene, forces):
    """The run in a file, its recipe, its mechanism with all forces, and the changes in its scene."""
    solution = Solution.load(file)
    recipe = Recipe.read(solution, file)
    if isinstance(scene, Mechanism):
        same, then = solution.versions.get("pin") == versions()["pin"], recipe.mechanism
        mechanism, changed = scene, _changed_mechanism(then, digests(scene), same) if then else []
    elif recipe.scene is None:
        raise InputError(f"{file} is a run of a mechanism in memory ({solution.scene}): pass it as scene=")
    else:
        source = SceneSource.recorded(recipe.scene, file)
        source = source if scene is None else replace(source, source=os.fspath(scene))
        mechanism, now = source.load_for(file)
        changed = changed_files(recipe.files, now)
    if forces is None:
        if recipe.forces is None:
            raise InputError(
                f"{file} was made with a force that is a Python function, which a file cannot store; repeat or "
                "continue it in Python, with the forces: pinconsist.rerun(file, forces=[...])"
            )
        forces = recipe.given_forces()
    mechanism = with_added_forces(mechanism, forces, "rerun")
    require_mechanism(solution, mechanism, file)
    return solution, recipe, mechanism, changed
