"""The pictures of the gallery, made by the examples themselves: python examples/pictures.py [FOLDER [NAME ...]].

Each shows a still of the page written by `pinconsist.export_html`, made by a headless Chromium, and a curve of it.
"""

import importlib.util
import io
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from PIL import Image

import pinconsist as pc

HERE = Path(__file__).parent
BROWSER = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
FLAGS = "--headless --no-sandbox --disable-quic --no-first-run --disable-background-networking --hide-scrollbars"
FLAGS += " --disable-sync --disable-component-update --use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader"
WIDE, HIGH, MARGIN = 690, 600, 20  # pixels of a still
PLAIN = "<style>#player, aside, .size { display: none !important; }</style>"
STOP = "setTimeout(() => {{ running = false; seek({time}); }}, 500);"
LOOK = {
    "font.size": 10,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "axes.spines.top": False,
    "axes.spines.right": False,
}
BLUE, ORANGE = "#0072b2", "#d55e00"


def photograph(mech, sol, time, look="", size=(WIDE, HIGH), **options):
    """The page of a run at a given time as an array of pixels; `look` is CSS."""
    if BROWSER is None:
        raise SystemExit("the stills need chromium, chromium-browser or google-chrome")
    with tempfile.TemporaryDirectory() as folder:
        page, shot = Path(folder) / "page.html", Path(folder) / "shot.png"
        pc.export_html(mech, sol, page, **options)
        text = page.read_text(encoding="utf-8").rsplit("</body>", 1)
        page.write_text(f"{look}<script>{STOP.format(time=time)}</script></body>".join(text), encoding="utf-8")
        flags = f"--window-size={size[0]},{size[1]} --virtual-time-budget=3000 --screenshot={shot}"
        command = [BROWSER, *FLAGS.split(), *flags.split(), f"--user-data-dir={folder}/user", page.as_uri()]
        subprocess.run(command, capture_output=True, timeout=120)
        return np.array(Image.open(shot).convert("RGB"))


def still(mech, sol, time, traces, forces):
    """The mechanism at a given time, as shown by its page."""
    return cropped(photograph(mech, sol, time, PLAIN, traces=traces, forces=forces, panel=False))


def cropped(pixels):
    """The part of an image that is darker than the background, with a margin."""
    rows, columns = (np.flatnonzero((pixels.min(axis=2) < 170).any(axis=axis)) for axis in (1, 0))
    top, left = max(rows[0] - MARGIN, 0), max(columns[0] - MARGIN, 0)
    return pixels[top : rows[-1] + MARGIN, left : columns[-1] + MARGIN]


def joint(mech, sol, name):
    """The values of a joint of one degree of freedom over time."""
    return sol.q[:, mech.model.idx_qs[mech.joint_index(name)]]


def height(mech, sol, frame):
    """The height of a frame over time, m."""
    import pinocchio as pin

    data, index, heights = mech.model.createData(), mech.model.getFrameId(frame), []
    for q in sol.q:
        pin.framesForwardKinematics(mech.model, data, q)
        heights.append(data.oMf[index].translation[2])
    return heights


def force(sol, loop):
    """The norm of a loop's force over time, N."""
    return np.linalg.norm(sol.reaction(loop).force, axis=1)


def four_bar(axes, mech, sol):
    axes.plot(sol.t, force(sol, mech.loops[0].name), color=BLUE)
    return "force in the loop  [N]"


def slider_crank(axes, mech, sol):
    axes.plot(sol.t, sol.reaction("motor").torque, color=BLUE)
    return "motor torque  [N·m]"


def own_mechanism(axes, mech, sol):
    axes.plot(sol.t, -sol.lam[:, 0], color=BLUE)
    return "tension of the bar  [N]"


def latch(axes, mech, sol):
    axes.plot(sol.t, np.abs(joint(mech, sol, "hinge")), color=BLUE)
    return "angle of the rod from the catch on  [rad]"


def pendulum(axes, mech, sol):
    axes.plot(sol.t, sol.lam[:, 0], "o-", color=BLUE, markersize=3, label="BDF")
    axes.plot(sol.t, -4 * (1 + sol.t) ** 2, "--", color=ORANGE, label="exact")
    axes.legend(frameon=False)
    return "multiplier  [N]"


def andrews(axes, mech, sol):
    for loop, dash in zip(mech.loops, ("-", "--", ":"), strict=True):
        axes.plot(1e3 * sol.t, force(sol, loop.name), dash, label=loop.name)
    axes.legend(frameon=False)
    axes.set_xlabel("t  [ms]")
    return "forces in the loops  [N]"


