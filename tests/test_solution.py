"""The record of a run: its file, its certificate, its words."""

import dataclasses
import json
import pickle
import re
import zipfile

import numpy as np
import pinocchio as pin
import pytest

import pinconsist as pc
from pinconsist.run.solution import Solution
from pinconsist.view.curves import verdicts
from pinconsist.view.motion import runs_of

ARRAYS = ("t", "q", "v", "lam", "h", "order")


@pytest.fixture(scope="module")
def run():
    return pc.simulate(pc.load("four_bar"), (0.0, 0.3), v0={"crank": 1.0}, step=0.005, order=4, method="BDF")


def spinner(damping=0.0):
    """One body of 2 kg m² on a hinge, no gravity: I v' = τ - d v."""
    model = pin.Model()
    hinge = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "hinge")
    model.appendBodyToJoint(hinge, pin.Inertia(1.0, np.zeros(3), np.eye(3) * 2.0), pin.SE3.Identity())
    model.gravity.setZero()
    model.damping[:] = damping
    return pc.Mechanism(model, name="spinner")


@pytest.mark.parametrize("options", [{"step": 0.01, "order": 2}, {}, {"t_eval": [0.05, 0.1]}])
def test_round_trip_through_a_file(tmp_path, options):
    mech = pc.load("five_bar")
    sol = pc.simulate(mech, (0.0, 0.1), **options, method="BDF")
    path = sol.save(tmp_path / "run")
    assert path == tmp_path / "run.npz" and [each.name for each in tmp_path.iterdir()] == ["run.npz"]
    with np.load(path, allow_pickle=False) as stored:  # any numpy can read it
        assert stored["t"].tolist() == sol.t.tolist() and json.loads(str(stored["about"]))["scene"] == "five_bar"
    back = Solution.load(path)
    for name in ARRAYS:
        found = getattr(back, name)
        np.testing.assert_array_equal(found, getattr(sol, name))
        assert found.dtype == getattr(sol, name).dtype and not found.flags.writeable
    for name in ("success", "status", "message", "nsteps", "nfev", "njev", "nlu", "rejected", "method", "scene"):
        assert getattr(back, name) == getattr(sol, name), name
    assert back.system is None and back.summary() == sol.summary()
    with pytest.raises(pc.InputError, match=r"sol\.check\(mechanism\)"):
        back.check()
    assert back.check(mech) == sol.check() == back.check()


