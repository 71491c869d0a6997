"""`twin.identify.verdicts`: Identification finds what made a log and says what it cannot know."""

from __future__ import annotations

import json
from types import SimpleNamespace

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from twin.cli.understand import identify as command
from twin.identify.least_squares import STEP_CONTROL, minimise
from twin.identify.logs import LOG_COLUMN_UNITS, read
from twin.identify.parameters import BALL_PARAMETERS, DEFAULT_PARAMETERS, SERVO_PARAMETER
from twin.identify.plate_motion import fit_drives
from twin.identify.prepare import prepare
from twin.identify.report import parameters, write
from twin.identify.twin_model import TwinIdentification, identify_twin
from twin.identify.twin_verdicts import _assess_servo
from twin.identify.verdicts import HOLD_OUT, ParameterVerdict
from twin.run.finished import record_run, run
from twin.run.opened import open_run
from twin.scenario import load

TRUTH = {"rolling": 0.21, "breakaway": 1.4, "delay": 0.042, "servo": 10.0}
SETTINGS = (
    "duration=30",
    f"plant.friction.rolling_mm={TRUTH['rolling']}",
    f"plant.friction.breakaway_ratio={TRUTH['breakaway']}",
    f"plant.servo.bandwidth_hz={TRUTH['servo']}",
)
DEGREES = {"rad": ("deg", 180 / np.pi), "rad/s^2": ("deg/s^2", 180 / np.pi)}


def logged(folder, scenario, *settings):
    """The folder, with the record of a run."""
    record_run(run(load(scenario, settings)), folder)
    return folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of the mechanism under the excitation."""
    return logged(tmp_path_factory.mktemp("log") / "excite", "excite", *SETTINGS)


@pytest.fixture(scope="module")
def found(folder):
    return identify_twin(read(folder), (*DEFAULT_PARAMETERS, "spring"))


@pytest.fixture(scope="module")
def columns(folder):
    """The log's columns in SI units by name."""
    (opened,) = open_run(folder)
    return {name: opened.rows[name] for name in LOG_COLUMN_UNITS if name in opened.rows}


def by_name(found):
    return {each.name: each for each in found.verdicts}


@pytest.mark.long
@pytest.mark.parametrize("name", TRUTH)
def test_what_made_the_log_is_found_within_3_percent_or_its_interval(found, name):
    each = by_name(found)[name]
    assert each.word == "identified"
    within = each.low <= TRUTH[name] <= each.high
    assert within or each.value == pytest.approx(TRUTH[name], rel=0.03)


@pytest.mark.long
def test_the_level_is_found_to_a_hundredth_of_a_degree(found):
    for name in ("level_phi", "level_theta"):
        assert by_name(found)[name].value == pytest.approx(0, abs=0.01)


@pytest.mark.long
def test_on_what_was_held_out_a_replay_is_within_a_millimetre_after_a_second(found):
    (judged,) = found.scores
    at = HOLD_OUT.horizons_s.index(1.0)
    assert judged.median["model"][at] < 1e-3
    assert judged.median["without friction"][at] > 5e-3
    assert judged.median["stays"][at] > 5e-3


@pytest.mark.long
def test_what_positions_cannot_show_is_said_with_the_experiment_that_would(found):
    spring = by_name(found)["spring"]
    assert spring.word == "not identifiable"
    assert spring.value is None
    assert "motor torque" in spring.why


@pytest.mark.parametrize(("rig", "delay"), [("hobby", 0.04), ("hobby", 0.0), ("", 0.04)])
def test_over_a_rigs_file_the_controller_assumes_what_was_found(rig, delay, tmp_path):
    verdicts = [
        ParameterVerdict(
            about=about, name=name, value=value, low=value, high=value, word="identified"
        )
        for name, about, value in (
            ("delay", BALL_PARAMETERS["delay"], delay),
            ("servo", SERVO_PARAMETER, 2.27),
        )
    ]
    over = {"parameters": '"hobby"'} if rig else {}
    found = SimpleNamespace(verdicts=verdicts, on=rig, over=over, log=SimpleNamespace(axes=2))
    lines = TwinIdentification.settings(found, {"identified"})
    text = "".join(f"{key} = {value}\n" for key, value in lines.items())
    (tmp_path / "parameters.toml").write_text(text, encoding="utf-8")
    twin, named = (
        load("cure", each and [f"parameters={each}"])
        for each in (tmp_path / "parameters.toml", rig)
    )
    assert (twin.sensors.touch.dead_time, twin.plant.servo.bandwidth_hz) == (delay, 2.27)
    assumed = (delay, pytest.approx(1 / (2 * np.pi * 2.27), rel=1e-5))
    before = (named.predictor.delay, named.rig.plate_lag)
    assert (twin.predictor.delay, twin.rig.plate_lag) == (assumed if rig else before)
    assert before == ((0.03, 0.06) if rig else (0.042, 0.0))


