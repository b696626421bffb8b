"""check() compares impacts one by one with those of a finer run: times, impulses, what is missed."""

import json
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pinocchio as pin
import pytest
from helpers import touching
from helpers.touching import G

import pinconsist as pc
from benchmarks.linkages import add_body, at
from pinconsist.mechanism.mode_system import Mode
from pinconsist.run.certificate import from_plain, plain
from pinconsist.run.contact_results import ContactHistory
from pinconsist.run.impact_errors import _Hit, paired
from pinconsist.run.modes import Period
from pinconsist.view.curves import verdicts
from pinconsist.view.motion import runs_of

LOOSE, TIGHT = ({"rtol": rtol, "atol": 1e-2 * rtol} for rtol in (1e-3, 1e-10))


def double_pendulum(*contacts):
    model = pin.Model()
    model.gravity.linear = np.array([0.0, 0.0, -G])
    one = add_body(model, 0, pin.JointModelRY(), at(0, 0), "one", 1.0, (0, 0, -0.5), 0.1)
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, -1.0]))
    add_body(model, one, pin.JointModelRY(), place, "two", 1.0, (0, 0, -0.5), 0.1)
    return pc.Mechanism(model, contacts=contacts, name="double pendulum")


def swinging(**options):
    return pc.simulate(touching.pendulum(-0.4, 0.5, 1.0), (0.0, 30.0), [0.1], [2.0], **options)


def with_impacts(sol, impacts):
    """The solution with other impacts."""
    return replace(sol, contacts=replace(sol.contacts, impacts=tuple(impacts)))


def test_a_hundred_bounces_are_compared_one_by_one():
    sol = pc.simulate(touching.ball(0.9), (0.0, 20.0), {"z": 1.0})
    found = sol.check()
    assert found.ok and found.not_judged == [] and found.verdict.endswith(": ok")
    assert found.impacts.compared >= 100 and found.impacts.missed == found.impacts.extra == ()
    assert found.impacts.time < 1e-8 and found.impacts.impulse < 1e-8