def bricard(axes, mech, sol):
    axes.plot(sol.t, height(mech, sol, "P3"), color=BLUE)
    return "height of P3  [m]"


def delta(axes, mech, sol):
    for i, dash in enumerate(("-", "--", ":"), start=1):
        axes.plot(sol.t, sol.reaction(f"motor{i}").torque, dash, label=f"motor {i}")
    axes.margins(y=0.2)
    axes.legend(frameon=False, loc="upper center", ncols=3, handlelength=1.5, columnspacing=1.0)
    return "motor torques  [N·m]"


def cassie(axes, mech, sol):
    for side, dash in (("left", "-"), ("right", "--")):
        axes.plot(sol.t, force(sol, f"{side}-plantar-foot-joint"), dash, label=side)
    axes.legend(frameon=False)
    return "force in the feet's loops  [N]"


def gripper(axes, mech, sol):
    axes.plot(sol.t, np.degrees(joint(mech, sol, "left_crank")), color=BLUE)
    return "left crank, up to the contact  [°]"


def strandbeest(axes, mech, sol):
    axes.plot(sol.t, height(mech, sol, "foot"), color=BLUE)
    return "height of the foot  [m]"


def car_axis(axes, mech, sol):
    axes.plot(sol.t, sol.q[:, 1], color=BLUE, label="left end")
    axes.plot(sol.t, sol.q[:, 3], "--", color=ORANGE, label="right end")
    axes.legend(frameon=False)
    return "height of the axis"


def ensemble(axes, mech, solutions):
    angles = np.array([np.pi / 2 - sol.q[:, 0] for sol in solutions])
    axes.plot(solutions[0].t, angles.T, color="#b0b4b8", linewidth=0.7)
    axes.plot(solutions[0].t, angles.mean(axis=0), color=BLUE, linewidth=2, label="mean")
    axes.legend(frameon=False)
    return "angle from hanging  [rad]"


def linearisation(axes, mech, sol):
    modes, rest = pc.linearize(mech, sol.q[0]).modes(), sol.q[0, 0]
    axes.plot(sol.t, sol.q[:, 0] - rest, color=BLUE, label="nonlinear")
    s = modes.eigenvalues[0]
    axes.plot(sol.t, (0.2 / s.imag * np.exp(s * sol.t)).imag, "--", color=ORANGE, label="its mode")
    axes.legend(frameon=False)
    return "crank beside its equilibrium  [rad]"


def held(axes, mech, sol):
    (table,) = sol.held.values()
    axes.step(table[:, 0], table[:, 1], where="post", color=BLUE)
    return "torque that is held  [N·m]"


def stewart(axes, mech, sol):
    table = sol.held["sampled"]
    for leg, column in enumerate(range(2, 18, 3), start=1):
        axes.step(table[:, 0], table[:, 1 + column], where="post", label=f"leg {leg}")
    axes.margins(y=0.25)
    axes.legend(frameon=False, loc="upper center", ncols=3, handlelength=1.5, columnspacing=1.0)
    return "forces that are held  [N]"


def episode(axes, mech, found):
    sol, _, target = found
    axes.plot(sol.t, sol.q[:, 0], color=BLUE, label="crank")
    axes.axhline(target, color=ORANGE, linestyle="--", label="target")
    axes.legend(frameon=False)
    return "crank angle  [rad]"


def workspace(axes, mech, found):
    tips, condition, ends, ellipses = found
    dots = axes.scatter(*tips.T, c=condition, s=7, cmap="viridis", label="reached by the motors")
    axes.scatter(*ends.T, s=9, color=ORANGE, label="singular: the way is blocked")
    for k, ellipse in enumerate(ellipses):
        axes.plot(*ellipse.T, color="#333333", linewidth=0.8, label="forces of unit torques" if k == 0 else None)
    axes.figure.colorbar(dots, ax=axes, label="condition")
    axes.set_aspect("equal")
    axes.legend(frameon=False, loc="center right", bbox_to_anchor=(-0.2, 0.5))
    axes.set_xlabel("x  [m]")
    return "height of the tip  [m]"


def identification(axes, mech, fit):
    crank, t = fit[2].dq[:, 0], fit[2].solution.t
    for i, (name, color) in enumerate({"mass": BLUE, "damping": ORANGE, "stiffness": "#333333"}.items()):
        axes.plot(t, 1e3 * fit[1][i] * crank[:, i], color=color, label=name)
    axes.legend(frameon=False)
    return "crank angle by one standard deviation of a parameter  [mrad]"


def calibration(axes, mech, fit):
    found, deviations = fit[:2]
    names = range(1, 1 + len(found.x))
    axes.bar(names, 1e3 * deviations, color=BLUE)
    axes.set_xlabel("parameter")
    axes.set_yscale("log")
    return "standard deviations of the parameters, times 1000"


