"""The compiled twin under hard use: every joint of Pinocchio, laws that raise or call back, threads, lifetimes."""

import gc
import threading

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import placement, random_state
from helpers.loops import closed_gap, loop_open_by
from helpers.twin import LOOSE, compare_terms, needs_twin

import pinconsist as pc

pytestmark = needs_twin
AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)


def composite(*joints):
    rng, joint = np.random.default_rng(7), pin.JointModelComposite()
    for part in joints:
        joint.addJoint(part, placement(rng))
    return joint


JOINTS = {
    "helical": lambda: pin.JointModelHZ(0.3),
    "unaligned helical": lambda: pin.JointModelHelicalUnaligned(AXIS, 0.3),
    "unaligned revolute": lambda: pin.JointModelRevoluteUnaligned(AXIS),
    "unaligned prismatic": lambda: pin.JointModelPrismaticUnaligned(AXIS),
    "universal": lambda: pin.JointModelUniversal(np.eye(3)[0], np.eye(3)[2]),
    "spherical ZYX": pin.JointModelSphericalZYX,
    "translation": pin.JointModelTranslation,
    "composite of vectors": lambda: composite(
        pin.JointModelRX(), pin.JointModelPY(), pin.JointModelRZ(), pin.JointModelSphericalZYX()
    ),
    "composite with a sphere": lambda: composite(pin.JointModelSpherical(), pin.JointModelPX()),
    "composite with a plane": lambda: composite(pin.JointModelPlanar(), pin.JointModelRUBX()),
}


@pytest.mark.parametrize("name", JOINTS)
def test_terms_of_rarer_joints(name):
    """Two of them in a chain that a point closes, with a spring across it and a wrench at its end."""
    rng, model = np.random.default_rng(1), pin.Model()

    def body(parent, joint, called):
        index = model.addJoint(parent, joint, placement(rng), called)
        model.appendBodyToJoint(index, pin.Inertia(1.3, 0.2 * rng.normal(size=3), np.diag([0.1, 0.2, 0.25])), pin.SE3())
        model.addFrame(pin.Frame(f"on {called}", index, 0, placement(rng), pin.FrameType.OP_FRAME))
        return index

    last = body(body(body(0, JOINTS[name](), "first"), pin.JointModelRY(), "hinge"), JOINTS[name](), "last")
    body(0, pin.JointModelSpherical(), "ball")
    assert last == 3
    q, _ = random_state(model, rng)
    loop = loop_open_by(model, q, "point", "on last", "on ball", closed_gap("point", rng))
    forces = [
        pc.SpringDamper("on last", "on ball", 30.0, 0.3, damping=2.0),
        pc.Wrench("on last", force=(1.0, 2.0, 3.0), moment=(0.1, 0.2, 0.3)),
    ]
    compare_terms(pc.Mechanism(model, [loop], forces), q)


class OwnError(BaseException):
    """No Exception: nobody may take it for a failure of the step."""


@pytest.mark.parametrize("raised", [GeneratorExit, OwnError])  # SystemExit: test_signals.py
def test_what_is_no_failure_passes_through(raised):
    def leave(t, q, v):
        if t > 0.1:
            raise raised("out")
        return np.zeros(3)

    for backend in ("python", "compiled"):
        with pytest.raises(raised, match="out"):
            pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[leave], backend=backend)


def test_an_interrupt_inside_a_users_force_keeps_what_was_reached():
    def interrupted(t, q, v):
        if t > 0.5:
            raise KeyboardInterrupt
        return np.zeros(3)

    for backend in ("python", "compiled"):
        sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), forces=[interrupted], backend=backend)
        assert sol.status == 1 and "interrupted" in sol.message and 0.2 < sol.t[-1] <= 0.5


RETURNED = {
    "whole numbers": lambda x: np.round(10 * x).astype(int),
    "single precision": lambda x: np.float32(x),
    "every other number": lambda x: np.repeat(x, 2)[::2],
    "reversed": lambda x: x[::-1],
    "read-only": lambda x: np.broadcast_to(x[0], 3),
}


class OwnForce:
    """A force object that shapes what it returns."""

    def __init__(self, shape):
        self.shape = shape

    def torque(self, t, q, v):
        return self.shape(np.array([0.3, -0.2, 0.1]))

    def derivatives(self, t, q, v):
        return np.asfortranarray(np.zeros((3, 3))), np.zeros((3, 6))[:, ::2]


@pytest.mark.parametrize("name", RETURNED)
def test_arrays_of_any_layout_are_understood(name):
    shape, scene = RETURNED[name], pc.load("four_bar")
    plain = pc.simulate(scene, (0.0, 0.3), forces=[OwnForce(lambda x: np.array(shape(x), float))], backend="compiled")
    other = pc.simulate(scene, (0.0, 0.3), forces=[OwnForce(shape)], backend="compiled")
    np.testing.assert_array_equal(other.lam, plain.lam)


@pytest.mark.parametrize("inside", ["run", "thread", "garbage collection"])
def test_a_force_may_simulate_the_same_mechanism(inside):
    mech, calls = pc.load("four_bar"), []

    def nested():
        pc.simulate(mech, (0.0, 0.01), backend="compiled")

    def alone(t, q, v):
        return -0.1 * v

    def disturbed(t, q, v):
        calls.append(t)
        if len(calls) % 20 == 0:
            if inside == "thread":
                thread = threading.Thread(target=nested)
                thread.start()
                thread.join()
            elif inside == "run":
                nested()
            else:
                gc.collect()
        return -0.1 * v

    runs = [pc.simulate(mech, (0.0, 0.3), forces=[law], backend="compiled", **LOOSE) for law in (alone, disturbed)]
    np.testing.assert_array_equal(runs[0].lam, runs[1].lam)


def test_threads_on_one_mechanism_do_not_meet():
    mech, found = pc.load("crank_rocker"), []

    def run():
        found.append(pc.simulate(mech, (0.0, 2.0), backend="compiled"))

    threads = [threading.Thread(target=run) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    alone = pc.simulate(mech, (0.0, 2.0), backend="compiled")
    assert len(found) == 4
    for sol in found:
        np.testing.assert_array_equal(sol.lam, alone.lam)


def test_a_solution_outlives_its_mechanism():
    mech = pc.load("bricard")
    sol = pc.simulate(mech, (0.0, 0.5), backend="compiled", dense_output=True)
    middle = sol.sol(0.25)
    del mech
    gc.collect()
    for a, b in zip(middle, sol.sol(0.25), strict=True):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("span", [(0.0, 1e-13), (5.0, 5.0 + 1e-15), (-1e-300, 1e-300), (1e6, 1e6 + 0.1), (0.1, 0.0)])
def test_strange_spans_end_alike(span):
    runs = [pc.simulate(pc.load("four_bar"), span, backend=b, **LOOSE) for b in ("python", "compiled")]
    assert runs[0].status == runs[1].status == 0
    assert runs[0].t[-1] == runs[1].t[-1] == span[1]