@pytest.mark.parametrize("rtol", [1e-2, 1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("restitution", [0.5, 0.9])
def test_a_ball_may_rest_earlier_than_in_the_finer_run(rtol, restitution):
    """The bounces that are slower than the tolerance are no concern: the finer run has dozens more of them."""
    sol = pc.simulate(touching.ball(restitution), (0.0, 20.0), {"z": 1.0}, rtol=rtol, atol=1e-2 * rtol)
    assert sol.check().ok, sol.check()


@pytest.mark.parametrize("options", [LOOSE, {"rtol": 1e-6}, {"step": 0.02, "order": 5}])
def test_errors_of_times_and_impulses_are_those_against_a_tight_run(options):
    sol, exact = swinging(**options), swinging(**TIGHT)
    found = sol.check()
    assert found.ok and found.impacts.compared == len(exact.impacts) == len(sol.impacts)
    pairs = list(zip(sol.impacts, exact.impacts, strict=True))
    late = max(abs(one.t - other.t) for one, other in pairs)
    apart = 0.0
    for name in ("hinge lower", "hinge upper"):
        impulses = np.array([[each.impulses[name] for each in pair] for pair in pairs if name in pair[0].impulses])
        apart = max(apart, np.abs(np.diff(impulses)).max() / impulses.max())
    assert found.impacts.time == pytest.approx(late, rel=0.2)
    assert found.impacts.impulse == pytest.approx(apart, rel=0.2)


def test_a_missed_bounce_is_named_on_page_and_in_json(tmp_path):
    """The second rod turns back 0.01 rad before its stop, but in the finer run it hits it."""
    mech = double_pendulum(pc.Stop("two", upper=2.8, restitution=0.5))
    sol = pc.simulate(mech, (0.0, 3.6), [1.5, 1.0], step=0.02, order=3)
    found = sol.check()
    assert not sol.impacts and not found.ok
    (missed,) = found.impacts.missed
    assert missed.contact == "two upper" and missed.t == pytest.approx(3.24, abs=0.03) and missed.unit == "rad/s"
    assert found.verdict.endswith("look at impacts") and "misses impacts" in str(found) and "'two upper'" in str(found)
    assert verdicts(runs_of(mech, sol)) == [{"text": found.verdict, "ok": False}]
    assert from_plain(json.loads(json.dumps(plain(found)))).impacts == found.impacts
    assert pc.Solution.load(sol.save(tmp_path / "run.npz")).check() == found


def test_a_missing_an_extra_and_a_displaced_impact_are_told_apart():
    sol = swinging(rtol=1e-6)
    impacts = list(sol.impacts)
    missed = with_impacts(sol, impacts[:20] + impacts[21:]).check()
    assert [each.t for each in missed.impacts.missed] == pytest.approx([impacts[20].t], abs=1e-5)
    assert missed.impacts.extra == () and list(missed._named_concerns) == ["impacts"]
    twice = impacts[20]._replace(t=impacts[20].t + 0.1)
    extra = with_impacts(sol, [*impacts[:21], twice, *impacts[21:]]).check()
    assert [each.t for each in extra.impacts.extra] == [twice.t] and extra.impacts.missed == ()
    late = with_impacts(sol, [*impacts[:20], twice, *impacts[21:]]).check()
    assert late.impacts.time == pytest.approx(0.1, abs=1e-5) and list(late._named_concerns) == ["times of impacts"]
    name, impulse = next(iter(impacts[20].impulses.items()))
    strong = impacts[20]._replace(impulses={name: 1.05 * impulse})
    of_impulse = with_impacts(sol, [*impacts[:20], strong, *impacts[21:]]).check()
    assert list(of_impulse._named_concerns) == ["impulses"] and "at t = " in of_impulse.impacts.impulse_at


def test_impacts_that_nobody_compared_are_not_judged():
    sol = pc.simulate(touching.ball(0.5), (0.0, 2.0), {"z": 1.0})
    assert sol.check(error=False).not_judged == ["error", "impacts"] and sol.check().not_judged == []
    flying = pc.simulate(touching.ball(0.5), (0.0, 0.2), {"z": 1.0})
    assert flying.check(error=False).not_judged == ["error"] and flying.check().impacts is None


def test_a_run_that_begins_and_ends_with_impacts_is_compared_from_its_beginning_to_its_end():
    """All its steps end at impacts: rows at which states jump are not compared, but the impacts between them are."""
    first = 6.0 / G
    sol = pc.simulate(touching.ball(1.0), (0.0, 4.0 * first), [0.0], [-3.0])
    assert sol.impacts[0].t == 0.0 and sol.check().impacts.compared >= 3 and sol.check().ok, sol.check()
    broken = with_impacts(sol, [sol.impacts[0], *sol.impacts[2:]])
    assert broken.check().impacts.missed[0].t == pytest.approx(first)


def test_rows_between_an_impact_of_one_run_and_of_the_other_are_not_compared():
    """There the velocities of the two runs differ by all of the jump."""
    exact = swinging(**TIGHT).impacts[-1].t
    sol = swinging(**LOOSE, t_eval=[0.0, 1.0, 30.0])
    between = 0.5 * (sol.impacts[-1].t + exact)
    assert abs(sol.impacts[-1].t - exact) > 1e-6
    again = swinging(**LOOSE, t_eval=[0.0, 1.0, between, 30.0])
    assert again.impacts[-1].t == sol.impacts[-1].t and again.check().ok, again.check()


@pytest.mark.parametrize("rtol", [1e-3, 1e-6])
def test_friction_that_turns_a_little_later_in_the_finer_run_is_no_error_of_forces(rtol):
    """A pendulum with dry friction turns back without a rest: the friction jumps at the last row before or after."""
    mech = touching.pendulum(-3.0, 3.0, 0.0).add_contacts(pc.DryFriction("hinge", 0.4))
    sol = pc.simulate(mech, (0.0, 6.0), [1.5], rtol=rtol, atol=1e-2 * rtol)
    assert len(sol.contacts.tables) > 4 and sol.check().ok, sol.check()


def test_rows_of_several_changes_at_one_time_belong_to_their_modes():
    """Each change has its row, also one after which the modes are the same."""
    kinds = {0.0: ["open"], 1.0: ["slip", "slip", "stick"], 2.0: ["open"]}
    tables = [(t, (Mode(kind),)) for t, each in kinds.items() for kind in each]
    element = SimpleNamespace(name="c")
    systems = [SimpleNamespace(modes=table, elements=[element], still=0.0) for _, table in tables]
    periods = [Period(t, system) for (t, _), system in zip(tables, systems, strict=True)]
    history = ContactHistory.of(SimpleNamespace(periods=periods, impacts=[]))
    found = [history.tables[k][0].kind for k in history.of_rows([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.5, 2.0, 2.0])]
    assert found == ["open", "open", "open", "slip", "slip", "stick", "stick", "stick", "open"]
    assert [each.mode for each in history.modes(3.0)] == ["open", "stick", "open"]


def hits(times, speeds):
    return [_Hit(t, speed, np.ones(1)) for t, speed in zip(times, speeds, strict=True)]


def test_pairs_beyond_bounces_that_one_run_leaves_out():
    """A ball is thrown twice; one run has 20 bounces of each throw, the other 35."""
    fades = 0.7 ** np.arange(35)
    times = np.concatenate((1.0 + np.cumsum(0.5 * fades), 10.0 + np.cumsum(0.5 * fades)))
    many = hits(times, np.tile(fades, 2))
    kept = [*range(20), *range(35, 55)]
    few = [many[i]._replace(t=many[i].t + 1e-6) for i in kept]
    assert paired(few, many, 15.0) == list(enumerate(kept))
    assert paired(many, few, 15.0) == [(j, i) for i, j in enumerate(kept)]


def test_ten_thousand_impacts_of_which_some_are_missed():
    rng = np.random.default_rng(3)
    times = np.cumsum(rng.uniform(0.5, 1.5, 10_000))
    every = hits(times, rng.uniform(0.5, 1.0, 10_000))
    kept = np.delete(np.arange(10_000), [0, 17, 5000, 5001, 9999])
    assert paired([every[i] for i in kept], every, times[-1]) == list(enumerate(kept.tolist()))
    assert paired([], every, 1.0) == paired(every, [], 1.0) == []


def test_the_figures_are_plain_data():
    found = pc.simulate(touching.ball(0.5), (0.0, 2.0), {"z": 1.0}).check()
    assert json.loads(json.dumps(asdict(found.impacts)))["compared"] == found.impacts.compared > 3
