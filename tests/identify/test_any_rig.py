"""`twin.identify.any_rig`: Logs of rigs that are none of ours: read, fitted, judged and refused."""

from __future__ import annotations

import json
from dataclasses import replace
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from ballplate import identify, run
from controllers.ballplate import BallPlate
from twin.base.errors import LogError, ScenarioError, TwinError
from twin.cli.understand import identify as command
from twin.identify import drive_effects
from twin.identify.any_logs import read_any
from twin.identify.any_rig import (
    _describe_gain,
    identify_axes,
    join_logs,
)
from twin.identify.axis_fitting import AXIS_FITTING
from twin.identify.axis_identification import AxisIdentification
from twin.identify.axis_logs import AnyLog, AxisLog
from twin.identify.axis_prediction import predict_axis, prediction_times, refit_for_prediction
from twin.identify.axis_problem import AxisProblem
from twin.identify.axis_verdicts import assess_axis
from twin.identify.balls import ball_factor
from twin.identify.command_model import TiltHistory, apply_play, drive_path
from twin.identify.drive_effects import profile, profile_drives
from twin.identify.least_squares import Minimum, Termination, fit_starts, fit_starts_from_scratch
from twin.identify.log_columns import unit_factor, wanted_columns
from twin.identify.model_choice import select_model
from twin.identify.parameters import PLAIN_PARAMETERS, plain_parameter
from twin.identify.plain_model import AxisFit, fit_axis
from twin.identify.profiles import Profile
from twin.identify.report import sentences
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    HOLD_OUT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    ParameterVerdict,
    score,
)
from twin.identify.windows import axis_windows, spans
from twin.scenario import load

ROOT = Path(__file__).parents[2]
CAMERA_COLUMNS = (
    "time=t_s:s,measured_x=x_m:m,command_phi=theta_x_ACTUATE_deg:deg,measured_y=y_m:m,"
    "command_theta=-theta_y_ACTUATE_deg:deg,touched=detected"
)
"""Columns of a log of a rig with a camera and servos, as its own program writes them."""
TRUTH = {"gain": 6.0, "dead_time": 0.1, "lag": 0.08, "level": 0.05, "friction": 0.03}
OWN = ("time", "measured_x", "measured_y", "measured_phi", "measured_theta", "age", "touched")
OWN_COLUMNS = ",".join(f"{each}={each}" for each in OWN)
T = np.arange(400) / 40.0
X = 0.05 * np.sin(1.3 * T)


def lines(separator, comma=".", header=True, scale=1000.0, start=0.0):
    rows = ["ms;X [mm];u;seen".replace(";", separator)] if header else []
    for t, x in zip(T, X, strict=True):
        cells = (f"{1e3 * (start + t):.3f}", f"{scale * x:.4f}", f"{20 * np.cos(t):.4f}", "1")
        rows.append(separator.join(cells).replace(".", comma))
    return rows


def written(tmp_path, rows):
    file = tmp_path / "log.txt"
    file.write_text("\n".join(rows) + "\n", encoding="utf-8")
    return file


COLUMNS = "time=ms:ms,measured_x=x,command_x=-u:0.3deg,touched=seen"


def table(file, separator=",", **columns):
    """A text file of columns by name."""
    rows, head = np.column_stack([*columns.values()]), separator.join(columns)
    np.savetxt(file, rows, delimiter=separator, header=head, comments="")
    return file


def logged(ran, tmp_path):
    return table(tmp_path / "log.csv", **{name: ran[name] for name in OWN})


def printed(*arguments):
    """What the command prints."""
    done = CliRunner().invoke(command, [*map(str, arguments)])
    assert done.exit_code == 0, done.output
    return done.stdout


def along_x(axis, source="rig.csv"):
    """A log of one axis."""
    return AnyLog(source, {"x": axis}, {"x": "rad"}, ())


def by_name(found):
    return {each.name: each for each in found.verdicts}


def of_axis(axis, *parameters):
    """What is found of one axis, and its verdicts by name."""
    found = identify_axes([along_x(axis)], 1 / 3, *parameters)
    return found, by_name(found)


def windowed(log, names, begin, end, lasting):
    """The problem of windows of a log that begin and end at these times."""
    windows = axis_windows(log, np.atleast_1d(begin), np.atleast_1d(end))
    return AxisProblem(windows, names, TiltHistory(log), lasting, (0.0, 0.5))


@pytest.mark.parametrize(
    ("separator", "comma", "told"),
    [(",", ".", None), (";", ",", None), ("\t", ",", None), (" ", ".", None), (";", ".", ";"),
     ("\t", ".", "tab")],
)  # fmt: skip
def test_columns_are_read_of_any_separator_sign_and_unit(tmp_path, separator, comma, told):
    rows = lines(separator, comma)
    if separator == " ":
        rows[0] = "ms X u seen"
    columns = COLUMNS if separator != " " else COLUMNS.replace("=x,", "=x:mm,")
    log = read_any(written(tmp_path, rows), wanted_columns(columns), told)
    axis = log.axes["x"]
    assert list(log.axes) == ["x"]
    assert axis.ball == pytest.approx(X, abs=1e-7)
    assert axis.time == pytest.approx(T)
    assert axis.tilt == pytest.approx(-np.radians(0.3) * 20 * np.cos(T), abs=1e-6)


def test_columns_have_numbers_where_there_is_no_header_and_pixels_a_length(tmp_path):
    file = written(tmp_path, ["# a remark", *lines(",", header=False, scale=2000, start=1.7e9)])
    told = "time=1:ms,measured_x=2:0.5mm,command_phi=3:counts"
    log = read_any(file, wanted_columns(told))
    assert log.axes["x"].ball == pytest.approx(X, abs=1e-6)
    assert np.ptp(log.axes["x"].time) == pytest.approx(np.ptp(T), abs=1e-5)
    assert log.unit["x"] == "count"


@pytest.mark.parametrize(
    ("stamp", "encoding"),
    [("%Y-%m-%dT%H:%M:%S.%f", "utf-8-sig"), ("%Y-%m-%d %H:%M:%S,%f", "cp1252"),
     ("%H:%M:%S.%f", "utf-16")],
)  # fmt: skip
def test_times_may_be_dates_and_files_those_of_windows(tmp_path, stamp, encoding):
    begin = datetime(2026, 5, 1, 12, 59, 57)
    rows = ["Zeit;Ort [mm];Winkel [°]"]
    for t, x in zip(T, X, strict=True):
        when = (begin + timedelta(seconds=t)).strftime(stamp)
        rows.append(f"{when};{1e3 * x:.4f};{20 * np.cos(t):.4f}")
    file = tmp_path / "log.csv"
    file.write_bytes("\r\n".join(rows).encode(encoding))
    columns = wanted_columns("time=Zeit,measured_x=Ort,command_x=Winkel")
    axis = read_any(file, columns).axes["x"]
    assert axis.time == pytest.approx(T, abs=1e-5)
    assert axis.ball == pytest.approx(X, abs=1e-7)
    assert axis.tilt == pytest.approx(np.radians(20) * np.cos(T), abs=1e-5)


