"""Mistakes of a caller: the package's own error, naming what and where, and no other exception."""

import pickle
import re
import warnings

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

FOUR_BAR = pc.load("four_bar")
TIP1, TIP2 = FOUR_BAR.loops[0].frame1, FOUR_BAR.loops[0].frame2
nan = float("nan")


def run(t_span=(0.0, 0.1), **options):
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # NaN must be met on purpose, not by way of numpy's warnings
        return pc.simulate(FOUR_BAR, t_span, **{"method": "BDF", **options})


def changed(**fields):
    return pc.Mechanism(FOUR_BAR.model, **fields)


def loop(kind="point", frame1=TIP1, frame2=TIP2, **fields):
    return pc.Loop("tip", kind, frame1, frame2, **fields)


SIMULATE = {
    "no mechanism": (lambda: pc.simulate("four_bar", (0, 1)), "needs a Mechanism, got str"),
    "one time": (lambda: run((0.0,)), r"t_span needs two numbers.*\(0.0,\)"),
    "three times": (lambda: run((0, 1, 2)), "t_span needs two numbers"),
    "one number": (lambda: run(5.0), "t_span needs two numbers"),
    "NaN time": (lambda: run((0, nan)), "t_span has a number that is not finite"),
    "endless": (lambda: run((0, np.inf)), "t_span has a number that is not finite"),
    "no time": (lambda: run((0, None)), r"t_span: expected numbers, got \(0, None\)"),
    "no tolerance": (lambda: run(rtol=None), "rtol: expected numbers, got None"),
    "pair as a list": (lambda: run(rtol=[1e-6, 1e-5]), r"needs scalars, \(3, 3\) numbers, or a tuple of the two"),
    "table of rows": (lambda: run(t_eval=[[0.0, 0.1]]), r"one row of times, got an array of shape \(1, 2\)"),
    "endless steps": (lambda: run(step=1e-13), r"step = 1e-13 s makes 1e\+12 steps.*max_steps"),
    "text times": (lambda: run(("0", "1")), "t_span: expected numbers"),
    "complex times": (lambda: run((0, 1j)), "t_span: expected numbers"),
    "q0 size": (lambda: run(q0=[1, 2]), r"configuration needs shape \(3,\) for 'four_bar', got \(2,\)"),
    "v0 size": (lambda: run(v0=[1, 2]), r"velocity needs shape \(3,\) for 'four_bar', got \(2,\)"),
    "q0 NaN": (lambda: run(q0=[0, nan, 0]), "configuration has a number that is not finite"),
    "v0 NaN": (lambda: run(v0={"crank": nan}), "velocity of joint 'crank'.*not finite"),
    "q0 name": (lambda: run(q0={"crnk": 1}), "four_bar: no joint 'crnk'; the joints are crank, coupler, rocker"),
    "v0 text": (lambda: run(v0={"crank": "fast"}), "velocity of joint 'crank': expected numbers, got 'fast'"),
    "negative step": (lambda: run(step=-0.1), "step must be a positive number of seconds, got -0.1"),
    "zero step": (lambda: run(step=0), "step must be a positive"),
    "NaN step": (lambda: run(step=nan), "step has a number that is not finite"),
    "text step": (lambda: run(step="0.1"), "step: expected numbers, got '0.1'"),
    "steps": (lambda: run(step=[0.1, 0.2]), "step must be a positive number of seconds"),
    "method": (lambda: run(method="RK45"), "unknown method 'RK45'; choose from 'Radau', 'BDF', 'ImplicitEuler'"),
    "consistency": (lambda: run(consistency="none"), "unknown consistency 'none'; choose from 'exact', 'initial'"),
    "initial, adaptive": (lambda: run(consistency="initial"), "'initial' is for a fixed step"),
    "order 0": (lambda: run(order=0), "order must be a whole number from 1 to 5, got 0"),
    "order 6": (lambda: run(order=6), "from 1 to 5, got 6"),
    "order 7": (lambda: run(order=7, step=0.1), "from 1 to 6, got 7"),
    "order 2.5": (lambda: run(order=2.5), "order must be a whole number"),
    "order True": (lambda: run(order=True), "order must be a whole number"),
    "rtol 0": (lambda: run(rtol=0), "rtol must be a positive number.*got 0"),
    "rtol of one": (lambda: run(rtol=1.0), "rtol = 1.0 allows errors as large as the solution"),
    "rtol of one for v": (lambda: run(rtol=(1e-6, 2.0)), "allows errors as large as the solution"),
    "rtol NaN": (lambda: run(rtol=nan), "rtol has a number that is not finite"),
    "rtol tiny": (lambda: run(rtol=1e-20), "below 1e-13, which double precision cannot reach"),
    "atol < 0": (lambda: run(atol=(1e-6, -1)), "atol must be a positive number"),
    "atol text": (lambda: run(atol="small"), "atol: expected numbers, got 'small'"),
    "first_step": (lambda: run(first_step=0), "first_step must be a positive"),
    "max_step": (lambda: run(max_step=nan), "max_step has a number that is not finite"),
    "max_steps": (lambda: run(max_steps=0), "max_steps must be a positive whole number, got 0"),
    "callback": (lambda: run(callback=3), "callback must be a function"),
    "event": (lambda: run(events=[3]), "an event must be an Event or a function"),
    "t_eval outside": (lambda: run(t_eval=[0.2]), "t_eval must be times between 0 and 0.1 s"),
    "t_eval order": (lambda: run(t_eval=[0.05, 0.01]), "t_eval must be sorted"),
    "force size": (lambda: run(forces=[np.ones(2)]), r"needs 3 numbers.*got shape \(2,\)"),
    "force NaN": (lambda: run(forces=[[0, nan, 0]]), "a number that is not finite"),
    "force text": (lambda: run(forces=["push"]), "a force must be a Force, a mapping joint"),
    "damping size": (lambda: run(forces=[pc.JointDamping(np.ones(4))]), r"JointDamping needs 3 numbers.*\(4,\)"),
}
DESCRIBE = {
    "no model": (lambda: pc.Mechanism("four_bar"), "needs a pin.Model, got str"),
    "unknown frame": (lambda: changed(loops=[loop(frame2="rocker_tp")]), "'tip'.*'rocker_tp'; similar: .*rocker_tip"),
    "same body": (lambda: changed(loops=[loop(frame1="crank", frame2="crank")]), "loop 'tip'.*are on the same body"),
    "ground to ground": (lambda: changed(loops=[loop("frame", "universe", "universe")]), "are on the same body"),
    "twice": (lambda: changed(loops=[loop(), loop("frame")]), "two loops are named 'tip'"),
    "one loop": (lambda: changed(loops=loop()), "loops= needs a sequence"),
    "no loop": (lambda: changed(loops=["tip"]), "loops= needs Loop, Drive, Coupling and Constraint objects"),
    "one force": (lambda: changed(forces=max), "forces= needs a sequence"),
    "motor": (lambda: changed(actuated=["crnk"]), "no joint 'crnk'"),
    "motors": (lambda: changed(actuated="crank"), "actuated= needs a sequence"),
    "duration": (lambda: changed(duration=-1), "duration must be greater than 0, got -1"),
    "durations": (lambda: changed(duration=[1, 2]), r"duration must be a number, got \[1, 2\]"),
    "guess": (lambda: changed(guess={"crank": [1, 2]}), r"configuration of joint 'crank' needs 1 number\(s\), got 2"),
    "complex guess": (lambda: changed(guess=np.array([1j, 0, 0])), "configuration: expected numbers"),
    "kind": (lambda: loop("pin"), "loop 'tip': unknown kind 'pin'; choose from point, frame, hinge, distance"),
    "kind list": (lambda: loop([]), "unknown kind"),
    "no length": (lambda: loop("distance"), "loop 'tip': the length of a distance, in m, must be a number, got None"),
    "length 0": (lambda: loop("distance", length=0.0), "length of a distance, in m, must be greater than 0"),
    "length text": (
        lambda: loop("distance", length="long"),
        "the length of a distance, in m, must be a number, got 'long'",
    ),
    "length NaN": (lambda: loop("distance", length=nan), "length of a distance, in m, has a number that is not finite"),
    "axis": (lambda: loop("hinge", axis=(0, 0, 0)), "loop 'tip': the hinge axis is the zero vector"),
    "tiny axis": (lambda: loop("hinge", axis=(0, 1e-200, 0)), "the hinge axis is the zero vector"),
    "axis NaN": (lambda: loop("hinge", axis=(0, nan, 0)), "loop 'tip': axis has a number that is not finite"),
    "xyz": (lambda: loop(xyz1=(1, 2)), r"loop 'tip': xyz1 needs three numbers, got \(1, 2\)"),
    "xyz text": (lambda: loop(xyz2="123"), "xyz2 must be a sequence of numbers, got '123'"),
    "length of a hinge": (
        lambda: loop("hinge", axis=(0, 1, 0), length=0.3),
        "loop 'tip': a loop of kind 'hinge' has no length, which is for distance; in addition to frames .* has axis",
    ),
    "axis of a point": (
        lambda: loop(axis=(0, 1, 0)),
        "kind 'point' has no axis, which is for hinge, slider, .*; in addition to frames and anchors it has no fields",
    ),
    "axis2 of a slider": (lambda: loop("slider", axis=(0, 1, 0), axis2=(1, 0, 0)), "has no axis2, which is for univ"),
    "axis of a distance": (lambda: loop("distance", axis=(0, 1, 0), length=1.0), "it has length"),
    "frame number": (lambda: loop(frame1=3), "loop 'tip': frame1 must be a name, got 3"),
    "gravity": (lambda: FOUR_BAR.with_gravity([0, -9.81]), "gravity needs three numbers"),
    "armature name": (lambda: FOUR_BAR.with_armature({"crnk": 1.0}), "no joint 'crnk'"),
    "armature < 0": (lambda: FOUR_BAR.with_armature({"crank": -1.0}), "armature of joint 'crank' must be at least 0"),
    "armature NaN": (lambda: FOUR_BAR.with_armature({"crank": nan}), "armature of joint 'crank'.*not finite"),
    "armature text": (lambda: FOUR_BAR.with_armature({"crank": "much"}), "armature of joint 'crank' must be a number"),
    "armature list": (lambda: FOUR_BAR.with_armature([1.0]), "armature needs a mapping"),
    "load name": (lambda: pc.load("for_bar"), "for_bar.*four_bar"),
}


