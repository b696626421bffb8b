"""Rods that spin freely are locked: the motion of everything else is that of before."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc

ACROSS, ALONG = 4e-3, 2e-4  # kg·m², of a rod


def rod(length, across=(ACROSS, ACROSS), aside=0.0):
    return pin.Inertia(0.4, np.array([aside, 0.0, 0.5 * length]), np.diag([*across, ALONG]))


def add_ball(model, parent, place, name, inertia):
    """A ball joint as three joints in series; the last one turns the rod about its own axis z."""
    for joint, axis in ((pin.JointModelRX(), "x"), (pin.JointModelRY(), "y"), (pin.JointModelRZ(), "z")):
        parent, place = model.addJoint(parent, joint, place, f"{name}_{axis}"), pin.SE3.Identity()
    model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    return parent


def frame(model, name, joint, xyz):
    model.addFrame(pin.Frame(name, joint, 0, pin.SE3(np.eye(3), np.array(xyz)), pin.FrameType.OP_FRAME))


def rssr(halves=False, **shape):
    """A crank about x and a rocker about y, joined by a rod between two balls, or by its two halves."""
    model = pin.Model()
    body = pin.Inertia(1.0, np.array([0.0, 0.0, 0.1]), 0.01 * np.eye(3))
    crank = model.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "crank")
    model.appendBodyToJoint(crank, body, pin.SE3.Identity())
    rocker = model.addJoint(0, pin.JointModelRY(), pin.SE3(np.eye(3), np.array([0.3, 0.9, 0.2])), "rocker")
    length = 0.4 if halves else 0.8
    end = add_ball(model, crank, pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.25])), "rod", rod(length, **shape))
    frame(model, "rod_end", end, [0.0, 0.0, length])
    tip = [0.0, 0.0, 0.3]
    guess = {"crank": -0.3, "rod_x": -1.2, "rod_y": 0.4}
    if halves:
        model.appendBodyToJoint(rocker, body, pin.SE3.Identity())
        other = add_ball(model, rocker, pin.SE3(np.eye(3), np.array(tip)), "half", rod(0.4))
        frame(model, "half_end", other, [0.0, 0.0, 0.4])
        loop = pc.Loop("join", "frame", "rod_end", "half_end", rpy2=(np.pi, 0.0, 0.0))
        guess |= {"half_x": 1.9}
    else:
        model.appendBodyToJoint(rocker, body, pin.SE3.Identity())
        frame(model, "rocker_tip", rocker, tip)
        loop = pc.Loop("ball", "point", "rod_end", "rocker_tip")
    return model, loop, guess


def in_depth_first_order(model):
    """The rocker was added before the rod of the crank."""
    new, carriers = pin.Model(), {0: 0}

    def add(old):
        for child in [j for j in range(1, model.njoints) if model.parents[j] == old]:
            here = new.addJoint(carriers[old], model.joints[child], model.jointPlacements[child], model.names[child])
            new.inertias[here] = model.inertias[child]
            carriers[child] = here
            add(child)

    add(0)
    for each in list(model.frames)[1:]:
        new.addFrame(pin.Frame(each.name, carriers[each.parentJoint], 0, each.placement, each.type))
    return new


def scene(halves=False, **shape):
    model, loop, guess = rssr(halves, **shape)
    return pc.Mechanism(in_depth_first_order(model), [loop], guess=guess)


@pytest.mark.parametrize("halves", [False, True])
def test_the_motion_is_that_of_before(halves):
    mech = scene(halves)
    locked = mech.lock_spins()
    spins = {"rod_z", "half_z"} if halves else {"rod_z"}
    assert set(mech.joints) - set(locked.joints) == spins
    assert mech.nc - locked.nc == halves
    options = {"v0": {"crank": 1.0}, "rtol": 1e-10, "atol": 1e-12, "t_eval": np.linspace(0.0, 1.0, 11)}
    before = pc.simulate(mech, (0.0, 1.0), **options)
    after = pc.simulate(locked, (0.0, 1.0), **options)
    spin = before.v[:, mech.columns("rod_z")]
    for joint in ("crank", "rocker"):
        np.testing.assert_allclose(after.position(joint), before.position(joint), rtol=0, atol=1e-7)
    assert np.ptp(before.position("crank")) > 1.0
    assert before.check().ok and after.check().ok
    assert np.abs(spin).max() > 1e-3  # of the joint: the speed of the body about its axis is another one


WITH_EFFECT = {
    "not round": lambda: scene(across=(ACROSS, 2.0 * ACROSS)),
    "aside": lambda: scene(aside=0.02),
    "damping": lambda: scene().with_parameters({"damping:rod_z": 0.1}),
    "armature": lambda: scene().with_armature({"rod_z": 0.01}),
    "spring": lambda: scene().add_forces(pc.JointSpring("rod_z", 1.0)),
    "motor": lambda: replace(scene(), actuated=("rod_z",)),
    "a point off the axis": lambda: scene().with_loops(replace(scene().loops[0], xyz1=(0.01, 0.0, 0.0))),
    "a push": lambda: scene().add_forces(pc.Wrench("rod_end", force=(1.0, 0.0, 0.0))),
    "a law": lambda: scene().add_forces(lambda t, q, v: 0.0 * v),
}


@pytest.mark.parametrize("what", WITH_EFFECT)
def test_spins_with_effects_stay(what):
    mech = WITH_EFFECT[what]()
    assert mech.lock_spins() is mech


def test_what_is_locked_is_logged(caplog):
    caplog.set_level("INFO")
    scene().lock_spins()
    assert "rods that spin freely are locked: rod_z" in caplog.text
    pc.load("four_bar").lock_spins()
    assert "four_bar: no rod spins freely" in caplog.text
