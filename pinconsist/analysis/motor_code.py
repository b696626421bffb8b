"""Closure, Jacobian and reduced dynamics of an Actuation as one C99 file, without libraries and allocation.

``motor_code.c`` has all functions: kinematics, rows of loops and couplings, inverse dynamics, LU factorisation, a fixed
number of Newton steps, projection. They are written once, for any mechanism; this module writes the tables of numbers
on which they work.

The rows have the same zeros as those of :mod:`pinconsist.mechanism.loops`, and the same first two derivatives there.
"""

import re
import textwrap
from pathlib import Path

import numpy as np
import pinocchio as pin

from ..errors import InputError
from ..files import as_path, written_whole
from ..mechanism.checks import spread
from ..mechanism.forces import JointDamping, JointFriction, JointSpring, JointTorque, SpringDamper, model_forces
from ..mechanism.forces.force import label_of
from ..mechanism.joint_constraints import TURN, Drive, JointConstraint
from ..mechanism.lie import integrate
from ..mechanism.loops import Length, Loop, RotationVector
from ..mechanism.names import position_names
from ..mechanism.rows import LoopRows
from .coordinates import ENOUGH, LONGEST_MOTION, MISS

NEWTON = 5  # steps
SMALLEST = 1e-13  # pivot
FORCES = "JointSpring joint_springs[]", "Friction frictions[]", "SpringDamper springs[]"


def to_c(act, file) -> Path:
    """See :meth:`Actuation.to_c`."""
    path, mechanism = as_path(file), act.mechanism
    if path.suffix != ".c" or not re.fullmatch(r"[A-Za-z_]\w*", path.stem, re.ASCII):
        raise InputError(f"{file}: C code is written to name.c, where name must be a valid prefix of C function names")
    if act._shared:
        raise InputError(f"{mechanism.name}: some motors depend on others; omit them: Actuation(mech, motors=[…])")
    if wide := [joint for joint in act._joints if mechanism.model.nvs[mechanism.joint_index(joint)] > 1]:
        raise InputError(f"{mechanism.name}: {wide[0]!r} has several degrees of freedom; in C motors have only one")
    names = {"MOTORS": act.motors, "Q": position_names(mechanism.model), "FREE": act.free or ["none"]}
    words = {f"NAMES_OF_{key}": _wrapped(" " * 15, names[key], "").lstrip() for key in names}
    words["MECHANISM"] = mechanism.name
    words = {key: words[key].replace("*/", "* /") for key in words} | {"NAME": path.stem}
    words["/*TABLES*/"] = "\n".join(_tables(act))
    text = (Path(__file__).parent / "motor_code.c").read_text(encoding="utf-8")
    for key, word in words.items():
        text = text.replace(key, word)
    with written_whole(path) as stream:
        stream.write(text.encode())
    return path


def _tables(act):
    """The lines of C with the numbers of the mechanism."""
    mechanism, chosen, model = act.mechanism, act._chosen, act.mechanism.model
    tables = _joints(mechanism) | _rows(mechanism, chosen.system.kept) | _forces(mechanism)
    tables |= {"double sizes[]": chosen.sizes.tolist(), "double gravity[]": model.gravity.linear.tolist()}
    tables["int motor[]"] = [mechanism.joint_index(act._joints[i]) for i in chosen.own]
    tables |= {"int lead[]": chosen.columns.tolist(), "int follow[]": chosen.p.tolist()}
    counts = {"NV": model.nv, "NQ": model.nq, "MOTORS": len(act.motors), "LEADS": len(chosen.columns)}
    counts |= {"FREE": len(act.free), "ROWS": (rows := len(chosen.p)), "SPACE": max(1, rows), "NEWTON": NEWTON}
    for declared in ("Joint joints[]", "Loop loops[]", "Coupling couplings[]", *FORCES):
        counts[declared.split()[1].removesuffix("[]").upper()] = len(tables[declared])
    numbers = {"LONGEST_MOTION": LONGEST_MOTION, "MISS": MISS, "ENOUGH": ENOUGH, "SMALLEST": SMALLEST, "WHOLE": TURN}
    yield from (f"enum {{ {name} = {count} }};" for name, count in counts.items())
    yield from (f"static const double {name} = {number!r};" for name, number in numbers.items())
    for declared, elements in tables.items():
        plain = not any(isinstance(each, list) for each in elements)
        if plain or not elements:
            yield _wrapped(f"static const {declared} = {{", [repr(each) for each in elements] or ["0"], "};")
        else:
            yield f"static const {declared} = {{"
            yield from (_wrapped("  {", _words(each), "},") for each in elements)
            yield "};"


def _wrapped(opening, words, closing) -> str:
    return textwrap.fill(opening + ", ".join(words) + closing, 120, subsequent_indent="    ", break_on_hyphens=False)


def _words(element):
    """The members of a C initialiser."""
    return [f"{{{', '.join(_words(each))}}}" if isinstance(each, list) else str(each) for each in element]


