"""Pictures of a solution: each shows the numbers it should, in lines that differ also where colours do not."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from helpers.loops import stayed_lid

import pinconsist as pc
from benchmarks.work_precision_figure import plot_work_precision
from pinconsist.view.filled import ROWS
from pinconsist.view.panels import style
from pinconsist.view.plots import PICTURES, pictures_of

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def rocker():
    return pc.load("crank_rocker")


@pytest.fixture(scope="module")
def sol(rocker):
    return pc.simulate(rocker, (0, 0.5), v0={"crank": 12}, method="BDF")


def named(axis):
    """Label → line, of the lines in the legend."""
    return {line.get_label(): line for line in axis.lines if not line.get_label().startswith("_")}


def at_rows(line, sol, values):
    """Whether a line passes through the values at the rows of a solution, in seconds, and is finer than they are."""
    t, shown = line.get_data()
    rows = np.isin(t, sol.t)
    assert len(t) > len(sol.t) or len(sol.t) >= ROWS
    return np.array_equal(t[rows], sol.t) and np.array_equal(shown[rows], values)


def test_trajectory_shows_q_and_v(sol):
    q, v = sol.plot("trajectory").axes
    for axis, values in ((q, sol.q), (v, sol.v)):
        assert [label.partition(",")[0] for label in named(axis)] == ["crank", "coupler", "rocker"]
        for k, (label, line) in enumerate(named(axis).items()):
            if label.endswith(", modulo 2π"):
                continue
            assert at_rows(line, sol, values[:, k])


def test_joints_that_go_round_leave_room_for_the_others(sol):
    lines = named(sol.plot("trajectory").axes[0])
    assert list(lines) == ["crank, modulo 2π", "coupler, modulo 2π", "rocker"]
    assert np.ptp(sol.q, axis=0)[0] > 2 * np.pi > np.ptp(sol.q, axis=0)[2]
    t, angle = lines["crank, modulo 2π"].get_data()
    drawn = np.isfinite(t)
    assert np.isin(sol.t, t[drawn]).all() and np.all(np.diff(t[drawn]) > 0)
    assert np.count_nonzero(~drawn) == 1 and np.abs(angle[drawn]).max() <= np.pi
    rows = np.isin(t, sol.t)
    turns = (angle[rows] - sol.q[:, 0]) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    alone = pc.simulate(pc.load("planar_pendulum"), (0, 1), v0=[30.0])
    assert list(named(alone.plot("trajectory").axes[0])) == ["pendulum"]  # nobody to leave room for


def test_short_times_are_in_smaller_units(rocker):
    short = pc.simulate(rocker, (0, 0.05), v0={"crank": 12})
    figure = short.plot(*["trajectory", "multipliers", "drift", "energy", "steps"])
    assert {axis.get_xlabel() for axis in figure.axes} == {"t  [ms]"}
    assert figure.axes[0].lines[0].get_xdata()[-1] == pytest.approx(50.0)
    np.testing.assert_allclose(figure.axes[4].lines[0].get_xdata(), 1e3 * short.t)  # the drift is that of the rows


def test_forces_that_are_not_determined_are_left_out_with_a_note():
    mech = stayed_lid(1e-6)
    sol = pc.simulate(mech, (0, 0.01))
    without = sol.check(error=False).undetermined
    assert without
    whole, first = sol.plot("multipliers").axes
    assert all(name in whole.texts[0].get_text() for name in without) and "not drawn" in whole.texts[0].get_text()
    assert len(first.lines) == sum(row[0] not in without for row in mech.row_labels)
    assert not pc.simulate(stayed_lid(1e-3), (0, 0.01)).plot("multipliers").axes[0].texts


def test_multipliers_are_magnified_and_zero_rows_are_no_clutter(sol):
    whole, first = sol.plot("multipliers").axes
    assert set(named(whole)) == {"rocker_ground x", "rocker_ground z", "3 zero throughout"}
    assert at_rows(named(whole)["rocker_ground x"], sol, sol.lam[:, 0])
    same = next(line for line in first.lines if line.get_label() == "rocker_ground x")
    np.testing.assert_array_equal(same.get_ydata(), sol.lam[:21, 0])
    assert same.get_linestyle() == named(whole)["rocker_ground x"].get_linestyle()


def test_forces_are_those_of_loops_and_joints(sol):
    forces, moments = sol.plot("forces").axes
    assert set(named(forces)) == {"rocker_ground", "crank", "coupler", "rocker"} and not forces.texts
    for axis, part in (forces, "force"), (moments, "moment"):
        t, shown = axis.lines[2].get_data()
        expected = np.linalg.norm(getattr(sol.at(t).joint_force("coupler"), part), axis=1)
        np.testing.assert_allclose(shown, expected, atol=1e-9)
    (left, _) = pc.simulate(pc.load("bricard"), (0, 0.05)).plot("forces").axes
    assert all(name.endswith(" *") for name in named(left)) and "* not unique" in left.texts[0].get_text()


def test_drift_is_that_of_the_certificate(sol, rocker):
    gaps, rates = (axis.lines[0].get_ydata() for axis in sol.plot("drift").axes)
    certificate = sol.check(error=False)
    assert np.nanmax(gaps) == pytest.approx(certificate.position, rel=1e-6)
    assert np.nanmax(rates) == pytest.approx(certificate.velocity, rel=1e-6)
    for axis in sol.plot("drift").axes:
        assert axis.get_ylim()[0] == 1e-16 and np.nanmin(axis.lines[0].get_ydata()) >= 1e-16


def test_drift_of_plain_bdf_is_seen_in_the_velocities(rocker):
    step = {"step": 0.005, "order": 1}
    exact = pc.simulate(rocker, (0, 0.1), v0={"crank": 12}, consistency="exact", **step)
    largest = [np.nanmax(axis.lines[0].get_ydata()) for axis in exact.plot("drift").axes]
    assert largest[0] < 1e-8 < 1e-3 < largest[1]


def test_drift_of_a_general_problem_and_of_a_drive(rocker):
    case = pc.paper.reference_problem("problem52")
    made = pc.integrate(case.system, (case.t0, case.t0 + 0.1), case.p0, case.v0, step=0.01, order=1, method="BDF")
    assert np.nanmax(made.plot("drift").axes[0].lines[0].get_ydata()) < 1e-9
    turning = pc.Drive("motor", "crank", lambda t: 3.0 * t, lambda t: 3.0, lambda t: 0.0)
    driven = rocker.add_loops(turning)
    driven = pc.simulate(driven, (0, 0.2))
    rates = [np.nanmax(line.get_ydata()) for line in driven.plot("drift").axes[1].lines]
    assert len(rates) == 2 and max(rates) < 1e-5  # Φ_t of the drive is in: 3 rad/s without it


def test_of_many_loops_the_worst_are_shown():
    mech = pc.load("n_four_bar_14")
    worst = [named(axis) for axis in pc.simulate(mech, (0, 0.05), v0={"crank0": 1}).plot("drift").axes]
    assert [len(lines) for lines in worst] == [12, 12]


def test_energy_is_the_solutions_own(sol, rocker):
    parts, error = sol.plot("energy").axes
    energy = sol.energy()
    assert list(named(parts)) == ["kinetic", "potential", "total"]
    assert at_rows(named(parts)["kinetic"], sol, energy.kinetic - energy.kinetic[0])
    assert named(parts)["total"].get_ydata()[0] == 0.0
    np.testing.assert_array_equal(error.lines[0].get_ydata(), energy.error)
    damped = rocker.add_forces(pc.JointDamping({"crank": 0.1}))
    parts, _ = pc.simulate(damped, (0, 0.1), v0={"crank": 12}).plot("energy").axes
    work = next(line for label, line in named(parts).items() if label.startswith("work of"))
    assert work.get_ydata()[-1] < 0


def test_steps_and_orders(sol):
    steps, orders = sol.plot("steps").axes
    np.testing.assert_array_equal(steps.lines[0].get_ydata(), np.abs(sol.h))
    np.testing.assert_array_equal(orders.lines[0].get_ydata(), sol.order)
    assert steps.get_yscale() == "log" and "one-step start" in named(orders)


def test_steps_leave_the_jumps_of_events_out():
    def bounce(t, q, v):
        return -v

    event = pc.Event(lambda t, q, v, lam: q[0] - 1.7, apply=bounce)
    sol = pc.simulate(pc.load("planar_pendulum"), (0, 2), events=[event])
    assert (sol.h == 0).any()
    assert len(sol.plot("steps").axes[0].lines[0].get_ydata()) == np.count_nonzero(sol.h)


def test_phase_portrait_pairs_each_joint_with_its_velocity(sol):
    axes = sol.plot("phase").axes
    assert [axis.get_title(loc="left") for axis in axes] == ["crank", "coupler", "rocker"]
    shown = axes[2].lines[0].get_xydata().tolist()
    assert all(point in shown for point in np.column_stack((sol.q[:, 2], sol.v[:, 2])).tolist())
    assert axes[2].lines[1].get_xydata().tolist() == [[sol.q[0, 2], sol.v[0, 2]]]


def test_phase_portrait_behind_joints_of_several_freedoms():
    """In Stewart's platform q and v have different columns for one joint."""
    mech = pc.load("stewart_platform")
    sol = pc.simulate(mech, (0, 0.02))
    model = mech.model
    for axis in sol.plot("phase").axes:
        if axis.lines:
            j = model.getJointId(axis.get_title(loc="left"))
            shown = axis.lines[0].get_xydata().tolist()
            expected = np.column_stack((sol.q[:, model.idx_qs[j]], sol.v[:, model.idx_vs[j]])).tolist()
            assert all(point in shown for point in expected)


