"""Real closed-chain robots, as their authors wrote them. None is closed at q = 0; one cannot close at all."""

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from helpers.bodies import frame_pose
from helpers.extras import skips_missing_extras

import pinconsist as pc

ROBOTS = Path(__file__).resolve().parents[2] / "shared" / "robots"
if not ROBOTS.is_dir():
    pytest.skip(f"the robots' files are not here: {ROBOTS.name}", allow_module_level=True)

KNOWN = {  # nv, rows, rank
    "5bar_linkage": (6, 6, 3),
    "5bar_linkage_iso6d": (8, 6, 6),
    "robot_delta": (14, 18, 9),
    "cassie_like": (19, 12, 12),
    "digit_like": (27, 18, 18),
}
STUCK = {f"closedloop{number}" for number in (2, 7, 8, 9, 10)}


def load(name, **options):
    return pc.load(ROBOTS / name, **options)


def opening(mech, q):
    """(largest distance, largest angle) between the frames that must coincide, by forward kinematics alone."""
    gaps = []
    for loop in mech.loops:
        pose1 = frame_pose(mech.model, q, loop.frame1) * loop.placement1
        gap = pose1.actInv(frame_pose(mech.model, q, loop.frame2) * loop.placement2)
        angle = np.linalg.norm(pin.log3(gap.rotation)) if loop.kind == "frame" else 0.0
        gaps.append((np.linalg.norm(gap.translation), angle))
    return np.max(gaps, axis=0)


@pytest.mark.parametrize("name", KNOWN)
def test_closes_from_zero_and_from_random_guesses(name):
    mech, rng = load(name), np.random.default_rng(0)
    nv, rows, rank = KNOWN[name]
    assert mech.nv == nv
    neutral = pin.neutral(mech.model)
    assert opening(mech, neutral).max() > 0.01  # not closed as it comes
    for guess in [neutral, *(pin.integrate(mech.model, neutral, rng.uniform(-1, 1, nv)) for _ in range(5))]:
        result = pc.assemble(mech, guess, rng.normal(size=nv))
        assert opening(mech, result.q).max() < 1e-10 and result.largest_gap[1] < 1e-10
        assert (result.rows, result.rank, result.mobility) == (rows, rank, nv - rank)
        assert len(result.redundant) == rows - rank
        after = opening(mech, pin.integrate(mech.model, result.q, 1e-7 * result.v))
        assert after.max() < 1e-11 * (1 + np.abs(result.v).max()) ** 2  # J v = 0


def test_kangaroo_is_refused_by_name():
    with pytest.raises(pc.AssemblyError, match=r"5 of 11 loops cannot close.*reanchored\(\)") as caught:
        pc.assemble(load("kangaroo_like"))
    gaps = caught.value.gaps
    assert set(gaps) == STUCK and all(1e-4 < gap < 5e-2 for gap in gaps.values())
    assert all(repr(name) in str(caught.value) for name in STUCK)
    assert caught.value.q.shape == (load("kangaroo_like").nq,)


def test_kangaroo_closes_by_points():
    mech = load("kangaroo_like", closure="point")
    result = pc.assemble(mech)
    assert opening(mech, result.q)[0] < 1e-10 and (result.rows, result.rank) == (33, 32)


def test_kangaroo_closes_reanchored():
    mech = load("kangaroo_like")
    with pytest.warns(UserWarning, match="anchor 2 moved") as caught:
        moved = mech.reanchored()
    assert all(repr(name) in str(caught[0].message) for name in STUCK)
    result = pc.assemble(moved)
    assert opening(moved, result.q).max() < 1e-10 and (result.rows, result.rank) == (66, 53)
    for before, after in zip(mech.loops, moved.loops, strict=True):
        assert np.linalg.norm(np.subtract(after.xyz2, before.xyz2)) < 0.1  # a best fit, not a new design


def energies(mech, sol):
    """(total, kinetic) energy of each row."""
    model, data = mech.model, mech.model.createData()
    kinetic = np.array([pin.computeKineticEnergy(model, data, q, v) for q, v in zip(sol.q, sol.v, strict=True)])
    return kinetic + [pin.computePotentialEnergy(model, data, q) for q in sol.q], kinetic


def constraint_forces(sol):
    """Jᵀλ of each row; with redundant rows λ itself means nothing."""
    return np.array([sol.system.loop_rows(q)[1].T @ lam for q, lam in zip(sol.q, sol.lam, strict=True)])


def forces_from_motion(mech, sol, rows):
    """M a + nle, a by fourth-order differences of the recorded velocities: what the loops must have carried."""
    model, data, h, v = mech.model, mech.model.createData(), sol.t[1] - sol.t[0], sol.v
    a = {i: (v[i - 2] - 8 * v[i - 1] + 8 * v[i + 1] - v[i + 2]) / (12 * h) for i in rows}
    return np.array([pin.rnea(model, data, sol.q[i], v[i], a[i]) for i in rows])


