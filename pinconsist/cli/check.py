"""`pinconsist models` and `pinconsist check`: the available scenes, and the description of a scene."""

from dataclasses import fields

import pinconsist as pc

from ..errors import AssemblyError, MissingExtraError, SingularSystemError
from . import output, scene

LINES, TERMS = 12, 4  # largest numbers of redundant rows shown, and of the rows that each depends on
LOOP_FIELDS = ("xyz1", "rpy1", "xyz2", "rpy2", "axis", "axis2", "length", "joint", "other", "ratio", "offset", "higher")
"""Fields with the geometry of loops and couplings; zero anchors are left out."""


def models(as_json: output.Json = False) -> int:
    """List the built-in scenes, the families of scenes, and the robots that are installed.

    Example: pinconsist models
    """
    from ..formats.catalogue import ROBOTS
    from ..paper.problems import PROBLEMS

    scenes, robots = pc.models(), [name for name in ROBOTS if _is_installed(name)]
    if as_json:
        output.print_json({"models": scenes, "robots": robots, "problems": list(PROBLEMS)})
        return output.FINE
    output.table(("scene", "description"), scenes.items())
    print("<n> stands for a number of your choice, as in chain_16\n")
    if robots:
        print("robots of the pip package example-robot-data, which is installed:")
        output.paragraph(", ".join(robots), indent="  ")
    if missing := [name for name in ROBOTS if name not in robots]:
        print("robots that are available after: pip install 'pinconsist[robots]'")
        output.paragraph(", ".join(missing), indent="  ")
    print()
    output.paragraph(f"only for compare: {' and '.join(PROBLEMS)}, whose solutions are known in closed form")
    return output.FINE


def _is_installed(robot) -> bool:
    from ..formats.catalogue import robot_file

    try:
        robot_file(robot)
    except MissingExtraError:
        return False
    return True


@scene.loads_scene
def check(source: scene.Scene, as_json: output.Json = False) -> int:
    """Describe a scene: bodies, loops, rank, redundant rows, mobility, and its closed configuration.

    --at sets the position. At a singular configuration more rows are dependent, the
    mobility is larger, and the exit code is 2.

    Example: pinconsist check four_bar --at crank=pi/2
    """
    from ..mechanism.closing import LoopSolver, held_motors
    from ..mechanism.correction import rounding_of
    from ..mechanism.names import by_joint
    from ..mechanism.rank import require_nonsingular
    from ..mechanism.system import MechanismSystem

    mech, q0 = source.load(), source.at
    guess = mech.configuration(q0, base=mech.guess)
    solver = LoopSolver(mech)
    before = solver.gaps(guess)
    try:
        assembly = scene.assembled(mech, q0)
    except AssemblyError as error:
        return _report_open(mech, before, solver.gaps(error.q), error, as_json)
    singular, held = "", held_motors(mech, assembly.q)
    weak = solver.ranking(assembly.q).weak(mech.row_labels)
    better = rounding_of(mech) if weak or not assembly.mobility else None
    without = better.mobility if better else assembly.mobility + len(weak)
    try:
        require_nonsingular(MechanismSystem(mech, assembly.q), assembly.q)
    except SingularSystemError as error:
        singular = str(error)
    warnings = scene.scene_warnings(mech, assembly)
    if as_json:
        output.print_json({
            "scene": mech.name, "closed": True, **_inventory(mech),
            "rows": assembly.rows, "rank": assembly.rank, "mobility": assembly.mobility,
            "redundant": [
                {"loop": loop, "row": row, "depends_on": [
                    {"loop": of, "row": name, "factor": factor} for (of, name), factor in combination.items()
                ]}
                for (loop, row), combination in assembly.redundant.items()
            ],
            "gaps_before": before, "gaps": assembly.gaps, "iterations": assembly.iterations, "moved": assembly.moved,
            "regular": not singular, "held_motors": held, "corrected_by": mech.corrected_by,
            "weak": [{"loop": loop, "row": row, "by": by} for (loop, row), by in weak.items()],
            "mobility_without_weak": without,
            "guess": by_joint(mech, guess), "q": by_joint(mech, assembly.q),
            **({"error": singular} if singular else {}), "warnings": warnings,
        })  # fmt: skip
    else:
        _print(mech, guess, before, assembly, singular, held, weak, without)
    if singular:
        output.print_error(singular)
    return output.WRONG_INPUT if singular else output.FINE