def test_what_is_broken_in_a_log_is_left_out_and_said(tmp_path):
    rows = lines(",")
    rows[50] = rows[50].replace(",1", ",0")  # not seen
    rows[60] = ",".join([rows[60].split(",")[0], "", "nan", "1"])
    rows[70] = rows[69]  # a doubled time
    rows[80] = rows[80][:5] + "?," + ",".join(rows[80].split(",")[1:])
    for k in range(100, 108):  # a value of no ball
        rows[k] = ",".join([rows[k].split(",")[0], "-80.0", *rows[k].split(",")[2:]])
    for k in range(191, 202):  # the one before, held while the ball rolls on
        rows[k] = ",".join([rows[k].split(",")[0], *rows[190].split(",")[1:]])
    log = read_any(written(tmp_path, rows), wanted_columns(COLUMNS))
    axis = log.axes["x"]
    assert len(axis.ball) == len(T) - 23
    assert axis.ball == pytest.approx(0.05 * np.sin(1.3 * axis.sampled), abs=1e-6)
    assert np.abs(axis.ball).max() < 0.051
    said = " ".join(log.notes)
    assert "19 ball positions left out" in said
    assert "1 row of a time" in said


def test_rows_of_one_frame_are_one_sample_where_their_age_is_told(tmp_path):
    time = np.arange(0.0, 8.0, 0.002)
    frame = np.floor(time * 50) / 50
    rows = ["t,x,u,age"]
    for t, taken in zip(time, frame, strict=True):
        x = 0.05 * np.sin(1.3 * taken)
        rows.append(f"{t:.4f},{x:.7f},{0.02 * np.cos(t):.5f},{t - taken:.6f}")
    columns = "time=t:s,measured_x=x:m,command_phi=u:rad,age=age:s"
    axis = read_any(written(tmp_path, rows), wanted_columns(columns)).axes["x"]
    assert np.diff(axis.sampled) == pytest.approx(np.full(len(axis.sampled) - 1, 0.02), abs=1e-5)
    assert axis.ball == pytest.approx(0.05 * np.sin(1.3 * axis.sampled), abs=1e-5)
    assert len(axis.time) == len(time)


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        ("time=ms:ms,measured_x=x", "command_phi or measured_phi, for measured_x"),
        ("measured_x=x,command_phi=u", "give time"),
        ("time=ms:ms measured_x=X", "put commas between the columns: time=ms:ms,measured_x=X"),
        ("time=ms:ms,mesured_x=x", "role one of time"),
        ("time=ms:hours,measured_x=x,command_phi=u", "unit 'hours'"),
        ("time=ms:ms,mesured_x=x", "did you mean 'measured_x'"),
        ("time=mss:ms,measured_x=x,command_phi=u", "no column mss; did you mean 'ms'"),
        ("time=ms:ms,measured_x=ball,command_phi=u", r"no column ball \(it has ms, X"),
        ("time=ms:s,measured_x=x,command_phi=u", "milliseconds"),
        ("time=ms:ms,measured_x=x:m,command_phi=u", "give the unit"),
    ],
)
def test_a_column_that_is_missing_or_wrong_is_named_with_what_would_do(tmp_path, columns, says):
    with pytest.raises(LogError, match=says) as caught:
        read_any(written(tmp_path, lines(",")), wanted_columns(columns))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("noise", "at", "says"),
    [
        (0.0, 0.03, "does not move: it stays within 0 m of one place"),
        (0.0, 0.0, "does not move: it stays within 0 m of one place"),
        (2e-4, 0.03, "does not move"),
        (2e-4, 0.0, "the ball hardly moves, or give the unit"),
    ],
)
def test_of_a_ball_that_never_moves_no_other_unit_is_advised(tmp_path, noise, at, says):
    time = 0.01 * np.arange(500)
    place = at + noise * np.random.default_rng(0).standard_normal(500)
    table = np.column_stack([time, place, 0.05 * np.sin(3 * time)])
    file = tmp_path / "still.csv"
    np.savetxt(file, table, delimiter=",", header="t,x,u", comments="")
    columns = wanted_columns("time=t:s,measured_x=x:m,command_phi=u:rad")
    with pytest.raises(LogError, match=says) as caught:
        read_any(file, columns)
    assert ("give the unit" in str(caught.value)) == ("unit" in says)


def test_a_unit_may_have_a_factor_and_a_ball_is_a_name_or_a_share():
    assert unit_factor("0.24deg", "rad") == pytest.approx(np.radians(0.24))
    assert unit_factor("5e-4", "m") == 5e-4
    assert unit_factor("in", "m") == 0.0254
    assert unit_factor("furlong", "m") is None
    assert (ball_factor("solid"), ball_factor("0.6")) == (5 / 7, 0.6)
    with pytest.raises(LogError, match="hollow"):
        ball_factor("round")


@pytest.fixture(scope="module")
def axis_of(axis_log):
    """Gives the log of an axis with the truth, but for what is told."""

    def of(seed, **about):
        time, ball, command = axis_log(seed, **{**TRUTH, **about})
        return AxisLog(time, command, True, time, ball)

    return of


def left_by(log, truth):
    """What the true parameters leave of each window, m RMS."""
    problem = windowed(log, tuple(truth), *spans(log, 2.5), 2.6)
    windows = replace(problem.windows, weight=problem.windows.weight / 1e-5)
    problem = replace(problem, windows=windows)
    theta = np.array([[*truth.values()]])
    theta[0, 0] *= problem.tilt.scale
    starts = fit_starts(problem, theta, fit_starts_from_scratch(problem, theta, 4), 10)
    off = (problem.simulate_samples(theta, starts)[0][0] - windows.ball)[..., 0]
    return np.sqrt(np.nanmean(np.where(windows.weight[..., 0] > 0, off, np.nan) ** 2, axis=1))


@pytest.mark.short("1120-1200")
@pytest.mark.parametrize(("first", "lost"), [(0, 1200), (1120, 1200)])
def test_the_truth_explains_a_log_where_commands_from_before_it_or_a_pause_act(
    axis_log, first, lost
):
    truth = TRUTH | {"dead_time": 0.2, "lag": 0.06, "camber": 0.3, "lever": 0.08}
    whole = axis_log(3, seconds=22, rate=100.0, noise=0.0, pixel=0.0, **truth)
    time, ball, command = (np.delete(each, slice(first, lost)) for each in whole)
    log = AxisLog(time, command, True, time, ball)
    all_of_it, known = left_by(log, truth), left_by(join_logs([log]), truth)
    step = 2.5e-4 * np.abs(np.gradient(whole[1], whole[0])).max()  # of the simulation, as a way
    assert (known < step).all()
    assert (all_of_it > 4 * step).sum() == 1


