"""The curves next to the motion: forces, torques, energies, joints, steps and orders, at times that show all peaks."""

from base64 import b64encode
from dataclasses import replace

import numpy as np

from ..errors import InputError
from ..mechanism.contacts import contact_units
from ..mechanism.forces import SpringDamper
from ..mechanism.joint_constraints import Drive
from ..mechanism.loops import LOOP_KINDS, Loop
from ..mechanism.names import position_names, position_units
from ..mechanism.rows import LoopRows
from .arrows import FORCE, TRUE, UNITS, actions, joint_wrenches, of_joint, true_actions
from .contacts import contact_actions
from .filled import ROWS, filled
from .motion import Run, body_poses, without_forces

SHARED = " *"  # behind the name of a force that is not unique
SMALL = 1e-5  # of the largest force of a joint: smaller ones are rounding


def packed(values) -> str:
    """Numbers in the format that the page unpacks, in single precision."""
    return b64encode(np.asarray(values, "<f4").tobytes()).decode()


def panel(runs: list[Run], size: float, without, planar: bool) -> dict:
    """Seconds since the start for each run, and groups of curves over them; those of the forces `without` are left out.

    ``whole`` says whether these are all rows. A curve of a loop or a motor names it and the bodies between which it
    acts, by which the page finds its force; true values have a colour. ``shared`` are forces that are not unique.
    ``notes`` say what is missing.
    """
    groups: dict[str, dict] = {}
    times = []
    reasons = dict.fromkeys(filter(None, map(without_forces, runs)))
    notes = [f"joint forces and energies are missing: {reason}" for reason in reasons]
    for number, run in enumerate(runs):
        run = replace(run, true=None) if number else run  # the true run is the same for all
        fine = _fine(run)
        times.append(packed(fine.elapsed))
        shared = _not_unique(run)
        for group, unit, name, values, about in _curves(fine, run, size, without, planar):
            label = f"{run.title}: {name}" if run.title and "color" not in about else name
            curve = {"name": label, "run": number, "y": packed(values), **about}
            if about.get("of") in shared:
                curve |= {"name": label + SHARED, "shared": True}
            groups.setdefault(group, {"name": group, "unit": unit, "curves": []})["curves"].append(curve)
    whole = all(len(run.t) <= ROWS and not run.continuous for run in runs)
    return {"times": times, "whole": whole, "groups": list(groups.values()), "notes": notes}


