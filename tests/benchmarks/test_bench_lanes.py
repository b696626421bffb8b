"""A step of Radau IIA, by each instruction set."""

from helpers import command_line

from benchmarks.app import main
from benchmarks.lanes import ONE_BY_ONE, measured
from pinconsist import engine


def test_each_way_makes_the_same_run():
    steps = list(measured(["four_bar"], repeats=1))
    assert [step.instructions for step in steps] == [ONE_BY_ONE, *engine.required().instruction_sets()]
    assert all(step.ratio > 0.0 and abs(step.steps - steps[0].steps) <= 2 for step in steps)


def test_the_command(capsys):
    code, printed, _ = command_line.called(capsys, "lanes", "four_bar", "--repeats", 1, main=main)
    assert code == 0 and all(name in printed for name in engine.required().instruction_sets())
