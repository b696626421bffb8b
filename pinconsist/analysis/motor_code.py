"""Closure, Jacobian and reduced dynamics of an Actuation as one C99 file, without libraries and allocation.

CasADi generates functions without branches for the rows and the equations of motion; ``motor_code.c`` has the rest: LU
factorisation, a fixed number of Newton steps, projection.
"""

import re
from pathlib import Path

import numpy as np

from ..errors import InputError
from ..files import written_whole
from ..mechanism.names import position_names
from .coordinates import ENOUGH, LONGEST, MISS
from .symbolic import Symbols, casadi

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
    path, mechanism, chosen = Path(file), act.mechanism, act._chosen
    if path.suffix != ".c" or not re.fullmatch(r"[A-Za-z_]\w*", path.stem, re.ASCII):
        raise InputError(f"{file}: C code is written to name.c, where name must be a valid prefix of C function names")
    if act._shared:
        raise InputError(f"{mechanism.name}: some motors depend on others; omit them: Actuation(mech, motors=[…])")
    if wide := [joint for joint in act._joints if mechanism.model.nvs[mechanism.joint_index(joint)] > 1]:
        raise InputError(f"{mechanism.name}: {wide[0]!r} has several degrees of freedom; in C motors have only one")
    counts = {"NQ": mechanism.nq, "NV": mechanism.nv, "MOTORS": len(act.motors), "LEADS": len(chosen.columns)}
    counts |= {"FREE": len(act.free), "ROWS": (rows := len(chosen.p)), "SPACE": max(1, rows), "NEWTON": NEWTON}
    numbers = {"LONGEST": LONGEST, "MISS": MISS, "CLOSED": ENOUGH, "SMALLEST": SMALLEST}
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