def test_the_verdict_is_made_once_and_kept_in_the_file(tmp_path):
    """Page, file and Python have the same one, also if the run had forces that the mechanism does not have."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.2), forces=[lambda t, q, v: -0.1 * v])
    before = sol.save(tmp_path / "before.npz")
    shown = verdicts(runs_of(mech, sol))
    assert shown == [{"text": sol.check().verdict, "ok": True}] and "error of q" in sol.check().verdict
    assert sol.check() is sol.certificate and sol.mechanism.forces and sol.certificate.not_judged == []
    read = Solution.load(sol.save(tmp_path / "run.npz"))
    assert read.check() == sol.check() and read.error == sol.error and read.mechanism is None
    assert verdicts(runs_of(mech, read)) == shown
    (unknown,) = verdicts(runs_of(mech, Solution.load(before)))
    assert not unknown["ok"] and unknown["text"].startswith("not judged: the run had 1 forces")
    changed = edited(sol, "lam", 3, 100.0)
    assert changed.certificate is None and changed.check().verdict != sol.check().verdict


def test_a_page_is_not_green_about_what_was_not_judged(monkeypatch):
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.2))
    with monkeypatch.context() as impatient:
        impatient.setattr("pinconsist.run.solution.FINER_TIME", 0.0)
        assert sol.check().ok and sol.certificate.not_judged == ["error"]
    assert verdicts(runs_of(mech, sol)) == [{"text": sol.certificate.verdict, "ok": False}]
    assert sol.check(error=True).not_judged == [] and verdicts(runs_of(mech, sol))[0]["ok"]


def test_a_page_has_the_verdict_of_check_whatever_was_asked_before():
    mech = pc.load("five_bar")
    sol = pc.simulate(mech, (0.0, 3.0))
    assert sol.check(error=False).ok  # by its residuals
    (told,) = verdicts(runs_of(mech, sol))
    assert not told["ok"] and told["text"] == str(sol.check()).splitlines()[0]
    assert "error" in told["text"].partition("look at")[2]


@pytest.mark.parametrize("name", ["q", "v", "lam"])
def test_numbers_that_are_not_finite_are_not_certified(run, name):
    bad = edited(run, name, 7, np.nan)
    for found in (bad.check(error=False), bad.check()):
        assert not found.ok and found.concerns == [f"{name}[0] at t = {run.t[7]:.6g} s is not a finite number"]
        assert found.verdict.endswith("nothing was judged") and found.concerns[0] in str(found)


def test_figures_that_are_not_numbers_are_concerns(run):
    good = run.check()
    for name in ("position", "velocity", "force", "energy_error"):
        assert not dataclasses.replace(good, **{name: np.nan}).ok, name
    for name in ("force", "tolerances"):
        assert not dataclasses.replace(good, error=dataclasses.replace(good.error, **{name: np.nan})).ok, name


@pytest.mark.parametrize(("kind", "digits"), [(">f8", 0.0), ("<f4", 1e-6), ("f2", 1e-2), (np.longdouble, 0.0)])
def test_files_of_other_number_types_are_converted(tmp_path, run, kind, digits):
    """Arrays as other programs store them."""
    arrays = {name: getattr(run, name).astype(kind) for name in ("q", "v", "lam", "h")}
    rewritten(tmp_path / "run.npz", run, order=run.order.astype("i1"), **arrays)
    back = Solution.load(tmp_path / "run.npz")
    assert back.order.dtype == run.order.dtype and (back.order == run.order).all()
    for name in arrays:
        assert getattr(back, name).dtype == float and getattr(back, name).dtype.isnative
        size = np.abs(getattr(run, name)).max()
        assert np.abs(getattr(back, name) - getattr(run, name)).max() <= digits * size
    assert back.check(pc.load("four_bar"), error=False).position < max(1e-8, 10 * digits)


def bouncing(**options):
    """A mass that falls on a floor and bounces, and an event that does not occur."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "z")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    events = [pc.Impact("z", lower=0.0, restitution=0.8), pc.Event(lambda t, q, v, lam: q[0] - 5.0)]
    return pc.simulate(pc.Mechanism(model), (0.0, 2.0), {"z": 1.0}, events=events, **options)


@pytest.mark.parametrize("options", [{}, {"method": "Radau", "t_eval": np.linspace(0.0, 2.0, 7)}])
def test_events_are_in_the_file(tmp_path, options):
    """Their times and states; the error cannot be judged from a file, as their functions are not in it."""
    sol = bouncing(**options)
    back = Solution.load(sol.save(tmp_path / "bounces"))
    falls = np.sqrt(2.0 / 9.81) * np.array([1.0, 2.6, 3.88])
    np.testing.assert_allclose(back.t_events[0], falls[falls < 2.0], rtol=1e-6)
    for name in ("t_events", "q_events", "v_events"):
        assert [each.tobytes() for each in getattr(back, name)] == [each.tobytes() for each in getattr(sol, name)]
        assert not any(each.flags.writeable for each in getattr(back, name))
    assert len(back.t_events) == 2 and back.t_events[1].size == 0
    assert "error" in back.check(sol.mechanism).not_judged
    assert Solution.load(back.save(tmp_path / "again")).v_events[0].tobytes() == sol.v_events[0].tobytes()


@pytest.mark.parametrize(
    ("name", "array", "words"),
    [
        ("t_events 0", np.zeros((3, 1)), "array 't_events 0' has shape"),
        ("q_events 0", np.zeros((2, 1)), "array 'q_events 0' has shape"),
        ("v_events 0", np.zeros((3, 2)), "array 'v_events 0' has shape"),
        ("t_events 2", np.zeros(3), "q_events 2"),
        ("t_events 0", np.array(["a"] * 3), "not numbers"),
    ],
)
def test_events_of_wrong_shapes_are_refused(tmp_path, name, array, words):
    path = bouncing().save(tmp_path / "bounces.npz")
    with np.load(path) as stored:
        parts = dict(stored) | {name: array}
    np.savez(path, **parts)
    with pytest.raises(pc.FormatError, match=words):
        Solution.load(path)