@pytest.mark.long
def test_along_levers_dead_time_and_lag_are_found_from_a_fit_that_has_no_lag(axis_log):
    """As a lag is a lever of - g lag^2 / 2 and so much dead time less, a lever may hide it."""
    truth = TRUTH | {"dead_time": 0.2, "lag": 0.05}
    rig = truth | {"lever": 0.03, "noise": 0.0, "pixel": 0.0, "rate": 100.0}
    time, ball, command = axis_log(3, seconds=22, **rig)
    log = join_logs([AxisLog(time, command, True, time, ball)])
    fit = fit_axis(log, tuple(truth), 2.5, (0.0, 0.5))
    found = profile(fit, "lever", (0.0, 0.02, 0.03, 0.04))
    assert fit.value("lag") < 0.02
    assert found.costs.sum(axis=1).argmin() == 2
    lags = found.theta[2:, found.names.index("lag")]
    assert lags == pytest.approx(np.sqrt(0.05**2 + 2 * np.array([0.0, 0.01]) / 9.81), abs=0.003)


@pytest.mark.parametrize("lever", [0.0, 0.15, -0.08])
def test_a_simulation_without_friction_is_the_closed_form(lever):
    """A step of the command behind dead time and lag: s^2/2 - T s + T^2 (1 - e^-s/T) of it.

    The lever takes the plate's angle from it, (1 - e^-s/T) lever / g.
    """
    time = np.arange(0.0, 4.0, 0.02)
    tilt = np.where(time >= 1.0, 0.02, 0.0)
    log = AxisLog(time, tilt, True, time, np.zeros_like(time))
    problem = windowed(log, ("gain", "dead_time", "lag", "level", "lever"), 0.5, 3.5, 3.0)
    theta = np.array([[6.0 * problem.tilt.scale, 0.13, 0.1, 0.03, lever]])
    found = problem.simulate_samples(theta, np.array([[[0.01]], [[0.02]]]))[0][0, 0, :, 0]
    t = problem.windows.time[0]
    s = np.maximum(t + 0.5 - 1.0 - 0.13, 0.0)
    turned = 1 - np.exp(-s / 0.1)
    moved = 0.12 * (s**2 / 2 - 0.1 * s + (0.01 - lever / 9.81) * turned)
    assert found == pytest.approx(0.01 + 0.02 * t + 0.015 * t**2 + moved, abs=2e-4)


def test_a_ball_that_friction_holds_rests_and_another_comes_to_rest_after_v2_by_2a():
    time = np.arange(0.0, 3.0, 0.02)
    log = AxisLog(time, np.sin(time), True, time, np.zeros_like(time))
    problem = windowed(log, ("gain", "dead_time", "level", "friction"), [0, 0], [2.5, 2.5], 2.5)
    places = problem.simulate(
        np.array([[0.0, 0.0, 0.02, 0.05]]), np.array([[[0.0, 0.0]], [[0.0, 0.03]]])
    )
    assert places[-1, 0, 0] == 0.0
    assert places[-1, 0, 1] == pytest.approx(0.03**2 / (2 * 0.03), rel=0.01)


@pytest.mark.short("0.0-1e-05", "0.001-*")
@pytest.mark.parametrize(
    ("across", "most"), [(0.0, 1e-5), (5e-4, 5e-5), (0.001, 3e-5), (0.005, 1e-5), (0.02, 1e-5)]
)
def test_a_ball_turns_under_friction_that_acts_against_its_old_way_then_its_new(across, most):
    """Its speed passes none anywhere in a step: one way for all of the step is 0.8 mm/s off then.

    That is twice what friction does in a step, and stays for all time after it.
    """
    f, level = 0.05, -0.15
    v = np.linspace(0.05, 0.06, 40)
    time = np.arange(0.0, 3.0, 0.02)
    ways = np.array([[0.0, 3.0], [across, across]])
    log = AxisLog(time, np.sin(time), True, time, 0 * time, ways)
    names = ("gain", "dead_time", "level", "friction")
    problem = windowed(log, names, np.zeros(40), np.full(40, 1.2), 1.2)
    theta = np.array([[0.0, 0.0, level, f]])
    found = problem.simulate(theta, np.stack((0 * v, v))[:, None])[-1, 0]
    if across:
        p, h = 0 * v, 1e-4
        for _ in range(12_000):
            middle = v + h / 2 * (level - f * v / np.hypot(v, across))
            v = v + h * (level - f * middle / np.hypot(middle, across))
            p = p + h * middle
    else:
        turn = v / (f - level)
        p = v * turn / 2 + (level + f) * (1.2 - turn) ** 2 / 2
    assert found == pytest.approx(p, abs=most)


def test_the_way_of_a_ball_that_is_seen_along_both_axes_is_known_across_each(tmp_path):
    time = np.arange(0.0, 6.0, 0.02)
    rows = [
        f"{t:.3f},{0.01 * np.sin(t):.6f},{0.1 * t - 0.3:.6f},{0.1 * np.cos(t):.5f},{np.sin(t):.5f}"
        for t in time
    ]
    columns = "time=1:s,measured_x=2:m,measured_y=3:m,measured_phi=4:rad,measured_theta=5:rad"
    log = read_any(written(tmp_path, rows), wanted_columns(columns)).axes["x"]
    assert log.across[0][[0, -1]] == pytest.approx([0.0, 5.98], abs=0.1)
    assert log.across[1] == pytest.approx(0.1, abs=1e-6)


def test_a_drive_stands_in_its_dead_band_goes_at_its_slew_and_leaves_its_play():
    time = np.arange(6.0)
    sent = np.array([0.0, 1.0, 1.4, 2.0, 1.0, 1.0])
    at, place = drive_path(time, sent, 0.5, 0.0)
    assert place[np.searchsorted(at, time, "right") - 1] == pytest.approx([0, 1, 1, 2, 1, 1])
    for first, places in (
        (0.4, [0.0, 1.4, 1.4, 2.4, 1.4, 1.4]),
        (0.6, [0.6, 1.6, 1.6, 2.6, 1.6, 1.6]),
    ):
        at, place = drive_path(time, sent + first, 0.5, 0.0)  # it stood at 0 before
        assert place[np.searchsorted(at, time, "right") - 1] == pytest.approx(places)
    assert apply_play(sent, 0.1) == pytest.approx([0, 0.9, 1.3, 1.9, 1.1, 1.1])
    at, place = drive_path(time, sent, 0.5, 2.0)  # half a unit a second
    assert np.interp(np.arange(1.0, 6.0), at, place) == pytest.approx([0, 0.5, 1.0, 1.5, 1.0])
    log = AxisLog(time, sent, True, time, 0 * time)
    ramp = TiltHistory(log, 1.0).at(np.array([1.5, 2.5]), 0.0, 0.5, 0.0, 2.0, 0.0)
    assert ramp == pytest.approx([0.25, 0.75], abs=1e-9)


@pytest.mark.parametrize("half", [0.0, 0.02, 0.5, 3.0])
def test_play_follows_the_side_of_the_gap_that_touches(half):
    rng = np.random.default_rng(3)
    track = np.round(np.cumsum(rng.normal(0.0, 0.1, 400)), 2)  # with stretches at rest
    place, expected = 0.0, []
    for low, high in zip(track - half, track + half, strict=True):
        place = min(max(place, low), high)
        expected.append(place)
    assert (apply_play(track, half) == expected).all()


