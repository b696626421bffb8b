"""Random chains: closed, reproducible, compared with equations that are right, and failures are found."""

import json
import time

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from benchmarks.app import main
from benchmarks.chains import campaign
from benchmarks.chains.campaign import FALSE, FINE, FOREIGN, HUNG, OPEN, Run, judged, runs
from benchmarks.chains.reference import Equations, Reference
from benchmarks.chains.scenes import random_chain
from benchmarks.chains_command import distribution
from benchmarks.linkages import pendulum

UNTIL = 0.05
RUN = Run(2, "", "BDF", 1e-5, HUNG)


@pytest.mark.parametrize("seed", range(12))
def test_chains_are_closed_and_reproducible(seed):
    (mech, q, v), (again, q_again, v_again) = random_chain(seed), random_chain(seed)
    assert (
        (q == q_again).all()
        and (v == v_again).all()
        and [repr(f) for f in mech.forces if "at 0x" not in repr(f)]
        == [repr(f) for f in again.forces if "at 0x" not in repr(f)]
    )
    assert Equations(mech).gap(0.0, q) < 1e-12 and pc.assemble(mech, q).moved < 1e-10


@pytest.mark.parametrize("seed", range(12))
def test_jacobian_and_bias_of_the_equations_by_differences(seed):
    mech, q, v = random_chain(seed)
    equations, size = Equations(mech), 1e-6
    q, v, _ = equations.closed(0.0, q, v)

    def moved(s):
        return equations.rows(s, pin.integrate(mech.model, q, s * v), v)

    (phi1, J1, rate1, _), (phi0, J0, rate0, _) = moved(size), moved(-size)
    _, J, rate, bias = moved(0.0)
    assert np.allclose((phi1 - phi0) / (2 * size), J @ v + rate, atol=1e-6 * (1.0 + np.abs(v).max()))
    slope = (J1 @ v + rate1 - J0 @ v - rate0) / (2 * size)
    assert np.abs(slope - bias).max() < 1e-6 * (1.0 + np.abs(bias).max())


def test_reference_of_a_pendulum():
    """Released from the horizontal: cos θ = ẋ-free energy, v² = 2 g (height lost)."""
    mech = pendulum()
    reference = Reference(mech, np.array([-1.0, 0.0]), np.zeros(2), 0.5)
    q, v, force = reference.at(0.4)
    assert reference.until == 0.5 and not reference.why
    assert q @ q == pytest.approx(1.0, abs=1e-12) and v @ v == pytest.approx(-2 * 9.81 * q[1], abs=1e-10)
    assert force == pytest.approx(-(v @ v - 9.81 * q[1]) * q, abs=1e-9)  # centripetal, and gravity along the rod


def test_a_run_is_compared_and_agrees():
    run = judged(RUN, UNTIL)
    assert run.outcome == FINE and run.gap < 1e-13 and max(run.q, run.v, run.force) < 100.0 and run.steps > 5


def broken(**changes):
    def simulate(*arguments, **options):
        sol = pc.simulate(*arguments, **options)
        for name, change in changes.items():
            object.__setattr__(sol, name, change(getattr(sol, name)))
        return sol

    return simulate


def raising(error):
    def simulate(*arguments, **options):
        raise error

    return simulate


@pytest.mark.parametrize(("simulate", "outcome"), [
    (raising(ValueError("shapes")), FOREIGN),
    (raising(pc.SingularSystemError("singular")), FALSE),
    (broken(success=lambda success: False, t=lambda t: 0.5 * t), FALSE),
    (broken(q=lambda q: q + 1e-6), OPEN),
])  # fmt: skip
def test_what_is_a_failure(monkeypatch, simulate, outcome):
    monkeypatch.setattr(campaign, "simulate", simulate)
    assert judged(RUN, UNTIL).outcome == outcome


@pytest.mark.parametrize(("seed", "tol"), [
    (40022, 1e-3),  # where steps grow, how fast shorter ones converged says little
    (50018, 1e-7),  # a finer run in the same steps has the same errors
])  # fmt: skip
def test_radau_knows_its_error(seed, tol):
    run = judged(Run(seed, "", "Radau", tol, HUNG), 0.4)
    assert run.outcome == FINE and 1 / 3 < run.estimate / max(run.q, run.v) < 3


@pytest.mark.parametrize(("seed", "tol"), [(60061, 1e-5), (60179, 1e-7)])
def test_radau_sees_friction_that_turns_before_the_first_stage(seed, tol):
    """The errors were 1187 and 157 tolerances: all stages of a step were behind the turn, and agreed."""
    run = judged(Run(seed, "", "Radau", tol, HUNG), 0.4)
    assert run.outcome == FINE and max(run.q, run.v, run.force) < 100.0


def test_an_error_is_measured_in_tolerances(monkeypatch):
    monkeypatch.setattr(campaign, "simulate", broken(v=lambda v: v + 1e-2))
    found = judged(RUN, UNTIL)
    largest = 1e-2 / (np.abs(random_chain(2)[2]).max() + 1.0) / RUN.tol
    assert found.outcome == FINE and largest < found.v <= 1e-2 / campaign.FLOOR / RUN.tol


def test_what_hangs_is_ended(monkeypatch):
    monkeypatch.setattr(campaign, "simulate", lambda *arguments, **options: time.sleep(60.0))
    first, second = runs([2], [1e-3, 1e-5], ["compiled"], until=UNTIL, limit=0.2)
    assert first.outcome == second.outcome == HUNG and "not done after" in first.message


def test_a_campaign_without_any_result_is_printed(monkeypatch, capsys):
    monkeypatch.setattr(campaign, "simulate", lambda *arguments, **options: time.sleep(60.0))
    with pytest.raises(SystemExit) as ended:
        main(f"chains --seed 2 --count 1 --tol 1e-3 --until {UNTIL} --limit 0.2".split())
    assert ended.value.code == 1 and "1 HUNG" in capsys.readouterr().out


def test_distribution():
    rows = [{"tol": 1e-3, "outcome": FINE, "q": q, "v": None, "force": None, "seed": int(q)}
            for q in (1.0, 2.0, 9.0)]  # fmt: skip
    (row,) = distribution([*rows, rows[0] | {"outcome": OPEN, "q": 99.0}])
    assert row["median"] == 2.0 and row["worst"] == 9.0 and row["seed"] == 9 and row["runs"] == 3


def test_command(capsys, tmp_path):
    with pytest.raises(SystemExit) as ended:
        main(
            [
                "chains",
                "--seed",
                "2",
                "--count",
                "2",
                "--tol",
                "1e-4",
                "--until",
                "0.05",
                "--csv",
                str(tmp_path / "c.csv"),
                "--json",
            ]
        )
    told = json.loads(capsys.readouterr().out)
    assert ended.value.code == 0 and told["counts"] == {FINE: 2} and len(told["runs"]) == 2
    assert len((tmp_path / "c.csv").read_text().splitlines()) == 3
