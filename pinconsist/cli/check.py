"""`pinconsist check`."""

from __future__ import annotations

from ..errors import AssemblyError, SingularSystemError
from . import doubts, inventory, output, scene

NOTHING = 1e-15  # rad or m, of a joint that stands at zero
LINES, TERMS = 12, 4  # of redundant rows, and of the rows each depends on


def check(
    source: scene.Source,
    loops: scene.Loops = None,
    closure: scene.Closure = None,
    free_flyer: scene.FreeFlyer = False,
    package_dirs: scene.PackageDirs = None,
    reanchor: scene.Reanchor = False,
    at: scene.At = None,
    as_json: output.Json = False,
) -> int:
    """Say what a scene is: bodies, loops, rank, redundant rows, mobility, and its closed configuration.

    At a position of your choice by --at, also a singular one, where more rows
    depend on each other, the mobility is larger, and the exit code is 2.

    Example: pinconsist check four_bar --at crank=pi/2
    """
    from ..mechanism.assembly import assemble

    q0 = scene.joint_values(at, "--at")
    mech = scene.Scene(source, loops, closure, free_flyer, package_dirs or [], reanchor, q0).load()
    guess = mech.configuration(q0, base=mech.guess)
    before = _gaps(mech, guess)
    try:
        assembly = assemble(mech, q0 or None)
    except AssemblyError as error:
        return _open(mech, before, _gaps(mech, error.q), error, as_json)
    scene.tell_moved(mech, q0, assembly)
    singular, found = _singular(mech, assembly.q), doubts.doubts(mech, assembly)
    if as_json:
        output.print_json(_report(mech, guess, before, assembly, singular) | {"warnings": found})
    else:
        _print(mech, guess, before, assembly, singular)
    doubts.tell(found)
    if singular:
        output.print_error(singular)
    return output.WRONG_INPUT if singular else output.FINE


def _gaps(mech, q) -> dict[str, float]:
    """Largest |Φ| of each loop."""
    from ..mechanism.system import MechanismSystem

    gaps = {loop.name: 0.0 for loop in mech.loops}
    for (loop, _), value in zip(mech.row_labels, MechanismSystem(mech, q).loop_rows(q)[0], strict=True):
        gaps[loop] = max(gaps[loop], abs(float(value)))
    return gaps


def _singular(mech, q) -> str:
    """Why the equations are singular at a configuration; empty if they are regular."""
    from ..mechanism.regular import require_regular
    from ..mechanism.system import MechanismSystem

    try:
        require_regular(MechanismSystem(mech, q), q)
    except SingularSystemError as error:
        return str(error)
    return ""


def _open(mech, before, after, error, as_json) -> int:
    """The loops cannot close: which, and by how much."""
    if as_json:
        output.print_json({
            "scene": mech.name, "closed": False, "error": str(error), "gaps_before": before, "gaps": after,
            "q": scene.by_joint(mech, error.q),
        })  # fmt: skip
    else:
        inventory.print_inventory(mech)
        rows = [(name, f"{before[name]:.3g}", f"{gap:.3g}") for name, gap in _worst_first(after)]
        output.table(("loop", "gap at the guess [m, rad]>", "gap left [m, rad]>"), rows)
    output.print_error(error)
    return output.WRONG_INPUT


def _worst_first(gaps):
    return sorted(gaps.items(), key=lambda item: -item[1])


def _print(mech, guess, before, assembly, singular):
    inventory.print_inventory(mech)
    if mech.loops:
        dropped = len(assembly.redundant)
        print(f"rows: {assembly.rows}, of which {assembly.rank} independent and {dropped} redundant")
    print(f"mobility: {assembly.mobility}")
    for line in _redundant_lines(assembly.redundant):
        output.paragraph(line, indent="  ", hanging="    ")
    if mech.loops:
        first, (where, gap) = _worst_first(before)[0], assembly.largest_gap
        print(f"largest gap at the guess: {first[1]:.3g} m or rad, in loop {first[0]!r}")
        print(f"largest gap once closed:  {gap:.3g} m or rad, in loop {where!r}")
        iterations = output.counted(assembly.iterations, "iteration")
        print(f"closing took {iterations} and moved no joint by more than {assembly.moved:.3g} rad or m")
    print(f"equations of motion: {'singular, see below' if singular else 'regular there'}\n")
    output.table(("joint [rad, m]", "guess>", "closed>"), _values(mech, guess, assembly.q))


def _values(mech, *configurations):
    """A line for each number of a configuration: its joint, and its value in each of several configurations."""
    by_joint = [scene.by_joint(mech, q) for q in configurations]
    for joint, first in by_joint[0].items():
        count = len(first) if isinstance(first, list) else 0
        names = [f"{joint}[{k}]" for k in range(count)] or [joint]
        numbers = [values[joint] if count else [values[joint]] for values in by_joint]
        for name, *each in zip(names, *numbers, strict=True):
            yield name, *(f"{value if abs(value) > NOTHING else 0.0:.9g}" for value in each)


def _redundant_lines(redundant) -> list[str]:
    """The redundant rows for a person: zero rows by loop, the others as combinations, all of it shortened."""
    zero, lines = {}, []
    for (loop, row), combination in redundant.items():
        if not combination:
            zero.setdefault(loop, []).append(row)
            continue
        terms = sorted(combination.items(), key=lambda item: -abs(item[1]))
        text = " ".join(f"{value:+.3g}·({of} {name})" for (of, name), value in terms[:TERMS])
        more = f" and {len(terms) - TERMS} more" if len(terms) > TERMS else ""
        lines.append(f"redundant: ({loop} {row}) = {text}{more}")
    lines[:0] = [f"redundant: ({loop} {', '.join(rows)}) = 0 for every motion" for loop, rows in zero.items()]
    more = [f"… and {len(lines) - LINES} more"] if len(lines) > LINES else []
    return lines[:LINES] + more


def _report(mech, guess, before, assembly, singular) -> dict:
    redundant = [
        {
            "loop": loop, "row": row,
            "depends_on": [{"loop": of, "row": name, "factor": value} for (of, name), value in combination.items()],
        }
        for (loop, row), combination in assembly.redundant.items()
    ]  # fmt: skip
    return {
        "scene": mech.name, "closed": True, **inventory.inventory(mech),
        "rows": assembly.rows, "rank": assembly.rank, "mobility": assembly.mobility, "redundant": redundant,
        "gaps_before": before, "gaps": assembly.gaps, "iterations": assembly.iterations, "moved": assembly.moved,
        "regular": not singular, "guess": scene.by_joint(mech, guess), "q": scene.by_joint(mech, assembly.q),
        **({"error": singular} if singular else {}),
    }  # fmt: skip
