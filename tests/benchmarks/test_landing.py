"""Benchmarks of contacts: thousands of impacts, and the leg in MuJoCo."""

import numpy as np
import pytest

from benchmarks import impacts, landing

WEIGHT = (4.0 + 4 * 0.2) * 9.81  # N


@pytest.mark.parametrize("scene", impacts.SCENES)
def test_scenes_stay_closed_and_balance_their_energy(scene):
    row = impacts.measured(scene, 1e-6, 20)
    assert row.status == "ok" and row.impacts >= 5
    assert row.closed < 1e-9 and row.balance < 1e-6


def test_mujocos_leg_is_that_of_the_example():
    pytest.importorskip("mujoco")
    theirs, ours = landing.Mujoco(12.0, 1e-3, "implicitfast", 2).motion(), landing.ours(12.0, 1e-6)[0]
    assert np.abs(theirs.q - ours.q).max() < 0.02 and np.abs(theirs.q - ours.q)[-1].max() < 2e-3
    for each in (theirs, ours):
        np.testing.assert_allclose(each.force[-1], [0.0, WEIGHT], atol=0.1)
    np.testing.assert_allclose(theirs.force[119], ours.force[119], atol=2.0)  # under the push