def test_all_pictures_under_each_other(sol, tmp_path):
    named = [name for name in PICTURES if name != "contacts"]  # which it has not
    figure = sol.plot(*named, file=tmp_path / "all.png")
    assert len(figure.axes) == 6 * 2 + 3
    assert [path.name for path in tmp_path.iterdir()] == ["all.png"]


def test_lines_differ_in_grey(sol):
    """Within a panel no two lines share both dash and marker."""
    for axis in sol.plot(*["trajectory", "multipliers", "energy"]).axes:
        looks = [(line.get_linestyle(), line.get_marker()) for line in named(axis).values()]
        assert len(set(looks)) == len(looks)


def test_lines_take_their_looks_in_turn():
    t = np.linspace(0, 1, 5)
    q = np.outer(t, range(1, 13))
    axis = pictures_of(SimpleNamespace(t=t, q=q, v=q, lam=np.zeros((5, 0))), ["trajectory"]).axes[0]
    looks = [style(k) for k in range(12)]
    assert [(line.get_color(), line.get_marker()) for line in axis.lines] == [
        (look["color"], look["marker"]) for look in looks
    ]
    assert [line.is_dashed() for line in axis.lines] == [look["linestyle"] != "-" for look in looks]


def test_many_lines_differ():
    """24 in all, 12 also without colour."""
    looks = [style(k) for k in range(24)]
    assert len({(look["color"], look["linestyle"], look["marker"]) for look in looks}) == 24
    assert len({(look["linestyle"], look["marker"]) for look in looks[:12]}) == 12