def test_saving_replaces_a_file_whole_or_not_at_all(tmp_path, run, monkeypatch):
    path = run.save(tmp_path / "run.npz")
    before = path.read_bytes()

    def breaks(stream, **arrays):
        stream.write(b"half")
        raise OSError("disk full")

    monkeypatch.setattr(np, "savez", breaks)
    with pytest.raises(OSError, match="disk full"):
        run.save(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def write_truncated(path, run):
    path.write_bytes(run.save(path).read_bytes()[:500])


def write_foreign(path, run):
    np.savez(path, x=np.arange(3))


def write_array(path, run):
    np.save(path.with_suffix(".npy"), np.arange(3))
    path.with_suffix(".npy").rename(path)


def write_pickled(path, run):
    np.savez(path, about=np.array({"format": 1}, dtype=object), **{name: getattr(run, name) for name in ARRAYS})


def rewritten(path, run, save=np.savez, **changes):
    with np.load(run.save(path)) as stored:
        parts = dict(stored)
    about = json.loads(str(parts["about"]))
    for name, value in changes.items():
        (parts if name in ARRAYS else about)[name] = value
    parts["about"] = np.array(json.dumps({name: each for name, each in about.items() if each is not LEFT_OUT}))
    save(path, **parts)


LEFT_OUT = "left out"
BAD_FILES = {
    "missing": (lambda path, run: None, "no such file"),
    "folder": (lambda path, run: path.mkdir(), "not a solution.*directory"),
    "empty": (lambda path, run: path.write_bytes(b""), "not a solution written by pinconsist"),
    "text": (lambda path, run: path.write_text("t, q, v"), "not a solution"),
    "truncated": (write_truncated, "damaged, or not a solution"),
    "foreign": (write_foreign, "not a solution"),
    "one array": (write_array, "not a solution"),
    "pickle": (write_pickled, "not a solution"),
    "zip": (lambda path, run: zipfile.ZipFile(path, "w").close(), "not a solution"),
    "newer": (lambda path, run: rewritten(path, run, format=99), "by pinconsist .* in format 99.* reads format 4"),
    "older": (lambda path, run: rewritten(path, run, format=1, versions=LEFT_OUT), "another version .* in format 1;"),
    "no format": (lambda path, run: rewritten(path, run, format=LEFT_OUT), "in format None"),
    "no message": (lambda path, run: rewritten(path, run, message=LEFT_OUT), "missing or unknown entries: message"),
    "more entries": (lambda path, run: rewritten(path, run, extra=1), "missing or unknown entries: extra"),
    "status in words": (lambda path, run: rewritten(path, run, status="fine"), "status is a str"),
    "rows missing": (lambda path, run: rewritten(path, run, q=run.q[1:]), r"'q' has shape \(60, 3\)"),
    "steps missing": (lambda path, run: rewritten(path, run, h=run.h[1:], order=run.order[1:]), "59 steps for 61 rows"),
    "flat": (lambda path, run: rewritten(path, run, lam=run.lam[:, 0]), r"'lam' has shape \(61,\)"),
    "complex": (lambda path, run: rewritten(path, run, t=run.t + 0j), "array 't' has type complex"),
    "times": (lambda path, run: rewritten(path, run, t=run.t * np.nan), "'t' has times that are not finite"),
    "halves": (lambda path, run: rewritten(path, run, order=run.order + 0.5), "'order' has numbers that are not whole"),
    "verdict": (lambda path, run: rewritten(path, run, certificate={"position": 0.0}), "not a solution"),
    "compressed": (lambda path, run: rewritten(path, run, np.savez_compressed), "its arrays are compressed"),
    "deep": (lambda path, run: np.savez(path, about=np.array("[" * 100_000)), "not a solution"),
}


@pytest.mark.parametrize("case", BAD_FILES)
def test_bad_files(tmp_path, run, case):
    write, message = BAD_FILES[case]
    path = tmp_path / "run.npz"
    write(path, run)
    with pytest.raises(pc.FormatError, match=message) as caught:
        Solution.load(path)
    assert caught.value.path == str(path) and str(path) in str(caught.value)


def test_a_damaged_file_is_read_as_it_was_or_refused(tmp_path, run):
    """Cut anywhere it is refused; with a byte changed it is refused, unless the byte says nothing (a date)."""
    rng, whole = np.random.default_rng(0), run.save(tmp_path / "run.npz").read_bytes()
    path = tmp_path / "spoilt.npz"
    for length in rng.integers(0, len(whole), 100):
        path.write_bytes(whole[:length])
        with pytest.raises(pc.FormatError):
            Solution.load(path)
    refused = 0
    for place in rng.integers(0, len(whole), 300):
        path.write_bytes(whole[:place] + bytes([whole[place] ^ 1 << int(rng.integers(8))]) + whole[place + 1 :])
        try:
            back = Solution.load(path)
        except pc.FormatError:
            refused += 1
        else:
            assert all(np.array_equal(getattr(back, name), getattr(run, name)) for name in ARRAYS)
            assert back.summary() == run.summary() and back.method == run.method
    assert refused > 250


def test_a_file_says_by_which_versions_it_was_made(tmp_path, run):
    back = Solution.load(run.save(tmp_path / "run.npz"))
    assert back.versions["pinconsist"] == pc.__version__ and back.versions["numpy"] == np.__version__
    assert set(back.versions) == {"pinconsist", "pin", "numpy", "scipy", "python", "machine"}
    again = Solution.load(dataclasses.replace(back, versions={"numpy": "1.0"}).save(tmp_path / "again.npz"))
    assert again.versions == {"numpy": "1.0"}  # of the run, not of the last save


def test_arrays_are_read_only_copies_in_rows_of_times(run):
    n = len(run.t)
    assert (run.q.shape, run.v.shape, run.lam.shape) == ((n, 3), (n, 3), (n, 5))
    assert run.h.shape == run.order.shape == (n - 1,)
    assert run.y.shape == (11, n)
    np.testing.assert_array_equal(run.y[:, -1], np.concatenate((run.q[-1], run.v[-1], run.lam[-1])))
    np.testing.assert_allclose(np.cumsum(run.h), run.t[1:], atol=1e-14)
    for name in ARRAYS:
        with pytest.raises(ValueError, match="read-only"):
            getattr(run, name)[0] = 0
    with pytest.raises(dataclasses.FrozenInstanceError):
        run.q = None


def test_summary_tells_the_run(run):
    text = run.summary()
    assert text.startswith(run.message)
    for part in ("t = 0 … 0.3 s in 60 steps", "0.005 … 0.005 s", f"{run.nfev} residuals", f"{run.nlu} factorisations"):
        assert part in text
    assert "rejected" not in text
    zero = pc.simulate(pc.load("four_bar"), (0.0, 0.0), method="BDF")
    assert "0 steps" in zero.summary()


def test_a_good_run_certifies_itself(run):
    good = run.check()
    assert good.position < 1e-12 and good.velocity < 1e-10 and good.force < 1e-3 and good.energy_error < 5e-4
    assert good.force_first <= good.force and good.energy.shape == run.t.shape
    assert "four_bar" not in good.position_at and "loop 'coupler_rocker' row" in good.position_at
    assert f"{good.velocity:9.2e}" in str(good) and "energy balance" in str(good)
    assert run.check(pc.load("four_bar")).position == good.position


def states(certificate):
    """Figure → (value, the words after it) of each line."""
    lines = [line for line in str(certificate).split("\n\n")[1].splitlines() if not line.startswith("note")]
    return {line[:20].strip(): (float(line[20:29]), line[29:].split()) for line in lines}


def test_the_verdict_is_one_line_and_every_figure_has_its_unit_and_state(run):
    good = run.check()
    words = re.fullmatch(r"closed to (\S+) m, forces good to (\S+), error of q about (\S+) rad: ok", good.verdict)
    closed, forces, error = map(float, words.groups())
    assert good.ok and str(good).startswith(good.verdict + "\n")
    assert closed == pytest.approx(good.position, rel=0.5) and error == pytest.approx(good.error.q, rel=0.5)
    assert forces == pytest.approx(max(good.force, good.error.force), rel=0.5)
    told = states(good)
    assert told["loops closed to"][1][:2] == ["m", "ok"] and told["velocity residual"][1][:2] == ["m/s", "ok"]
    assert told["error of q"][1][:2] == ["rad", "ok"] and told["error of v"][1][:2] == ["rad/s", "ok"]
    assert told["error of v"][0] == pytest.approx(good.error.v, rel=1e-2)
    assert all({"ok", "look"} & {*words} for _, words in told.values()) and len(told) == 8


@pytest.mark.parametrize(
    ("name", "row", "change", "figure", "word"),
    [
        ("lam", 30, [9.0, 0, 0, 0, 0], "constraint forces", "forces"),
        ("lam", 4, [9.0, 0, 0, 0, 0], "  at the first step", "forces"),
        ("q", 30, [1e-6, 0, 0], "loops closed to", "loops"),
        ("v", 30, [0, 0, 0.5], "velocity residual", "velocities"),
    ],
)
def test_what_is_wrong_is_looked_at(run, name, row, change, figure, word):
    bad = edited(run, name, row, change).check(error=False)
    assert not bad.ok and word in bad.verdict.partition(": look at ")[2].partition(";")[0].split(", ")
    assert "look" in states(bad)[figure.strip()][1] and "ok" in states(run.check(error=False))[figure.strip()][1]


def test_forces_that_a_finer_run_does_not_have_are_looked_at(run):
    good = run.check()
    bad = dataclasses.replace(good, error=dataclasses.replace(good.error, force=0.05))
    assert bad.verdict.endswith(": look at forces") and "forces good to 0.05" in bad.verdict
    assert "look" in states(bad)["error of forces"][1] and "ok" in states(bad)["constraint forces"][1]


def test_units_of_figures_are_those_of_their_rows():
    sliding = pin.Model()
    sliding.addJoint(0, pin.JointModelPX(), pin.SE3.Identity(), "slide")
    sliding.addJoint(0, pin.JointModelRX(), pin.SE3.Identity(), "turn")
    for joint in (1, 2):
        sliding.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    for joint, unit in (("slide", "m"), ("turn", "rad")):
        mech = pc.Mechanism(sliding, [pc.Drive("drive", joint, pc.Motion(amplitude=0.1, frequency=3.0))])
        certificate = pc.simulate(mech, (0.0, 0.1)).check()
        assert certificate.units == (unit, f"{unit}/s") and f" {unit}, forces" in certificate.verdict


def edited(run, name, row, change):
    array = getattr(run, name).copy()
    array[row] += change
    return dataclasses.replace(run, **{name: array})


def test_each_corruption_is_seen_by_its_residual(run):
    """One wrong number in one row; the other residuals stay (λ) or follow as they must (q moves everything)."""
    good, row = run.check(), 30
    _, J = run.system.loop_rows(run.q[row])
    scale = max(np.abs(run.system.loop_rows(q)[1].T @ lam).max() for q, lam in zip(run.q, run.lam, strict=True))

    forced = edited(run, "lam", row, [0.5, 0, 0, 0, 0]).check()
    assert forced.force == pytest.approx(0.5 * np.abs(J[0]).max() / scale, rel=2e-2)
    assert (forced.position, forced.velocity, forced.energy_error) == (good.position, good.velocity, good.energy_error)
    assert forced.force_first == good.force_first
    assert run.order[:4].tolist() == [0, 0, 0, 4]  # row 4 is the first that the formula computed
    assert edited(run, "lam", 4, [0.5, 0, 0, 0, 0]).check().force_first > 10 * good.force_first

    silent = edited(run, "lam", row, [0, 7.0, 0, 0, 0]).check()  # along the axis: a row that does nothing in the plane
    assert silent.force == pytest.approx(good.force)

    opened = edited(run, "q", row, [1e-6, 0, 0]).check()
    assert opened.position == pytest.approx(1e-6 * np.abs(J[:, 0]).max(), rel=1e-3)
    assert f"t = {run.t[row]:.6g}" in opened.position_at

    sped = edited(run, "v", row, [0, 0, 1e-3]).check()
    assert sped.velocity == pytest.approx(1e-3 * np.abs(J[:, 2]).max(), rel=1e-6) and sped.position == good.position

    faster = dataclasses.replace(run, v=run.v * np.linspace(1.0, 1.01, len(run.t))[:, None]).check()
    assert faster.velocity == pytest.approx(good.velocity, abs=1e-10)  # still on the constraints
    assert faster.energy_error > 1e-2  # 2 % of the kinetic energy too much at the end


@pytest.mark.parametrize("damping", [0.0, 0.5])
def test_energy_balance_counts_the_work_of_forces(damping):
    """A hinge driven by sin t against damping: the energy changes a lot, the balance holds to the sum's order."""
    drive = pc.Torque(lambda t, q, v: np.array([3.0 * np.sin(5 * t)]))
    errors = []
    for h in (0.01, 0.005):
        sol = pc.simulate(
            spinner(damping), (0.0, 2.0), v0={"hinge": 1.0}, step=h, order=4, forces=[drive], method="BDF"
        )
        certificate = sol.check(error=False)
        assert np.ptp(certificate.energy) > 0.3 * certificate.energy.max()
        np.testing.assert_allclose(certificate.energy, sol.v[:, 0] ** 2, rtol=1e-12)  # I = 2
        errors.append(certificate.energy_error)
    assert errors[0] < 1e-6 and errors[0] / errors[1] == pytest.approx(16.0, rel=0.1)  # the spline of the power
    stored = dataclasses.replace(sol, system=None)
    with pytest.raises(pc.InputError, match=r"1 forces .*add_forces"):
        stored.check(spinner(damping))
    undriven = stored.check(spinner(damping).add_forces(np.zeros(1)))  # the same motion, without the drive
    assert undriven.energy_error > 0.1 and "energy balance" in " ".join(undriven.concerns)


def test_energy_of_a_falling_linkage_is_conserved_with_its_order():
    errors = []
    for h in (0.01, 0.005):
        sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), step=h, order=3, method="BDF")
        errors.append(sol.check(error=False).energy_error)
    assert errors[0] < 1e-2 and np.log2(errors[0] / errors[1]) > 2.7


