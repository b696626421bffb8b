"""`pinconsist sensitivity`."""

from dataclasses import replace
from typing import Annotated

import pinconsist as pc

from ..errors import InputError
from . import output, scene
from .scene import QUANTITY, Texts, option

RELATIVE_CHANGE = 0.01  # relative change of a parameter
KINDS = ("mass", "length", "anchor", "stiffness", "damping", "friction", "gravity")


@scene.loads_scene
def sensitivity(
    source: scene.Scene,
    of: Annotated[str, option(
        "--of", "QUANTITY", "A frame (its position), a joint, a loop (its multipliers) at the end of the run; or, in "
        f"quotes, {QUANTITY}.")] = "",
    to: Annotated[Texts, option(
        "--to", "NAME ...", "The parameters: all of a kind (mass, length, anchor, stiffness, damping, friction, "
        "gravity), or by name, such as mass:coupler or motor.speed.")] = None,
    start: scene.From = 0.0,
    until: scene.Until = None,
    with_velocity: scene.WithVelocity = None,
    rtol: scene.Rtol = 1e-7,
    atol: scene.Atol = 1e-9,
    as_json: output.Json = False,
) -> int:  # fmt: skip
    """Simulate a scene, and print the effect of its parameters at the end of the run.

    Each parameter has a row: its value, the derivatives of the quantity with respect
    to it, and the change of the quantity if the parameter increases by one percent.
    Lengths that would open a redundant loop are listed and left out.

    Example: pinconsist sensitivity jansen_leg --of foot --to mass length --until 0.3
    """
    if not of or not to:
        raise InputError(
            "--of NAME (a frame, joint or loop; or a quantity) and --to NAME ..., as --to mass, are needed"
        )
    q0, v0 = ({name: value[0] if len(value) == 1 else value for name, value in values.items()}
              for values in (source.at, scene.joint_values(with_velocity, "--with-velocity")))  # fmt: skip
    mech = source.load()
    import numpy as np

    from ..mechanism.parameters import about_length, names_of
    from ..run.quantities import Quantity

    quantity = Quantity.of(of, mech)
    if not quantity.statistic:
        quantity = replace(quantity, statistic="final")
    names = [name for one in to for name in (names_of(mech, one) if one in KINDS else [one])]
    if not names:
        raise InputError(f"{mech.name} has no parameters of the kind {' '.join(to)}")
    until = start + mech.duration if until is None else until
    options: dict = {"rtol": rtol, "atol": atol}
    options |= {"t_eval": [until]} if quantity.statistic == "final" else {}
    with output.doing(f"the run, and its derivatives by {output.counted(len(names), 'parameter')}"):
        found, refused = _without_refused(mech, names, (start, until), q0 or None, v0 or None, options)
        value, by = quantity.value(found.solution), found.of(quantity)
    labels = quantity.labels(found.solution)
    rows = [
        {"parameter": name, "about": about_length(mech, name), "value": own, "derivatives": each}
        | {"percent": RELATIVE_CHANGE * abs(own) * np.linalg.norm(each)}
        for name, own, each in zip(found.names, found.values, np.atleast_2d(by).T, strict=True)
    ]
    if as_json:
        about = {"scene": mech.name, "of": of, "t": until, "quantities": labels, "values": np.atleast_1d(value)}
        output.print_json({**about, "rows": rows, "refused": refused})
        return output.FINE
    rows.sort(key=lambda row: -row["percent"])
    named = [f"{row['parameter']} ({row['about']})" if row["about"] else row["parameter"] for row in rows]
    cells = [(name, row["value"], *row["derivatives"], row["percent"]) for name, row in zip(named, rows, strict=True)]
    heads = ("parameter", "value>.6g", *(f"d {label}>.4e" for label in labels), "by 1 %>.2e")
    for name, why in refused.items():
        output.paragraph(f"left out: {name}: {why}", hanging="  ")
    when = f" at t = {until:g} s" if quantity.statistic == "final" else "" if quantity.time else f" to t = {until:g} s"
    numbers = ", ".join(output.size(each) for each in np.atleast_1d(value))
    output.table(heads, cells, title=f"{of} of {mech.name}{when} is {numbers}; its change with each parameter")
    return output.FINE


def _without_refused(mech, names, span, q0, v0, options):
    """The sensitivities to all parameters that can be varied, and the reasons why others cannot."""
    refused: dict[str, str] = {}
    while True:
        left = [name for name in names if name not in refused]
        try:
            return pc.sensitivities(mech, left, span, q0, v0, **options), refused
        except InputError as error:
            why = str(error)
            whose = [name for name in left if f"parameter {name!r}" in why]
            if len(whose) != 1 or "loop" not in why or len(left) == 1:
                raise
            refused[whose[0]] = why