@pytest.mark.long
def test_residuals_of_the_twin_itself_are_white(found):
    assert found.whiteness.misfit == pytest.approx(1, abs=0.15)
    assert found.whiteness.white


@pytest.mark.long
def test_any_scenario_can_name_the_parameter_file(found, tmp_path):
    file = tmp_path / "rig.toml"
    file.write_text(parameters(found), encoding="utf-8")
    scenario = load("circle", (f"parameters={file}",))
    value = by_name(found)["rolling"].value
    assert scenario.plant.friction.rolling_mm == pytest.approx(value, rel=1e-5)
    assert scenario.sensors.touch.dead_time == pytest.approx(0.042, abs=0.002)
    other = load("circle", (f"parameters={file}", "plant.friction.rolling_mm=0.5"))
    assert other.plant.friction.rolling_mm == 0.5


@pytest.mark.long
def test_the_report_needs_no_other_file(found, tmp_path):
    write(found, tmp_path)
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert text.count("<svg") == 1
    assert "plant.friction.rolling_mm" in text
    assert 'src="' not in text
    assert "<link" not in text
    assert "<script" not in text


@pytest.mark.long
def test_a_csv_file_in_other_units_says_the_same(columns, found, tmp_path, write):
    scaled, headers = {}, {}
    for name, values in columns.items():
        unit = LOG_COLUMN_UNITS[name]
        new, factor = {"s": ("ms", 1e3), "m": ("mm", 1e3), **DEGREES}.get(unit, (unit, 1.0))
        scaled[name], headers[name] = values * factor, f"{name} [{new}]"
    again = identify_twin(
        read(write(tmp_path / "log.csv", scaled, headers=headers)), DEFAULT_PARAMETERS
    )
    for name in ("rolling", "breakaway"):
        assert by_name(again)[name].value == pytest.approx(by_name(found)[name].value, rel=0.01)
    assert any("friction at rest" in note for note in again.notes)


@pytest.mark.long
def test_gaps_missing_numbers_spikes_and_lift_offs_are_left_out_and_said(columns, tmp_path, write):
    bad = {name: values.copy() for name, values in columns.items()}
    bad["measured_x"][2000:2010] = np.nan
    bad["measured_x"][5000] += 0.1
    bad["touched"][7000:7200] = 0.0
    rows = [k for k in range(len(bad["time"])) if not 9000 <= k < 9500]
    again = identify_twin(
        read(write(tmp_path / "log.csv", bad, rows=rows)), ("rolling", "breakaway")
    )
    notes = " ".join(again.notes)
    for words in (
        "1 gap of 1.00 s",
        "ball not detected for 0.40 s",
        "10 rows without ball",
        "far off",
    ):
        assert words in notes
    assert by_name(again)["rolling"].value == pytest.approx(TRUTH["rolling"], rel=0.03)


@pytest.mark.long
def test_without_friction_none_is_claimed(tmp_path):
    log = read(logged(tmp_path, "excite", *SETTINGS, "plant.friction.rolling_mm=0"))
    assert by_name(identify_twin(log, ("rolling",)))["rolling"].value < 0.003


@pytest.mark.long
@pytest.mark.parametrize("seed", [0, 3])
def test_friction_that_grows_with_speed_is_offered_where_the_log_shows_it(seed, tmp_path):
    exact = ("plant.kind=lagrange", *SETTINGS[1:], "duration=40", f"seed={seed}")
    log = read(logged(tmp_path, "excite", *exact, "plant.friction.viscous_mm=0.8"))
    found = identify_twin(log, DEFAULT_PARAMETERS)
    each = by_name(found)
    assert any("viscous friction fitted along" in note for note in found.notes)
    assert each["viscous"].value == pytest.approx(0.8, rel=0.02)
    assert each["viscous"].low <= 0.8 <= each["viscous"].high
    assert each["rolling"].low <= TRUTH["rolling"] <= each["rolling"].high