def _report_open(mech, before, after, error, as_json) -> int:
    from ..mechanism.names import by_joint

    if as_json:
        output.print_json({
            "scene": mech.name, "closed": False, "error": str(error), "gaps_before": before, "gaps": after,
            "q": by_joint(mech, error.q),
        })  # fmt: skip
    else:
        _print_inventory(mech)
        worst_first = sorted(after.items(), key=lambda item: -item[1])
        rows = [(name, before[name], gap) for name, gap in worst_first]
        output.table(("loop", "gap at the guess [m, rad]>.3g", "remaining gap [m, rad]>.3g"), rows)
    output.print_error(error)
    return output.WRONG_INPUT


def _print(mech, guess, before, assembly, singular, held, weak, without):
    from ..mechanism.names import position_names

    _print_inventory(mech)
    if mech.corrected_by:
        print(f"lengths and angles corrected by up to {mech.corrected_by:.1e} m or rad")
    if mech.loops:
        print(f"rows: {assembly.rows}, {assembly.rank} of them independent and {len(assembly.redundant)} redundant")
    print(f"mobility: {assembly.mobility}")
    if weak or without != assembly.mobility:
        rows = output.first([f"({loop} {row}) {by:.1e}" for (loop, row), by in weak.items()], TERMS, "and {} more")
        on = f"rows that are independent by less than 1e-6 m or rad: {', '.join(rows)}" if weak else "rounding"
        output.paragraph(f"depends on {on}; without them it would be {without}", indent="  ", hanging="    ")
    if held:
        output.paragraph(f"motors that cannot move independently: {', '.join(held)}", indent="  ", hanging="    ")
    for line in _redundant_lines(assembly.redundant):
        output.paragraph(line, indent="  ", hanging="    ")
    if mech.loops:
        for when, gaps in (("at the guess:", before), ("when closed: ", assembly.gaps)):
            worst = max(gaps, key=gaps.get)
            print(f"largest gap {when} {output.size(gaps[worst], '.3g')} m or rad, in loop {worst!r}")
        iterations, moved = output.counted(assembly.iterations, "iteration"), output.size(assembly.moved, ".3g")
        print(f"closing took {iterations} and moved no joint by more than {moved} rad or m")
    print(f"equations of motion: {'singular, see below' if singular else 'regular'}\n")
    rows = list(zip(position_names(mech.model), guess, assembly.q, strict=True))
    output.table(("joint [rad, m]", "guess>.9g", "closed>.9g"), rows)


def _redundant_lines(redundant) -> list[str]:
    """The redundant rows as text: zero rows by loop, the others as combinations; shortened."""
    zero, lines = {}, []
    for (loop, row), combination in redundant.items():
        if combination:
            terms = sorted(combination.items(), key=lambda item: -abs(item[1]))
            texts = [f"{value:+.3g}·({of} {name})" for (of, name), value in terms]
            lines.append(f"redundant: ({loop} {row}) = {' '.join(output.first(texts, TERMS, 'and {} more'))}")
        else:
            zero.setdefault(loop, []).append(row)
    lines[:0] = [f"redundant: ({loop} {', '.join(rows)}) = 0 for every motion" for loop, rows in zero.items()]
    return output.first(lines, LINES)


