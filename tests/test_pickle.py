"""Objects of all public classes can be pickled and copied, and give the same answers after that."""

import copy
import pickle
from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np
import pytest

import pinconsist as pc

SPAN = (0.0, 0.05)


def law(t, q, v):
    return -0.1 * v


def torque(t):
    return np.sin(t)


def gap(t, q):
    return q[:1]


def stands(t, q, v, lam):
    return v[0]


def passes(t, q, v, lam):
    return t - 0.02


def slower(t, q, v):
    return {"crank": 0.5 * v[0]}


def coordinate(t, q, v, lam):
    return q[0]


def short_run(x):
    return pc.simulate("crank_rocker", (0.0, 0.01), v0={"crank": x}).q[-1]


@cache
def mechanism():
    return pc.load("crank_rocker").add_forces(pc.Actuator("motor", "crank", control=torque))


@cache
def run():
    return pc.simulate(mechanism(), SPAN, v0={"crank": 8.0}, dense_output=True, events=[stands])


@cache
def driven():
    mech = pc.load("crank_rocker").add_loops(pc.Drive("turn", "crank", pc.Motion(speed=2.0)))
    return pc.inverse_dynamics(mech, [0.0, 0.1])


def small():
    return pc.linearize(mechanism(), run().q[-1], run().v[-1])


def reaction():
    return run().reaction(mechanism().loops[0].name)


def still():
    return pc.equilibrium(pc.load("crank_rocker"))


def rerun(folder):
    pc.record("crank_rocker", (0.0, 0.02), folder / "run.npz")
    return pc.rerun(folder / "run.npz")


RECORDS = {
    "Actuator": lambda: pc.Actuator("motor", "crank", control=torque),
    "Constraint": lambda: pc.Constraint("gap", gap, 1),
    "Contact": lambda: pc.Contact("tip", "coupler", (1.0, 0.0, 0.0), friction=0.5),
    "Coupling": lambda: pc.Coupling("gears", "crank", "rocker", -2.0),
    "Drive": lambda: pc.Drive("turn", "crank", torque),
    "Event": lambda: pc.Event(stands, terminal=True),
    "HeldTorque": lambda: pc.HeldTorque([0.0, 0.01, 0.02], [[0.0], [1.0], [0.5]], joints=("crank",)),
    "Bushing": lambda: pc.Bushing("coupler", "rocker", stiffness=(1.0,) * 6),
    "Curve": lambda: pc.Curve((0.0, 1.0), (0.0, 2.0), "cycloid"),
    "DryFriction": lambda: pc.DryFriction("crank", 0.1),
    "PinFriction": lambda: pc.PinFriction("rocker_ground", 0.01, 0.1),
    "Impact": lambda: pc.Impact("crank", upper=1.0, restitution=0.5),
    "JointDamping": lambda: pc.JointDamping({"crank": 0.1}),
    "JointFriction": lambda: pc.JointFriction({"crank": 0.1}),
    "JointSpring": lambda: pc.JointSpring("crank", 3.0),
    "JointTorque": lambda: pc.JointTorque({"crank": torque}),
    "Loop": lambda: mechanism().loops[0],
    "Motion": lambda: pc.Motion(speed=2.0),
    "Piecewise": lambda: pc.Piecewise(law, times=(0.1, 0.2)),
    "Rope": lambda: pc.Rope("rope", "coupler", "rocker", 2.0),
    "Sampled": lambda: pc.Sampled(0.01, law),
    "Servo": lambda: pc.Servo("crank", torque, 10.0),
    "SpringDamper": lambda: pc.SpringDamper("coupler", "rocker", 10.0),
    "Stop": lambda: pc.Stop("crank", upper=1.0, restitution=0.5),
    "Strut": lambda: pc.Strut("strut", "coupler", "rocker", 0.1),
    "Torque": lambda: pc.Torque(law),
    "Wrench": lambda: pc.Wrench("coupler", force=torque),
}
RESULTS = {  # an object, and what it is asked for afterwards
    "Actuation": (
        lambda: pc.Actuation(pc.load("five_bar"), ["left_crank", "right_crank"]),
        lambda act: (act.jacobian(act.mechanism.guess), act.mass_matrix(act.mechanism.guess)),
    ),
    "Assembly": (lambda: pc.assemble(mechanism()), None),
    "Certificate": (lambda: run().check(), lambda found: (found.verdict, str(found))),
    "Derivatives": (lambda: driven().derivatives(["mass:coupler"]), None),
    "ElementForce": (lambda: run().force("motor"), None),
    "Energy": (lambda: run().energy(), None),
    "Equilibrium": (still, lambda found: list(found.derivatives(["mass:coupler"]).values.values())),
    "GlobalError": (lambda: run().check(error=True).error, None),
    "Gradient": (lambda: pc.gradient(mechanism(), ["mass:coupler"], SPAN, terminal=coordinate), None),
    "InverseDynamics": (driven, lambda found: list(found.derivatives(["mass:coupler"]).values.values())),
    "JointForce": (lambda: run().joint_force("crank"), None),
    "Linearization": (small, lambda found: found.modes().eigenvalues),
    "Mechanism": (mechanism, lambda mech: pc.simulate(mech, SPAN, v0={"crank": 8.0}).q),
    "Modes": (lambda: small().modes(), None),
    "Outcome": (lambda: pc.sweep(short_run, [(1.0,)])[0], None),
    "Peak": (lambda: reaction().peak(), None),
    "Reaction": (reaction, None),
    "Sensitivities": (lambda: pc.sensitivities(mechanism(), ["mass:coupler"], SPAN), None),
    "Solution": (run, lambda sol: (sol.energy(mechanism()).total, sol.check(mechanism()).verdict)),
}
NOT_KEPT = {"sol", "system"}  # of a solution, see its documentation
OTHERS = {
    "ForwardDynamics",
    "HessenbergProblem",
    "Judgement",
    "SerialEquivalent",
    "StepLinearization",
    "Rerun",
    "Simulation",
    "Simulations",
}


