"""`twin.board.export`.

The C controller against the Python one, period by period."""

import pytest
from board_source import compiled, replayed, scenario

from twin.board.export import export

LAWS = {
    "pole_placement": "luenberger",
    "lqr": "luenberger",
    "feedforward": "kalman",
    "pid": "nonlinear_luenberger",
    "afl": "ekf",
    "afl_integral": "kalman",
    "backstepping": "nonlinear_luenberger",
    "sliding_mode": "luenberger",
}
"""Each law, with one of the observers."""
LOST = {"sensors__touch__lost": 0.02, "sensors__touch__frame_rate": 133.0}
"""Frames slower than the control period, one of 50 lost."""


@pytest.mark.parametrize("law", LAWS)
def test_a_law_in_c_commands_what_it_commands_in_python(law, tmp_path):
    chosen = scenario(controller__kind=law, observer__kind=LAWS[law], duration=0.6)
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen)))
    assert passed
    assert difference < 1e-14


def test_the_predictor_in_c_is_that_of_python_with_frames_lost(tmp_path):
    delay = {"predictor__kind": "smith", "predictor__delay": 0.0413}
    chosen = scenario(observer__kind="kalman", duration=1.0, **delay, **LOST)
    passed, difference = replayed(compiled(export(tmp_path / "plate.c", chosen)))
    assert passed
    assert difference < 1e-14