def _rows_that_vary(run: Run) -> np.ndarray:
    """Rows of a run: all, or of each part the first and those with the extreme multipliers and speeds."""
    n = len(run.t)
    if n <= ROWS:
        return np.arange(n)
    sizes = [np.abs(x).max(axis=1) for x in (run.lam, run.v) if x is not None and x.size]
    found = [0, n - 1]
    for part in np.array_split(np.arange(n), ROWS // (2 * len(sizes) + 1)):
        found += [part[0], *(part[pick(x[part])] for x in sizes for pick in (np.argmin, np.argmax))]
    return np.unique(found)


def _fine(run: Run) -> Run:
    """A run at the times of its curves: the rows that vary, and states between them until lines join them well."""
    rows = _rows_that_vary(run)
    if not run.continuous:
        return run.rows(rows)
    found = filled(run.source, run.scene_of_file, rows)
    columns = {name: getattr(found, name) for name in ("t", "q", "v", "lam")}
    return replace(run, **columns, elapsed=np.abs(found.t - run.t[0]), source=found)


def _curves(some: Run, run: Run, size: float, without, planar: bool):
    """(group, unit, name, values, subject) of each curve of a run, at the times of `some`."""
    source, model = run.source, run.mech.model
    if run.lam is not None and (run.v is not None or not run.mech.forces):
        poses, words = body_poses(model, some.q), {loop.name: _word(loop, planar) for loop in run.mech.loops}
        for action in actions(some, poses, size, without) + true_actions(some, poses, size, without):
            group = "forces" if action.kind == FORCE else "torques"
            values = action.norms if action.on_joint is None else action.on_joint
            about = {"of": action.of, "bodies": action.bodies} | ({"color": action.color} if action.color else {})
            *true, name = action.name.rpartition(TRUE)
            yield group, UNITS[action.kind], "".join((*true, words.get(action.of, ""), name)), values, about
        yield from _of_elements(some)
        yield from _of_contacts(some, poses)
    for name, energies in _energies(some).items():
        yield "energy", "J", name, energies, {}
    for name, unit, values in zip(position_names(model), position_units(model), some.q.T, strict=True):
        if unit:
            yield {"rad": "angles", "m": "positions"}[unit], unit, name, values, {}
    for name, group, unit, of_steps in ("h", "step", "s", source.h), ("order", "order", "", source.order):
        values = np.asarray(of_steps, float)
        if len(run.t) > 1 and values.shape == (len(run.t) - 1,):
            reached = values[(np.searchsorted(run.elapsed, some.elapsed) - 1).clip(0)]
            yield group, unit, name, np.where(reached > 0, reached, np.nan), {}
    yield from _of_joints(some, size, without)


def _of_elements(some: Run):
    """Curves of springs, of couplings, and of the rows of user-defined constraints."""
    model, rows = some.mech.model, LoopRows.of(some.mech)
    for spring in (each for each in some.mech.forces if isinstance(each, SpringDamper) and some.v is not None):
        law = spring.bind(model)
        pulls = [law.element(*state)["force"] for state in zip(some.t, some.q, some.v, strict=True)]
        yield "forces", "N", spring.label, np.array(pulls), {"of": spring.label}
    for loop in (each for each in some.mech.loops if not isinstance(each, Loop | Drive)):
        part = rows.slices[loop.name]
        for row in range(part.start, part.stop):
            name = loop.name if part.stop - part.start == 1 else f"{loop.name} {rows.labels[row][1]}"
            unit = rows.multiplier_units[row]
            group = {"N": "forces", "N·m": "torques"}.get(unit, "multipliers")
            yield group, unit, f"{loop.kind} {name}", some.lam[:, row], {"of": loop.name}


def _of_contacts(some: Run, poses):
    """Curves of the forces of contacts and of their gaps."""
    for action in contact_actions(some, poses):
        group = "forces" if action.kind == FORCE else "torques"
        values = action.norms if action.on_joint is None else action.on_joint
        yield group, UNITS[action.kind], action.name, values, {"of": action.of}
    if some.source.contacts is None or len(some.source.t) != len(some.t):
        return
    names = [each.name for each in some.mech.contacts if each.has_gap]
    for name in names:
        gap, unit = some.source.contact(name, some.mech).gap, contact_units(some.mech, name)[0]
        yield {"m": "gaps", "rad": "gaps of joints"}[unit], unit, name, gap, {"of": name}


def _of_joints(some: Run, size: float, without):
    """Curves of what the joints of the tree transmit, (group, unit, name, values, subject), if they are known.

    Moments that are rounding, or the error of the forces of the loops, for a picture of this `size` are left out.
    """
    found = joint_wrenches(some, without)
    sizes = {joint: np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2) for joint, wrench in found.items()}
    least = SMALL * max((each[:, 0].max() for each in sizes.values()), default=0.0)
    for group, unit, part, of_part in ("joint forces", "N", 0, 1.0), ("joint moments", "N·m", 1, size):
        for joint, each in sizes.items():
            if each[:, part].max() > least * of_part:
                yield group, unit, joint, each[:, part], {"of": of_joint(joint)}


def _word(loop, planar: bool) -> str:
    """The kind of a loop, printed before its name; nothing for drives, which are named after what they drive."""
    if isinstance(loop, Loop):
        return f"{LOOP_KINDS[loop.kind].label_in(planar)} "
    return "" if isinstance(loop, Drive) else f"{loop.kind} "


def _energies(run: Run) -> dict[str, np.ndarray]:
    """Energies minus those at the start, for solutions that have them."""
    if run.is_bare:
        return {}
    try:
        energy = run.source.energy(run.source.mechanism or run.mech)
    except InputError:
        return {}
    kinds = {name: getattr(energy, name) for name in ("kinetic", "potential", "elastic", "total")}
    return {f"{name}, since the start": values - values[0] for name, values in kinds.items() if values.any()}


def verdicts(runs: list[Run]) -> list[dict]:
    """The verdict on each run, that of :meth:`Solution.check`, or why there is none."""
    out = []
    for run in runs:
        if run.is_bare:
            continue
        try:
            certificate = _certificate(run)
        except InputError as error:
            text = f"not judged: {error}"
            ok = False
        else:
            text = certificate.verdict
            ok = certificate.ok and not certificate.not_judged
        out.append({"text": f"{run.title}: {text}" if run.title else text, "ok": ok})
    return out


def _certificate(run: Run):
    """The certificate of a run; of one from a file that has none, with its mechanism. InputError if there is none."""
    try:
        return run.source.check()
    except InputError:
        try:
            return run.source.check(run.mech)
        except InputError:
            if run.source.certificate is None:
                raise
            return run.source.certificate


def _not_unique(run: Run) -> set[str]:
    """The loops, and joints by `of_joint`, whose forces are not unique, if the run has its verdict."""
    certificate = run.source.certificate
    names = certificate.not_unique if certificate else ()
    return {*names, *map(of_joint, names)}
