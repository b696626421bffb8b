"""What `--vary` says: the values of each name, and the cases they make together."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from decimal import Decimal, InvalidOperation

import numpy as np

from ..errors import InputError

MOST = 1_000_000
DISTRIBUTIONS = {"normal": "normal:MEAN:DEVIATION", "uniform": "uniform:LOW:HIGH"}
FORMS = "FROM:TO:STEP, VALUE,VALUE,..., normal:MEAN:DEVIATION or uniform:LOW:HIGH"


def cases_of(
    texts, number: Callable[[str], float], *, count: int | None = None, seed: int | None = None
) -> tuple[tuple[str, ...], list[tuple[float, ...]]]:
    """Names and cases of texts such as ``crank_speed=5:15:0.1``.

    The lists are crossed, the last one running fastest. All random names together are one more list of `count` samples,
    crossed with the others like one; sample i comes from the i-th of ``numpy.random.SeedSequence(seed).spawn(count)``,
    so that it stays the same when `count` grows.

    Parameters
    ----------
    texts : sequence of str
        ``name=values``: a range with its end, a list, or a distribution.
    number : callable
        Reads a number; ValueError where it is none.
    count, seed : int, optional
        For distributions, and only for them.

    Returns
    -------
    names : tuple of str
    cases : list of tuple of float
        A number for each of the names.

    Raises
    ------
    InputError
        A text that cannot be read; the same name twice; more than a million cases.
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
        raise InputError("--count says how many samples to draw of normal: and uniform: values; give both or none")
    if seed is not None and not random:
        raise InputError("--seed is for normal: and uniform: values")
    names = (*lists, *random)
    size = math.prod(map(len, lists.values())) * (count or 1)
    if size > MOST:
        raise InputError(f"{size} cases are more than a million; take larger steps, or draw samples: normal:, uniform:")
    samples = [()] if count is None else _samples(random.values(), count, seed or 0)
    return names, [(*values, *sample) for *values, sample in itertools.product(*lists.values(), samples)]


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
        raise InputError(f"--vary {text}: a value stands twice")
    return found


def _range(values, number, text):
    parts = values.split(":")
    if len(parts) != 3:
        raise InputError(f"--vary {text}: a range needs FROM:TO:STEP")
    try:
        return _steps(*map(Decimal, parts), text)  # 5.3, where floats would give 5.300000000000001
    except InvalidOperation:
        return _steps(*(_number(each, number, text) for each in parts), text)


def _steps(start, end, step, text) -> list[float]:
    if not all(map(math.isfinite, (start, end, step))) or step == 0 or (end - start) / step < 0:
        raise InputError(f"--vary {text}: the step must lead from start to end")
    count = float((end - start) / step)
    if count > MOST:
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