def test_play_is_behind_the_lag_of_its_drive():
    time = np.arange(0.0, 3.0, 0.02)
    log = AxisLog(time, np.where(time >= 1.0, 0.5, 0.0), True, time, 0 * time)
    at = np.array([1.05, 1.2, 2.0])
    drive = 0.5 * (1 - np.exp(-(at - 1.0) / 0.1))
    found = TiltHistory(log, 1.0).at(at, 0.1, 0.0, 0.2, 0.0, 0.0)
    assert found == pytest.approx(np.maximum(drive - 0.2, 0.0), abs=0.005)


@pytest.mark.parametrize("lag", [0.0, 5e-5, 1e-3, 0.02, 0.2])
def test_a_plate_that_turns_steadily_is_behind_its_angle_by_the_lag_and_no_more(lag):
    time = np.cumsum(np.random.default_rng(0).uniform(0.003, 0.05, 200))
    measured = AxisLog(time, 0.3 * time, False, time, np.zeros_like(time))
    at = np.array([3.3001, 4.7])
    assert TiltHistory(measured, 1.0).at(at, lag) == pytest.approx(0.3 * (at - lag), abs=0.3 * 2e-5)


@pytest.mark.short("0.9-0.1-True", "0.5-*")
@pytest.mark.parametrize(
    ("share", "best", "fits"), [(0.98, 0.1, False), (0.9, 0.1, True), (0.5, 0.0, False)]
)
def test_an_effect_that_gains_little_is_not_fitted_further(axis_of, monkeypatch, share, best, fits):
    log = axis_of(1, seconds=8.0)
    fit = fit_axis(log, ("gain", "dead_time", "level"), 1.5, (0.0, 0.5))
    own = fit.problem.costs(fit.found.linearisation.r)
    names = (*fit.problem.names, "play")
    tried = np.array([0.0, 0.1])
    theta = np.array([[*fit.found.theta[0], value] for value in tried])
    costs = np.where(tried[:, None] == best, share, 1.0) * own
    refitted = []

    def refit(self, *given):
        refitted.append(given)
        return replace(self, problem=replace(self.problem, names=names))

    monkeypatch.setattr(
        drive_effects, "profile", lambda *_, **__: Profile("play", names, theta, costs, 0)
    )
    monkeypatch.setattr(AxisFit, "refit", refit)
    found = drive_effects._fit_effect(fit, "play", tried, 1.5)
    assert bool(refitted) is fits
    assert (found is fit) is not fits


@pytest.mark.long
def test_a_fit_that_continues_the_best_lags_is_that_of_all_of_them(axis_of):
    log, search = axis_of(2, seconds=20.0, rate=60.0), AXIS_FITTING.search
    each = replace(search, lag_steps=30, continued_lags=6)
    few, all_of_them = (
        fit_axis(log, ("gain", "dead_time", "lag", "level", "friction"), 2.5, (0.0, 0.5), how)
        for how in (AXIS_FITTING, replace(AXIS_FITTING, search=each))
    )
    own, other = few.estimate(), all_of_them.estimate()
    assert own.value == pytest.approx(other.value, abs=0.02 * other.half_width.min())
    assert own.half_width == pytest.approx(other.half_width, rel=0.02)


@pytest.mark.long
@pytest.mark.parametrize(("name", "size"), [("dead_band", 0.0175), ("slew", 0.5)])
def test_dead_band_and_slew_of_the_drives_are_found_and_bias_nothing_else(axis_of, name, size):
    """A drive of its own simulates the commands' log: see axis_log."""
    log = axis_of(4, rate=60.0, seconds=45, camber=0.35, **{name: size})
    found, told = of_axis(log)
    assert told[f"{name}_x"].value == pytest.approx(size, rel=0.1)
    for other in ("gain", "friction", "camber"):
        truth = {**TRUTH, "camber": 0.35}[other]
        each = told[f"{other}_x"]
        assert each.value == pytest.approx(truth, abs=1.5 * (each.high - each.low))
    assert any("fitted along" in note for note in found.notes)
    without = ({"dead_band", "slew"} - {name}).pop()
    assert told[f"{without}_x"].value is None


@pytest.mark.long
@pytest.mark.parametrize(("name", "other"), [("play", "dead_band"), ("dead_band", "play")])
def test_play_and_dead_band_are_told_apart_over_twelve_rigs(axis_of, name, other):
    """Both models are fitted to the same windows; the truth is of 0.8 degrees."""
    width = truth = np.radians(0.8)
    held = 0
    for seed in range(12):
        rig = {"gain": 7.007, "dead_time": 0.05, "lag": 0.05, "friction": 0.025}
        log = axis_of(seed, rate=60.0, seconds=36, pixel=0.0, noise=4e-4, **rig, **{name: width})
        _, told = of_axis(log)
        right, wrong = told[f"{name}_x"], told[f"{other}_x"]
        held += right.low <= truth <= right.high
        assert wrong.word != IDENTIFIED_VERDICT
        assert wrong.low <= 0.0
    assert held >= 10


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate", "about"),
    [
        (25.0, {"pixel": 1e-3, "dead_time": 0.25}),
        (30.0, {"camber": 0.35, "dead_time": 0.02}),
        (240.0, {"camber": 0.35}),
        (1000.0, {"dead_time": 0.05}),
    ],
)
def test_a_rig_is_found_by_commands_alone_within_its_intervals(axis_of, rate, about):
    truth = {**TRUTH, "camber": 0.0, **about}
    names = ("friction", "camber") if "camber" in about else ("friction",)
    fit, _ = select_model(axis_of(3, rate=rate, seconds=50, **about), names)
    found = {each.name[:-2]: each for each in assess_axis(fit, "x", "rad")}
    for name in ("gain", "level", *names):
        each = found[name]
        assert each.word == IDENTIFIED_VERDICT
        # three times the interval: a twentieth of all is outside of the plain one
        half = 3 * (each.high - each.low) / 2
        assert each.value == pytest.approx(truth[name], abs=half)
        assert each.value == pytest.approx(truth[name], rel=0.1, abs=0.01)
    both = truth["dead_time"] + truth["lag"]
    assert found["delay"].value == pytest.approx(both, abs=0.004)


@pytest.mark.long
@pytest.mark.parametrize("angles", [True, False])
@pytest.mark.parametrize("lever", [0.155, -0.08])
def test_what_the_plates_acceleration_does_is_not_taken_for_gain(axis_of, lever, angles):
    """Under a quick controller: half as much again by acceleration."""
    truth = {**TRUTH, "lag": 0.06, "dead_time": 0.05, "camber": 0.2}
    log = axis_of(
        5, rate=60.0, seconds=40, lever=lever, angles=angles, stiff=3.0, damped=1.4, **truth
    )
    _, told = of_axis(replace(log, held=not angles))
    for name, true in (("gain_x", truth["gain"]), ("lever_x", lever)):
        assert told[name].low <= true <= told[name].high
    if angles:
        assert told["gain_x"].word == IDENTIFIED_VERDICT
        assert told["gain_x"].value == pytest.approx(truth["gain"], rel=0.05)
        assert told["lever_x"].value == pytest.approx(lever, abs=0.015)


