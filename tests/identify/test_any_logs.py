"""`twin.identify.any_logs`, `twin.identify.samples`.

Logs of slow cameras, and of rows at a constant rate."""

import numpy as np
import pytest

from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.log_columns import unit_factor, wanted_columns
from twin.identify.samples import find_held

COLUMNS = wanted_columns("time=t,measured_x=x,command_phi=u")
ROWS = np.arange(800)
T = 0.05 * ROWS


def written(tmp_path, x, time=T):
    rows = [f"{t:.4f},{place:.5f},{0.2 * np.cos(t):.5f}" for t, place in zip(time, x, strict=True)]
    (tmp_path / "a.csv").write_text("\n".join(["t,x,u", *rows]))
    return tmp_path / "a.csv"


def frames(seed):
    """Rows in which a camera of 5 Hz with a late or early row has a new position, of 20 Hz."""
    late = np.random.default_rng(seed).choice([-1, 0, 0, 0, 1], len(ROWS) // 4)
    return np.unique(np.clip(ROWS[::4] + late, 0, len(ROWS) - 1))


def test_rows_that_hold_the_position_of_a_slow_camera_are_one_sample(tmp_path):
    new = frames(1)
    held = new[np.searchsorted(new, ROWS, "right") - 1]
    # up to 0.45 m/s and 1.3 m/s^2: 90 mm from frame to frame
    x = 0.15 * np.sin(3 * T)
    log = read_any(written(tmp_path, x[held]), COLUMNS)
    axis = log.axes["x"]
    assert axis.sampled == pytest.approx(T[new])
    assert axis.ball == pytest.approx(x[new], abs=1e-5)
    assert "new in one row of 4" in log.notes[0]
    assert len(log.notes) == 1


def test_of_a_ball_at_rest_a_slow_camera_has_a_sample_every_n_rows(tmp_path):
    x = 0.1 * np.sin(2 * np.clip(T, 0.0, 20.0))
    held = ROWS - ROWS % 4
    axis = read_any(written(tmp_path, x[held]), COLUMNS).axes["x"]
    assert axis.sampled == pytest.approx(T[::4])


def test_a_value_that_a_slow_camera_holds_without_a_ball_is_false(tmp_path):
    x = 0.15 * np.sin(3 * T)[ROWS - ROWS % 4]
    x[400:420] = -0.6  # five frames
    x[600:604] = 0.5  # one
    log = read_any(written(tmp_path, x), COLUMNS)
    axis = log.axes["x"]
    assert len(axis.sampled) == len(ROWS) // 4 - 6
    assert np.abs(axis.ball).max() < 0.151


@pytest.mark.parametrize("step", [0.1, 0.2])
def test_where_a_fast_ball_turns_a_slow_camera_sees_no_false_one(tmp_path, step):
    time = step * np.arange(300)
    x = 0.12 * (1 - np.cos(3 * np.maximum(time - 10, 0.0)))  # up to 1.1 m/s^2
    log = read_any(written(tmp_path, x, time), COLUMNS)
    assert len(log.axes["x"].ball) == len(time)
    x[200] += 0.5
    assert len(read_any(written(tmp_path, x, time), COLUMNS).axes["x"].ball) == len(time) - 1


def test_coarse_readings_of_a_slow_ball_are_not_held():
    slow = np.round(1e3 * (0.03 * np.sin(0.2 * T))) / 1e3
    assert find_held(slow)[1] == 1
    assert not find_held(slow)[0].any()
    assert find_held(0.1 * np.sin(3 * T))[1] == 1
    assert find_held(np.zeros(100))[1] == 1


@pytest.mark.parametrize("time", ["row:20Hz", "row:0.02kHz", "row:50ms", "n:20Hz", "1:20Hz"])
def test_rows_at_a_constant_rate_need_no_column_of_times(tmp_path, time):
    x = 0.1 * np.sin(T)
    rows = [
        f"{k + 7},{place:.6f},{u:.6f}"
        for k, (place, u) in enumerate(zip(x, np.cos(T), strict=True))
    ]
    (tmp_path / "a.csv").write_text("\n".join(["n,x,u", *rows]))
    axis = read_any(
        tmp_path / "a.csv", wanted_columns(f"time={time},measured_x=x,command_phi=u")
    ).axes["x"]
    assert axis.time == pytest.approx(T)
    assert axis.ball == pytest.approx(x, abs=1e-6)


def test_a_damaged_row_takes_its_time(tmp_path):
    rows = [f"{place:.6f};{u:.6f}" for place, u in zip(0.1 * np.sin(T), np.cos(T), strict=True)]
    rows[300] = "7"
    (tmp_path / "a.csv").write_text("\n".join(["x;u", *rows]))
    told = wanted_columns("time=row:20Hz,measured_x=x,command_phi=u")
    axis = read_any(tmp_path / "a.csv", told).axes["x"]
    assert axis.sampled == pytest.approx(np.delete(T, 300))
    assert axis.ball == pytest.approx(0.1 * np.sin(axis.sampled), abs=1e-6)


def test_a_pause_is_reported_with_its_length_and_a_clock_that_begins_anew_is_none(tmp_path):
    x = 0.05 * np.sin(0.3 * T)
    there = (T < 10.0) | (T >= 14.0)
    (note,) = read_any(written(tmp_path, x[there], T[there]), COLUMNS).notes
    assert note.startswith("1 gap of 4.05 s in all")  # from the row before to the one after
    (note,) = read_any(written(tmp_path, x, T % 20.0), COLUMNS).notes
    assert note.startswith("the clock begins anew 1 time")


def test_a_column_that_is_called_row_is_taken_as_one(tmp_path):
    rows = [
        f"{t:.3f},{x:.6f},{u:.6f}"
        for t, x, u in zip(2 * T, 0.1 * np.sin(T), np.cos(T), strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["Row,x,u", *rows]))
    told = wanted_columns("time=row:s,measured_x=x,command_phi=u")
    assert read_any(tmp_path / "a.csv", told).axes["x"].time == pytest.approx(2 * T)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("measured_x=x,command_phi=u", "give time in --columns, too: .* time=row:100Hz"),
        ("time=row,measured_x=x,command_phi=u", "time: give the rate of .*, as time=row:100Hz"),
        ("time=row:Hz,measured_x=x,command_phi=u", "unit 'Hz'; known: .* rate of rows, as 100Hz"),
        ("time=row:0Hz,measured_x=x,command_phi=u", "unit '0Hz'"),
        ("time=row:RATEHz,measured_x=x,command_phi=u", "unit 'RATEHz'"),
        ("time=t,measured_x=x:20Hz,command_phi=u", "unit '20Hz'"),
    ],
)  # fmt: skip
def test_a_rate_that_is_none_is_one_line(tmp_path, columns, says):
    with pytest.raises(LogError, match=says) as caught:
        read_any(written(tmp_path, 0.1 * np.sin(T)), wanted_columns(columns))
    assert "\n" not in str(caught.value)


