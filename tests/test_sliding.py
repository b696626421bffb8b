"""Sliding in three dimensions: pucks, boxes that slide and turn, legs that slip; certificates and tighter runs."""

import numpy as np
import pinocchio as pin
import pytest
from helpers import touching
from helpers.touching import G
from scipy.integrate import solve_ivp

import pinconsist as pc

TIGHT = {"rtol": 1e-11, "atol": 1e-13}
NOT_RESOLVED = 2e-8  # m: what flights may change that are too short to be resolved


@pytest.mark.parametrize("seed", range(12))
def test_sliding_ends_and_its_certificate_is_true(seed):
    """The error that `check` estimates, against the difference from a much tighter run."""
    mech, q, v = touching.random_slide(seed)
    sol = pc.simulate(mech, (0.0, 0.6), q, v)
    assert sol.success, sol.message
    certificate = sol.check(error=True)
    assert certificate.ok, str(certificate)
    assert certificate.position < 1e-9
    exact = pc.simulate(mech, (0.0, 0.6), q, v, t_eval=sol.t[-1:], **TIGHT)
    error = np.abs(pin.difference(mech.model, sol.q[-1], exact.q[-1])).max()
    assert error <= 3.0 * certificate.error.q + NOT_RESOLVED


@pytest.mark.parametrize("seed", range(12, 24))
def test_forces_of_what_slides_obey_their_laws(seed):
    """Gaps push; friction is at its limit and opposes the velocity; energy is lost only by it and by impacts."""
    mech, q, v = touching.random_slide(seed)
    sol = pc.simulate(mech, (0.0, 0.6), q, v)
    assert sol.success, sol.message
    largest = np.abs(sol.lam).max()
    for contact, (normal, *tangents) in zip(mech.contacts, np.split(sol.lam.T, len(mech.contacts)), strict=True):
        found, tangents = sol.contact(contact.name), np.transpose(tangents)
        assert normal.min() > -1e-7 * largest
        assert (np.linalg.norm(tangents, axis=1) - contact.friction[0] * normal).max() < 1e-6 * largest
        speed = np.linalg.norm(found.slip, axis=1)
        slides = np.array([mode == "slip" for mode in found.mode]) & (speed > 1e-3)
        opposed = (tangents * found.slip).sum(axis=1)[slides]
        np.testing.assert_allclose(opposed, -(contact.friction[1] * normal * speed)[slides], atol=1e-6 * largest)
    energy = sol.energy()
    assert energy.balance_error < 1e-4
    assert (energy.total - np.minimum.accumulate(energy.total)).max() < 1e-6


@pytest.mark.parametrize("seed", [30001, 30009, 30014, 30016, 30023, 30040])
def test_what_slides_slowly_comes_to_rest_at_loose_tolerances(seed):
    """Points of a body that turns slowly cannot all stick: what is slower than the tolerance stops first."""
    mech, q, v = touching.random_slide(seed)
    sol = pc.simulate(mech, (0.0, 0.8), q, v, rtol=1e-3, atol=1e-5)
    assert sol.success, sol.message
    exact = pc.simulate(mech, (0.0, 0.8), q, v)
    assert np.abs(pin.difference(mech.model, sol.q[-1], exact.q[-1])).max() < 2e-2  # m, rad
    assert [mode[-1] for mode in (sol.contact(each.name).mode for each in mech.contacts)] == [
        exact.contact(each.name).mode[-1] for each in mech.contacts
    ]
    assert np.diff(sol.energy().total).max() < 1e-5


def test_a_contact_whose_direction_turns_slides_on():
    """A point that slides ahead of a turning body: its velocity turns by more than a right angle, and never ends."""
    mech = touching.table([(0.4, 0.0), (-0.2, 0.35), (-0.2, -0.35)], friction=0.02)
    sol = pc.simulate(mech, (0.0, 0.6), v0=[1.0, 0.2, 0.0, 0.0, 0.0, 5.0], q0=[0, 0, 0.5, 0, 0, 0, 1])
    slip = sol.contact("leg0").slip
    turned = np.degrees(np.arccos(slip @ slip[0] / np.linalg.norm(slip, axis=1) / np.linalg.norm(slip[0])))
    assert turned.max() > 100.0 and {each.mode for each in sol.modes} == {"slip"}
    assert np.abs(np.diff(sol.energy().kinetic)).max() < 0.5  # nothing is lost at once
    assert sol.check().ok