def same(one, other):
    """Whether two objects of the same class have the same public fields."""
    assert type(one) is type(other)
    if isinstance(one, pc.Mechanism):
        return one.forces == other.forces and one.loops == other.loops
    if is_dataclass(one):
        names = [field.name for field in fields(one) if field.name[0] != "_" and field.name not in NOT_KEPT]
        return all(same(getattr(one, name), getattr(other, name)) for name in names)
    if isinstance(one, list | tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    if isinstance(one, np.ndarray | float | int | str | type(None)) or callable(one):
        return np.array_equal(one, other, equal_nan=True) if isinstance(one, np.ndarray) else one == other
    return True  # a system, which is not compared


def twins(thing):
    return pickle.loads(pickle.dumps(thing)), copy.deepcopy(thing)


def test_no_class_is_left_out():
    classes = {name for name in pc.__all__ if isinstance(getattr(pc, name), type)}
    errors = {name for name in classes if issubclass(getattr(pc, name), Exception)}
    assert classes == {*RECORDS, *RESULTS, *OTHERS, *errors}


@pytest.mark.parametrize("name", RECORDS)
def test_records(name):
    record = RECORDS[name]()
    for twin in twins(record):
        assert same(twin, record)


@pytest.mark.parametrize("name", RESULTS)
def test_results(name):
    make, asked = RESULTS[name]
    thing = make()
    assert type(thing) is getattr(pc, name)
    for twin in twins(thing):
        assert same(twin, thing)
        if asked is not None:
            assert same(asked(twin), asked(thing))


def test_a_rerun(tmp_path):
    found = rerun(tmp_path)
    for twin in twins(found):
        assert same(twin, found)


def test_what_runs_is_refused():
    with pytest.raises(pc.InputError, match=r"cannot be pickled; pickle its solution\(\)"):
        pickle.dumps(pc.Simulation(mechanism()))


@pytest.mark.parametrize("name", [name for name in pc.__all__ if name.endswith("Error")])
def test_errors(name):
    kind = getattr(pc, name)
    if not (isinstance(kind, type) and issubclass(kind, Exception)):
        pytest.skip("a result")
    error = kind("a function", 0.5, ValueError("why")) if name == "UserFunctionError" else kind("why")
    for twin in twins(error):
        assert type(twin) is kind and str(twin) == str(error)


def test_the_error_of_a_copied_run_with_events():
    """It has no events, which may have changed the motion: a finer run would be another one."""
    mech = pc.load("crank_rocker")
    events = [pc.Event(passes, apply=slower)]
    sol = pc.simulate(mech, SPAN, v0={"crank": 8.0}, events=events)
    assert sol.check(mech).error is not None
    for twin in twins(sol):
        assert "events" in twin.check(mech).error_missing