def test_general_problems_are_certified_too():
    problem = pc.paper.reference_problem("problem52")
    sol = pc.integrate(
        problem.system, (problem.t0, problem.t0 + 0.1), problem.p0, problem.v0, step=1e-3, order=3, method="BDF"
    )
    good = sol.check()
    assert good.position < 1e-12 and good.velocity < 1e-10 and good.force < 1e-5
    assert good.energy is None and good.energy_error is None and "energy" not in str(good)
    bad = edited(sol, "lam", 50, 0.1 * np.ones(sol.lam.shape[1])).check()
    assert bad.force > 1e-2 and bad.position == good.position


def test_raw_bdf_shows_its_velocity_residual_and_its_wrong_first_multiplier():
    """Arévalo's point, measured by the certificate alone."""
    mech = pc.load("four_bar")
    raw, clean = (
        pc.simulate(mech, (0.0, 0.1), v0={"crank": 3.0}, step=1e-3, order=1, consistency=mode, method="BDF").check()
        for mode in ("exact", "every-step")
    )
    assert raw.velocity > 1e-3 and clean.velocity < 1e-6
    assert raw.force_first > 0.05 and clean.force_first < 0.02


@pytest.mark.parametrize("step", [0.01, None])
def test_a_callback_stops_the_run(step):
    seen = []

    def callback(t, q, v, lam):
        seen.append((t, q.copy(), v.copy(), lam.copy()))
        return t > 0.1

    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), step=step, callback=callback)
    assert sol.status == 1 and sol.success and "callback" in sol.message
    assert 0.1 < sol.t[-1] < 0.5 and sol.t[-1] == seen[-1][0]
    _, q, v, lam = seen[-1]
    for name, value in (("q", q), ("v", v), ("lam", lam)):
        np.testing.assert_array_equal(getattr(sol, name)[-1], value)  # all five rows of λ, as in the solution
    assert sol.check(error=False).position < 1e-10


