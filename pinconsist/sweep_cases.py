"""What `pinconsist sweep --vary` says: the cases, and what each of their numbers changes in a scene or a run."""

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, field
from decimal import Decimal, InvalidOperation

import numpy as np

from .errors import InputError
from .mechanism.mechanism import Mechanism
from .mechanism.parameters import UnknownParameterError, parameter, unknown

MOST = 1_000_000
DISTRIBUTIONS = {"normal": "normal:MEAN:DEVIATION", "uniform": "uniform:LOW:HIGH"}
FORMS = "FROM:TO:STEP, VALUE,VALUE,..., normal:MEAN:DEVIATION or uniform:LOW:HIGH"
SETTINGS = ("rtol", "atol", "step", "until")


def cases_of(
    texts, number: Callable[[str], float], *, count: int | None = None, seed: int | None = None
) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
    """Names and cases of texts such as ``crank_speed=5:15:0.1``, whose numbers are read by `number`; or InputError.

    The lists are crossed, the last one running fastest. All random names together are one more list of `count` samples,
    crossed with the others like one; sample i comes from the i-th of ``numpy.random.SeedSequence(seed).spawn(count)``,
    so that it stays the same when `count` grows.
    """
    lists, random = {}, {}
    for text in texts:
        name, sign, values = (part.strip() for part in text.rpartition("="))
        if not sign or not name or not values:
            raise InputError(f"--vary needs name=values, got {text!r}; values are {FORMS}")
        if name in lists or name in random:
            raise InputError(f"--vary names {name!r} twice")
        if values.split(":")[0] in DISTRIBUTIONS:
            random[name] = _distribution(values, number, text)
        else:
            lists[name] = _range(values, number, text) if ":" in values else _list(values, number, text)
    if bool(random) != (count is not None):
        raise InputError("--count is the number of samples of normal: and uniform: values; give both or neither")
    if seed is not None and not random:
        raise InputError("--seed is for normal: and uniform: values")
    size = math.prod(map(len, lists.values())) * (count or 1)
    if size > MOST:
        raise InputError(f"{size} cases are more than a million; take larger steps, or draw samples: normal:, uniform:")
    samples = [()] if count is None else _samples(random.values(), count, seed or 0)
    cases = [(*values, *sample) for *values, sample in itertools.product(*lists.values(), samples)]
    return (*lists, *random), cases


def _samples(distributions, count, seed):
    if count < 1 or seed < 0:
        raise InputError(f"--count must be at least 1 and --seed not negative, got {count} and {seed}")
    generators = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(count))
    return [tuple(float(draw(generator)) for draw in distributions) for generator in generators]


def _distribution(values, number, text):
    kind, *parameters = values.split(":")
    if len(parameters) != 2:
        raise InputError(f"--vary {text}: needs {DISTRIBUTIONS[kind]}")
    first, second = (_number(each, number, text) for each in parameters)
    if kind == "normal" and second < 0:
        raise InputError(f"--vary {text}: the deviation is negative")
    if kind == "uniform" and second < first:
        raise InputError(f"--vary {text}: the end is below the start")
    return lambda generator: getattr(generator, kind)(first, second)


def _list(values, number, text):
    found = [_number(each, number, text) for each in values.split(",")]
    if len(set(found)) < len(found):
        raise InputError(f"--vary {text}: a value is given twice")
    return found


def _range(values, number, text):
    parts = values.split(":")
    if len(parts) != 3:
        raise InputError(f"--vary {text}: a range needs FROM:TO:STEP")
    try:
        start, end, step = map(Decimal, parts)  # 5.3, where floats would give 5.300000000000001
    except InvalidOperation:
        start, end, step = (_number(each, number, text) for each in parts)
    if not all(map(math.isfinite, (start, end, step))) or step == 0 or (end - start) / step < 0:
        raise InputError(f"--vary {text}: the step must lead from start to end")
    if (count := float((end - start) / step)) > MOST:
        raise InputError(f"--vary {text}: that makes more than a million cases")
    return [float(start + k * step) for k in range(int(count + 1e-9) + 1)]


def _number(text, number, whole) -> float:
    try:
        value = number(text)
    except ValueError:
        raise InputError(f"--vary {whole}: {text!r} is not a number; values are {FORMS}") from None
    if not math.isfinite(value):
        raise InputError(f"--vary {whole}: {text!r} is not a finite number")
    return value


@dataclass
class Run:
    """What `simulate` is to be called with; targets change it."""

    mechanism: Mechanism
    until: float
    q0: dict = field(default_factory=dict)
    v0: dict = field(default_factory=dict)
    torques: dict = field(default_factory=dict)
    options: dict = field(default_factory=dict)


def target(mechanism: Mechanism, name: str) -> Callable[[Run, float], None]:
    """The function that puts a number of this name into a run, or InputError where nothing has the name.

    Names are those of joints of one degree of freedom (initial position, rad or m), ``<joint>_speed`` (initial
    velocity), ``<joint>_torque`` (constant, in addition to the scene's forces); ``<loop or force>.<number>``, by the
    names of the scene file, such as ``gear.ratio``, ``motor.speed``, ``spring crank.stiffness``; what else
    :mod:`pinconsist.mechanism.parameters` names; ``rtol``, ``atol``, ``step``, ``until``.
    """
    for joint, kind in ((name, "q0"), (name.removesuffix("_speed"), "v0"), (name.removesuffix("_torque"), "torques")):
        if joint in mechanism.joints and (kind == "q0" or joint != name):
            columns = mechanism.columns(joint)
            if columns.stop - columns.start != 1:
                raise InputError(f"{name} cannot be varied: joint {joint!r} has several degrees of freedom")
            return lambda run, value: getattr(run, kind).__setitem__(joint, value)
    if name == "until":
        return lambda run, value: setattr(run, name, value)
    if name in SETTINGS:
        return lambda run, value: run.options.__setitem__(name, value)
    try:
        put = parameter(mechanism, name).put
    except UnknownParameterError:
        starts = [*mechanism.joints, *(f"{joint}_speed" for joint in mechanism.joints), *SETTINGS]
        listed = f", JOINT, JOINT_speed and JOINT_torque of a joint, {', '.join(SETTINGS)}"
        raise unknown(mechanism, name, starts, listed) from None

    def change(run, value):
        run.mechanism = put(run.mechanism, value)

    return change