def test_panels_line_up_and_no_label_is_cut(sol):
    """Also where legends are of different widths, as those of joints and of loop rows."""
    figure = sol.plot(*["trajectory", "steps", "phase", "multipliers", "drift"])
    figure.draw_without_rendering()
    boxes = [axis.get_window_extent() for axis in figure.axes]
    for rows in (boxes[0:4], boxes[7:11]):  # what stands in one grid, above and below the phase portrait
        for column in (rows[0::2], rows[1::2]):
            assert np.ptp([box.x0 for box in column]) < 0.5 and np.ptp([box.x1 for box in column]) < 0.5
    whole = figure.get_tightbbox()
    assert whole.x0 >= 0 and whole.x1 <= figure.get_figwidth()


def test_a_saved_run_needs_its_mechanism_for_some(sol, rocker, tmp_path):
    stored = pc.Solution.load(sol.save(tmp_path / "run.npz"))
    for picture in ("forces", "drift", "energy"):
        with pytest.raises(pc.InputError, match="needs the mechanism"):
            stored.plot(picture)
        assert stored.plot(picture, mechanism=rocker).axes
    assert list(named(stored.plot("trajectory").axes[0])) == ["q1", "q2", "q3"]


@pytest.mark.parametrize(
    ("what", "message"),
    [
        (["forses"], "no picture 'forses'; available: trajectory, multipliers"),
    ],
)
def test_unknown_pictures_are_refused(sol, what, message):
    with pytest.raises(pc.InputError, match=message):
        sol.plot(*what)