@pytest.mark.parametrize("t_eval", [None, [0.5, 1.0]])
def test_a_callback_that_has_room_for_it_is_told_the_order(t_eval):
    class Watch:
        order = None

        def __init__(self):
            self.seen = []

        def __call__(self, t, q, v, lam):
            self.seen.append(self.order)

    watch, mech = Watch(), pc.load("four_bar")
    pc.simulate(mech, (0.0, 1.0), t_eval=t_eval, callback=watch)
    assert watch.seen == [None, *pc.simulate(mech, (0.0, 1.0)).order]  # the initial row has none


def test_reaching_the_end_is_status_zero_even_if_the_callback_fires_there():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.05), step=0.01, callback=lambda t, q, v, lam: t >= 0.05)
    assert sol.success and sol.t[-1] == 0.05


def test_too_few_steps_is_a_failure_that_keeps_what_was_reached():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 1.0), step=0.01, max_steps=20)
    assert (sol.success, sol.status) == (False, -1) and "max_steps = 20" in sol.message
    assert 0.15 < sol.t[-1] < 0.3 and sol.check(error=False).position < 1e-10


def falling(bounce):
    """A point mass above the ground with an impact at z = 0."""
    model = pin.Model()
    slide = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "height")
    model.appendBodyToJoint(slide, pin.Inertia(2.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    impact = pc.Event(lambda t, q, v, lam: q[0], direction=-1, apply=lambda t, q, v: -bounce * v)
    return pc.simulate(pc.Mechanism(model), (0.0, 1.0), {"height": 1.0}, events=impact, method="BDF")


def test_an_impact_is_no_error_of_the_energy_balance():
    sol = falling(0.5)
    assert len(sol.t_events[0]) == 2 and np.ptp(sol.check(error=False).energy) > 10.0
    assert sol.check(error=False).energy_error < 1e-9


def test_steps_add_up_to_the_times_also_at_events():
    sol = falling(0.5)
    np.testing.assert_allclose(sol.t[0] + np.cumsum(sol.h), sol.t[1:], rtol=1e-14)
    assert (sol.h == 0.0).sum() == 2


def test_an_interrupted_start_with_redundant_rows_has_empty_rows():
    def interrupt(t, q, v, lam):
        raise KeyboardInterrupt

    sol = pc.simulate(pc.load("bricard"), (0.0, 1.0), t_eval=[0.5, 1.0], callback=interrupt)
    assert sol.status == 1 and sol.lam.shape == (0, 5)


def test_rotor_inertia_counts_once_and_rest_is_no_alarm():
    geared = pc.load("four_bar").with_armature({"crank": 5.0})
    assert pc.simulate(geared, (0.0, 1.0), rtol=1e-9, atol=1e-11).check(error=False).energy_error < 1e-6
    still = pc.load("planar_pendulum")
    hanging = pc.simulate(still, (0.0, 1.0), {still.joints[0]: np.pi / 2})
    assert hanging.check(error=False).energy_error < 1e-6 and not hanging.check().concerns


def test_solutions_travel_between_processes():
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.1), dense_output=True)
    copy = pickle.loads(pickle.dumps(sol))
    np.testing.assert_array_equal(copy.lam, sol.lam)
    assert copy.message == sol.message and copy.check(mech).position == sol.check(error=False).position


