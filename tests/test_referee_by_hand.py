"""Two findings of the referee, checked without it: MuJoCo on a model written here, against scipy in one coordinate."""

import numpy as np
import pytest
from helpers import zoo

import pinconsist as pc

FOUR_BAR = """
<mujoco>
  <option timestep="0.002" {option}/>
  <default><equality {loops}/></default>
  <worldbody>
    <body name="crank">
      <joint axis="0 1 0"/>
      <inertial pos="0.5 0 0" mass="1" diaginertia="0.0008 0.08333333333333333 0.08333333333333333"/>
      <body name="coupler" pos="1 0 0">
        <joint axis="0 1 0"/>
        <inertial pos="1 0 0" mass="2" diaginertia="0.0016 0.6666666666666666 0.6666666666666666"/>
        <site name="coupler_tip" pos="2 0 0"/>
      </body>
    </body>
    <body name="rocker" pos="2.2 0 0">
      <joint axis="0 1 0"/>
      <inertial pos="0.75 0 0" mass="1.5" diaginertia="0.0012 0.28125 0.28125"/>
      <site name="rocker_tip" pos="1.5 0 0"/>
    </body>
  </worldbody>
  <equality><connect site1="coupler_tip" site2="rocker_tip"/></equality>
</mujoco>
"""
END = 2.0  # s
SETTINGS = {  # as the referee names them, and as they are written in a file
    "Euler, 2 ms, default loops": ("", ""),
    "RK4, 2 ms, loops of 2 steps": ('integrator="RK4"', 'solref="0.004 1" solimp="0.9999 0.9999 0.001 0.5 2"'),
}


@pytest.fixture(scope="module")
def judged():
    """The referee's errors of loop forces, by the names of the settings."""
    pytest.importorskip("mujoco")
    judgement = pc.referee(pc.load("four_bar"), (0.0, END))
    return {row.setting: row.force for row in judgement.rows if row.tool == "MuJoCo"}


def pin_forces(times):
    """The force of the pin between coupler and rocker, (n, 2), and the start: scipy on the angle of the crank alone."""
    linkage, start = zoo.FourBar(), pc.assemble(pc.load("four_bar")).q
    q, _, pushed = zoo.reduced_solution(linkage, start, 0.0, times)
    rows = [linkage.jacobian(linkage.T @ each) @ linkage.T for each in q]
    forces = [np.linalg.lstsq(row.T, push, rcond=None)[0] for row, push in zip(rows, pushed, strict=True)]
    return np.array(forces), start


@pytest.mark.parametrize("setting", SETTINGS)
def test_the_error_of_loop_forces_in_mujoco(judged, setting):
    mujoco = pytest.importorskip("mujoco")
    option, loops = SETTINGS[setting]
    model = mujoco.MjModel.from_xml_string(FOUR_BAR.format(option=option, loops=loops))
    data, found = mujoco.MjData(model), []
    times = 0.002 * np.arange(round(END / 0.002) + 1)
    exact, data.qpos[:] = pin_forces(times)
    for _ in times:
        mujoco.mj_forward(model, data)
        found.append(data.efc_force[[0, 2]].copy())
        mujoco.mj_step(model, data)
    found = np.array(found)
    found *= np.sign(np.sum(found * exact))  # on the other body
    error = np.sqrt(np.sum((found - exact)[1:] ** 2) / np.sum(exact[1:] ** 2))
    assert error == pytest.approx(judged[setting], rel=0.05)
    assert (error > 0.01) == (setting == "Euler, 2 ms, default loops")
