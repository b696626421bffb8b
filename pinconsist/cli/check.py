"""`pinconsist check`."""

from __future__ import annotations

from ..errors import AssemblyError, SingularSystemError
from . import output, scene

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
    singular = _singular(mech, assembly.q)
    if as_json:
        output.print_json(_report(mech, before, assembly, singular))
    else:
        _print(mech, before, assembly, singular)
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
        _print_inventory(mech)
        rows = [(name, f"{before[name]:.3g}", f"{gap:.3g}") for name, gap in _worst_first(after)]
        output.table(("loop", "gap at the guess [m, rad]>", "gap left [m, rad]>"), rows)
    output.print_error(error)
    return output.WRONG_INPUT


def _worst_first(gaps):
    return sorted(gaps.items(), key=lambda item: -item[1])


def _print_inventory(mech):
    mass = sum(inertia.mass for inertia in list(mech.model.inertias)[1:])
    count = output.counted(len(mech.joints), "moving body").replace("bodys", "bodies")
    print(f"{mech.name}: {count}, {mass:.4g} kg in all, nq = {mech.nq}, nv = {mech.nv}")
    massless = [n for n, body in zip(mech.joints, list(mech.model.inertias)[1:], strict=True) if body.mass == 0.0]
    if massless:
        output.paragraph(f"bodies without mass, at joints: {', '.join(massless)}", hanging="  ")
    if mech.actuated:
        output.paragraph(f"motors: {', '.join(mech.actuated)}", hanging="  ")
    print()
    if mech.loops:
        rows = [(loop.name, loop.kind, len(loop.rows), *_ends(loop)) for loop in mech.loops]
        output.table(("loop", "kind", "rows>", "joins", "and"), rows)
    else:
        print("loops: none, a plain tree; a loop file beside it, or --loops FILE, closes some\n")


def _ends(loop):
    """What a loop joins: two frames, a joint and its drive, two joints, or what a function of the user's says."""
    if loop.kind == "drive":
        return loop.joint, "along a curve"
    if loop.kind == "coupling":
        return loop.joint, loop.other
    return ("a function", "") if loop.kind == "constraint" else (loop.frame1, loop.frame2)


def _print(mech, before, assembly, singular):
    _print_inventory(mech)
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
    values = [(joint, _shown(value)) for joint, value in scene.by_joint(mech, assembly.q).items()]
    output.table(("joint", "closed configuration [rad, m]>"), values)


def _shown(value) -> str:
    values = value if isinstance(value, list) else [value]
    return " ".join(f"{each if abs(each) > NOTHING else 0.0:.9g}" for each in values)


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


def _report(mech, before, assembly, singular) -> dict:
    redundant = [
        {
            "loop": loop, "row": row,
            "depends_on": [{"loop": of, "row": name, "factor": value} for (of, name), value in combination.items()],
        }
        for (loop, row), combination in assembly.redundant.items()
    ]  # fmt: skip
    return {
        "scene": mech.name, "closed": True, "bodies": len(mech.joints), "nq": mech.nq, "nv": mech.nv,
        "actuated": mech.actuated,
        "loops": [
            {"name": loop.name, "kind": loop.kind, "ends": _ends(loop)} for loop in mech.loops
        ],
        "rows": assembly.rows, "rank": assembly.rank, "mobility": assembly.mobility, "redundant": redundant,
        "gaps_before": before, "gaps": assembly.gaps, "iterations": assembly.iterations, "moved": assembly.moved,
        "regular": not singular, "q": scene.by_joint(mech, assembly.q), **({"error": singular} if singular else {}),
    }  # fmt: skip