def plan(axes, mech, found):
    solver, sol = found
    for name, color in {"left_crank": BLUE, "right_crank": ORANGE}.items():
        axes.plot(sol.t, sol.position(name), color=color, label=f"{name}  [rad]")
    axes.step(0.02 * np.arange(len(solver.us)), np.array(solver.us), where="post", color="#999999", linewidth=1)
    axes.legend(frameon=False)
    return "cranks, and torques in N·m, grey"


def way_of_joints(axes, mech, way):
    for joint, color in zip(mech.actuated, (BLUE, ORANGE), strict=True):
        axes.plot(way[:, mech.columns(joint)], color=color, label=joint)
    axes.legend(frameon=False)
    return "motors at the iterations  [rad]"


def returns(axes, mech, found):
    _, total, targets, masses = found
    points = axes.scatter(targets, total, c=masses, s=12)
    axes.figure.colorbar(points, ax=axes, label="mass of the coupler  [kg]")
    return "return by the target  [rad]"


def spring_size(axes, mech, found):
    times, before, now, _ = found
    axes.plot(times, before, color=ORANGE, label="spring of the guess")
    axes.plot(times, now, color=BLUE, label="best spring")
    axes.legend(frameon=False)
    return "force in the pin  [N]"


def swing_up(axes, mech, found):
    sol, torques = found
    axes.plot(np.linspace(0.0, sol.t[-1], len(torques)), torques, color=BLUE, label="torque  [N·m]")
    axes.plot(sol.t, 10.0 * sol.q[:, 0], color=ORANGE, label="crank  [0.1 rad]")
    axes.legend(frameon=False)
    return "torque and angle of the crank"


def unit(axes, mech, found):
    for name, color in {"angle": BLUE, "speed": ORANGE}.items():
        axes.plot(found["time"], found[name], color=color, label=name)
    axes.legend(frameon=False)
    return "crank of the unit  [rad, rad/s]"


def ilqr(axes, mech, found):
    sol, every = found
    for name, color in {"left_crank": BLUE, "right_crank": ORANGE}.items():
        axes.plot(sol.t, sol.position(name), color=color, label=f"{name}  [rad]")
    axes.step(0.01 * np.arange(len(every[-1].torques)), every[-1].torques, where="post", color="#999999", linewidth=1)
    axes.legend(frameon=False)
    return "cranks, and torques in N·m, grey"


def gap_and_force(axes, sol, name):
    """The gap of a contact, and the vertical force."""
    fine = sol.at(np.linspace(sol.t[0], sol.t[-1], 800))
    found = fine.contact(name)
    axes.plot(fine.t, found.force[:, 2], color=BLUE)
    other = axes.twinx()
    other.plot(fine.t, 1e3 * found.gap, color=ORANGE, linewidth=1)
    other.grid(False)
    other.set_ylabel("gap  [mm]", color=ORANGE)


def leg(axes, mech, sol):
    gap_and_force(axes, sol, "ground")
    axes.set_ylim(0.0, 150.0)
    return "vertical force of the ground  [N]"


def clutch(axes, mech, sol):
    motor = sol.velocity("motor")
    axes.plot(sol.t, motor, color=BLUE, label="motor")
    axes.plot(sol.t, motor + sol.velocity("clutch"), "--", color=ORANGE, label="load")
    axes.legend(frameon=False)
    return "speeds  [rad/s]"


def cam(axes, mech, sol):
    gap_and_force(axes, sol, "face")
    return "force on the cam  [N]"


def excavator(axes, mech, sol):
    fine = sol.at(np.linspace(0.0, 3.0, 600))
    for part, color in (("boom", BLUE), ("arm", ORANGE)):
        axes.plot(fine.t, fine.position(f"{part}_cylinder"), color=color, label=part)
    axes.legend(frameon=False)
    return "lengths of the cylinders  [m]"


def grip_and_lift(axes, mech, sol):
    fine = sol.at(np.linspace(0.0, 2.0, 600))
    for side, color in (("left", BLUE), ("right", ORANGE)):
        axes.plot(fine.t, np.abs(fine.contact(f"{side} pad").force[:, 0]), color=color, label=f"{side} pad")
    axes.plot(fine.t, 100.0 * fine.position("z"), color="#333333", label="height of the part  [cm]")
    axes.legend(frameon=False)
    return "grip  [N]"


def hopper(axes, mech, sol):
    gap_and_force(axes, sol, "ground")
    axes.set_ylim(0.0, 200.0)
    return "vertical force of the ground  [N]"


