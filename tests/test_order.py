"""Orders of the multipliers, measured: k-1 from exact values, k from consistent ones and with every step corrected."""

import numpy as np
import pytest
from helpers.zoo import scaled_bead

import pinconsist as pc

MODES = {"exact": -1, "consistent": 0, "every_step": 0}
# step sizes at which order k is measured: small enough to be asymptotic, large enough to stay above the rounding floor
STEPS = {1: 1 / 800, 2: 1 / 400, 3: 1 / 400, 4: 1 / 200, 5: 1 / 100}
FINER = {"every_step": 0.5}  # its floor is lower, and k = 5 comes down to its order later (5.5, 5.3, ...)


def multiplier_orders(subject, k, h, **start):
    """Observed order of the largest λ error over the first k+2 BDF steps, for each mode."""
    orders = {}
    for mode in MODES:
        step = h * FINER.get(mode, 1.0)
        coarse, fine = pc.paper.compare(subject, [step, step / 2], order=k, count=k + 2, **start).runs
        orders[mode] = np.log2(getattr(coarse, mode)[k:].max() / getattr(fine, mode)[k:].max())
    return orders


@pytest.mark.parametrize("k", STEPS)
@pytest.mark.parametrize("name", ["problem51", "problem52"])
def test_multiplier_order_on_the_papers_problems(name, k):
    orders = multiplier_orders(name, k, STEPS[k])
    for mode, change in MODES.items():
        assert orders[mode] == pytest.approx(k + change, abs=0.35), mode


@pytest.mark.parametrize(("k", "h"), [(1, 1 / 4000), (2, 1 / 800), (3, 1 / 800), (4, 1 / 400), (5, 1 / 200)])
def test_multiplier_order_on_a_closed_chain(k, h):
    """A genuine closed chain: the mass matrix depends on the configuration."""
    orders = multiplier_orders(pc.load("crank_rocker"), k, h, q0={"crank": 0.3}, v0={"crank": 3.0})
    for mode, change in MODES.items():
        assert orders[mode] == pytest.approx(k + change, abs=0.35), mode


@pytest.mark.parametrize("k", range(1, 7))
def test_positions_and_velocities_have_order_k(k):
    """BDF-k over a fixed interval of problem 5.1, against the closed form."""
    problem = pc.paper.reference_problem("problem51")
    errors = []
    for h in (1 / 80, 1 / 160) if k > 4 else (1 / 160, 1 / 320):
        sol = pc.integrate(problem.system, (0.0, 0.5), problem.p0, problem.v0, step=h, order=k, method="BDF")
        p, v, _ = problem.exact(0.5)
        errors.append((np.abs(sol.q[-1] - p).max(), np.abs(sol.v[-1] - v).max()))
    orders = np.log2(np.divide(*errors))
    assert (orders > k - 0.3).all(), orders


@pytest.mark.parametrize("k", [1, 3, 5])
def test_backwards_in_time_has_the_same_order(k):
    problem = pc.paper.reference_problem("problem51")
    p1, v1, _ = problem.exact(0.3)
    errors = []
    for h in (1 / 100, 1 / 200):
        sol = pc.integrate(problem.system, (0.3, 0.0), p1, v1, step=h, order=k, method="BDF")
        assert sol.success and sol.t[-1] == 0.0
        errors.append(max(np.abs(sol.lam[i] - problem.exact(t)[2]).max() for i, t in enumerate(sol.t)))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(k, abs=0.6)


def test_table_of_largest_errors_at_one_four_hundredth():
    """The published magnitudes for problem 5.1 at h = 1/400, first k+2 steps."""
    table = {  # k: exact, consistent, every-step
        1: (2.02, 2.1e-2, 1.0e-2),
        2: (1.5e-2, 8.7e-5, 2.9e-5),
        3: (1.2e-5, 7.2e-7, 2.5e-7),
        4: (1.1e-6, 9.0e-9, 4.1e-9),
    }
    for k, expected in table.items():
        run = pc.paper.compare("problem51", [1 / 400], order=k, count=k + 2).runs[0]
        found = [getattr(run, mode)[k:].max() for mode in MODES]
        np.testing.assert_allclose(found, expected, rtol=0.05)


def test_every_step_correction_lowers_the_rounding_floor():
    """Raw BDF-5 multipliers drown in eps/h²; corrected ones in about 10 eps/h."""
    h = 1e-4
    run = pc.paper.compare("problem51", [h], order=5, count=7).runs[0]
    assert run.every_step[5:].max() < 1000 * np.finfo(float).eps / h
    assert run.consistent[5:].max() > 100 * run.every_step[5:].max()


@pytest.mark.parametrize("k", [1, 3, 5, 2, 4])
@pytest.mark.parametrize("consistency", ["every-step", "initial"])
def test_orders_where_the_kinematics_depend_on_the_position(consistency, k):
    """U(t, p, v) of the general form, which neither a mechanism nor the paper's problems have."""
    problem, exact = scaled_bead()
    p0, v0, _ = exact(0.0)
    errors = []
    steps = {4: (1 / 80, 1 / 160), 5: (1 / 40, 1 / 80)}.get(k, (1 / 160, 1 / 320))
    for h in steps:
        sol = pc.integrate(problem, (0.0, 0.5), p0, v0, step=h, order=k, consistency=consistency, method="BDF")
        p, v, lam = (np.array(column) for column in zip(*map(exact, sol.t), strict=True))
        errors.append([np.abs(ours - theirs).max() for ours, theirs in ((sol.q, p), (sol.v, v), (sol.lam[:, 0], lam))])
    # The multipliers follow from positions of size 1, which the formula (its coefficients are Σ 2ⁱ/i in all)
    # differentiates twice, or from corrected velocities, differentiated once: so much of the rounding can be in them.
    times = {"initial": 2, "every-step": 1}[consistency]
    floor = np.finfo(float).eps * (sum(2**i / i for i in range(1, k + 1)) / steps[1]) ** times
    assert floor < 0.05 * errors[1][2]  # so that rounding changes the observed order by less than 0.1
    assert np.log2(np.divide(*errors)) == pytest.approx(k, abs=0.5)


def test_the_papers_initial_velocity_where_the_kinematics_depend_on_the_position():
    """The first multiplier of implicit Euler is wrong by O(1) from the exact velocity, by O(h) from the paper's."""
    problem, exact = scaled_bead()
    p0, v0, _ = exact(0.0)
    first = {}
    for h in (1e-2, 1e-3):
        for start in (v0, pc.paper.consistent_initial_velocity(problem, 0.0, p0, v0, h)):
            sol = pc.integrate(problem, (0.0, h), p0, start, step=h, order=1, consistency="exact", method="BDF")
            first.setdefault(h, []).append(abs(sol.lam[1, 0] - exact(h)[2]))
    (raw, cured), (finer_raw, finer_cured) = first.values()
    assert min(raw, finer_raw) > 0.3
    assert cured / finer_cured == pytest.approx(10.0, rel=0.2)


def test_a_first_step_from_near_rest_comes_down_to_rounding():
    """The velocity that it predicts is thousands of times too small to measure rounding by."""
    mech = pc.load("crank_rocker")
    for count in (144, 147, 150, 152, 193, 195):
        options = {"method": "ImplicitEuler", "step": 1.0 / count, "consistency": "initial"}
        sol = pc.simulate(mech, (0.0, 1.0), max_steps=2, **options)
        assert len(sol.t) == 3 and sol.message.startswith("max_steps"), sol.message
