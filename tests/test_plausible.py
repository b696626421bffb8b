"""Numbers that are hardly meant are told when a file is loaded or its loops are closed, and others are not."""

import warnings

import numpy as np
import pinocchio as pin
import pytest
from helpers import sdf_texts, urdf_texts
from helpers.warned import told

import pinconsist as pc

SLENDER = 'ixx="1e-4" iyy="0.0301" izz="0.03"'  # of a rod, rounded


def arm(inertia=SLENDER, limit="", length=0.6, mass=1.0, kind="continuous"):
    """A URDF of two arms of the same length, m, with some inertia in the second one."""
    rod = f'<inertial><origin xyz="{length / 2} 0 0"/><mass value="{mass}"/><inertia {{}} ixy="0" ixz="0" iyz="0"/>'
    own = rod.format(inertia) + "</inertial>"
    first = rod.format(f'ixx="0" iyy="{mass * length**2 / 12}" izz="{mass * length**2 / 12}"') + "</inertial>"
    return (
        f'<link name="base"/><link name="upper">{first}</link><link name="lower">{own}</link>'
        + urdf_texts.joint("shoulder", "base", "upper", "continuous", '<axis xyz="0 1 0"/>')
        + urdf_texts.joint("elbow", "upper", "lower", kind, f'<origin xyz="{length} 0 0"/><axis xyz="0 1 0"/>{limit}')
    )


def moments_of_a_random_body(rng):
    """Inertia about the centre of mass of point masses, as a matrix."""
    points, masses = rng.normal(size=(4, 3)), rng.uniform(0.1, 1.0, 4)
    points -= np.average(points, axis=0, weights=masses)
    return sum(m * (p @ p * np.eye(3) - np.outer(p, p)) for m, p in zip(masses, points, strict=True))