@pytest.mark.parametrize("case", SIMULATE | DESCRIBE)
def test_input_error_names_what_is_wrong(case):
    call, message = (SIMULATE | DESCRIBE)[case]
    with pytest.raises(pc.InputError, match=message) as caught:
        call()
    assert isinstance(caught.value, ValueError)  # callers who know nothing of pinconsist
    assert str(pickle.loads(pickle.dumps(caught.value))) == str(caught.value)


def test_unknown_joint_of_a_large_model_shows_its_neighbours():
    model, last = pin.Model(), 0
    for i in range(20):
        name = f"link{i:02}_{'abcdefghijklmnopqrst'[i] * 6}"
        last = model.addJoint(last, pin.JointModelRZ(), pin.SE3.Identity(), name)
    with pytest.raises(pc.InputError, match=r"no joint 'link17_rrrrr'; similar: link17_rrrrrr.*; the joints are link"):
        pc.Mechanism(model).joint_index("link17_rrrrr")
    with pytest.raises(pc.InputError, match="no joint 3; "):
        pc.Mechanism(model).joint_index(3)


CALLS = {
    "rtol size": (lambda: run(rtol=[1e-6] * 4), "rtol"),
    "atol size": (lambda: run(atol=(1e-6, [1e-6] * 2)), "atol"),
    "atol matrix": (lambda: run(atol=np.full((2, 2), 1e-6)), "atol"),
    "rtol empty": (lambda: run(rtol=[]), "rtol"),
    "events number": (lambda: run(events=3), "event"),
    "forces number": (lambda: run(forces=3), "forces"),
    "step below spacing": (lambda: run((1.0, 2.0), step=1e-17, max_steps=3), "step"),
    "torque size": (lambda: run(forces=lambda t, q, v: np.zeros(2)), r"torque function .*shape \(2,\) at t = 0"),
    "torque complex": (lambda: run(forces=lambda t, q, v: 1j * v), "torque function .* complex"),
}