def _print_inventory(mech):
    from ..mechanism.forces import Actuator

    about, masses = _inventory(mech), [inertia.mass for inertia in list(mech.model.inertias)[1:]]
    bodies = output.counted(about["bodies"], "moving body")
    print(f"{mech.name}: {bodies}, {sum(masses):.4g} kg in all, nq = {mech.nq}, nv = {mech.nv}")
    if massless := [joint for joint, mass in zip(mech.joints, masses, strict=True) if mass == 0.0]:
        output.paragraph(f"bodies without mass, at joints: {', '.join(massless)}", hanging="  ")
    if actuators := [force for force in mech.forces if isinstance(force, Actuator)]:
        commands = [f"{f.control:.4g}" if not callable(f.control) else "of time" for f in actuators]
        pairs = zip(actuators, commands, strict=True)
        acting = ", ".join(f"{force.name} on {' and '.join(force.arms)} (command {at})" for force, at in pairs)
        output.paragraph(f"actuators: {acting}; --control ACTUATOR=VALUE sets a command", hanging="  ")
    if mech.actuated:
        output.paragraph(f"motors: {', '.join(mech.actuated)}", hanging="  ")
    output.paragraph(f"forces: {', '.join(about['forces']) or 'none'}", hanging="  ")
    if mech.ignored:
        output.paragraph(f"without effect: {', '.join(mech.ignored)}", hanging="  ")
    gravity = about["gravity"]
    print(f"gravity: {f'{scene.text(gravity)} m/s²' if gravity.any() else 'none'}; duration: {mech.duration:g} s\n")
    if mech.loops:
        rows = []
        for loop in mech.loops:
            shown = {name: value for name, value in _fields(loop).items() if name not in ("joint", "other") and value}
            rows.append((loop.name, loop.kind, len(loop.rows), *_ends(loop), _shown(shown)))
        output.table(("loop", "kind", "rows>", "connects", "to", "with"), rows)
    else:
        print("loops: none (a plain tree); a loop file next to it, or --loops FILE, adds loops\n")
    if mech.contacts:
        rows = [(record.pop("name"), record.pop("kind"), _shown(record)) for record in about["contacts"]]
        output.table(("contact", "kind", "with"), rows)


def _shown(values) -> str:
    """The fields of a record in one line."""
    return ", ".join(
        f"{name} {value if isinstance(value, str) else scene.text(value)}" for name, value in values.items()
    )


def _inventory(mech) -> dict:
    from ..formats.records import contact_entries
    from ..mechanism.forces import bound_forces

    return {
        "bodies": len(mech.joints), "nq": mech.nq, "nv": mech.nv, "actuated": mech.actuated,
        "forces": list(bound_forces(mech.model, mech.forces)), "gravity": mech.model.gravity.linear,
        "duration": mech.duration, "ignored": mech.ignored,
        "loops": [
            {"name": loop.name, "kind": loop.kind, "ends": _ends(loop), "rows": loop.rows} | _fields(loop)
            for loop in mech.loops
        ],
        "contacts": contact_entries(mech),
    }  # fmt: skip


def _ends(loop):
    """The two ends of a loop: two frames, two joints, a joint and its drive, or a user-defined function."""
    if loop.kind == "drive":
        return loop.joint, "along a curve"
    if loop.kind == "coupling":
        return loop.joints
    return ("a function", "") if loop.kind == "constraint" else (loop.frame1, loop.frame2)


def _fields(loop) -> dict:
    """The fields that define a loop, by their names in a loop file."""
    from ..mechanism.curve import Curve
    from ..mechanism.joint_constraints import Drive
    from ..mechanism.motion import Motion

    record = loop.curve if isinstance(loop, Drive) and isinstance(loop.curve, Motion | Curve) else loop
    values = {each.name: getattr(record, each.name) for each in fields(record)}
    if record is loop:
        values = {name: values[name] for name in LOOP_FIELDS if name in values}
    return {name: value for name, value in values.items() if value not in (None, (), (0.0, 0.0, 0.0))}