def test_a_solution_without_rows_cannot_be_checked():
    with pytest.raises(pc.InputError, match="no rows"):
        pc.simulate(pc.load("four_bar"), (0.0, 1.0), t_eval=[1.0], max_steps=5).check()


@pytest.mark.parametrize("method", ["check", "energy", "reaction"])
def test_another_mechanism_than_the_one_of_the_run_is_refused(run, method):
    first = ("tip",) if method == "reaction" else ()
    with pytest.raises(pc.InputError, match="not the one that was simulated"):
        getattr(run, method)(*first, pc.load("chain_5"))
    with pytest.raises(pc.InputError, match="a Mechanism is needed to read the solution, got str"):
        getattr(run, method)(*first, "four_bar")


def test_what_is_to_be_done_about_errors_fits_the_method():
    mech = pc.load("four_bar")
    for options, advice in ({"step": 0.05, "order": 1}, "a smaller step"), ({"rtol": 0.3, "atol": 0.3}, "rtol"):
        concerns = pc.simulate(mech, (0.0, 2.0), **options, method="BDF").check().concerns
        assert any(advice in concern for concern in concerns) and "rtol" not in "".join(concerns).replace(advice, "")


def test_what_was_skipped_is_told(tmp_path):
    """All of it in the method; in the summary the loop rows alone, which a reader of its multipliers misses."""
    mech = pc.load("four_bar")
    sol = pc.simulate(mech, (0.0, 0.1))
    rows = "3 of 5 loop rows (dependent or zero)"
    for each in (sol, pc.Solution.load(sol.save(tmp_path / "run"))):
        assert each.method["skipped"] == ["charts (all joints vector-like)", rows, "geometry", "dense output", "events"]
        assert f"skipped: {rows}" in each.summary().splitlines()
    events = [lambda t, q, v, lam: t - 1.0]
    asked = pc.simulate(mech, (0.0, 0.1), dense_output=True, events=events).method["skipped"]
    assert "geometry" in asked and "dense output" not in asked and "events" not in asked
    assert "skipped" not in pc.simulate(pc.load("planar_pendulum"), (0.0, 0.1)).summary()


