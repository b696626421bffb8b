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

COMPILER = shutil.which("cc") or pytest.skip("there is no C compiler", allow_module_level=True)
DIGIT = Path(__file__).resolve().parents[2] / "shared" / "robots" / "digit_like"
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


def geared() -> pc.Mechanism:
    """Couplings of every kind: an angle that wraps, its whole multiple, a sum on both sides; sprung and damped."""
    model, kinds = pin.Model(), {"motor": pin.JointModelRUBZ, "wheel": pin.JointModelRUBX, "ring": pin.JointModelRY}
    kinds |= {"carrier": pin.JointModelRZ, "rack": pin.JointModelPX}
    for name, kind in kinds.items():
        add_body(model, 0, kind(), pin.SE3.Random(), name, 0.4, (0.1, 0, 0.1), 0.02)
    gears = [
        pc.Coupling("wheel", "wheel", "motor", ratio=-3.0, offset=0.2), pc.Coupling("ring", "ring", "motor", ratio=2.0),
        pc.Coupling("planets", {"carrier": 3.0, "ring": -1.0}, {"rack": 2.0}, ratio=0.5, higher=(0.4,)),
        pc.Coupling("rack", "rack", "ring", ratio=0.3, higher=(0.0, 0.2)),
    ]  # fmt: skip
    return pc.Mechanism(model, gears, [pc.JointTorque({"rack": 0.7})], name="geared", guess={"motor": 2.9})


def actuation(name):
    if name == "geared":
        return pc.Actuation(geared(), ["motor"])
    if name == "digit_like":
        return pc.Actuation(pc.load(DIGIT))
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
    "name",
    [*KINDS, *actuated.FREE, "geared", "ankle", "boom", "five_bar", "andrews", "delta_robot", "double_pendulum",
     pytest.param("digit_like", marks=pytest.mark.skipif(not DIGIT.exists(), reason="the robot is not here"))],
)  # fmt: skip
def test_c_and_python_are_equal(name, tmp_path):
    act, rng = actuation(name), np.random.default_rng(1)
    lib, m, nv = library(act, tmp_path), len(act.motors), act.mechanism.nv
    q = act.q.copy()
    for _ in range(3):
        goal = act.positions() + rng.uniform(-0.01, 0.01, m)
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


@pytest.mark.skipif(not DIGIT.exists(), reason="the robot is not here")
@pytest.mark.filterwarnings("ignore::UserWarning")
def test_the_code_of_a_humanoid_is_short(tmp_path):
    """It was 9,800 lines of expressions."""
    lines = actuation("digit_like").to_c(tmp_path / "leg.c").read_text().splitlines()
    assert len(lines) < 2000
    assert max(map(len, lines)) <= 120


def test_the_same_file_each_time(tmp_path):
    texts = [pc.Actuation(pc.load("four_bar")).to_c(tmp_path / "a.c").read_bytes() for _ in range(2)]
    assert texts[0] == texts[1]


@pytest.mark.filterwarnings("ignore::UserWarning")  # free motions
def test_what_has_no_c():
    mech, file = pc.load("five_bar"), Path("a.c")
    motors = mech.actuated
    ball = pc.Mechanism(actuated.held("ball").model, (), [pc.JointSpring("ball", 1.0)], name="ball")
    cases = {
        "the force 'spring ball' cannot be converted to C": pc.Actuation(ball, ["motor0"]),
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