def test_a_rate_is_the_inverse_of_a_time():
    assert unit_factor("50Hz", "s") == pytest.approx(0.02)
    assert unit_factor("2.5 kHz", "s") == pytest.approx(4e-4)
    assert unit_factor("50Hz", "m") is None


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("time=t,measured_x=x@60,command_phi=u", r"as measured_x=x:mm@60$"),
        ("time=t,measured_x=2@-1.5,command_phi=u", r"as measured_x=2:mm@-1.5$"),
        ("time=t,measured_x=x,command_phi=u@90", r"as command_phi=u:deg@90$"),
        ("time=t,measured_x=x@60mm,command_phi=u", r"as measured_x=x:mm@60$"),
        ("time=t,measured_x=w@60,command_phi=u", "no column w@60"),
        ("time=t,measured_x=x@y,command_phi=u", "no column x@y"),
    ],
)
def test_a_number_at_zero_without_a_unit_is_answered_with_the_right_form(tmp_path, columns, says):
    with pytest.raises(LogError, match=says) as caught:
        read_any(written(tmp_path, 0.1 * np.sin(T)), wanted_columns(columns))
    assert "\n" not in str(caught.value)


def test_positions_in_rows_of_their_own_are_taken_at_the_times_of_x(tmp_path):
    """The rows of x, y and the command follow each other; no row has two of them."""
    lines = [
        line
        for t in T
        for line in (
            f"{t:.3f},{0.1 * np.sin(t):.6f},,,",
            f"{t + 0.01:.3f},,{0.1 * np.cos(t + 0.01):.6f},,",
            f"{t + 0.02:.3f},,,{np.cos(t):.6f},{np.sin(t):.6f}",
        )
    ]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["t,x,y,u,v", *lines]))
    log = read_any(
        file, wanted_columns("time=t,measured_x=x,measured_y=y,command_phi=u,command_theta=v")
    )
    x, y = log.axes["x"], log.axes["y"]
    assert len(x.sampled) >= len(T) - 2
    assert x.ball == pytest.approx(0.1 * np.sin(x.sampled), abs=2e-6)
    assert y.ball == pytest.approx(0.1 * np.cos(y.sampled), abs=1e-4)
    assert any("rows of its own" in note for note in log.notes)


def test_a_log_in_which_the_ball_is_never_seen_is_one_line(tmp_path):
    lines = [f"{t:.3f},{0.1 * np.sin(t):.6f},{np.cos(t):.6f},0" for t in T]
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["t,x,u,touched", *lines]))
    with pytest.raises(LogError, match="no row has a ball that is seen"):
        read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u,touched=touched"))


def test_a_log_of_zeros_alone_is_one_line(tmp_path):
    file = tmp_path / "a.csv"
    file.write_text("\n".join(["t,x,u", *(80 * ["0,0,0"])]))
    with pytest.raises(LogError, match="0 usable rows"):
        read_any(file, wanted_columns("time=t,measured_x=x,command_phi=u"))