def test_the_summary_tells_rejected_steps_once():
    sol = pc.simulate(pc.load("four_bar"), (0.0, 0.1))
    for rejected, told in (
        ({"error": 29, "newton": 0}, "steps (29 rejected by error)\n"),
        ({"error": 2, "newton": 1}, "steps (3 rejected: 2 by error, 1 by newton)\n"),
        ({"error": 0}, "steps\n"),
    ):
        assert told in dataclasses.replace(sol, rejected=rejected).summary()


def rotor(lower, upper, joint=None):
    """A body on a joint "j" with limits, without gravity."""
    model = pin.Model()
    model.gravity.linear = np.zeros(3)
    index = model.addJoint(0, joint or pin.JointModelRZ(), pin.SE3.Identity(), "j")
    model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit, model.upperPositionLimit = np.full(model.nq, lower), np.full(model.nq, upper)
    return pc.Mechanism(model)


@pytest.mark.parametrize(
    ("limits", "start", "speed", "first", "told"),
    [
        ((-0.9, 0.9), 0.0, 2.0, 0.45, "j reaches 2 of 0.9, first at t = 0.45"),
        (
            (-0.9, 0.9),
            2 * np.pi,
            -2.0,
            0.45,
            "j reaches -2 of -0.9, first at t = 0.45",
        ),  # whole turns away at the start
        ((-np.pi, np.pi), 0.0, 8.0, np.pi / 8, "j reaches 8 of 3.142, first at t = 0.39"),  # but not on the way
        ((-0.9, 0.9), 1.5, -2.0, 0.0, "j reaches 1.5 of 0.9, first at t = 0"),
        ((-0.9, np.inf), 0.0, 2.0, None, None),
        ((0.0, 0.0), 0.0, 2.0, None, None),
        ((-2.1, 2.1), 0.0, 2.0, None, None),
    ],
)
def test_joints_that_leave_their_limits_are_named(limits, start, speed, first, told):
    """Uniform motion, start + speed t; the rows are far apart, and the finer run looks between them."""
    sol = pc.simulate(rotor(*limits), (0.0, 1.0), {"j": start}, {"j": speed}, t_eval=np.linspace(0.0, 1.0, 11))
    found = sol.check()
    assert [(each.joint, each.t) for each in found.beyond_limits] == (
        [("j", pytest.approx(first, abs=2e-3))] if told else []
    )
    lines = [line for line in str(found).splitlines() if line.startswith("note")]
    assert found.ok is not found.verdict.endswith("look at joint limits") is bool(told)
    assert len(lines) == bool(told)
    assert not told or lines[0].startswith(f"note: joints exceed their limits, which are not enforced: {told}")


