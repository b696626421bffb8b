"""Wrong types: an InputError tells what was expected, whatever is passed to whatever is public."""

import inspect
import warnings
import webbrowser

import numpy as np
import pytest
from helpers.signatures import PARAMETERS

import pinconsist as pc
from pinconsist.view.plots import pictures_of

WRONG = {
    "None": None,
    "str": "nonsense",
    "dict": {"no_joint": 1.0},
    "list": [1, "x"],
    "nan": float("nan"),
    "array": np.ones((2, 3)),
    "object": object(),
}
MECH = pc.load("four_bar")
SOL = pc.simulate(MECH, (0.0, 0.1))
RIGHT = {
    **dict.fromkeys(("mech", "mechanism"), MECH),
    **dict.fromkeys(("sol", "solution"), SOL),
    **dict.fromkeys(("source", "scene"), "four_bar"),
    "model": MECH.model,
    "t_span": (0.0, 0.05),
    "q": np.zeros(MECH.nq),
    "v": np.zeros(MECH.nv),
    "t": 0.0,
}


def public():
    """Name and function of everything public that can be called."""
    for name in PARAMETERS:
        if callable(getattr(pc, name, None)):
            yield name, getattr(pc, name)
    for each in (MECH, SOL):
        for name, _ in inspect.getmembers(type(each), callable):
            if not name.startswith("_"):
                yield f"{type(each).__name__}.{name}", getattr(each, name)


def failure(function, positional, named):
    """The exception from below, if there is one."""
    try:
        function(*positional, **named)
    except pc.PinconsistError:
        return None
    except Exception as error:
        return error
    return None


@pytest.mark.parametrize(("name", "function"), [pytest.param(*each, id=each[0]) for each in public()])
def test_wrong_types_are_named(name, function, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(webbrowser, "open", lambda *_: False)
    try:
        found = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        pytest.skip("has no signature")
    parameters = [each for each in found if each.kind not in (each.VAR_POSITIONAL, each.VAR_KEYWORD)]
    required = {each.name: RIGHT.get(each.name, "crank") for each in parameters if each.default is each.empty}
    first = [each.name for each in parameters if each.kind is each.POSITIONAL_ONLY]
    from_below = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for parameter in parameters:
            for kind, value in WRONG.items():
                named = {**required, parameter.name: value}
                positional = [named.pop(each) for each in first if each in named]
                if (error := failure(function, positional, named)) is not None:
                    from_below.append(f"{name}({parameter.name}={kind}): {type(error).__name__}: {error}")
    assert not from_below, "\n".join(from_below)


def test_what_is_no_file_solution_or_mechanism_is_named():
    with pytest.raises(pc.InputError, match="path"):
        SOL.plot("trajectory", file={"a": 1})
    with pytest.raises(pc.InputError, match="needs a Solution"):
        pictures_of({"a": SOL}, ["trajectory"])
    with pytest.raises(pc.InputError, match="Mechanism"):
        SOL.plot("trajectory", mechanism="four_bar")


def test_a_drawing_at_one_time(tmp_path):
    """`at` may be one number; it was a TypeError."""
    one, several = (SOL.render(tmp_path / f"{k}.svg", at=at) for k, at in enumerate((0.05, [0.05])))
    assert one.read_bytes() == several.read_bytes()