def _joints(mechanism):
    model, joints, axes = mechanism.model, [], []
    for i, S in enumerate(motions(mechanism)):
        placement, inertia = model.jointPlacements[i], model.inertias[i]
        places = int(np.abs(S[:3]).any(axis=1).sum()) if S.shape[1] > 1 else 0
        where = [model.parents[i], model.idx_qs[i], model.idx_vs[i], S.shape[1], places, model.nqs[i] - places]
        body = [inertia.mass, inertia.lever.tolist(), inertia.inertia.ravel().tolist()]
        joints.append([*(where if i else [0] * 6), *_pose(placement), *(body if i else [0.0, [0.0], [0.0]])])
        axes += S.T.tolist()
    return {"Joint joints[]": joints, "double axes[][6]": axes, "double armature[]": model.armature.tolist()}


def _pose(placement):
    return [placement.rotation.ravel().tolist(), placement.translation.tolist()]


def _place(joint, placement):
    return [joint, *_pose(placement)]


def _rows(mechanism, kept):
    """The kept rows: those of loops, then those of couplings and of drives, which stand still."""
    rows, kept = LoopRows.of(mechanism), set(kept.tolist())
    loops, loop_rows, couplings, shares, laws = [], [], [], [], []
    for closure in rows.closures:
        loop, start = closure.loop, rows.slices[closure.loop.name].start
        own = [i for i in range(len(closure.turns)) if start + i in kept]
        if not isinstance(loop, Loop | JointConstraint):
            raise InputError(f"{mechanism.name}: {loop.name!r} is a Python function and cannot be converted to C")
        if isinstance(loop, Loop) and own:
            first = len(loop_rows)
            places = [_place(closure.joint1, closure.place1), _place(closure.joint2, closure.place2)]
            its_rows, axis2, length = _rows_of(closure)
            loop_rows += [row for i, row in enumerate(its_rows) if i in own]
            loops.append([places, axis2.tolist(), length, first, len(loop_rows)])
        elif own:
            ends, law = _law(loop)
            first, middle = len(shares), len(shares) + len(ends[0])
            shares += [[mechanism.joint_index(joint), share] for end in ends for joint, share in end.items()]
            couplings.append([first, middle, len(shares), len(laws), len(laws) + len(law), closure.period or 0.0])
            laws += law
    return {
        "Loop loops[]": loops, "Row loop_rows[]": loop_rows, "Coupling couplings[]": couplings,
        "Share shares[]": shares, "double laws[]": laws,
    }  # fmt: skip


def _rows_of(closure):
    """The kind and the direction of each row of a loop, the axis of body 2, and the length."""
    position, rotation = closure.translation, closure.rotation
    axis2, length = np.zeros(3), 1.0
    if isinstance(position, Length):
        rows, length = [["LENGTH", [0.0]]], position.length
    else:
        rows = [["ALONG", each] for each in position.directions.tolist()]
    if isinstance(rotation, RotationVector):
        rows += [["TURN", each] for each in np.eye(3).tolist()]
    elif rotation is not None:
        rows += [["TILT", each] for each in rotation.directions.tolist()]
        axis2 = rotation.axis2
    return rows, axis2, length


def _law(loop):
    """Joint → share on both sides of a coupling, and the coefficients of its polynomial; a drive stands still."""
    if isinstance(loop, Drive):
        return ({loop.joint: 1.0}, {}), [float(loop.curve(0.0))]
    return loop.shares, [loop.offset, loop.ratio, *loop.higher]


def _forces(mechanism):
    """The forces of the mechanism; InputError for one that has no C."""
    model, found = mechanism.model, {declared: [] for declared in FORCES}
    damping, torque = np.zeros(model.nv), np.zeros(model.nv)
    for force in (*model_forces(model), *mechanism.forces):
        if isinstance(force, JointDamping):
            damping += spread(model, force.coefficients, "C", alike=True)
        elif isinstance(force, JointFriction):
            sizes = spread(model, force.coefficients, "C", alike=True).tolist()
            found["Friction frictions[]"] += [[k, size, force.width] for k, size in enumerate(sizes) if size]
        elif isinstance(force, JointSpring) and force.plain and model.nvs[i := mechanism.joint_index(force.joint)] == 1:
            found["JointSpring joint_springs[]"].append([i, force.stiffness, force.rest])
        elif isinstance(force, SpringDamper):
            places = [_place(joint, pin.SE3(np.eye(3), point)) for joint, point in force.bind(model).ends]
            found["SpringDamper springs[]"].append([places, force.stiffness, force.length, force.damping])
        elif isinstance(force, JointTorque) and (constant := force.bind(model).constant) is not None:
            torque += constant
        else:
            raise InputError(f"{mechanism.name}: the force {label_of(force)!r} cannot be converted to C; omit it")
    return found | {"double damping[]": damping.tolist(), "double torque[]": torque.tolist()}


def motions(mechanism):
    """The body velocities for unit velocities of each joint, (6, n); InputError if they depend on q."""
    model, found = mechanism.model, []
    for q in (pin.neutral(model), integrate(model, pin.neutral(model), np.linspace(0.3, 1.1, model.nv))):
        data = model.createData()
        pin.computeJointJacobians(model, data, q)
        found.append([np.reshape(joint.S, (6, -1)) if i else np.zeros((6, 0)) for i, joint in enumerate(data.joints)])
    for joint, one, other in zip(list(model.names)[1:], found[0][1:], found[1][1:], strict=True):
        if not np.array_equal(one, other):
            raise InputError(
                f"{mechanism.name}: joint {joint!r} cannot be converted to C, as its axes move relative to each other"
            )
    return found[0]