def test_what_a_solution_does_not_have_is_said(rocker):
    sampled = pc.simulate(rocker, (0, 0.1), t_eval=[0, 0.05, 0.1])
    with pytest.raises(pc.InputError, match="t_eval"):
        sampled.plot("steps")
    tree = pc.simulate(pc.load("double_pendulum"), (0, 0.1))
    for picture, message in (("multipliers", "no multipliers"), ("drift", "no drift")):
        with pytest.raises(pc.InputError, match=message):
            tree.plot(picture)
    assert len(tree.plot().axes) == 2
    with pytest.raises(pc.InputError, match="no rows"):
        pictures_of(SimpleNamespace(t=[], q=[], v=[], lam=[]), ["trajectory"])
    with pytest.raises(pc.InputError, match="columns of q"):
        tree.plot("trajectory", mechanism=rocker)


def test_a_comparison_shows_all_three_ways_and_no_exact_start():
    runs = pc.paper.compare("problem51", [0.01], order=2, count=4).runs
    (axis,) = pc.paper.plot_comparison(runs).axes
    lines = named(axis)
    assert list(lines) == ["exact start", "consistent start", "every step corrected"]
    np.testing.assert_allclose(lines["every step corrected"].get_xdata(), 1e3 * runs[0].t[2:])
    np.testing.assert_array_equal(lines["exact start"].get_ydata(), runs[0].exact[2:])
    assert min(line.get_ydata().min() for line in lines.values()) > 1e-6
    assert axis.get_ylabel() == "error of the force in circle  [N]" and runs[0].wrong in axis.get_title(loc="left")


def test_work_precision_sorts_by_error_and_leaves_out_what_failed(tmp_path):
    series = {"BDF": ([0.1, 0.4, 0.2, np.nan], [1e-2, 1e-6, 1e-4, 1e-8]), "Radau": ([1.0], [1e-5])}
    series["pinconsist BDF"] = ([0.1], [1e-3])
    (axis,) = plot_work_precision(series, tmp_path / "wp.pdf").axes
    widths = {label: line.get_linewidth() for label, line in named(axis).items()}
    assert widths["pinconsist BDF"] > 1.5 * widths["BDF"] == 1.5 * widths["Radau"]
    assert (axis.get_xscale(), axis.get_yscale()) == ("log", "log") and axis.get_xlabel().startswith(
        "largest error of q"
    )
    assert named(axis)["BDF"].get_xydata().tolist() == [[1e-6, 0.4], [1e-4, 0.2], [1e-2, 0.1]]
    assert Path(tmp_path / "wp.pdf").read_bytes().startswith(b"%PDF")


@pytest.mark.parametrize(
    ("series", "message"),
    [
        ({}, "at least one label"),
        ({"a": ([1, 2], [1])}, "'a' has times of shape"),
        ({"a": 3}, "'a' needs two rows"),
        ({"a": ([0.0], [1.0])}, "'a' has no point"),
    ],
)
def test_work_precision_of_nothing_is_refused(series, message):
    with pytest.raises(pc.InputError, match=message):
        plot_work_precision(series)