@pytest.mark.long
@pytest.mark.parametrize(("w", "word"), [(1.0, IDENTIFIED_VERDICT), (5.0, NOT_IDENTIFIABLE)])
@pytest.mark.parametrize("lever", [0.2, -0.05])
def test_of_a_plate_that_swings_at_one_frequency_the_gain_holds_what_a_lever_does(lever, w, word):
    """There u'' = -w^2 u: only gain (1 + lever w^2 / g) shows, little of a slow one."""
    time = np.arange(0.0, 30.0, 0.02)
    tilt = 0.006 * w**2 * np.sin(w * time)
    seen = np.random.default_rng(0).normal(0.0, 2e-4, len(time))
    ball = -6.0 * (1 / w**2 + lever / 9.81) * tilt + seen
    _, told = of_axis(AxisLog(time, tilt, False, time, ball), ("friction",))
    gain = told["gain_x"]
    assert gain.word == word
    assert gain.low <= 6.0 <= gain.high
    assert ("lever" in gain.why) == (word == NOT_IDENTIFIABLE)


@pytest.mark.long
@pytest.mark.parametrize(("ball", "factor"), [("solid", 5 / 7), ("hollow", 3 / 5)])
def test_at_a_known_height_one_frequency_tells_the_gain(ball, factor, tmp_path):
    """By differences of the exact equations, of axes at two heights: x'' = a u + b u''."""
    w, nudge, heights = 5.0, 1e-6, (0.1, 0.23)
    time = np.arange(0.0, 20.0, 0.04)
    tilt = 0.006 * w**2 * np.sin(w * time)
    seen = np.random.default_rng(0).normal(0.0, 5e-5, (2, len(time)))
    columns, truth = {"t": time}, {}
    for k, (axis, angle, height) in enumerate(zip("xy", "ab", heights, strict=True)):
        inertia = 0.01 * 0.02**2 * (1 / factor - 1)
        exact = BallPlate(mass=0.01, radius=0.02, inertia=inertia, height=height - 0.02)
        x, u = np.zeros((2, 8)), np.zeros((2, 2))
        x[1, 2 + 4 * k] = u[1, k] = nudge
        by_angle, by_acceleration = (
            np.diff(exact.derivative(*each)[:, 1 + 4 * k])[0] / nudge
            for each in ((x, 0 * u), (0 * x, u))
        )
        truth[axis] = by_angle, -9.81 * by_acceleration / by_angle
        columns |= {axis: -(by_angle / w**2 - by_acceleration) * tilt + seen[k], angle: tilt}
    told = "time=t,measured_x=x,measured_phi=a,measured_y=y,measured_theta=b"
    how = ("--columns", told, "--ball", ball, "--ball-height", "0.1,0.23", "--json")
    how += ("--parameters", "friction", "--out", tmp_path / "out")
    told = json.loads(printed(table(tmp_path / "rig.csv", **columns), *how))["parameters"]
    found = {each["name"]: each for each in told}
    for axis, (gain, lever) in truth.items():
        by_log, by_ruler = (found[f"{name}_{axis}"] for name in ("gain", "lever"))
        assert by_log["verdict"] == IDENTIFIED_VERDICT
        assert by_log["value"] == pytest.approx(gain, rel=0.01)
        # a ruler is taken to be right within 1 cm, and gain (1 + lever w^2 / g) is what shows
        half = abs(gain) * 0.01 / (9.81 / w**2 + lever)
        assert 0.9 * half < (by_log["high"] - by_log["low"]) / 2 < 2.0 * half
        assert by_ruler["high"] - lever == pytest.approx(0.01)
        assert by_ruler["verdict"] == "given"
        assert by_ruler["value"] == pytest.approx(lever, rel=1e-6)
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "Held at its given value, not fitted: lever (x), lever (y)." in page


def test_a_lever_that_is_told_is_as_far_off_as_a_ruler_whatever_the_log_prefers():
    theta = np.array([[6.2, -0.01], [6.0, 0.0], [5.8, 0.01]])
    costs = np.array([[100.0] * 5, [50.0] * 5, [0.0] * 5])
    moved = Profile("lever", ("gain", "lever"), theta, costs, 1, known=True).deviations
    assert moved["lever"].mean() == pytest.approx(0.0, abs=3e-4)
    assert np.quantile(np.abs(moved["lever"]), 0.68) == pytest.approx(0.005, rel=0.05)
    assert moved["gain"] == pytest.approx(-20 * moved["lever"])


@pytest.mark.long
def test_dead_time_and_lag_are_as_uncertain_as_the_ruler_makes_them(axis_log):
    """A lever that is a centimetre off is made up for by ms of dead time for as many of lag."""
    truth = TRUTH | {"gain": 5.5, "dead_time": 0.12, "level": 0.04}
    time, ball, command = axis_log(1, rate=60.0, seconds=45, lever=0.14, **truth)
    log = AxisLog(time, command, True, time, ball, lever=0.15)
    names = ("gain", "dead_time", "lag", "level", "friction")
    found = profile_drives(fit_axis(log, names, 2.5, (0.0, 0.5))).estimate()
    for name, value, half in zip(names, found.value, found.half_width, strict=True):
        if name in {"dead_time", "lag"}:
            assert abs(value - truth[name]) < half < 0.02


@pytest.mark.parametrize(
    ("height", "about", "says"),
    [
        *((each, {}, "metres from the axis") for each in ("142", "high", "nan", "", "0,0,0")),
        (0.142, {"parameters": "friction,lever"}, "it determines the lever"),
        (0.142, {"columns": None}, "needs columns; a run states its rig"),
    ],
)
def test_a_height_that_cannot_be_or_is_not_asked_for_is_refused(height, about, says, tmp_path):
    columns = "time=ms:ms,measured_x=X,command_phi=u"
    log = written(tmp_path, lines(","))
    with pytest.raises(TwinError, match=f"^ball_height: .*{says}") as caught:
        identify(log, **{"columns": columns, "ball_height": height, **about})
    assert "\n" not in str(caught.value)


@pytest.mark.long
@pytest.mark.parametrize(("rig", "gain"), [("hobby", 5.886), ("course", 7.007)])
def test_a_circle_tells_the_gain_of_a_rig_whose_height_is_told(rig, gain, tmp_path):
    """Play makes the plate of hobby swing at one frequency: without its height 5.1 comes out."""
    ran = run("circle", (f"parameters={rig}", "seed=1"), out=tmp_path / "run")
    height = 0.122 + ran.scenario.plant.ball.radius
    about = {"columns": OWN_COLUMNS, "ball_height": height, "on": rig}
    found = identify(logged(ran, tmp_path), **about).found
    told = by_name(found)
    for axis, sign in (("x", 1), ("y", -1)):
        one = told[f"gain_{axis}"]
        assert one.word == IDENTIFIED_VERDICT
        assert one.low <= sign * gain <= one.high
        assert one.value == pytest.approx(sign * gain, rel=0.025)
    assert float(found.settings(())["plant.plate.height"].split()[0]) == pytest.approx(0.122, 1e-3)


@pytest.mark.long
@pytest.mark.parametrize(("rig", "gain", "friction"), [("hobby", 5.886, 0.02943),
                                                       ("course", 7.007, 0.04671)])  # fmt: skip
