"""All parameters of a run, and what they change in its equations: checked, those of one table at once."""

from collections.abc import Sequence
from functools import cached_property, partial

import numpy as np

from ..errors import InputError
from ..mechanism.parameters import difference_step
from .known import parts_of
from .variants import KnownVariant, Side, Variant, variant_of

SMOOTH, ROUGH = 3e-8, 1e-5  # by which residual differences over two steps are to differ, and may differ, relative
MOST_TRIES, SHORTER = 4, 5.0
WIDE = 1e-3  # of a value: steps of differences of fourth order alone


class Variants(Sequence):
    """The variants of all parameters, in order.

    `moved` are those without a known derivative of the equations, by their indices. For the others, `known` has
    (index, parts), or of a table (indices, parts); each of them is a :class:`KnownVariant` only where it is asked for.
    """

    def __init__(self, names, steps, base, moved, known, sides_of):
        self.names, self.steps, self.base, self.moved, self.known = names, steps, base, moved, known
        self._sides_of, self._made = sides_of, dict(moved)

    def __len__(self):
        return len(self.names)

    def __getitem__(self, i):
        if i not in self._made:
            self._made[i] = KnownVariant(self._parts[i], self.base, partial(self._sides_of, i))
        return self._made[i]

    @cached_property
    def _parts(self):
        parts: list = [None] * len(self)
        for i, own in self.known:
            for j, column in enumerate(np.atleast_1d(i).tolist()):
                parts[column] = own if np.ndim(i) == 0 else [(1.0, own[0][1].one(j))]
        return parts

    def residuals(self, like):
        """What they change in the steps of the system `like`."""
        return Residuals(self, like)

    def close(self) -> None:
        for variant in self._made.values():
            variant.close()


class Residuals(Sequence):
    """For each parameter, what :meth:`Variant.residuals` gives; `known` of them as in :class:`Variants`."""

    def __init__(self, variants, like):
        self._variants, self._like, self.known = variants, like, variants.known
        self.beside = {i: variant.residuals(like) for i, variant in variants.moved.items()}
        self.evaluations = sum(map(len, self.beside.values())) + sum(np.size(i) * len(parts) for i, parts in self.known)
        self._terms = dict(self.beside)

    def __len__(self):
        return len(self._variants)

    def __getitem__(self, i):
        if i not in self._terms:
            self._terms[i] = self._variants[i].residuals(self._like)
        return self._terms[i]

    @property
    def workspace(self):
        """Model and data for what is known."""
        return self._like.model, self._variants.base.workspace


def variants_of(make, theta, names, steps, base: Side, system, t, p, v, parameters=()) -> Variants:
    """The variants of all parameters; ``make(theta)`` gives a Side. Checked at the state (`t`, `p`, `v`).

    `parameters` are those given by names, with their indices.
    """
    given = np.array([step is not None for step in steps] if steps is not None else [False] * len(names))
    chosen = difference_step(theta)
    if given.any():
        chosen[given] = [float(step) for step in steps if step is not None]
    wide = np.where(given, chosen, np.maximum(WIDE * np.abs(theta), 0.1 * chosen))

    def beside(i, step):
        return variant_of(make, theta, i, names[i], float(step), base)

    parts = [(i, parts_of(each, base.mechanism.model, chosen[i])) for i, each in parameters]
    known, moved = [(i, own) for i, own in parts if own], {}
    everyone = np.ones(len(names), bool)
    for i, _ in known:
        everyone[i] = False
    for i in np.flatnonzero(everyone).tolist():
        state = system, t, p, v
        moved[i] = _smooth(partial(beside, i), chosen[i], 1 if given[i] else MOST_TRIES, *state)
        chosen[i] = moved[i].step
    return Variants(names, chosen, base, moved, known, lambda i: beside(i, wide[i]))


def _smooth(beside, step, tries, system, t, p, v) -> Variant:
    """The variant whose step is so short that the equations are smooth over it; ``beside(step)`` makes one."""
    tried, sizes = [], []
    for _ in range(tries):
        variant = beside(step)
        rough, size = (0.0, 0.0) if variant.inert else _roughness(variant, system, t, p, v)
        tried.append((rough, -len(tried), variant))
        sizes.append(size)
        if rough <= SMOOTH:
            break
        step /= SHORTER
    rough, _, variant = min(tried)
    if max(sizes) > 2.0 * min(sizes):  # flat pieces of stairs
        rough = 1.0
    if rough > ROUGH:
        raise InputError(
            f"the equations are not smooth in the parameter {variant.name!r}: differences over {variant.step:.1e} and "
            f"{2 * variant.step:.1e} differ by {rough:.1e} of their size. A table, a rounded number or a kink "
            "depends on it; give steps= for it, or leave it out"
        )
    return variant


def _roughness(variant, system, t, p, v) -> tuple[float, float]:
    """How much residual differences over one step and over two differ, relative to their largest, and that."""
    v = v + 0.3 * np.cos(np.arange(system.nv))
    a = 1.0 + np.abs(v)
    sizes, values = 1e-300, {}
    for m in {*variant.near, *(2 * m for m in variant.near)}:
        f, phi, G, rho = variant.sides[m].index1(system).system.evaluate(t, p, v, a)
        values[m] = np.concatenate((f, phi, rho, (G @ np.ones(system.nc)) if system.nc else np.zeros(0)))
        sizes = max(sizes, np.abs(values[m]).max())
    one = sum(weight * values[m] for m, weight in variant.near.items())
    two = sum(weight * values[2 * m] for m, weight in variant.near.items()) / 2.0
    noise = 1e-14 * sizes
    size = float(np.abs(one).max())
    return float(np.abs(one - two).max() / (size + noise / ROUGH)), size / variant.step