def test_lines_follow_the_motion_between_the_rows_of_radau(rocker):
    """Against a run at a smaller tolerance with dense rows. The points are close enough for 1 %; the rows are not."""
    span, start = (0.0, 1.0), {"crank": 12.0}
    loose = pc.simulate(rocker, span, v0=start, method="Radau")
    times = np.linspace(*span, 5001)
    tight = pc.simulate(rocker, span, v0=start, method="Radau", rtol=1e-10, atol=1e-12, t_eval=times)

    def lines(sol):
        yield sol.velocity("rocker")
        yield np.linalg.norm(sol.reaction("rocker_ground").force, axis=1)
        yield np.linalg.norm(sol.joint_force("crank").force, axis=1)
        yield sol.lam[:, 0]

    figures = [pc.plot(loose, name) for name in ("v rocker", "reaction:rocker_ground", "joint_force crank")]
    drawn = [figure.axes[0].lines[0] for figure in figures]
    drawn.append(named(loose.plot("multipliers").axes[0])["rocker_ground x"])
    for exact, rows, line in zip(lines(tight), lines(loose), drawn, strict=True):
        size = np.abs(exact).max()
        assert np.abs(np.interp(times, *line.get_data()) - exact).max() < 1e-2 * size
        assert np.abs(np.interp(times, loose.t, rows) - exact).max() > 5e-2 * size


def test_multipliers_of_fixed_steps_are_joined_by_lines(rocker):
    """From exact initial values they are wrong at first, and a line between right values would hide it."""
    exact = pc.simulate(rocker, (0, 0.1), v0={"crank": 12}, consistency="exact", step=0.005, order=1, method="BDF")
    np.testing.assert_array_equal(exact.plot("multipliers").axes[0].lines[0].get_xdata(), exact.t)


def test_two_designs_in_one_plot(rocker, tmp_path):
    """A panel for each unit, a line for each run and quantity; runs from files need their mechanisms."""
    longer = rocker.with_parameters({"length:coupler": 0.3})
    runs = {
        "short": pc.simulate(rocker, (0, 0.3), v0={"crank": 9}),
        "long": pc.simulate(longer, (0, 0.2), v0={"crank": 9}),
    }
    figure = pc.plot(
        runs, "reaction:rocker_ground", "joint_force crank x", "v rocker", "rocker", file=tmp_path / "a.svg"
    )
    forces, rates, angles = figure.axes
    assert list(named(forces)) == [
        f"{run}: {of}" for of in ("reaction:rocker_ground", "joint_force crank x") for run in runs
    ]
    assert list(named(rates)) == list(named(angles)) == ["short", "long"]
    assert [axis.get_title(loc="left") for axis in figure.axes] == ["[N]", "v rocker  [rad/s]", "rocker  [rad]"]
    assert [line.get_xdata()[-1] for line in rates.lines] == [pytest.approx(0.3), pytest.approx(0.2)]
    sizes = np.linalg.norm(runs["long"].reaction("rocker_ground").force, axis=1)
    assert at_rows(forces.lines[1], runs["long"], sizes)
    assert len({line.get_color() for line in forces.lines}) == 4
    loaded = {name: pc.Solution.load(sol.save(tmp_path / name)) for name, sol in runs.items()}
    again = pc.plot(loaded, "reaction:rocker_ground", mech={"short": rocker, "long": longer})
    assert at_rows(again.axes[0].lines[1], runs["long"], sizes)


def test_a_quantity_of_several_numbers_has_a_line_for_each(sol):
    (axis,) = pc.plot(sol, "multipliers rocker_ground").axes
    assert len(axis.lines) == 5
    (axis,) = pc.plot(sol, "position rocker_tip").axes
    assert list(named(axis)) == [f"position rocker_tip {part}" for part in "xyz"]
    for arguments, words in (((sol, "peak reaction rocker_ground"), "leave out peak"), ((sol,), "at least one"),
                             (({}, "crank"), "needs a run"), ((3, "crank"), "needs a Solution"),
                             ((sol, "q crank at 0.1"), "a number, not a curve")):  # fmt: skip
        with pytest.raises(pc.InputError, match=words):
            pc.plot(*arguments)