@pytest.mark.parametrize("case", CALLS)
def test_input_error_of_a_call(case):
    call, message = CALLS[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def test_tolerances_per_component_in_one_part_only():
    """Documented for ErrorControl: each part of the pair is a scalar or an array."""
    assert run(rtol=(1e-6, [1e-6, 1e-5, 1e-6])).success


@pytest.mark.parametrize("step", [0.01, None])
def test_an_exception_of_a_users_function_comes_through(step):
    def law(t, q, v):
        return np.zeros(3) / (1 // int(t < 0.5))

    sol = run((0.0, 1.0), forces=law, step=step)  # in mid-run: what was reached is kept, and the message says why
    assert not sol.success and "ZeroDivisionError" in sol.message and 0.4 < sol.t[-1] <= 0.5
    with pytest.raises(pc.UserFunctionError, match="ZeroDivisionError") as caught:
        run(forces=lambda t, q, v: 1 / 0, step=step)
    assert isinstance(caught.value.__cause__, ZeroDivisionError)
    with pytest.raises(pc.UserFunctionError, match="the callback raised KeyError: 'mine'") as caught:
        run(callback=lambda t, q, v, lam: {}["mine"], step=step)
    assert isinstance(caught.value.__cause__, KeyError)
    travelled = pickle.loads(pickle.dumps(caught.value))  # as from a worker of a sweep
    assert type(travelled) is pc.UserFunctionError and travelled.t == 0.0 and str(travelled) == str(caught.value)


def test_torques_and_gradients_are_checked_where_they_are_called():
    q = v = np.zeros(3)
    for function, message in [
        (lambda t, q, v: np.zeros(2), r"returned shape \(2,\) at t = 0.25; it must return \(3,\)"),
        (lambda t, q, v: None, "torque function"),
        (lambda t, q, v: 1j * v, "complex"),
        (lambda t: 0.0, "TypeError: .*positional.*at t = 0.25"),
        (lambda t, q, v: q.fill(1.0), "read-only"),
    ]:
        with pytest.raises((pc.InputError, pc.UserFunctionError), match=message):
            pc.Torque(function).torque(0.25, q, v)
    for gradient, message in [
        (lambda t, q, v: (np.zeros(2), None), r"gradient .*shape \(2,\) at t = 0.25"),
        (lambda t, q, v: None, "gradient .* returned None at t = 0.25; it must return two matrices"),
    ]:
        with pytest.raises(pc.InputError, match=message):
            pc.Torque(lambda t, q, v: v, gradient).derivatives(0.25, q, v)
    assert not q.any() and q.flags.writeable
    with pytest.raises(pc.UserFunctionError, match=r"gradient .* raised ZeroDivisionError.*at t = 0.25"):
        pc.Torque(lambda t, q, v: v, lambda t, q, v: 1 / 0).derivatives(0.25, q, v)


@pytest.mark.parametrize("step", [0.01, None])
def test_a_force_that_turns_nan_ends_the_run_with_a_message(step):
    sol = run((0.0, 0.5), forces=lambda t, q, v: np.full(3, nan if t > 0.25 else 0.0), step=step)
    assert not sol.success and sol.status == -1
    assert "not finite" in sol.message and "t = 0.25" in sol.message
    assert 0.2 < sol.t[-1] <= 0.2501 and np.isfinite(sol.q).all() and np.isfinite(sol.lam).all()


@pytest.mark.parametrize("step", [0.01, None])
def test_a_force_that_is_nan_from_the_start(step):
    with pytest.raises(pc.PinconsistError, match="not finite at t = 0"):
        run(forces=lambda t, q, v: np.full(3, nan), step=step)


INTEGRATE = {
    "p0 size": (FOUR_BAR.guess[:2], np.zeros(3), r"p0 and v0 need shapes \(3,\) and \(3,\), got \(2,\)"),
    "v0 size": (FOUR_BAR.guess, np.zeros((3, 1)), "p0 and v0 need shapes"),
    "p0 NaN": ([0, nan, 0], np.zeros(3), "p0 has a number that is not finite"),
    "v0 text": (FOUR_BAR.guess, "rest", "v0: expected numbers, got 'rest'"),
    "p0 off": (FOUR_BAR.guess + 1e-3, np.zeros(3), "off the constraint by .*'coupler_rocker' row .*step squared"),
}


@pytest.mark.parametrize("case", INTEGRATE)
def test_integrate_takes_values_as_they_stand_if_it_can(case):
    p0, v0, message = INTEGRATE[case]
    with pytest.raises(pc.InputError, match=message):
        pc.integrate(FOUR_BAR, (0, 0.1), p0, v0)


def test_integrate_needs_a_system():
    with pytest.raises(pc.InputError, match="cannot integrate a str"):
        pc.integrate("four_bar", (0, 1), [0.0], [0.0])


P0, V0 = np.array([1.0, 0.0]), np.zeros(2)
PENDULUM = {
    "U": lambda t, p, v: v,
    "F": lambda t, p, v: np.array([0.0, -1.0]),
    "G": lambda t, p, v: p[:, None],
    "R": lambda t, p: np.array([(p @ p - 1) / 2]),
}
WRONG = {  # what is exchanged: message
    "U": (lambda t, p, v: v[:1], r"U returned shape \(1,\), needs \(2,\)"),
    "F": (lambda t, p, v: np.zeros(3), r"F returned shape \(3,\), needs \(2,\)"),
    "G": (lambda t, p, v: p, r"G returned shape \(2,\), needs \(2, 1\)"),
    "R": (lambda t, p: (p @ p - 1) / 2, r"R returned shape \(\), needs \(1,\)"),
}


def pendulum(t_span=(0.0, 0.1), p0=P0, v0=V0, step=0.01, **functions):
    return pc.integrate(pc.HessenbergProblem(**(PENDULUM | functions)), t_span, p0, v0, step=step, method="BDF")


def test_the_pendulum_itself_runs():
    assert pendulum().success


@pytest.mark.parametrize("name", WRONG)
def test_inconsistent_shapes_of_a_general_problem(name):
    function, message = WRONG[name]
    with pytest.raises(pc.InputError, match=message):
        pendulum(**{name: function})
    with pytest.raises(pc.InputError, match=f"{name} must be callable, got int"):
        pendulum(**{name: 3})


def late(name, wrong, since=0.05):
    """The pendulum's function, which returns something else from some time on."""

    def function(t, *state):
        return wrong if t > since else PENDULUM[name](t, *state)

    return {name: function}


LATE = {  # function, what it returns later: message
    "a number is not spread over all rows": ("F", -1.0, r"F returned shape \(\), needs \(2,\)"),
    "one row is not spread": ("F", np.array([-1.0]), r"F returned shape \(1,\), needs \(2,\)"),
    "another shape of U": ("U", np.zeros(3), r"U returned shape \(3,\), needs \(2,\)"),
    "another shape of G": ("G", np.zeros(2), r"G returned shape \(2,\), needs \(2, 1\)"),
    "complex": ("F", np.array([0.0, -1.0j]), "F returned .*, needs real numbers"),
    "text": ("F", "down", "F returned 'down', needs real numbers"),
    "nothing": ("R", None, "R returned None, needs real numbers"),
    "rows of different lengths": ("G", [[1.0], [1.0, 2.0]], r"G returned .*, needs real numbers"),
}


@pytest.mark.parametrize("options", [{"step": 0.01}, {"max_step": 0.05}], ids=str)  # else its start looks far ahead
@pytest.mark.parametrize("case", LATE)
def test_a_general_problem_whose_function_changes_its_mind(case, options):
    """Such a run keeps what it reached, with the reason; numpy would broadcast, or raise an error of its own."""
    name, wrong, message = LATE[case]
    problem = pc.HessenbergProblem(**(PENDULUM | late(name, wrong, since=0.5)))
    sol = pc.integrate(problem, (0.0, 1.0), P0, V0, **options)
    assert sol.status == -1 and 0.1 < sol.t[-1] <= 0.5 and re.search(message, sol.message), sol.message


def test_a_function_may_return_its_own_buffer():
    """The values are copied: a buffer that the next call overwrites changes nothing that was returned before."""
    buffer = np.zeros(1)

    def R(t, p):
        buffer[0] = (p @ p - 1) / 2
        return buffer

    own, fresh = pendulum(R=R), pendulum()
    np.testing.assert_array_equal(own.q, fresh.q)


@pytest.mark.parametrize("factor", [1.1, 0.9, -1.0])
def test_a_wrong_derivative_of_the_constraint_is_refused(factor):
    assert pendulum(R_p=lambda t, p: p[None]).success
    with pytest.raises(pc.InputError, match=r"R_p is not the derivative of R at t = 0: .* Omit R_p"):
        pendulum(R_p=lambda t, p: factor * p[None])
    with pytest.raises(pc.InputError, match="R_p is not the derivative of R"):
        pendulum(R_p=lambda t, p: np.array([[0.0, 1.0]]))  # that of another point


def test_general_problem_off_its_constraint_or_not_finite():
    with pytest.raises(pc.InputError, match=r"off the constraint by 0.105 .row 0 of R"):
        pendulum(p0=1.1 * P0)
    with pytest.raises(pc.InputError, match="F is not finite at t = 0"):
        pendulum(F=lambda t, p, v: np.array([0.0, nan]))
    with pytest.raises(pc.UserFunctionError, match="G of the problem raised ZeroDivisionError"):
        pendulum(G=lambda t, p, v: 1 / 0)


@pytest.mark.parametrize("step", [0.01, None])
def test_a_general_problem_that_turns_nan(step):
    """Where the one-step start already runs into it there is nothing to keep, and the error is raised."""
    F = lambda t, p, v: np.array([0.0, nan if t > 0.05 else -1.0])  # noqa: E731
    try:
        sol = pendulum(F=F, step=step)
    except pc.PinconsistError as error:
        assert "not finite at t = 0.05" in str(error)
    else:
        assert not sol.success and "not finite" in sol.message and 0.04 <= sol.t[-1] <= 0.0501


GENERAL_CALLS = {
    "R_p transposed": (lambda: pendulum(R_p=lambda t, p: p[:, None]), "R_p"),
    "R_p no function": (lambda: pendulum(R_p=3), "R_p must be callable, got int"),
    "R_t size": (lambda: pendulum(R_p=lambda t, p: p[None], R_t=lambda t, p: np.zeros(3)), "R_t"),
    "U_v size": (lambda: pendulum(U_v=lambda t, p, v: np.eye(3)), "U_v"),
    "p0 scalar": (lambda: pendulum(p0=1.0), r"p0 and v0 need shapes \(n,\), got \(\) and \(2,\)"),
    "p0 column": (lambda: pendulum(p0=P0[:, None]), r"got \(2, 1\) and \(2,\)"),
    "v0 column": (lambda: pendulum(v0=V0[:, None]), r"got \(2,\) and \(2, 1\)"),
}


@pytest.mark.parametrize("case", GENERAL_CALLS)
def test_input_error_of_a_general_problem(case):
    call, message = GENERAL_CALLS[case]
    with pytest.raises(pc.InputError, match=message):
        call()


def heavy_and_light():
    model = pin.Model()
    heavy = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "heavy")
    model.appendBodyToJoint(heavy, pin.Inertia(1.0, np.array([0.5, 0, 0]), np.eye(3)), pin.SE3.Identity())
    model.addJoint(heavy, pin.JointModelRX(), pin.SE3.Identity(), "light")
    return pc.Mechanism(model)


def test_a_singular_mass_matrix_that_nothing_cures():
    for call in (
        lambda mech: pc.simulate(mech, (0, 1)),
        lambda mech: pc.integrate(mech, (0, 1), np.zeros(2), np.zeros(2)),
    ):
        with pytest.raises(pc.SingularSystemError, match=r"joints light can move without any inertia.*with_armature"):
            call(heavy_and_light())
    assert pc.simulate(heavy_and_light().with_armature({"light": 1e-3}), (0, 0.1)).success


@pytest.mark.parametrize("step", [0.01, None])
@pytest.mark.parametrize("t_span", [(0.25, 0.25), [1, 1], np.array([0.0, 0.0])])
def test_an_interval_of_length_zero_is_its_start(t_span, step):
    sol = run(t_span, v0={"crank": 1.0}, step=step)
    assert sol.success and sol.t.tolist() == [t_span[0]] and sol.nsteps == 0 and sol.h.shape == (0,)
    assert sol.v[0, 0] == pytest.approx(1.0) and np.isfinite(sol.lam).all() and np.abs(sol.lam).max() > 1.0
    assert sol.check(error=False).position < 1e-10


@pytest.mark.parametrize("options", [{"step": 0.01, "order": 3}, {"rtol": 1e-8, "atol": 1e-10}])
@pytest.mark.parametrize("kind", [tuple, list, np.array])
def test_forth_and_back(kind, options):
    there = run(kind([0.0, 0.2]), **options)
    back = pc.integrate(FOUR_BAR, kind([0.2, 0.0]), there.q[-1], there.v[-1], **options)
    assert there.success and back.success and back.t[0] == 0.2 and back.t[-1] == 0.0
    assert (np.diff(back.t) < 0).all()
    np.testing.assert_allclose(back.q[-1], there.q[0], atol=2e-5)
    np.testing.assert_allclose(back.lam[-1], there.lam[0], atol=2e-2)


def test_a_step_longer_than_the_interval_is_the_interval():
    sol = run((0.0, 0.02), step=1e6, order=1)
    assert sol.success and sol.t.tolist() == [0.0, 0.02] and sol.check(error=False).position < 1e-10
    assert run(step=0.03).h.tolist() == pytest.approx([0.025] * 4)  # the largest that divides the interval


@pytest.mark.parametrize("h", [0.08, 0.1])
def test_implicit_euler_takes_a_moderate_step(h):
    """The crank falls by 0.05 rad; without the turning of the constraint forces Newton contracts too slowly."""
    assert run((0.0, h), step=h, order=1).success


@pytest.mark.parametrize("step", [0.01, None])
def test_a_drive_out_of_reach_ends_at_the_dead_centre_with_the_reason(step):
    """The piston is driven to 1.3 m; crank and rod reach 1.2 m, at t = 1.75 s."""
    mech = pc.load("slider_crank")
    mech = mech.add_loops(pc.Drive("press", "piston", lambda t: 1.025 + 0.1 * t, lambda t: 0.1))
    sol = pc.simulate(mech, (0.0, 2.0), step=step)
    assert not sol.success and sol.status == -1
    assert 1.5 < sol.t[-1] and 0.1 * (sol.t[-1] - 1.75) < 1e-14  # m beyond, what rounding cannot tell from closed
    assert sol.check(error=False).position < 1e-14
    assert f"t = {sol.t[-1]:.9g}"[:8] in sol.message
    assert step or ("singular configuration" in sol.message and "press" in sol.message)
