"""`twin.board.state`: observers with a dead time and a state in many places, in C."""

import ctypes
import math

import numpy as np
import pandas as pd
import pytest
from board_source import FRAMES, LIMITS, compiled, remeasured, replayed, scenario

from twin.board.state import ObserverState
from twin.run.controller_building import control_of
from twin.run.controller_source import export

FRICTION = {"observer__kind": "friction_kalman", "plant__friction__rolling_mm": 0.18}
AT_REST = {
    "observer__smooth": 0.002,
    "observer__resting_walk": 0.03,
    "observer__keep_at_rest": True,
    "observer__forget_rest": 0.05,
    "observer__swinging_pole": 5.0,
}
"""What the cure has beyond the defaults: other walks at rest, and a plate that swings."""
MODELLED = {"observer__plate": "modelled", "rig__plate_lag": 0.02}
"""A plate without encoders and with drives that lag."""


def exported(folder, real="double", **settings):
    chosen = scenario(**({"duration": 0.6} | FRICTION | FRAMES | settings))
    return chosen, export(folder / "plate.c", chosen, real=real)


@pytest.mark.long
@pytest.mark.parametrize("more", [{}, AT_REST, MODELLED], ids=["measured", "at rest", "modelled"])
def test_friction_kalman_in_c_commands_what_it_commands_in_python(more, tmp_path):
    _, folder = exported(tmp_path, controller__kind="afl", **more)
    passed, difference = replayed(compiled(folder))
    assert passed
    assert difference < 1e-12


def test_the_state_is_what_a_period_changes_and_no_more():
    """Two plates, a queue of 22 periods, a covariance of nine states: counted by hand."""
    observer = control_of(scenario(**FRICTION, **FRAMES)).observer
    before = vars(observer).copy()
    state = ObserverState(observer)
    assert vars(observer) == before  # it is not run itself
    names = [str(each) for each in state.of(state.now)]
    assert names == [str(each) for each in state.symbols]
    assert [str(each) for each in state.of(state.begun)[:8:2]] == [f"y_{i}" for i in range(4)]
    covariance = state.now._P.ravel().tolist()
    assert len({str(each.expression) for each in covariance}) == 81
    assert len(state.now._ball._past) == 22
    entries = [each.expression for tilt in state.now._ball._past for each in tilt]
    assert {str(each) for each in entries} <= set(names)
    slow = vars(state.now._plates[0])
    assert slow["_period"] == 0.002  # a constant stays a number


@pytest.mark.long
def test_limits_in_c_are_those_of_python_behind_friction_kalman(tmp_path):
    _, folder = exported(tmp_path, duration=1.2, **LIMITS)
    run = pd.read_csv(folder / "reference_run.csv")
    rates = run[["rate_phi", "rate_theta"]]
    assert rates.abs().max().max() == pytest.approx(math.radians(1.5))
    assert not run.touched.all()
    passed, difference = replayed(compiled(folder))
    assert passed
    assert difference < 1e-12


@pytest.mark.long
def test_a_ball_that_is_put_elsewhere_is_an_impact_in_c_as_in_python(tmp_path):
    def move(run):
        run.loc[150:, "x"] += 0.04
        run.loc[220:, "y"] -= 0.03

    chosen, folder = exported(tmp_path)
    source = folder / "plate.c"
    remeasured(folder, chosen, move)
    passed, difference = replayed(compiled(folder))
    assert passed
    assert difference < 1e-12
    # without the reaction to impacts it is another command
    constant = "OBSERVER_IMPACT_TEST_OUTLIER_SQUARED_DISTANCE = 36.0"
    text = source.read_text("utf-8")
    assert constant in text
    source.write_text(text.replace(constant, constant[:-4] + "1e9"), "utf-8")
    assert not replayed(compiled(folder))[0]


@pytest.mark.long
def test_a_plate_without_encoders_needs_no_measured_angle(tmp_path):
    chosen, folder = exported(tmp_path, duration=0.2, **MODELLED)
    assert "without encoders phi and theta are NaN" in (folder / "plate.h").read_text("utf-8")

    def blind(run):
        run[["phi", "theta"]] = np.nan

    remeasured(folder, chosen, blind)
    passed, difference = replayed(compiled(folder))
    assert passed
    assert difference < 1e-12


@pytest.mark.long
@pytest.mark.parametrize("more", [{}, MODELLED], ids=["measured", "modelled"])
def test_a_ball_that_is_no_number_is_reported(more, tmp_path):
    _, folder = exported(tmp_path, duration=0.01, **more)
    library = ctypes.CDLL(str(compiled(folder, "-shared", "-fPIC")))
    state, command = ctypes.create_string_buffer(8192), (ctypes.c_double * 13)()
    library.plate_init(state)
    rates = []
    for k in range(60):
        ball = math.nan if k == 20 else 0.01
        measured = np.array([ball, 0.0, 0.0, 0.0, 0.0, 0.0])
        measured[5:].view(np.int64)[:] = 1
        library.plate_step(state, measured.ctypes.data_as(ctypes.c_void_p), command, command)
        rates.append(list(command)[:2])
    valid = np.frombuffer(command, np.int32)[24]
    assert not valid
    assert np.isfinite(rates).all()