def test_limits_of_joints_of_several_coordinates_and_of_quaternions():
    mech = rotor(-0.5, 0.5, pin.JointModelTranslation())
    found = pc.simulate(mech, (0.0, 1.0), v0=[0.0, -1.0, 0.4]).check()
    assert [each.joint for each in found.beyond_limits] == ["j[1]"] and found.beyond_limits[0].value < -0.99
    assert pc.simulate(rotor(-0.1, 0.1, pin.JointModelSpherical()), (0.0, 0.1), v0=[1.0, 0, 0]).check().concerns == []


def test_a_cam_that_would_have_to_pull_its_follower_is_named():
    """A mass of 1 kg on a base that moves by A cos ωt is pushed while g > A ω² cos ωt; it parts at the top."""
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelPZ(), pin.SE3.Identity(), "follower")
    model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    size = 0.1

    def run(rate, unilateral=True):
        cam = pc.Constraint("cam", lambda t, q: q - size * np.sin(rate * t), 1, unilateral=unilateral)
        return pc.simulate(pc.Mechanism(model, [cam]), (0.0, 1.0), max_step=0.005, method="BDF")

    slow, fast = np.sqrt(0.8 * 9.81 / size), np.sqrt(2.0 * 9.81 / size)
    assert run(slow).check().ok and run(slow).lam.min() > 0.0
    found = run(fast).check()
    assert list(found.pulling) == ["cam"] and found.verdict.endswith("look at unilateral constraints")
    assert found.pulling["cam"] == pytest.approx(np.arcsin(0.5) / fast, abs=0.005)
    assert "'cam' from t = " in found.concerns[0] and run(fast, unilateral=False).check().ok
