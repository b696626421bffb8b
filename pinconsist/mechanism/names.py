"""The names and the units of the numbers of a configuration and of a velocity."""

from __future__ import annotations


def position_names(model) -> list[str]:
    """A name for each number of a configuration: ``crank``, or ``ball[0]`` of a joint that has several."""
    return _names(model, model.nqs)


def velocity_names(model) -> list[str]:
    """A name for each number of a velocity: ``crank``, or ``ball[0]`` of a joint that has several."""
    return _names(model, model.nvs)


def _names(model, sizes):
    pairs = zip(list(model.names)[1:], list(sizes)[1:], strict=True)
    return [f"{joint}[{k}]" if size > 1 else joint for joint, size in pairs for k in range(size)]