def test_inertias_of_bodies_pass_and_others_are_told(recwarn):
    """Those of point masses, also two of them (a rod) or in a plane; less than any body has is told."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        inertia = moments_of_a_random_body(rng)
        sizes, axes = np.linalg.eigh(inertia)
        for change, expected in ((1.0, False), (0.9 * (sizes[2] - sizes[0]) / sizes[1], True)):
            moments = sizes * [1.0, min(change, 1.0), 1.0]
            if expected and moments[0] + moments[1] > 0.98 * moments[2]:
                continue
            model = pin.Model()
            joint = model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
            body = pin.Inertia(1.0, np.array([0.5, 0.0, 0.0]), axes @ np.diag(moments) @ axes.T)
            model.appendBodyToJoint(joint, body, pin.SE3.Identity())
            before = len(recwarn)
            pc.load(model)
            assert (len(recwarn) > before) == expected


@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_an_inertia_that_no_body_has_is_told_with_link_and_numbers(tmp_path, recwarn, kind):
    if kind == "urdf":
        path = urdf_texts.write(tmp_path, arm('ixx="0.1" iyy="0.1" izz="1"'))
    else:
        bad = sdf_texts.BAR.replace("0.08", "1")
        path = sdf_texts.write(
            tmp_path, sdf_texts.A + sdf_texts.link("lower", "", bad) + sdf_texts.joint("j", "a", "lower")
        )
    pc.load(path)
    assert f"{path}: link 'lower': inertial: no body has this inertia: izz = 1 kg·m² is above ixx + iyy" in told(
        recwarn
    )
    assert len(recwarn) == 1


def test_rounded_inertias_are_not_told(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pc.load(urdf_texts.write(tmp_path, arm()))
        pc.load(urdf_texts.write(tmp_path, arm('ixx="0" iyy="0" izz="0"')))  # a point mass on a lever
        for name in pc.models():
            mech = pc.load(name.replace("<n>", "3"))
            pc.load(mech.model)
            pc.assemble(mech)


def test_limits_in_the_wrong_order_are_told(tmp_path, recwarn):
    limit = '<limit lower="1" upper="-1" effort="1" velocity="1"/>'
    mech = pc.load(urdf_texts.write(tmp_path, arm(limit=limit, kind="revolute")))
    assert "joint 'elbow': limit: its lower limit 1 is above its upper limit -1" in told(recwarn)
    assert 'lower="-1" upper="1"' in told(recwarn)
    assert not pc.simulate(mech, (0.0, 0.1)).check(error=False).beyond_limits


@pytest.mark.parametrize(("length", "mass", "expected"), [(0.6, 1.0, ""), (600.0, 1.0, "0.45"), (60.0, 9000.0, "")])
def test_lengths_in_millimetres_are_told(tmp_path, recwarn, length, mass, expected):
    """A crane of 120 m is none of them."""
    inertia = f'ixx="0" iyy="{mass * length**2 / 12}" izz="{mass * length**2 / 12}"'
    pc.load(urdf_texts.write(tmp_path, arm(inertia, length=length, mass=mass)))
    assert ("are the lengths in millimetres" in told(recwarn)) == bool(expected)
    assert f"write {expected} for" in told(recwarn) or not expected


def test_inertias_in_other_units_are_told(tmp_path, recwarn):
    pc.load(urdf_texts.write(tmp_path, arm('ixx="1e2" iyy="3e4" izz="3e4"')))  # kg·mm²
    assert "the body at joint 'elbow'" in told(recwarn) and "kg·mm² (factor 1e-6)" in told(recwarn)


def two_slides(angle, offset):
    """Two slides on lines that meet at `offset`, m, and a pin between them."""
    model = pin.Model()
    for name, turn, place in (("first", 0.0, 0.0), ("second", angle, angle * offset)):
        mount = pin.SE3(pin.utils.rotate("y", turn), np.array([0.0, 0.0, place]))
        joint = model.addJoint(0, pin.JointModelPX(), mount, name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.array([0.4, 0.0, 0.0]), 0.1 * np.eye(3)), pin.SE3.Identity())
    return pc.Mechanism(model, [pc.Loop("pin", "point", "first", "second")])


@pytest.mark.parametrize("angle", [1e-9, 1e-6])
def test_slides_that_meet_far_away_are_told_where(angle):
    with pytest.raises(pc.AssemblyError, match=r"would close only far away, with first = 200, second = 200, while all"):
        pc.assemble(two_slides(angle, 200.0))


def test_loops_that_close_far_away_are_told(recwarn):
    found = pc.assemble(two_slides(1e-3, 100.0))
    assert found.largest_gap[1] < 1e-10 and abs(found.q[0] - 100.0) < 1e-3
    assert "the loops close only far away, with first = 100" in told(recwarn)
    before = len(recwarn)
    pc.assemble(two_slides(1e-2, 0.7))
    assert len(recwarn) == before


def pendulums(*anchors):
    """Two pendulums of 0.5 m, 0.2 m apart, and a pin between them."""
    model = pin.Model()
    for name, x in (("left", 0.0), ("right", 0.2)):
        joint = model.addJoint(0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([x, 0.0, 0.0])), name)
        body = pin.Inertia(1.0, np.array([0.0, 0.0, -0.25]), 0.01 * np.eye(3))
        model.appendBodyToJoint(joint, body, pin.SE3.Identity())
    return pc.Mechanism(model, [pc.Loop("pin", "point", "left", "right", *anchors)])


def test_anchors_in_millimetres_are_told(recwarn):
    """Both wrong: the loop closes, 500 m away. One wrong: it does not close."""
    far = {"xyz1": (0.0, 0.0, -500.0), "xyz2": (0.0, 0.0, -500.0)}
    mech = pendulums()
    assert pc.assemble(mech.with_loops(pc.Loop("pin", "point", "left", "right", **far))).largest_gap[1] < 1e-8
    assert "of loop 'pin' is 500 m away (and 1 more), while all bodies are within" in told(recwarn)
    one = {"xyz1": (0.0, 0.0, -0.5), "xyz2": (0.0, 0.0, -500.0)}
    with pytest.raises(pc.AssemblyError, match=r"Anchor 2 of loop 'pin' is 500 m away.*Is its xyz2 in millimetres"):
        pc.assemble(mech.with_loops(pc.Loop("pin", "point", "left", "right", **one)))


@pytest.mark.parametrize(
    ("file", "content", "advice"),
    [
        ("closures.yaml", "loops:\n- {name: p, kind: point, frame1: a, frame2: c}\n", 'pass it as loops="'),
        ("robot_data.yaml", "closing_joints: []\n", ""),
        ("controllers.yaml", "gains: {p: 1}\n", ""),
        ("other.yaml", "loops: []\n", ""),
    ],
)
@pytest.mark.parametrize("kind", ["urdf", "sdf"])
def test_files_with_loops_that_are_not_read_are_told(tmp_path, recwarn, kind, file, content, advice):
    texts = {"urdf": urdf_texts, "sdf": sdf_texts}[kind]
    (folder := tmp_path / kind).mkdir()
    path = texts.write(folder, texts.CHAIN)
    (folder / "other.urdf").write_text("<robot/>")  # to it belongs other.yaml
    (folder / file).write_text(content)
    pc.load(path)
    assert advice in told(recwarn) and len(recwarn) == bool(advice)


def test_a_loop_file_beside_an_sdf_file_is_told(tmp_path, recwarn):
    path = sdf_texts.write(tmp_path, sdf_texts.CHAIN)
    path.with_suffix(".yaml").write_text("loops: []\n")
    pc.load(path)
    assert f'pass it as loops="{path.with_suffix(".yaml")}"' in told(recwarn)
    before = len(recwarn)
    pc.load(path, loops=path.with_suffix(".yaml"))
    assert len(recwarn) == before


def test_a_mechanism_that_is_too_large_for_the_machine_is_refused(monkeypatch):
    """Before, the process was ended from outside, or a MemoryError came from below."""
    monkeypatch.setattr("pinconsist.mechanism.checks._memory", lambda: 1e5)
    mech = pc.load("chain_16")
    with pytest.raises(pc.InputError, match=r"chain_16: 16 velocities are too many: .* this machine has 0 GB"):
        pc.linearize(mech)
    assert pc.simulate(mech, (0.0, 0.01)).success  # a run needs no workspace of Pinocchio


def test_degrees_are_told(tmp_path, recwarn):
    """Angles of more than a turn: in the URDF, at anchors, in the guess, in an SDF pose."""
    body = arm().replace('<origin xyz="0.6 0 0"/>', '<origin xyz="0.6 0 0" rpy="0 90 0"/>')
    body = body.replace('<origin xyz="0.3 0 0"/>', '<origin xyz="0.3 0 0" rpy="3.14159 -6.283185 0"/>', 1)  # rad
    loops = "loops:\n- {name: p, kind: point, frame1: upper, frame2: lower, rpy1: [0, 0, -45], rpy2: [0, 0, 1.5]}\n"
    pc.load(urdf_texts.write(tmp_path, body, loops + "guess: {elbow: 30, shoulder: -6.2}\n"))
    first, second = told(recwarn).splitlines()
    assert "joint 'elbow': origin has an angle of 90 rad, more than a full turn; write 1.5708 for 90 degrees" in first
    assert "loop 'p': rpy1" in second and "guess: elbow has an angle of 30 rad" in second and "shoulder" not in second
    chain = sdf_texts.A + sdf_texts.link("b", "{}0 0 0 0 90 0") + sdf_texts.joint()
    (folder := tmp_path / "turned").mkdir()
    before = len(recwarn)
    pc.load(sdf_texts.write(folder, chain.replace("<pose>{}", '<pose degrees="true">')))
    assert len(recwarn) == before
    pc.load(sdf_texts.write(folder, chain.replace("{}", "")))
    assert "link 'b': pose has an angle of 90 rad" in str(recwarn[-1].message) and len(recwarn) == before + 1


def test_only_inertias_that_have_an_effect_are_told_or_refused(tmp_path):
    """Of a link on the ground, of a small part of a body, of a point that was rounded: as in public robots."""
    wrong = 'ixx="1e-6" iyy="1e-6" izz="1e-6"', 'ixy="2e-6" ixz="0" iyz="0"'  # of an antenna, a principal one is -1e-6

    def robot(inertia, mount, products='ixy="0" ixz="0" iyz="0"'):
        part = f'<link name="part"><inertial><mass value="1e-3"/><inertia {inertia} {products}/></inertial></link>'
        return arm() + part + urdf_texts.joint("weld", mount, "part", "fixed", "")

    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for mount in ("base", "lower"):
            pc.load(urdf_texts.write(tmp_path, robot(wrong[0], mount, wrong[1])))
        pc.load(urdf_texts.write(tmp_path, arm('ixx="-5e-20" iyy="-5e-20" izz="0"')))
    large = robot('ixx="0.1" iyy="0.1" izz="-0.1"', "base")
    assert pc.load(urdf_texts.write(tmp_path, large)).nv == 2
    with pytest.raises(pc.FormatError, match=r"link 'part': inertial: a principal inertia is negative: -0.1"):
        pc.load(urdf_texts.write(tmp_path, large), free_flyer=True)