def biped(axes, mech, sol):
    fine = sol.at(np.linspace(0.0, 2.5, 1000))
    for name, color in (("left", BLUE), ("right", ORANGE)):
        axes.plot(fine.t, fine.contact(f"{name} ground").force[:, 2], color=color, label=name)
    axes.set_ylim(0.0, 100.0)
    axes.legend(frameon=False)
    return "vertical forces of the ground  [N]"


FIGURES = {  # curve, time of the still or None, traces in it
    "02_four_bar": (four_bar, 1.0, ("coupler_tip",)),
    "03_driven_slider_crank": (slider_crank, 0.05, ()),
    "04_own_mechanism": (own_mechanism, 0.3, ("left_tip", "right_tip")),
    "05_events": (latch, 0.3, ("ball",)),
    "06_pendulum": (pendulum, None, ()),
    "07_andrews": (andrews, 0.012, ()),
    "08_bricard": (bricard, 0.7, ("P3",)),
    "09_delta_robot": (delta, 0.3, ("platform",)),
    "10_cassie": (cassie, 0.15, ()),
    "11_gripper": (gripper, 1.0, ()),
    "12_strandbeest": (strandbeest, 0.55, ("foot",)),
    "13_own_dae": (car_axis, None, ()),
    "14_ensemble": (ensemble, None, ()),
    "15_linearisation": (linearisation, 0.5, ()),
    "16_sampled_pd": (held, None, ()),
    "17_cosimulation": (held, None, ()),
    "18_five_bar_workspace": (workspace, None, ()),
    "19_identification": (identification, None, ()),
    "20_spring_size": (spring_size, None, ()),
    "21_swing_up": (swing_up, None, ()),
    "22_stewart_control": (stewart, 0.3, ()),
    "23_gymnasium": (episode, None, ()),
    "24_fmu": (unit, None, ()),
    "25_ilqr": (ilqr, None, ()),
    "26_kinematic_calibration": (calibration, None, ()),
    "27_held_identification": (calibration, None, ()),
    "28_crocoddyl": (plan, None, ()),
    "29_pink": (way_of_joints, None, ()),
    "30_vector_environment": (returns, None, ()),
    "31_standing_leg": (leg, 1.1, ()),
    "32_clutch": (clutch, None, ()),
    "33_cam": (cam, 0.05, ()),
    "34_excavator": (excavator, 0.6, ()),
    "35_grip_and_lift": (grip_and_lift, 1.2, ()),
    "36_hopping_leg": (hopper, 0.3, ()),
    "37_biped": (biped, 1.0, ()),
}


ARROWS = {
    "02_four_bar",
    "04_own_mechanism",
    "09_delta_robot",
    "12_strandbeest",
    "31_standing_leg",
    "35_grip_and_lift",
    "37_biped",
}


def example(name):
    """The module of an example."""
    spec = importlib.util.spec_from_file_location(name, HERE / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def figure_of(name):
    """The figure of an example."""
    result = example(name).run()
    if name not in FIGURES:
        return pc.paper.plot_comparison(result.runs)
    mech, sol = result[0], result[-1]
    curve, time, traces = FIGURES[name]
    with matplotlib.rc_context(LOOK):
        figure = Figure(figsize=(8.0, 3.3), layout="constrained")
        if time is None:
            axes = figure.subplots()
        else:
            left, axes = figure.subplots(1, 2)
            left.imshow(still(mech, sol, time, traces, forces=name in ARROWS))
            left.set_axis_off()
        axes.set_xlabel("t  [s]")
        axes.set_title(curve(axes, mech, sol), loc="left", fontsize=10)
    return figure


def page_of_four_bar():
    """The page of README's first command."""
    mech = pc.load("four_bar")
    return Image.fromarray(photograph(mech, pc.simulate(mech, (0.0, 5.0)), 1.05, size=(1100, 700), forces=True))


def picture_of(name):
    """The picture of an example."""
    image = io.BytesIO()
    figure_of(name).savefig(image, format="png", dpi=100)
    return Image.open(image).convert("RGB")


def make(name, folder) -> Path:
    """Write a picture, in few colours to keep it small."""
    image, path = page_of_four_bar() if name == "four_bar" else picture_of(name), Path(folder) / f"{name}.png"
    image.quantize(256, kmeans=1, dither=Image.Dither.NONE).save(path, optimize=True)
    return path


if __name__ == "__main__":
    folder, *names = sys.argv[1:] or [HERE / "pictures"]
    for each in names or ["four_bar", "01_exact_and_consistent", *FIGURES]:
        made = make(each, folder)
        print(f"{made}: {made.stat().st_size / 1000:.0f} kB")