@pytest.mark.long
def test_on_an_uneven_screen_intervals_are_wide_enough_to_hold_the_truth(tmp_path):
    patchy = (*SETTINGS, "duration=40", "plant.surface.spread_percent=12", "plant.surface.seed=11")
    found = identify_twin(read(logged(tmp_path, "excite", *patchy)), DEFAULT_PARAMETERS)
    assert found.whiteness.white
    each = by_name(found)
    for name in ("rolling", "delay", "level_phi"):
        truth = TRUTH.get(name, 0.0)
        assert each[name].low <= truth <= each[name].high
    assert each["rolling"].word == "identified"
    assert each["rolling"].high - each["rolling"].low > 0.01  # an even one: 0.004


@pytest.mark.long
def test_ageing_that_noise_hides_moves_no_interval_off_the_truth(tmp_path):
    """Without ageing in the model the residuals looked white, and these intervals missed."""
    truth = {"rolling": 0.2, "breakaway": 1.24, "delay": 0.041}
    ageing = (
        "plant.friction.rolling_mm=0.2",
        "plant.friction.breakaway_ratio=1.24",
        "plant.friction.dwell_time=0.62",
        "plant.friction.stribeck_speed=0.01",
        "sensors.touch.dead_time=0.041",
        "sensors.touch.frame_rate=58",
        "duration=60",
    )
    found = identify_twin(read(logged(tmp_path, "excite", *ageing)), DEFAULT_PARAMETERS)
    assert found.fit.problem.windows.white is None  # explained by an even screen
    assert found.whiteness.white
    each = by_name(found)
    for name, value in truth.items():
        assert each[name].low <= value <= each[name].high
    assert each["breakaway"].word == "identified"


@pytest.mark.long
@pytest.mark.parametrize(("corner", "seed"), [(6, 204), (10, 7), (15, 105)])
def test_the_corner_of_the_servo_is_right_on_a_run_of_the_cure(tmp_path, corner, seed):
    settings = ("duration=14", "metrics.start=5", f"plant.servo.bandwidth_hz={corner}")
    drives = fit_drives(prepare(read(logged(tmp_path, "cure", *settings, f"seed={seed}"))))
    servo = _assess_servo(drives)
    assert servo.word == "identified" or corner == 15
    assert servo.low <= corner <= servo.high


@pytest.mark.long
def test_the_command_writes_its_files_and_prints_one_json_object(folder, tmp_path):
    table = pq.read_table(folder / "run.parquet")
    pq.write_table(table.slice(0, 7000), tmp_path / "log.parquet")
    out = tmp_path / "out"
    arguments = [str(tmp_path / "log.parquet"), "--parameters", "rolling,wheels"]
    arguments += ["--out", str(out), "--json"]
    result = CliRunner().invoke(command, arguments, standalone_mode=False)
    assert result.exception is None
    assert result.return_value == 0
    told = json.loads(result.stdout)
    assert [each["name"] for each in told["parameters"]] == ["rolling", "wheels"]
    assert told["replay_error"]["twin"] == told["held_out"][0]["median"]["model"]
    assert told["fit"]["reason"] in {"converged", "step limit reached"}
    assert 0 < told["fit"]["steps"] <= told["fit"]["step_limit"]
    assert {path.name for path in out.iterdir()} == {"report.html", "parameters.toml"}


@pytest.mark.long
def test_a_minimisation_says_why_it_stopped(found):
    fit = found.fit
    long = minimise(fit.problem, fit.found.theta, fit.found.starts, 300)
    assert long.termination.reason == "converged"
    assert 2 <= long.termination.steps < 300
    assert "converged after" in str(long.termination)
    again = minimise(fit.problem, long.theta, long.starts, 300)
    assert again.termination.steps == 2
    assert long.cost[0] - again.cost[0] <= 2 * STEP_CONTROL.cost_tolerance * long.cost[0]
    away = fit.found.theta.copy()
    away[:, fit.problem.names.index("rolling")] *= 2
    short = minimise(fit.problem, away, fit.found.starts, 1)
    assert short.termination.reason == "step limit reached"
    assert short.termination.steps == short.termination.step_limit == 1
    assert "limit of 1 step" in str(short.termination)