def test_four_legs_that_slide_and_turn_share_their_load():
    """Legs of a square carry a quarter each: sliding and turning about the middle, against scipy."""
    friction, half, inertia, mass = 0.3, 0.3, 0.2, 2.0
    legs = [(x, y) for x in (half, -half) for y in (half, -half)]
    model_height = 1e-9  # of the centre of mass over the floor: friction does not tilt the load
    mech = touching.table(legs, friction=friction, height=model_height)
    v0 = np.array([0.6, 0.0, 0.0, 0.0, 0.0, 3.0])
    sol = pc.simulate(mech, (0.0, 0.15), v0=v0, q0=[0, 0, model_height, 0, 0, 0, 1], rtol=1e-9, atol=1e-11)

    def rate(t, y):
        angle, v, w = y[2], y[3:5], y[5]
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        force, moment = np.zeros(2), 0.0
        for leg in legs:
            arm = turn @ leg
            slip = v + w * np.array([-arm[1], arm[0]])
            own = -friction * mass * G / 4.0 * slip / np.linalg.norm(slip)
            force, moment = force + own, moment + arm[0] * own[1] - arm[1] * own[0]
        return [*v, w, *(force / mass), moment / inertia]

    exact = solve_ivp(rate, (0.0, 0.15), [0, 0, 0, 0.6, 0, 3.0], rtol=1e-12, atol=1e-13, method="DOP853").y[:, -1]
    np.testing.assert_allclose(sol.q[-1, :2], exact[:2], atol=1e-7)
    np.testing.assert_allclose([sol.v[-1, 5]], exact[5], atol=1e-6)
    np.testing.assert_allclose(sol.lam[-1].reshape(4, 3)[:, 0], mass * G / 4.0, rtol=1e-6)


def test_a_box_that_lands_flat_does_not_turn():
    """The impulses of four corners that fall on the floor at once are equal."""
    legs = [(x, y) for x in (0.3, -0.3) for y in (0.2, -0.2)]
    sol = pc.simulate(touching.table(legs, friction=0.5), (0.0, 0.3), q0=[0, 0, 0.52, 0, 0, 0, 1])
    impulses = [each for each in sol.impacts[0].impulses.values()]
    np.testing.assert_allclose([each[0] for each in impulses], 2.0 * np.sqrt(2.0 * G * 0.02) / 4.0, rtol=1e-6)
    np.testing.assert_allclose(sol.q[-1], [0, 0, 0.5, 0, 0, 0, 1], atol=1e-9)
    forces = [sol.contact(f"leg{i}").force[-1] for i in range(4)]
    np.testing.assert_allclose(forces, np.tile([0.0, 0.0, 2.0 * G / 4.0], (4, 1)), atol=1e-6)


def test_the_order_of_legs_does_not_matter():
    legs = [(x, y) for x in (0.3, -0.3) for y in (0.2, -0.2)]
    mech = touching.table(legs, friction=0.3)
    other = mech.with_contacts(*mech.contacts[::-1])
    start = {"q0": [0, 0, 0.5, 0, 0, 0, 1], "v0": [0.5, 0.3, 0.0, 0.0, 0.0, 2.0]}
    one, two = (pc.simulate(each, (0.0, 0.4), **start) for each in (mech, other))
    np.testing.assert_allclose(pin.difference(mech.model, one.q[-1], two.q[-1]), 0.0, atol=1e-7)
    assert pin.Quaternion(one.q[-1, 3:]).angularDistance(pin.Quaternion(np.array([0.0, 0, 0, 1]))) > 0.05
