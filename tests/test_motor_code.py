"""C code of an Actuation: compiled without warnings, and equal to Python."""

import ctypes
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers import actuated
from helpers.scenes import add_body

import pinconsist as pc

pytest.importorskip("casadi", reason="CasADi is not installed: pip install casadi")
COMPILER = shutil.which("cc") or pytest.skip("there is no C compiler", allow_module_level=True)
STRICT = "-std=c99 -Wall -Wextra -Werror -pedantic -O0 -shared -fPIC".split()
KINDS = {
    "point": {}, "frame": {}, "hinge": {"axis": (0.6, 0, 0.8)}, "slider": {"axis": (0, 0, 1)},
    "cylinder": {"axis": (1, 0, 0)}, "plane": {"axis": (0, 0.6, 0.8)}, "distance": {"length": 0.2},
    "universal": {"axis": (1, 0, 0), "axis2": (0, 1, 0)},
}  # fmt: skip


def tied(kind) -> pc.Mechanism:
    """A floating body tied to that of a motor by one loop; a gear that the motor turns, and a slide that is held."""
    model, loop = pin.Model(), KINDS[kind]
    add_body(model, 0, pin.JointModelRY(), pin.SE3.Identity(), "motor", 1.0, (0.2, 0, 0), 0.1)
    add_body(model, 0, pin.JointModelRUBX(), pin.SE3.Identity(), "gear", 0.4, (0, 0, 0.1), 0.02)
    slide = add_body(model, 0, pin.JointModelPZ(), pin.SE3.Identity(), "slide", 0.4, (0, 0, 0.1), 0.02)
    add_body(model, slide, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "float", 2.0, (0.1, 0.2, 0.1), 0.3)
    loops = [
        pc.Loop("tie", kind, "motor", "float", xyz1=(0.1, 0, 0.2), **loop),
        pc.Coupling("gear", "gear", "motor", ratio=-2.0, offset=0.1, higher=(0.3,)),
        pc.Drive("held", "slide", pc.Motion(0.2)),
    ]
    return pc.Mechanism(model, loops, name=kind, guess={"float": [0.1, 0, 0, 0.1, 0.2, -0.1], "motor": 0.3})


def actuation(name):
    if name in KINDS:
        return pc.Actuation(tied(name), ["motor"])
    if name in actuated.FREE:
        return pc.Actuation(actuated.held(name))
    own = {"ankle": actuated.ankle, "boom": actuated.boom}
    mech = own[name]() if name in own else pc.load(name)
    return pc.Actuation(mech, mech.actuated or mech.joints)


def library(act, folder):
    file = act.to_c(folder / "leg.c")
    subprocess.run([COMPILER, *STRICT, "-o", folder / "leg.so", file, "-lm"], check=True)
    return ctypes.CDLL(str(folder / "leg.so"))


def call(function, *arrays) -> int:
    return function(*(ctypes.c_void_p(each.ctypes.data) for each in arrays))


def same(one, other):
    np.testing.assert_allclose(one, other, rtol=0, atol=1e-12 * max(1.0, np.abs(other).max()))


@pytest.mark.filterwarnings("ignore::UserWarning")  # free motions
@pytest.mark.parametrize(
    "name", [*KINDS, *actuated.FREE, "ankle", "boom", "five_bar", "andrews", "delta_robot", "double_pendulum"]
)
def test_c_and_python_are_equal(name, tmp_path):
    act, rng = actuation(name), np.random.default_rng(1)
    lib, m, nv = library(act, tmp_path), len(act.motors), act.mechanism.nv
    q = act.q.copy()
    for _ in range(3):
        goal = act.positions() + rng.uniform(-0.03, 0.03, m)
        expected, ok = act.closure(goal)
        assert ok
        assert call(lib.leg_closure, goal, q) == 0
        if not (act.free and act.mechanism.nq > nv):  # else free quaternions differ by the path
            same(q, expected)
        q = np.array(expected)
        again, A, M, h, v = q.copy(), np.empty((nv, m)), np.empty((m, m)), np.empty(m), rng.normal(size=m)
        assert call(lib.leg_jacobian, q, A) == call(lib.leg_dynamics, q, v, M, h) == 0
        same(A, act.jacobian(q))
        same(M, act.mass_matrix(q))
        same(h, act.bias(q, v))
        assert call(lib.leg_closure, goal, again) == 0
        np.testing.assert_allclose(again, q, atol=1e-12)


def test_a_walk_in_c_stays_in_its_mode_of_assembly(tmp_path):
    """What is refused leaves q; what is done is the closed form of the mode."""
    act, rng = pc.Actuation(actuated.five_bar()), np.random.default_rng(0)
    lib, q, done, codes = library(act, tmp_path), act.q.copy(), 0, set()
    for _ in range(3000):
        goal = q[[0, 2]] + rng.normal(0.0, 0.3, 2)
        before = q.copy()
        codes.add(code := call(lib.leg_closure, goal, q))
        if code:
            np.testing.assert_array_equal(q, before)
        else:
            apart = q - actuated.five_bar_configuration(*goal)
            assert np.abs(np.remainder(apart + np.pi, 2 * np.pi) - np.pi).max() < 1e-8
            done += 1
    assert done > 500 and codes == {0, 1, 2}


def test_the_same_file_each_time(tmp_path):
    texts = [pc.Actuation(pc.load("four_bar")).to_c(tmp_path / "a.c").read_bytes() for _ in range(2)]
    assert texts[0] == texts[1]


def test_what_has_no_c():
    mech, file = pc.load("five_bar"), Path("a.c")
    motors = mech.actuated
    cases = {
        "the force 'torque pull' cannot be converted to C": pc.Actuation(mech.add_forces(pull)),
        "some motors depend on others": pc.Actuation(mech, [*motors, "left_distal"]),
        "'free' has several degrees": pc.Actuation(replace(actuated.held("free"), actuated=()), ["free"]),
    }
    for message, act in cases.items():
        with pytest.raises(pc.InputError, match=message):
            act.to_c(file)
    for wrong in ("a.h", "2.c", "a-b.c"):
        with pytest.raises(pc.InputError, match=r"name\.c"):
            pc.Actuation(mech).to_c(wrong)
    assert not file.exists()


def pull(t, q, v):
    return -v
