"""Every example runs, and its number is the one it should be."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest

EXAMPLES = Path(__file__).parents[1] / "examples"
ANSWERS = {  # where the number comes from
    "01_exact_and_consistent": (8.0120e-3, 5e-5),  # Arévalo (2008), table 5.1
    "02_four_bar": (4.143275032678, 1e-7),  # zoo.reduced_solution: scipy in the crank angle alone
    "03_driven_slider_crank": (15.943068750830, 1e-5),  # inverse dynamics by hand, on the same 601 times
    "04_own_mechanism": (5.715995, 5e-4),  # scipy's DOP853 on the index-1 equations, 3001 times
    "05_events": (np.sqrt(2 / 9.81) * (1 + 2 * 0.8 + 2 * 0.64), 1e-6),  # free fall, then two flights, each 0.8 as long
}


def run(name):
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.main()


def test_all_examples_are_here():
    assert sorted(path.stem for path in EXAMPLES.glob("*.py")) == sorted(ANSWERS)


@pytest.mark.parametrize("name", ANSWERS)
def test_example(name):
    number = run(name)
    text = (EXAMPLES / f"{name}.py").read_text()
    assert len(text.splitlines()) <= 60
    answer, tolerance = ANSWERS[name]
    assert number == pytest.approx(answer, rel=tolerance)