# Largest energy error over the largest kinetic energy, of order 3: measured 1.44e-5, 1.83e-6 (h/2) and 4.8e-7, 6.0e-8
# (h/2); the bounds leave a factor of two.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "until", "h", "drift"), [("5bar_linkage_iso6d", 0.5, 1e-3, 3e-5), ("robot_delta", 0.25, 2.5e-4, 1e-6)]
)
def test_falls_from_rest_with_closed_loops_and_constant_energy(name, until, h, drift):
    mech = load(name)
    runs = [pc.simulate(mech, (0.0, until), step=step, order=3) for step in (h, h / 2)]
    errors = []
    for sol in runs:
        assert sol.success and sol.t[-1] == until and np.abs(sol.v).max() > 1.0  # it does fall
        openings = np.array([opening(mech, q) for q in sol.q])
        assert openings.max() < 1e-12
        total, kinetic = energies(mech, sol)
        errors.append(np.abs(total - total[0]).max() / kinetic.max())
        certificate = sol.check(error=False)
        assert certificate.position < 1e-12 and certificate.velocity < 1e-10 and certificate.force < 1e-4
        exchanged = kinetic.max() + np.ptp(total - kinetic)
        assert certificate.energy_error == pytest.approx(errors[-1] * kinetic.max() / exchanged, rel=1e-6)
    assert errors[0] < drift and np.log2(errors[0] / errors[1]) > 2.7
    coarse, fine = (constraint_forces(sol) for sol in runs)
    size = np.abs(fine).max()
    assert np.abs(coarse - fine[::2]).max() < 1e-4 * size
    rows = range(2, len(fine) - 2, 10)
    np.testing.assert_allclose(forces_from_motion(mech, runs[1], rows), fine[rows], atol=1e-4 * size)


def not_carried(mech, found):
    """(largest joint force, largest net force in space) that is left with loops cut and their reactions put on instead.

    By Newton and Euler on the open tree with the wrenches that ``reaction`` gives; J is not looked at.
    """
    model, data, rest = mech.model, mech.model.createData(), np.zeros(mech.nv)
    pin.framesForwardKinematics(model, data, found.q)
    outside, ground, forces = [pin.Force.Zero() for _ in range(model.njoints)], np.zeros(3), np.zeros(mech.nv)
    for loop in mech.loops:
        reaction = found.reaction(loop.name)
        if reaction.force is None:
            forces += reaction.joint_forces[0]
            continue
        at = (data.oMf[model.getFrameId(loop.frame2)] * loop.placement2).translation
        wrench = pin.Force(reaction.force[0], reaction.moment[0] + np.cross(at, reaction.force[0]))
        for frame, sign in ((loop.frame1, -1), (loop.frame2, 1)):
            joint = model.frames[model.getFrameId(frame)].parentJoint
            if joint:
                outside[joint] += data.oMi[joint].actInv(sign * wrench)
            else:
                ground += sign * wrench.linear
    forces += sum((force.bind(model).torque(0.0, found.q, rest) for force in mech.forces), np.zeros(mech.nv))
    torques = pin.rnea(model, data, found.q, rest, rest, outside)
    roots = [joint for joint in range(1, model.njoints) if model.parents[joint] == 0]
    held = sum((data.oMi[joint].act(data.f[joint]).linear for joint in roots), -ground)
    weight = sum(inertia.mass for inertia in model.inertias[1:]) * model.gravity.linear
    size = max(np.abs(weight).max(), np.abs(found.lam).max())
    return np.abs(torques - forces).max() / size, np.abs(held + weight).max() / size


@pytest.mark.parametrize("name", [*KNOWN, "kangaroo_like", "cassie", "cassie_v2"])
def test_reactions_balance_the_weight(name):
    """The cut mechanism rests under the reactions of its loops. Kangaroo's motors are held: without them it slides."""
    if name.startswith("cassie") and name not in KNOWN:
        with skips_missing_extras():
            mech = pc.load(name)
    else:
        mech = load(name, closure="point") if name == "kangaroo_like" else load(name)
    if name == "kangaroo_like":
        q = pc.assemble(mech).q
        place = [mech.model.idx_qs[mech.joint_index(joint)] for joint in mech.actuated]
        held = [pc.Drive(f"hold {j}", j, pc.Motion(float(q[i]))) for j, i in zip(mech.actuated, place, strict=True)]
        mech = mech.add_loops(*held)
        found = pc.equilibrium(mech, q)
    else:
        found = pc.equilibrium(mech)
    assert max(not_carried(mech, found)) < 1e-12
    assert (found.stiffness >= 0).all() and np.abs(found.lam).max() > 0.01
