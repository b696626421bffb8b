"""Closure, Jacobian and reduced dynamics of an Actuation as one C99 file, without libraries and allocation.

CasADi generates functions without branches for the rows and the equations of motion; ``motor_code.c`` has the rest: LU
factorisation, a fixed number of Newton steps, projection.

The expressions are those of joints displaced by a small motion u. Every joint has the pose T(q) E(u),
E(u) = 1 + S u + (S u)²/2. At u = 0 the first and second derivatives by u are those along the joint's velocities, so
that J = Φ_u, and J̇ v is the second derivative along v. The rows have the same zeros as those of
:mod:`pinconsist.mechanism.loops`, and the same first two derivatives there.
"""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from ..errors import InputError, MissingExtraError
from ..files import as_path, written_whole
from ..mechanism.checks import spread
from ..mechanism.forces import JointDamping, JointFriction, JointSpring, JointTorque, SpringDamper, model_forces
from ..mechanism.forces.force import label_of
from ..mechanism.joint_constraints import Coupling, Drive
from ..mechanism.lie import integrate
from ..mechanism.loops import Length, Loop, Turn
from ..mechanism.names import position_names
from ..mechanism.rows import LoopRows
from .coordinates import ENOUGH, LONGEST_MOTION, MISS

NEWTON = 5  # steps
SMALLEST = 1e-13  # pivot
OPERATIONS = {
    "ASSIGN": "{0}", "ADD": "{0} + {1}", "SUB": "{0} - {1}", "MUL": "{0} * {1}", "DIV": "{0} / {1}", "NEG": "-{0}",
    "SQ": "{0} * {0}", "TWICE": "2.0 * {0}", "INV": "1.0 / {0}", "SIN": "sin({0})", "COS": "cos({0})",
    "SQRT": "sqrt({0})", "ATAN2": "atan2({0}, {1})", "TANH": "tanh({0})", "POW": "pow({0}, {1})",
    "CONSTPOW": "pow({0}, {1})",
}  # fmt: skip


def to_c(act, file) -> Path:
    """See :meth:`Actuation.to_c`."""
    path, mechanism, chosen = as_path(file), act.mechanism, act._chosen
    if path.suffix != ".c" or not re.fullmatch(r"[A-Za-z_]\w*", path.stem, re.ASCII):
        raise InputError(f"{file}: C code is written to name.c, where name must be a valid prefix of C function names")
    if act._shared:
        raise InputError(f"{mechanism.name}: some motors depend on others; omit them: Actuation(mech, motors=[…])")
    if wide := [joint for joint in act._joints if mechanism.model.nvs[mechanism.joint_index(joint)] > 1]:
        raise InputError(f"{mechanism.name}: {wide[0]!r} has several degrees of freedom; in C motors have only one")
    counts = {"NQ": mechanism.nq, "NV": mechanism.nv, "MOTORS": len(act.motors), "LEADS": len(chosen.columns)}
    counts |= {"FREE": len(act.free), "ROWS": (rows := len(chosen.p)), "SPACE": max(1, rows), "NEWTON": NEWTON}
    numbers = {"LONGEST_MOTION": LONGEST_MOTION, "MISS": MISS, "ENOUGH": ENOUGH, "SMALLEST": SMALLEST}
    constants = [
        f"enum {{ {_listed(counts)} }};",
        f"static const double {_listed(numbers)}, sizes[] = {{{_listed(chosen.sizes)}}};",
        f"static const int lead[] = {{{_listed(chosen.columns)}}}; /* velocities of motors, then free ones */",
        f"static const int follow[] = {{{_listed(chosen.p) or 0}}};",
    ]
    words = {"NAMES_OF_MOTORS": ", ".join(act.motors), "NAMES_OF_FREE": ", ".join(act.free) or "none"}
    words |= {"NAMES_IN_Q": ", ".join(position_names(mechanism.model)), "MECHANISM": mechanism.name}
    words = {key: words[key].replace("*/", "* /") for key in words} | {"NAME": path.stem}
    words |= {"/*CONSTANTS*/": "\n".join(constants), "/*FUNCTIONS*/": "\n".join(_functions(act))}
    text = (Path(__file__).parent / "motor_code.c").read_text(encoding="utf-8")
    for key, word in words.items():
        text = text.replace(key, word)
    with written_whole(path) as stream:
        stream.write(text.encode())
    return path


def _listed(values) -> str:
    if isinstance(values, dict):
        return ", ".join(f"{key} = {value!r}" for key, value in values.items())
    return ", ".join(map(repr, np.asarray(values).tolist()))


