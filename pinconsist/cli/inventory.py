"""What a scene holds, as it was read: bodies, loops, forces."""

from __future__ import annotations

from dataclasses import fields

from . import output

SHOWN = ("xyz1", "rpy1", "xyz2", "rpy2", "axis", "axis2", "length", "joint", "other", "ratio", "offset", "higher")
"""Fields of loops and couplings that say where and along what they hold; zero anchors are left out."""


def print_inventory(mech):
    """Bodies, motors, forces and loops for a person."""
    from ..mechanism.forces import bound_forces

    mass = sum(inertia.mass for inertia in list(mech.model.inertias)[1:])
    count = output.counted(len(mech.joints), "moving body").replace("bodys", "bodies")
    print(f"{mech.name}: {count}, {mass:.4g} kg in all, nq = {mech.nq}, nv = {mech.nv}")
    massless = [n for n, body in zip(mech.joints, list(mech.model.inertias)[1:], strict=True) if body.mass == 0.0]
    if massless:
        output.paragraph(f"bodies without mass, at joints: {', '.join(massless)}", hanging="  ")
    if mech.actuated:
        output.paragraph(f"motors: {', '.join(mech.actuated)}", hanging="  ")
    output.paragraph(f"forces: {', '.join(bound_forces(mech.model, mech.forces)) or 'none'}", hanging="  ")
    gravity = mech.model.gravity.linear
    print(f"gravity: {f'{_text(gravity)} m/s²' if gravity.any() else 'none'}; duration: {mech.duration:g} s\n")
    if mech.loops:
        rows = [(loop.name, loop.kind, len(loop.rows), *ends(loop), _told(loop)) for loop in mech.loops]
        output.table(("loop", "kind", "rows>", "joins", "and", "by"), rows, width=output.PLAIN_WIDTH)
    else:
        print("loops: none, a plain tree; a loop file beside it, or --loops FILE, closes some\n")


def inventory(mech) -> dict:
    """The same for JSON."""
    from ..mechanism.forces import bound_forces

    return {
        "bodies": len(mech.joints), "nq": mech.nq, "nv": mech.nv, "actuated": mech.actuated,
        "forces": list(bound_forces(mech.model, mech.forces)), "gravity": mech.model.gravity.linear,
        "duration": mech.duration,
        "loops": [
            {"name": loop.name, "kind": loop.kind, "ends": ends(loop), "rows": loop.rows} | _fields(loop)
            for loop in mech.loops
        ],
    }  # fmt: skip


def ends(loop):
    """What a loop joins: two frames, a joint and its drive, two joints, or what a function of the user's says."""
    if loop.kind == "drive":
        return loop.joint, "along a curve"
    if loop.kind == "coupling":
        return loop.joint, loop.other
    return ("a function", "") if loop.kind == "constraint" else (loop.frame1, loop.frame2)


def _fields(loop) -> dict:
    """The fields that say how a loop holds, by the names they have in a loop file."""
    from ..mechanism.constraints.motion import Motion

    record = loop.curve if isinstance(getattr(loop, "curve", None), Motion) else loop
    given = {each.name: getattr(record, each.name) for each in fields(record)}
    wanted = given if record is not loop else {name: given[name] for name in SHOWN if name in given}
    return {name: value for name, value in wanted.items() if value not in (None, (), (0.0, 0.0, 0.0))}


def _told(loop) -> str:
    """Like "axis 0 1 0, xyz2 0.2 0 0"; what the columns beside it say already is left out."""
    parts = {name: value for name, value in _fields(loop).items() if name not in ("joint", "other") and value != 0.0}
    return ", ".join(f"{name} {_text(value)}" for name, value in parts.items())


def _text(value) -> str:
    return f"{value:.4g}" if isinstance(value, int | float) else " ".join(f"{each:.4g}" for each in value)