def test_gain_and_friction_of_a_shipped_rig_are_those_of_its_ball(rig, gain, friction, tmp_path):
    """By hand from its file: 3/5 and 5/7 of gravity, and the arm of friction by the radius."""
    law = "controller={kind='afl', gains=[180.0, 162.0, 66.0, 13.0]}"  # as of a plate on time
    settings = (f"parameters={rig}", "seed=5", law, "observer={kind='luenberger'}")
    ran = run("excite", settings, out=tmp_path / "run")
    told = by_name(identify(logged(ran, tmp_path), columns=OWN_COLUMNS).found)
    for axis, true in (("x", gain), ("y", -gain)):
        one, held = told[f"gain_{axis}"], told[f"friction_{axis}"]
        assert one.word == IDENTIFIED_VERDICT
        assert one.low <= true <= one.high
        # in the cycle of hobby friction at rest and rolling friction are known together only
        assert held.low <= friction <= held.high or held.word == NOT_IDENTIFIABLE
        assert rig == "hobby" or held.word == IDENTIFIED_VERDICT
        assert f"camber_{axis}" not in told  # it was taken for what pushes the ball outwards
        assert one.value == pytest.approx(true, rel=0.07)


@pytest.mark.long
def test_an_axis_that_nobody_moved_is_not_blamed_and_the_other_is_identified(axis_of, tmp_path):
    log = axis_of(1, seconds=30)
    moved, still = {"t": log.time, "x": log.ball, "a": log.tilt}, 0 * log.time
    file = table(tmp_path / "rig.csv", ";", **moved, y=still, b=still)
    columns = "time=t:s,measured_x=x:m,measured_y=y:m,command_phi=a:rad,command_theta=b:rad"
    found = json.loads(printed(file, "--columns", columns, "--json", "--out", tmp_path / "out"))
    words = {each["name"]: each["verdict"] for each in found["parameters"]}
    assert words["gain_x"] == words["friction_x"] == IDENTIFIED_VERDICT
    assert words["gain_y"] == NOT_IDENTIFIABLE
    assert any("does not move in the log" in note for note in found["notes"])
    (one,) = found["held_out"]
    at = HOLD_OUT.horizons_s.index(1.0)
    assert one["median"]["model"][at] < 0.2 * one["median"]["stays"][at]
    assert one["median"]["model"][at] < 0.5 * one["median"]["without friction"][at]
    assert (tmp_path / "out" / "report.html").read_text(encoding="utf-8").count("<svg") == 1
    twin = load("circle", (f"parameters={tmp_path / 'out' / 'parameters.toml'}",))
    assert twin.sensors.touch.dead_time == pytest.approx(0.1, abs=0.02)
    assert twin.predictor.delay == twin.sensors.touch.dead_time
    lag = 1 / (2 * np.pi * twin.plant.servo.bandwidth_hz)
    assert twin.rig.plate_lag == pytest.approx(lag, rel=1e-5)  # six digits in the file


@pytest.mark.parametrize(
    ("alone", "both", "written"),
    [
        (NOT_IDENTIFIABLE, IDENTIFIED_VERDICT, True),
        (NOT_IDENTIFIABLE, NOT_IDENTIFIABLE, False),
        (IDENTIFIED_VERDICT, NOT_IDENTIFIABLE, True),
    ],
)
def test_dead_time_and_lag_of_which_only_the_sum_is_told_are_written_both(alone, both, written):
    rows = (("dead_time", 0.12, alone), ("lag", 0.05, alone), ("delay", 0.17, both))
    verdicts = [
        ParameterVerdict(about=PLAIN_PARAMETERS["lag"], name=f"{name}_x", value=value, word=word)
        for name, value, word in rows
    ]
    found = AxisIdentification(
        source="log.csv", seconds=30.0, verdicts=tuple(verdicts), scores=(), predictions={},
        notes=(), extent="", remarks=(), factor=0.6, ball=BallPlate(),
    )  # fmt: skip
    lines = found.settings({IDENTIFIED_VERDICT})
    assert ("rig.plate_lag" in lines) == ("predictor.delay" in lines) == written
    if written:
        lag, _, remark = lines["rig.plate_lag"].partition("  # ")
        assert (float(lag), float(lines["predictor.delay"])) == (0.05, 0.12)
        assert ("sum" in remark) == (alone == NOT_IDENTIFIABLE)


def test_a_lag_of_zero_is_written_as_drives_without_one():
    lag = ParameterVerdict(
        about=PLAIN_PARAMETERS["lag"], name="lag_x", value=0.0, word=IDENTIFIED_VERDICT
    )
    found = AxisIdentification(
        source="log.csv", seconds=30.0, verdicts=(lag,), scores=(), predictions={},
        notes=(), extent="", remarks=(), factor=0.6, ball=BallPlate(),
    )  # fmt: skip
    lines = found.settings({IDENTIFIED_VERDICT})
    assert lines["plant.servo.bandwidth_hz"] == "0"
    assert lines["rig.plate_lag"].startswith("0 ")


@pytest.mark.long
def test_a_camber_that_is_found_is_one_of_the_twin(axis_of, tmp_path):
    found, told = of_axis(axis_of(3, seconds=50, camber=0.35), ("friction", "camber"))
    written = "\n".join(
        f"{key} = {value}" for key, value in found.settings({IDENTIFIED_VERDICT}).items()
    )
    (tmp_path / "parameters.toml").write_text(written, encoding="utf-8")
    twin = load("hold", [f"parameters={tmp_path / 'parameters.toml'}", "plant.kind=lagrange"])
    camber = told["camber_x"].value
    assert twin.plant.camber == (pytest.approx(camber, rel=1e-5), 0.0)
    assert camber == pytest.approx(0.35, abs=0.05)


