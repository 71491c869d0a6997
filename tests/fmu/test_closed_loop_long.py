"""`twin.fmu`: The C rig under the twin's own loop, law and observer, for the whole circle."""

import numpy as np
import pytest
from c_rig import CRig, behind_the_seam, counted, exact, followed, made

from twin.run.assemble import assemble
from twin.run.controller_building import build_controller


@pytest.mark.long
@pytest.mark.parametrize("name", ["circle", "cure"])
def test_a_circle_under_the_loop_of_the_twin_is_the_same(tmp_path, name):
    harder = {"plant__friction__breakaway_ratio": 2.0, "plant__friction__dwell_time": 0.3}
    scenario = exact(name, seed=5, **harder)
    twin = assemble(scenario)
    there = followed(counted(twin.rig, 5), twin.controller, scenario)
    rig = behind_the_seam(CRig(made(tmp_path, name, seed=5, **harder)).begin(), scenario)
    here = followed(rig, build_controller(scenario), scenario)
    assert np.abs(here - there)[:, [0, 4]].max() < 1e-9
    rests = [(each[:, [1, 5]] == 0).all(axis=1) for each in (there, here)]
    assert rests[0].sum() > 100
    np.testing.assert_array_equal(*rests)