def _functions(act):
    """The C functions that depend on the mechanism."""
    ca, chosen, symbols = casadi(), act._chosen, Symbols(act.mechanism)
    q, v, a, u, still = symbols.q, symbols.v, symbols.a, symbols.u, symbols.still
    phi = symbols.rows()[chosen.system.kept.tolist()]
    goals = ca.SX.sym("motors", chosen.n_motors)
    joints = zip((act._joints[i] for i in chosen.own), ca.vertsplit(goals), strict=True)
    way = ca.vertcat(*(-symbols.beyond(*each) for each in joints))
    forces = symbols.inverse_dynamics(v, a, act.mechanism.model.gravity.linear) - symbols.applied()
    yield _straight("rows", {"q": q}, {"phi": still(phi), "J": still(ca.jacobian(phi, u))})
    yield _straight("drift", {"q": q, "v": v}, {"drift_of_rows": still(ca.jtimes(ca.jtimes(phi, u, v), u, v))})
    yield _straight("to_go", {"q": q, "motors": goals}, {"way": still(way)})
    yield _straight("moved", {"q": q, "change": v}, {"to": symbols.moved(v)})
    yield _straight("inertia", {"q": q, "a": a}, {"forces": symbols.inverse_dynamics(0 * v, a, np.zeros(3))})
    yield _straight("bias", {"q": q, "v": v, "a": a}, {"forces": forces})


def _straight(name, inputs, outputs) -> str:
    """A C function without branches: `inputs` are columns, `outputs` are written row by row."""
    ca = casadi()
    function = ca.Function(name, [*inputs.values()], ca.cse([*outputs.values()]))
    given, made, operations = [*inputs], [*outputs], {getattr(ca, f"OP_{key}"): OPERATIONS[key] for key in OPERATIONS}
    full = [ca.DM.ones(function.sparsity_out(k)) for k in range(len(made))]
    places = [[row * each.size2() + column for row, column in zip(*each.sparsity().get_triplet(), strict=True)]
              for each in full]  # fmt: skip
    lines = [f"for (i = 0; i < {each.numel()}; ++i) {to}[i] = 0.0;" for to, each in zip(made, full, strict=True)
             if each.nnz() < each.numel()]  # fmt: skip
    kinds, space = [], [f"double w[{function.sz_w()}];", *["int i;"] * bool(lines)] * (function.n_instructions() > 0)
    for k in range(function.n_instructions()):
        kind, into, of = function.instruction_id(k), function.instruction_output(k), function.instruction_input(k)
        kinds.append((kind, of[0] if kind == ca.OP_INPUT else into[0]))
        if kind == ca.OP_CONST:
            lines.append(f"w[{into[0]}] = {function.instruction_constant(k)!r};")
        elif kind == ca.OP_INPUT:
            lines.append(f"w[{into[0]}] = {given[of[0]]}[{of[1]}];")
        elif kind == ca.OP_OUTPUT:
            lines.append(f"{made[into[0]]}[{places[into[0]][into[1]]}] = w[{of[0]}];")
        else:
            lines.append(f"w[{into[0]}] = {operations[kind].format(*(f'w[{i}]' for i in of))};")
    idle = [each for i, each in enumerate(given) if (ca.OP_INPUT, i) not in kinds]
    idle += [each for i, each in enumerate(made) if not full[i].numel()]
    heads = [f"const double *{each}" for each in given] + [f"double *{each}" for each in made]
    text = "".join(f"  {line}\n" for line in (*space, *(f"(void){each};" for each in idle), *lines))
    return f"static void {name}({', '.join(heads)}) {{\n{text}}}\n"


def casadi() -> Any:
    """The package casadi; MissingExtraError if it is not installed."""
    try:
        import casadi as ca
    except ImportError:
        raise MissingExtraError("C code needs CasADi; install it with: pip install 'pinconsist[c]'") from None
    return ca


