"""The confusion matrix counts what was said of each rig."""

from __future__ import annotations

import numpy as np

from twin.shadow.injections import HEALTHY, KINDS, rig
from twin.shadow.matrix import CALIBRATED, INJECTED, JUDGED, Trial
from twin.shadow.matrix_page import page


def trial(seed, kind, alarm=None, causes=(), largest=1.0):
    return Trial(seed, kind, largest, alarm, causes, np.array([1.0, 7.0]), np.array([5e-4, 7e-4]))


def test_alarms_count_in_time_right_wrong_and_early():
    friction = KINDS[0]
    found = [
        *[trial(CALIBRATED + k, HEALTHY, largest=1.0 + 0.3 * k) for k in range(6)],
        trial(JUDGED, HEALTHY),
        trial(JUDGED + 1, HEALTHY, alarm=30.0, causes=("level",)),
        trial(INJECTED, friction, 25.0, ("rolling friction",)),
        trial(INJECTED + 2, friction, 39.0, ("another ball", "rolling friction")),
        trial(INJECTED + 4, friction, 26.0, ("level",)),
        trial(INJECTED + 6, friction, 41.0, ("rolling friction",)),
        trial(INJECTED + 1, friction, 49.0, ("rolling friction",)),  # a ramp is complete at 30 s
        trial(INJECTED + 8, friction, 12.0, ("rolling friction",)),
    ]
    text = page(found, "ballplate shadow --matrix")
    row = next(line for line in text.splitlines() if line.startswith("| rolling friction +30 %"))
    cells = [cell.strip() for cell in row.strip("|").split("|")]
    assert cells[1] == "6"
    assert cells[2].startswith("80 ")  # 4 of 5, one came early
    assert cells[3].startswith("75 ")  # 3 of 4, one of them among those not told apart
    assert cells[4].startswith("25 ")
    assert cells[5] == "1"
    assert "1 in 0.03 h" in text
    assert "50.0 % of 4" in text
    assert "0.60 mm" in text


def test_every_kind_is_a_rig_that_can_be_simulated_jump_or_ramp():
    for kind in KINDS:
        for seed in (2, 3):
            belief, truth = rig(seed, "excite", kind)
            assert not belief.change
            assert len(truth.change) == 1
            assert (truth.change[0].over > 0) == (kind.ramps and seed == 3)
