"""Files spoilt at random: whatever is done to a valid file, it is read as a Mechanism, or refused by an error of ours
that names the file. Nothing else comes out, and no mechanism of numbers that are none.
"""

import logging
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from helpers.fuzz_seeds import (
    AMBF,
    BODY,
    CLOSING_JOINTS,
    CLOSURES,
    DIRECTIVES,
    LOOP_FILE,
    LOOP_LIST,
    MJCF,
    PLAIN_URDF,
    PROTO,
    ROBOT_YAML,
    SDF,
    URDF,
    USD,
    WEBOTS,
    WRL,
    XACRO,
)
from helpers.mutations import mutated_words, mutated_xml, mutated_yaml
from hypothesis import HealthCheck, given, settings, strategies

import pinconsist as pc

EXAMPLES, PROCESSES = 150, 40  # the latter where each example is a process


def fuzzed(test, examples=EXAMPLES):
    """A Hypothesis test over a source of random numbers; the same examples every time."""
    quiet = (HealthCheck.function_scoped_fixture, HealthCheck.too_slow)
    return settings(max_examples=examples, deadline=None, derandomize=True, database=None, suppress_health_check=quiet)(
        given(strategies.randoms(use_true_random=False))(test)
    )


@pytest.fixture(autouse=True)
def silence(capfd):
    """No log, so that it does not count as printed; and no parser below us prints anything."""
    logger = logging.getLogger("pinconsist")
    logger.setLevel(logging.CRITICAL)
    yield
    logger.setLevel(logging.NOTSET)
    assert capfd.readouterr() == ("", "")


def outcome(path):
    """Load a file; anything but a mechanism of finite numbers or an error of ours that names the file escapes."""
    try:
        mech = pc.load(path)
    except pc.PinconsistError as error:
        assert path.stem in str(error), str(error)
        return error
    model, data = mech.model, mech.model.createData()
    rest = np.zeros(mech.nv)
    numbers = (mech.guess, pin.crba(model, data, mech.guess), pin.rnea(model, data, mech.guess, rest, rest))
    assert all(np.isfinite(each).all() for each in numbers)
    return mech


@pytest.mark.parametrize(
    ("name", "text"), [("scene.urdf", URDF), ("scene.sdf", SDF), ("scene.xml", MJCF)], ids=["URDF", "SDF", "MJCF"]
)
@fuzzed
def test_xml(tmp_path, name, text, rng):
    path = tmp_path / name
    path.write_bytes(mutated_xml(text, rng))
    outcome(path)


@partial(fuzzed, examples=PROCESSES)
def test_xacro(tmp_path, rng):
    pytest.importorskip("xacro")
    path = tmp_path / "scene.xacro"
    path.write_bytes(mutated_xml(XACRO, rng))
    outcome(path)


WORDS = {"scene.usda": USD, "scene.wbt": WEBOTS, "scene.proto": PROTO, "scene.wrl": WRL, "scene.body": BODY}
WORDS |= {"scene.yaml": AMBF}


@pytest.mark.parametrize("name", WORDS)
@fuzzed
def test_words(tmp_path, name, rng):
    if name.endswith("usda"):
        pytest.importorskip("pxr.Usd")
    path = tmp_path / name
    path.write_bytes((mutated_yaml if name.endswith(("body", "yaml")) else mutated_words)(WORDS[name], rng))
    outcome(path)


@fuzzed
def test_directives(tmp_path, rng):
    (tmp_path / "arm.sdf").write_text(SDF)
    path = tmp_path / "scene.dmd.yaml"
    path.write_bytes(mutated_words(DIRECTIVES, rng))
    outcome(path)


LISTS = {"loop file": LOOP_FILE, "robot.yaml": ROBOT_YAML, "loops": LOOP_LIST}
LISTS |= {"closures": CLOSURES, "closing joints": CLOSING_JOINTS}


@pytest.mark.parametrize("text", LISTS.values(), ids=LISTS)
@fuzzed
def test_yaml(tmp_path, text, rng):
    (tmp_path / "scene.urdf").write_text(PLAIN_URDF)
    (tmp_path / "scene.yaml").write_bytes(mutated_yaml(text, rng))
    outcome(tmp_path / "scene.urdf")


@pytest.mark.parametrize(
    ("name", "text", "loops"),
    [
        ("scene.urdf", URDF, None),
        ("scene.urdf", PLAIN_URDF, LOOP_FILE),
        ("scene.urdf", PLAIN_URDF, ROBOT_YAML),
        ("scene.sdf", SDF, None),
        ("scene.xml", MJCF, None),
        ("scene.xacro", XACRO, None),
        ("scene.usda", USD, None),
        ("scene.wbt", WEBOTS, None),
        ("scene.proto", PROTO, None),
        ("scene.wrl", WRL, None),
        ("scene.body", BODY, None),
        ("scene.urdf", PLAIN_URDF, LOOP_LIST),
        ("scene.urdf", PLAIN_URDF, CLOSURES),
        ("scene.urdf", PLAIN_URDF, CLOSING_JOINTS),
    ],
)
def test_what_is_spoilt_is_valid_and_closes(tmp_path, name, text, loops):
    for suffix, package in ((".usda", "pxr.Usd"), (".xacro", "xacro")):
        if name.endswith(suffix):
            pytest.importorskip(package)
    (tmp_path / name).write_text(text)
    if loops:
        (tmp_path / "scene.yaml").write_text(loops)
    mech = outcome(tmp_path / name)
    assert isinstance(mech, pc.Mechanism) and mech.loops
    assert pc.assemble(mech).largest_gap[1] < 1e-10