@pytest.mark.long
@pytest.mark.parametrize("rig", ["course", "hobby"])
def test_what_is_found_lies_over_the_rig_that_is_named(axis_of, rig, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log = axis_of(1, seconds=30, gain=6.0)
    file = table("log.csv", t=log.time, x=log.ball, u=log.tilt)
    printed(file, "--columns", "time=t:s,measured_x=x:m,command_phi=u:rad", "--on", rig)
    twin, named = (
        load("hold", [f"parameters={each}"]) for each in ("runs/identify-log/parameters.toml", rig)
    )
    assert twin.plant.size == named.plant.size
    assert twin.plant.model.c1 == pytest.approx(named.plant.model.c1, rel=1e-5)
    # friction as a deceleration is what the log has, whatever the ball's radius
    ball, arm = twin.plant.model, twin.plant.friction.rolling_mm / 1000
    assert ball.k1 * arm / ball.radius == pytest.approx(TRUTH["friction"], rel=0.1)


def test_a_rig_is_named_for_columns_only():
    with pytest.raises(ScenarioError, match="on: needs columns; a run states its rig"):
        identify("runs/excite", on="hobby")


@pytest.mark.long
def test_the_commands_of_the_page_work_on_logs_of_these_names(axis_of, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for seed in (1, 2):
        log = axis_of(seed, seconds=25)
        columns = {"millis": 1e3 * log.time, "X": 1e3 * log.ball, "servo": np.degrees(log.tilt)}
        table(f"run{seed}.csv", **columns)
    page = (ROOT / "docs" / "own-rig.md").read_text(encoding="utf-8")
    told = [line for line in page.splitlines() if "identify run1.csv" in line]
    assert len(told) == 2
    for line in told:
        said = printed(*line.split()[4:])
        assert "gain (x)" in said
        assert "a ball that stays" in said


@pytest.mark.long
def test_a_model_of_a_wrong_command_is_said_to_be_worse_than_none(axis_of):
    log = axis_of(2, seconds=30)
    other = np.random.default_rng(1).normal(0, 0.05, len(log.tilt))
    found, told = of_axis(replace(log, tilt=other), ("friction",))
    assert told["gain_x"].word == NOT_IDENTIFIABLE
    assert any("WORSE THAN NO MODEL" in each for each in sentences(found))
    assert not any("give the command times" in each for each in sentences(found))
    assert any("no factor on the command is advised" in each for each in sentences(found))


def gain_of(word, value, low, high):
    return ParameterVerdict(
        about=PLAIN_PARAMETERS["gain"], name="gain_x", value=value, low=low, high=high, word=word
    )


@pytest.mark.parametrize(
    "gain",
    [
        gain_of(NOT_IDENTIFIABLE, -0.08, -9.2, 0.0),
        gain_of(NOT_IDENTIFIABLE, 1.9, 0.5, 2.1),
        gain_of(BOUNDED_VERDICT, 1.9, 0.5, 40.0),
        gain_of(NOT_IDENTIFIABLE, None, None, None),
    ],
    ids=["holds zero", "wide", "at its bound", "not shown"],
)
def test_no_factor_is_advised_of_a_gain_that_is_not_identified(gain):
    said = _describe_gain("x", gain, 0.714, held=True)
    assert "times" not in said
    assert said.startswith("x: how far a command tilts the plate is not known from this log")
    assert ("0.5 to 2.1" in said) == (gain.low == 0.5 and gain.high == 2.1)


def test_the_factor_that_is_advised_of_an_identified_gain_has_its_interval():
    said = _describe_gain("y", gain_of(IDENTIFIED_VERDICT, 1.9, 1.7, 2.1), 0.714, held=True)
    share = [-each / (0.714 * 9.81) for each in (1.9, 2.1, 1.7)]
    assert "give the command times {:.3g} ({:.3g} to {:.3g}; a -".format(*share) in said
    near = _describe_gain("x", gain_of(IDENTIFIED_VERDICT, 7.0, 6.8, 7.2), 0.714, held=True)
    assert "tell the command" not in near


@pytest.mark.parametrize(
    ("value", "factor", "ball"),
    [(7.0, 3 / 5, "solid"), (-5.9, 5 / 7, "hollow"), (7.0, 5 / 7, ""), (6.4, 3 / 5, "")],
)
def test_a_gain_that_is_that_of_another_ball_names_it(value, factor, ball):
    gain = gain_of(IDENTIFIED_VERDICT, value, value - 0.05, value + 0.05)
    said = _describe_gain("x", gain, factor, held=True)
    assert ("--ball" in said) == bool(ball)
    assert f"A {ball} ball has this gain: state it by --ball {ball}" in said or not ball


def test_parameters_of_a_command_in_counts_have_units_of_counts():
    units = {name: plain_parameter(name, "count").unit for name in PLAIN_PARAMETERS}
    assert units["gain"] == "m/s^2 by count"
    assert (units["dead_band"], units["play"], units["slew"]) == ("count", "count", "count/s")
    assert not any("rad" in unit for unit in units.values())
    assert plain_parameter("slew", "rad").unit == "rad/s"


def test_of_a_measured_angle_nothing_is_said_of_a_command_or_of_measuring_it():
    gain = gain_of(IDENTIFIED_VERDICT, 1.9, 1.7, 2.1)
    said = _describe_gain("y", gain, 0.714, held=False)
    assert "m/s^2 per rad of the measured angle (1.7 to 2.1)" in said
    assert "give the measured angle times" in said
    said += _describe_gain("x", gain_of(NOT_IDENTIFIABLE, 1.9, 0.5, 2.1), 0.714, held=False)
    assert "command tilts" not in said
    assert "linkage" not in said
    assert "measure the plate" in plain_parameter("lever", "rad").experiment
    assert plain_parameter("lever", "rad", held=False).experiment.startswith("tilt this axis")


@pytest.mark.parametrize("unit", ["rad", "count"])
def test_what_is_of_the_tilt_is_in_its_unit(unit):
    stated = {name: plain_parameter(name, unit).unit for name in PLAIN_PARAMETERS}
    assert stated["gain"] == f"m/s^2 by {unit}"
    assert stated["dead_band"] == stated["play"] == unit
    assert stated["slew"] == f"{unit}/s"
    assert stated["friction"] == stated["level"] == "m/s^2"
    assert stated["lever"] == "m"


def test_the_baselines_of_a_ball_that_stays_or_goes_on_are_what_they_say():
    time = np.arange(0.0, 12.0, 0.04)
    ball = 0.05 * time - 0.004 * time**2
    log = AxisLog(time, np.sin(3 * time), True, time, ball)
    problem = windowed(log, ("gain", "dead_time", "level"), *spans(log, 2.5), 2.6)
    line = problem.linearise(np.zeros((1, 3)), problem.initial_starts())
    found = Minimum(
        np.array([[0.0, 0.0, -0.008]]), problem.initial_starts(), np.zeros(1), line,
        Termination("converged", 1, 1),
    )  # fmt: skip
    fit = AxisFit(problem, found, log, 1e-3, 1e-3)
    at = prediction_times(log)
    judged = score({"x": predict_axis(log, fit, at)})
    for k, ahead in enumerate(HOLD_OUT.horizons_s):
        ways = [0.05 * ahead - 0.004 * ((t + ahead) ** 2 - t**2) for t in at]
        assert judged.median["stays"][k] == pytest.approx(np.median(np.abs(ways)), rel=0.15)
        # a parabola leaves its tangent in the middle of the lead by a (t + 0.2)^2
        assert judged.median["goes on"][k] == pytest.approx(0.004 * (ahead + 0.2) ** 2, rel=0.2)
        assert judged.median["model"][k] < 2e-4


def camera_log(file, x, y, lost):
    """A log as a rig with a camera writes it, read again: degrees, frames without a ball."""
    with file.open("w", encoding="utf-8") as out:
        out.write("t_s,mode,detected,x_m,y_m,theta_x_ACTUATE_deg,theta_y_ACTUATE_deg\n")
        for t, a, u, b, v, gap in zip(*x, *y[1:], lost, strict=False):
            where = (0.0, 0.0) if gap else (a, b)
            cells = (*where, np.degrees(u), -np.degrees(v))
            out.write(f"{t:.4f},1,{int(not gap)},{','.join(f'{each:.5f}' for each in cells)}\n")
    return read_any(file, wanted_columns(CAMERA_COLUMNS))


@pytest.mark.long
def test_a_log_with_a_camera_s_gaps_gives_the_gain_of_its_ball(axis_log, tmp_path):
    """In the form of a rig with a camera: degrees, millisecond gaps, frames without a ball."""
    gain, lost = 0.6 * 9.81, np.random.default_rng(3).random(4000) < 0.05
    x, y = (
        axis_log(seed, seconds=25, gain=gain, dead_time=0.14, lag=0.13, stiff=0.3, damped=0.3)
        for seed in (1, 2)
    )
    log = camera_log(tmp_path / "run.csv", x, y, lost)
    fit = fit_axis(log.axes["x"], ("gain", "dead_time", "lag", "level", "friction"), 2.5, (0, 0.5))
    assert fit.value("gain") / fit.problem.tilt.scale == pytest.approx(gain, rel=0.2)
    assert fit.value("dead_time") + fit.value("lag") == pytest.approx(0.27, abs=0.08)


@pytest.mark.long
def test_a_level_that_changes_within_a_log_is_not_taken_for_gain_or_friction(axis_of):
    parts = [axis_of(seed, seconds=20, level=level) for seed, level in ((1, 0.1), (2, -0.1))]
    other = along_x(axis_of(4, seconds=25, level=0.0), "other.csv")
    found = identify_axes([along_x(join_logs(parts))], [other])
    told = by_name(found)
    for name in ("gain", "friction"):
        each = told[f"{name}_x"]
        assert each.value == pytest.approx(TRUTH[name], rel=0.1)
        assert each.low <= TRUTH[name] <= each.high
    assert any("the level drifts" in note for note in found.notes)
    (one,) = found.scores
    at = HOLD_OUT.horizons_s.index(1.0)
    assert one.median["level followed"][at] < 0.2 * one.median["stays"][at]


@pytest.mark.long
def test_a_later_run_of_a_rig_whose_level_changes_is_predicted_better_than_by_windows(
    axis_log, tmp_path
):
    """A level that changes is taken for gain and friction where every window shares one."""
    axis = "y"  # whose command has the other sign
    first, second = (axis_log(seed, **TRUTH | {"seconds": 20, "level": level})
                     for seed, level in ((1, 0.1), (2, -0.1)))  # fmt: skip
    pause = first[0][-1] + 5.0
    whole = tuple(map(np.concatenate, zip(first, (second[0] + pause, *second[1:]), strict=True)))
    next_run = axis_log(4, **TRUTH | {"seconds": 20, "level": 0.0})
    fitted, other = (
        camera_log(tmp_path / f"{name}.csv", run, run, np.zeros(len(run[0]), bool)).axes[axis]
        for name, run in (("fitted", whole), ("other", next_run))
    )
    names = ("gain", "dead_time", "lag", "level", "friction")
    windows = fit_axis(fitted, names, 2.5, (0, 0.5))
    windows = replace(windows, briefer=(windows.refit(windows.log, names, 1.25),))
    at = prediction_times(other)
    before, after = (
        score({axis: predict_axis(other, fit, at)}).median
        for fit in (windows, refit_for_prediction(windows, 2.5))
    )
    last = HOLD_OUT.horizons_s.index(1.0)
    assert after["model"][last] < 0.6 * before["model"][last]
    assert after["model"][last] < 1.1 * min(after["stays"][last], after["goes on"][last])


ON_TWIN = ("plant.kind=lagrange", "plant.servo.bandwidth_hz=2.0", "rig.cam_error_percent=[10,0]")


def frames(tilt, **about):
    """A log of 30 frames/s of a ball at 10 and -30 mm, with a command in rad along x."""
    time = np.arange(0.0, 3.0, 1 / 30)
    still = np.full_like(time, 0.01)
    axes = {
        "x": AxisLog(time, tilt(time), True, time, still),
        "y": AxisLog(time, 0 * time, True, time, -3 * still),
    }
    return AnyLog("rig.csv", axes, {"x": "rad", "y": "rad", **about}, ())


def test_a_log_of_commands_becomes_one_of_the_plate_that_the_twins_drives_make():
    """A step behind a lag: 1 - exp(-t / T), taken too far by what the scenario says."""
    log = frames(lambda time: np.where(time >= 1.0, 0.05, 0.0)).on(load("circle", ON_TWIN))
    assert np.diff(log.time) == pytest.approx(0.002)
    since = log.time - 1.0
    turned = np.where(since > 0, 1 - np.exp(-2 * np.pi * 2.0 * np.maximum(since, 0)), 0.0)
    assert log.plate[:, 0] == pytest.approx(0.05 * 1.1 * turned, abs=2e-3)
    assert log.plate[:, 1] == pytest.approx(0.0)
    # what was commanded is what the rates add up to, by the next command
    assert 0.002 * log.command[:, 0].sum() == pytest.approx(0.05)
    assert log.ball[100] == pytest.approx([0.01, -0.03])
    assert (log.age >= -1e-9).all()
    assert log.age.max() < 1 / 30 + 1e-9


@pytest.mark.parametrize(
    ("about", "settings", "says"),
    [
        ({"x": "count"}, (), "command_phi: in counts"),
        ({}, ("plant.size=[0.1,0.05]", "rig.limits.area=[0.01,0.01]"), "measured_y: reaches 0.03"),
    ],
)
def test_a_log_that_is_not_of_the_scenarios_rig_is_refused(about, settings, says):
    with pytest.raises(LogError, match=says):
        frames(np.sin, **about).on(load("hold", (*ON_TWIN, *settings)))


@pytest.mark.parametrize(("middle", "said"), [(0.06, True), (-0.06, True), (0.0, False)])
def test_a_ball_beyond_the_plate_on_one_side_of_zero_is_told_of_the_zero(middle, said):
    time = np.arange(0.0, 3.0, 1 / 30)
    swing = 0.03 if middle else 0.3
    own = AxisLog(time, 0 * time, True, time, middle + swing * np.sin(4 * time))
    with pytest.raises(LogError, match="the plate ends at") as refused:
        AnyLog("tube.csv", {"x": own}, {"x": "rad"}, ()).on(load("line", ("parameters=tube",)))
    asked = (
        f"it moves about {middle:.2g} m; state the column's number in the middle of the plate, as"
    )
    assert (asked in str(refused.value)) is said


def test_a_coverage_counts_what_lies_within_and_leaves_out_what_has_no_interval(coverage):
    rig = {"gain": 6.0, "dead_time": 0.1, "lag": 0.05}
    inside, above = (6.1, 5.9, 6.3, "identified"), (6.5, 6.4, 6.6, "bounded")
    below = (5.5, 5.4, 5.6, "bounded")
    none = (None, None, None, "not identifiable")
    told = (
        {"gain": one, "delay": (0.15, 0.14, 0.16, "identified")} for one in (inside, above, below)
    )
    hidden = {"gain": none, "delay": none, "lever": (None, -0.01, 0.02, "not identifiable")}
    found = [{"rig": rig, "told": each} for each in (hidden, *told)]
    gain, delay, lever, camber = coverage(found)
    assert (gain["rigs"], gain["held"], gain["identified"]) == (3, 1, 1)
    assert gain["share"] == pytest.approx((6.15, 79.23), abs=0.1)  # Wilson, 1 of 3
    assert (delay["rigs"], delay["held"]) == (3, 3)
    assert (lever["rigs"], lever["held"]) == (1, 1)
    assert camber["rigs"] == 0