class Symbols:
    """Expressions in ``q``, ``v`` and ``a`` of a mechanism without moving drives; InputError if one is not possible."""

    def __init__(self, mechanism):
        self.ca, self.mechanism, self.model = (ca := casadi()), mechanism, (model := mechanism.model)
        self.q = ca.SX.sym("q", model.nq)
        self.v, self.a, self.u = (ca.SX.sym(name, model.nv) for name in "vau")
        self._S, self._standing, self._on_parent = _motions(mechanism), [None], [None]  # without u, and with
        for i in range(1, model.njoints):
            shift, turn = ca.vertsplit(ca.mtimes(self._S[i], self._own(self.u, i)), 3)
            X = ca.vertcat(ca.horzcat(ca.skew(turn), shift), ca.SX(1, 4))
            moved = ca.SX.eye(4) + X + 0.5 * ca.mtimes(X, X)
            self._standing.append(ca.mtimes(model.jointPlacements[i].homogeneous, self._pose(i)))
            self._on_parent.append(ca.mtimes(self._standing[i], moved))

    def _own(self, velocities, i):
        return velocities[self.model.idx_vs[i] : self.model.idx_vs[i] + self.model.nvs[i]]

    def _numbers(self, i):
        """The numbers of a joint in q: those of its position and of its rotation; a single axis has only the latter."""
        q = self.ca.vertsplit(self.q[self.model.idx_qs[i] : self.model.idx_qs[i] + self.model.nqs[i]])
        n = int(np.abs(self._S[i][:3]).any(axis=1).sum()) if self._S[i].shape[1] > 1 else 0
        return q[:n], q[n:]

    def _pose(self, i):
        """The pose of a joint at q."""
        ca, S, (place, turn) = self.ca, self._S[i], self._numbers(i)
        shift = ca.vertcat(*place, ca.SX(3 - len(place), 1)) if len(turn) != 1 else S[:3, 0] * turn[0]
        if len(turn) == 4:
            axis, s, c = ca.skew(ca.vertcat(*turn[:3])), 2 * turn[3], 2
        else:
            c, s = turn if len(turn) == 2 else (ca.cos(*turn), ca.sin(*turn)) if turn else (1, 0)
            axis, c = ca.skew(S[3:, -1]), 1 - c
        R = ca.SX.eye(3) + s * axis + c * ca.mtimes(axis, axis)
        return ca.vertcat(ca.horzcat(R, shift), ca.DM([[0, 0, 0, 1]]))

    def moved(self, change):
        """q ⊕ change; for quaternions to first order, normalised."""
        ca, parts = self.ca, []
        for i in range(1, self.model.njoints):
            (place, turn), d = self._numbers(i), ca.vertsplit(self._own(change, i))
            moved = ca.mtimes(self._pose(i), ca.vertcat(*d[: len(place)], ca.SX(3 - len(place), 1), 1))
            parts += ca.vertsplit(moved)[: len(place)]
            if len(turn) == 1:
                parts.append(turn[0] + d[0])
            elif len(turn) == 2:
                c, s = ca.cos(d[-1]), ca.sin(d[-1])
                parts += [turn[0] * c - turn[1] * s, turn[1] * c + turn[0] * s]
            elif turn:
                axis, half = ca.vertcat(*turn[:3]), 0.5 * ca.vertcat(*d[-3:])
                turned = ca.vertcat(axis + turn[3] * half + ca.cross(axis, half), turn[3] - ca.dot(axis, half))
                parts.append(turned / ca.sqrt(ca.sumsqr(turned)))
        return ca.vertcat(*parts)

    def beyond(self, joint, target=0.0):
        """The distance of a joint from a target, the shorter way round if it stores (cos, sin)."""
        i, ca = self.model.getJointId(joint), self.ca
        turn, u = self._numbers(i)[1], self._own(self.u, i) - target
        if len(turn) == 1:
            return turn[0] + u
        c, s = ca.cos(u), ca.sin(u)
        return ca.atan2(turn[1] * c + turn[0] * s, turn[0] * c - turn[1] * s)

    def _seen(self, *ends):
        """The poses of places on joints, pairs (joint, pin.SE3), relative to the last joint that carries both."""
        common, poses = max(set.intersection(*(set(self.model.supports[joint]) for joint, _ in ends))), []
        for joint, place in ends:
            pose = self.ca.SX(place.homogeneous)
            while joint != common:
                joint, pose = self.model.parents[joint], self.ca.mtimes(self._on_parent[joint], pose)
            poses.append(pose)
        return poses

    def rows(self):
        """Φ of all rows, in q and u."""
        return self.ca.vertcat(self.ca.SX(0, 1), *map(self._rows, LoopRows.of(self.mechanism).closures))

    def _rows(self, closure):
        ca, loop = self.ca, closure.loop
        if isinstance(loop, Drive):
            return self.beyond(loop.joint, loop.curve(0.0))
        if isinstance(loop, Coupling):
            powers = enumerate((loop.offset, loop.ratio, *loop.higher))
            other = sum(share * self.beyond(joint) for joint, share in loop.shares[1].items())
            law = sum(factor * other**k for k, factor in powers)
            if isinstance(loop.joint, str):
                return self.beyond(loop.joint, law)
            return sum(share * self.beyond(joint) for joint, share in loop.joint.items()) - law
        if not isinstance(loop, Loop):
            raise InputError(f"{self.mechanism.name}: {loop.name!r} is a Python function and cannot be converted to C")
        one, two = self._seen((closure.joint1, closure.place1), (closure.joint2, closure.place2))
        d, R = (ca.mtimes(one[:3, :3].T, each) for each in (two[:3, 3] - one[:3, 3], two[:3, :3]))
        if isinstance(closure.place, Length):
            return (ca.sumsqr(d) / closure.place.length - closure.place.length) / 2
        rows, turn = [ca.mtimes(closure.place.directions, d)], closure.turn
        if isinstance(turn, Turn):
            rows.append(ca.inv_skew((R - R.T) / 2))
        elif turn is not None:
            rows.append(ca.mtimes([turn.directions, R, turn.axis2]))
        return ca.vertcat(*rows)

    def inverse_dynamics(self, v, a, gravity):
        """Inertial forces and weights, (nv,), as by Pinocchio's ``rnea``."""
        ca, model, ways = self.ca, self.model, [None]
        motions, forces, tau = [(ca.SX(6, 1), ca.vertcat(-gravity, ca.SX(3, 1)))], [None], []
        for i in range(1, model.njoints):
            R, (speed, rate) = self._standing[i][:3, :3].T, motions[model.parents[i]]
            ways.append(self._blocks(R, -ca.mtimes(R, ca.skew(self._standing[i][:3, 3]))))
            moving, pushed = (ca.mtimes(self._S[i], self._own(each, i)) for each in (v, a))
            speed = ca.mtimes(ways[i], speed) + moving
            turn = self._blocks(*map(ca.skew, ca.vertsplit(speed, 3)[::-1]))
            rate = ca.mtimes(ways[i], rate) + pushed + ca.mtimes(turn, moving)
            motions.append((speed, rate))
            inertia = pin.Inertia(model.inertias[i]).matrix()
            forces.append(ca.mtimes(inertia, rate) - ca.mtimes([turn.T, inertia, speed]))
        for i in range(model.njoints - 1, 0, -1):
            tau.insert(0, ca.mtimes(self._S[i].T, forces[i]))
            if (parent := model.parents[i]) > 0:
                forces[parent] += ca.mtimes(ways[i].T, forces[i])
        return ca.vertcat(*tau) + model.armature * a

    def _blocks(self, turning, shifting):
        return self.ca.blockcat([[turning, shifting], [self.ca.SX(3, 3), turning]])

    def applied(self):
        """τ of the mechanism's forces at q and v; InputError for a force without an expression."""
        ca, total = self.ca, self.ca.SX(self.model.nv, 1)
        for force in (*model_forces(self.model), *self.mechanism.forces):
            if isinstance(force, JointDamping | JointFriction):
                size = spread(self.model, force.coefficients, "C", alike=True)
                total -= size * (self.v if isinstance(force, JointDamping) else ca.tanh(self.v / force.width))
            elif isinstance(force, JointSpring) and force.plain:
                total -= self._pull(self.beyond(force.joint, force.rest), force.stiffness)
            elif isinstance(force, SpringDamper):
                places = [(joint, pin.SE3(np.eye(3), offset)) for joint, offset in force.bind(self.model).ends]
                one, two = self._seen(*places)
                length = ca.norm_2(two[:3, 3] - one[:3, 3])
                total -= self._pull(length - force.length, force.stiffness, force.damping)
            elif isinstance(force, JointTorque) and not (law := force.bind(self.model))._curves:
                total += law._constant
            else:
                label = label_of(force)
                raise InputError(f"{self.mechanism.name}: the force {label!r} cannot be converted to C; omit it")
        return self.still(total)

    def _pull(self, beyond, stiffness, damping=0.0):
        along = self.ca.jacobian(beyond, self.u)
        return along.T * (stiffness * beyond + damping * self.ca.mtimes(along, self.v))

    def still(self, expression):
        """The expression at u = 0."""
        return self.ca.substitute(expression, self.u, self.ca.DM.zeros(self.model.nv))


def _motions(mechanism):
    """The body velocities for unit velocities of each joint, (6, n); InputError if they depend on q."""
    model, found = mechanism.model, []
    for q in (pin.neutral(model), integrate(model, pin.neutral(model), np.linspace(0.3, 1.1, model.nv))):
        data = model.createData()
        pin.computeJointJacobians(model, data, q)
        found.append([np.reshape(joint.S, (6, -1)) if i else None for i, joint in enumerate(data.joints)])
    for joint, one, other in zip(list(model.names)[1:], found[0][1:], found[1][1:], strict=True):
        if not np.array_equal(one, other):
            raise InputError(
                f"{mechanism.name}: joint {joint!r} cannot be converted to C, as its axes move relative to each other"
            )
    return found[0]
