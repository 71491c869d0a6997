"""Identification finds what made a log, says what it cannot know, and refuses what is broken."""

from __future__ import annotations

import csv
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from controllers.ballplate import BallPlate
from twin.cli.identify import identify as command
from twin.errors import ScenarioError
from twin.identify.bootstrap import Estimate, estimate
from twin.identify.identify import identify
from twin.identify.levenberg_marquardt import TOLERANCE, minimise
from twin.identify.log import COLUMNS, LogError, read
from twin.identify.parameters import CHOICES, DEFAULT, chosen
from twin.identify.plate_motion import servo_response
from twin.identify.replay import STEP, AccelerationField, replay
from twin.identify.report import page, parameters
from twin.identify.verdict import BOUNDED, IDENTIFIED, _servo
from twin.run.execute import run, save
from twin.scenario import load
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction

TRUTH = {"rolling": 0.21, "breakaway": 1.4, "delay": 0.042, "servo": 10.0}
SETTINGS = (
    "duration=30",
    f"plant.friction.rolling_mm={TRUTH['rolling']}",
    f"plant.friction.breakaway_ratio={TRUTH['breakaway']}",
    f"plant.servo.bandwidth_hz={TRUTH['servo']}",
)
DEGREES = {"rad": ("deg", 180 / np.pi), "rad/s^2": ("deg/s^2", 180 / np.pi)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of the mechanism under the excitation."""
    path = tmp_path_factory.mktemp("log") / "excite"
    done = run(load("excite", SETTINGS))
    save(done, path, {"run": done.motion})
    return path


@pytest.fixture(scope="module")
def exact_folder(tmp_path_factory):
    """A run folder of the exact plant, for what is refused before anything is fitted."""
    path = tmp_path_factory.mktemp("exact") / "excite"
    done = run(load("excite", ["duration=14", "plant.kind=lagrange"]))
    save(done, path, {"run": done.motion})
    return path


@pytest.fixture(scope="module")
def found(folder):
    return identify(read(folder), (*DEFAULT, "spring"))


@pytest.fixture(scope="module")
def columns(folder):
    """The log's columns in SI units by name."""
    return columns_of(folder)


@pytest.fixture(scope="module")
def exact_columns(exact_folder):
    """The same of the exact plant."""
    return columns_of(exact_folder)


def columns_of(folder):
    table = pq.read_table(folder / "run.parquet")
    return {name: table[name].to_numpy().copy() for name in COLUMNS if name in table.column_names}


def write(path, columns, *, rows=None, headers=None, texts=None):
    """A CSV file of columns; ``texts`` replaces cells (row, name) by words."""
    headers, texts = headers or {}, texts or {}
    with path.open("w", newline="", encoding="utf-8") as file:
        out = csv.writer(file)
        out.writerow([headers.get(name, name) for name in columns])
        for k in range(len(columns["time"])) if rows is None else rows:
            out.writerow(
                [texts.get((k, name), repr(float(values[k]))) for name, values in columns.items()]
            )
    return path


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
    at = list(found.horizons.ahead).index(1.0)
    assert found.horizons.twin[at] < 1e-3
    assert found.horizons.frictionless[at] > 5e-3
    assert found.horizons.still[at] > 5e-3


@pytest.mark.long
def test_what_positions_cannot_show_is_said_with_the_experiment_that_would(found):
    spring = by_name(found)["spring"]
    assert spring.word == "not identifiable"
    assert spring.value is None
    assert "motor torque" in spring.why


@pytest.mark.long
def test_residuals_of_the_twin_itself_are_white(found):
    assert found.whiteness.misfit == pytest.approx(1, abs=0.15)
    assert found.whiteness.outside <= 4


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


def test_a_parameter_file_may_stand_in_the_scenario_file(tmp_path):
    (tmp_path / "rig.toml").write_text("[plant.friction]\nrolling_mm = 0.3\n", encoding="utf-8")
    scenario = tmp_path / "mine.toml"
    scenario.write_text(
        f'title = "mine"\nduration = 1.0\nparameters = "{tmp_path / "rig.toml"}"\n'
        '[controller]\nkind = "afl"\n[reference]\nkind = "hold"\n'
        "[plant.friction]\nrolling_mm = 0.1\nbreakaway_ratio = 1.5\n",
        encoding="utf-8",
    )
    friction = load(str(scenario)).plant.friction
    assert (friction.rolling_mm, friction.breakaway_ratio) == (0.3, 1.5)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "cannot be read: No such file"),
        ("[plant", "not a TOML file"),
        ("[plant.friction]\nrollling_mm = 1\n", "did you mean 'rolling_mm'"),
    ],
)
def test_a_parameter_file_that_is_wrong_is_named_in_one_line(tmp_path, text, says):
    file = tmp_path / "rig.toml"
    if text is not None:
        file.write_text(text, encoding="utf-8")
    with pytest.raises(ScenarioError, match=says) as caught:
        load("circle", (f"parameters={file}",))
    assert "rig.toml" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.long
def test_the_report_needs_no_other_file(found):
    text = page(found)
    assert text.count("<svg") == 3
    assert "plant.friction.rolling_mm" in text
    assert 'src="' not in text
    assert "<link" not in text
    assert "<script" not in text


@pytest.mark.long
def test_a_csv_file_in_other_units_says_the_same(columns, found, tmp_path):
    scaled, headers = {}, {}
    for name, values in columns.items():
        unit = COLUMNS[name].unit
        new, factor = {"s": ("ms", 1e3), "m": ("mm", 1e3), **DEGREES}.get(unit, (unit, 1.0))
        scaled[name], headers[name] = values * factor, f"{name} [{new}]"
    again = identify(read(write(tmp_path / "log.csv", scaled, headers=headers)), DEFAULT)
    for name in ("rolling", "breakaway"):
        assert by_name(again)[name].value == pytest.approx(by_name(found)[name].value, rel=0.01)
    assert any("friction at rest" in note for note in again.notes)


def broken(columns, **changes):
    return {**columns, **{name: change(columns[name].copy()) for name, change in changes.items()}}


@pytest.mark.long
def test_gaps_missing_numbers_spikes_and_lift_offs_are_left_out_and_said(columns, tmp_path):
    def holes(x):
        x[2000:2010] = np.nan
        x[5000] += 0.1
        return x

    def lifted(touched):
        touched[7000:7200] = 0.0
        return touched

    bad = broken(columns, measured_x=holes, touched=lifted)
    rows = [k for k in range(len(bad["time"])) if not 9000 <= k < 9500]
    again = identify(read(write(tmp_path / "log.csv", bad, rows=rows)), ("rolling", "breakaway"))
    notes = " ".join(again.notes)
    for words in (
        "1 gaps of 1.00 s",
        "off the screen for 0.40 s",
        "10 rows without ball",
        "far off",
    ):
        assert words in notes
    assert by_name(again)["rolling"].value == pytest.approx(TRUTH["rolling"], rel=0.03)


def scaled(factor):
    return lambda values: values * factor


def shifted_back(time):
    time[5000:] -= 3.0
    return time


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"measured_x": scaled(1000)}, "measured_x: reaches .* millimetres"),
        ({"measured_y": scaled(100)}, "measured_y: reaches .* centimetres"),
        ({"measured_phi": scaled(57.3)}, "measured_phi: reaches .* degrees"),
        ({"time": scaled(1000)}, "milliseconds"),
        ({"time": shifted_back}, "the clock must run forwards"),
        ({"measured_x": scaled(-1)}, "measured_x accelerates against measured_phi"),
        ({"measured_x": scaled(0.1)}, "measured_x accelerates .* times as much"),
        ({"applied_phi_acc": scaled(57.3)}, "measured_phi moves .* times as far"),
        ({"touched": scaled(0)}, "never detected the ball"),
        ({"measured_x": scaled(0), "measured_y": scaled(0)}, "too quiet"),
    ],
)
def test_a_log_that_cannot_be_so_is_refused_in_one_line(exact_columns, tmp_path, changes, says):
    log = read(write(tmp_path / "log.csv", broken(exact_columns, **changes)))
    with pytest.raises(LogError, match=says) as caught:
        identify(log, DEFAULT)
    assert "\n" not in str(caught.value)
    assert "log.csv" in str(caught.value)


@pytest.mark.parametrize("rows", [50, 600, 2000])
def test_a_log_that_is_too_short_is_refused_in_one_line(exact_columns, tmp_path, rows):
    log = read(write(tmp_path / "log.csv", exact_columns, rows=range(rows)))
    with pytest.raises(LogError, match=r"too short|too quiet|no stretch") as caught:
        identify(log, DEFAULT)
    assert "\n" not in str(caught.value)


def test_a_file_without_its_columns_names_those_that_are_missing(exact_columns, tmp_path):
    less = {name: values for name, values in exact_columns.items() if name != "measured_theta"}
    with pytest.raises(LogError, match=r"no column measured_theta \(it has time, measured_x"):
        read(write(tmp_path / "log.csv", less, rows=range(5)))


def test_a_word_among_numbers_is_named_with_its_line(exact_columns, tmp_path):
    texts = {(2, "measured_y"): "n/a"}
    with pytest.raises(LogError, match=r"line 4: measured_y: 'n/a' is not a number"):
        read(write(tmp_path / "log.csv", exact_columns, rows=range(5), texts=texts))


def test_a_unit_that_is_none_is_refused_with_those_known(exact_columns, tmp_path):
    headers = {"measured_x": "measured_x [furlong]"}
    with pytest.raises(LogError, match="measured_x: unit 'furlong'; known: m, mm, cm"):
        read(write(tmp_path / "log.csv", exact_columns, rows=range(5), headers=headers))


@pytest.mark.parametrize("content", [b"", b"PAR1 no", b"\xff\xfe\x00"])
@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_a_file_that_is_no_log_is_refused_in_one_line(tmp_path, content, suffix):
    path = tmp_path / f"log{suffix}"
    path.write_bytes(content)
    with pytest.raises(LogError) as caught:
        read(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "metadata",
    [
        b"[1, 2]",
        b"{",
        b"\xff",
        b"[" * 5000,
        b'{"scenario": 3}',
        b'{"scenario": {"plant": []}}',
        b'{"scenario": {"plant": {"kind": ["mujoco"]}}}',
        b'{"scenario": {"plant": {"ball": {"mass": "heavy"}}}}',
        b'{"scenario": {"rig": {"period": null}}}',
    ],
)
def test_metadata_that_are_not_those_of_a_run_are_refused_in_one_line(
    exact_folder, tmp_path, metadata
):
    table = pq.read_table(exact_folder / "run.parquet").replace_schema_metadata(
        {"ballplate": metadata}
    )
    pq.write_table(table, tmp_path / "foreign.parquet")
    with pytest.raises(LogError, match=r"foreign\.parquet: its metadata") as caught:
        read(tmp_path / "foreign.parquet")
    assert "\n" not in str(caught.value)


def test_a_parquet_column_that_holds_no_numbers_is_named(tmp_path):
    names = [name for name, column in COLUMNS.items() if column.required]
    table = pa.table({name: ["a", "b"] if name == "measured_y" else [0.0, 1.0] for name in names})
    pq.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(LogError, match="measured_y: is not one column of numbers"):
        read(tmp_path / "log.parquet")


def test_an_unknown_parameter_is_refused_with_those_known():
    with pytest.raises(LogError, match="no 'frction'") as caught:
        chosen("rolling,frction")
    assert all(name in str(caught.value) for name in CHOICES)


@pytest.mark.long
def test_without_friction_none_is_claimed(tmp_path):
    done = run(load("excite", (*SETTINGS, "plant.friction.rolling_mm=0")))
    save(done, tmp_path / "log", {"run": done.motion})
    rolling = by_name(identify(read(tmp_path / "log"), ("rolling",)))["rolling"]
    assert rolling.value < 0.003


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
    assert told["fit"]["reason"] in {"converged", "step limit reached"}
    assert 0 < told["fit"]["steps"] <= told["fit"]["step_limit"]
    assert {path.name for path in out.iterdir()} == {"report.html", "parameters.toml"}


@pytest.mark.parametrize(("lag", "word"), [(1.2e-4, BOUNDED), (2.0e-4, IDENTIFIED)])
def test_drives_faster_than_a_scenario_takes_are_bounded(lag, word):
    draws = lag + 1e-5 * np.random.default_rng(1).standard_normal((400, 1))
    verdict = _servo(Estimate(np.array([lag]), draws, np.array([True]), 20))
    assert verdict.word == word
    if verdict.value is not None:
        load("circle", [f"plant.servo.bandwidth_hz={verdict.value}"])


def test_a_servo_solves_its_first_order_equation():
    period, lag, parts = 0.002, 0.02, 2000
    command = np.random.default_rng(0).normal(0, 0.2, (50, 1))
    angle, speed = servo_response(command, period, lag)
    truth, step = np.zeros(2), period / parts
    for k in range(50):
        assert angle[k, 0] == pytest.approx(truth[0], abs=1e-7)
        assert speed[k, 0] == pytest.approx(truth[1], abs=1e-5)
        for _ in range(parts):
            truth = truth + step * np.array([truth[1], (command[k, 0] - truth[1]) / lag])


def test_a_replay_rolls_as_the_exact_plant_does():
    model, friction = BallPlate(), Friction(rolling=2e-4, breakaway_ratio=1.5)
    plant = ExactPlant(model, rigs=1, step=0.001, friction=friction)
    plant.start(np.array([[0.02, 0.0, -0.03, 0.0]]))
    states, rng = [plant.state.copy()], np.random.default_rng(3)
    swing = rng.uniform(0.5, 1.5, 2)
    for k in range(500):
        t = 0.004 * (k + 1)
        plant.advance(np.array([[0.05 * np.sin(swing[0] * t), 0.04 * np.sin(swing[1] * t)]]), 4)
        states.append(plant.state.copy())
    states = np.array(states)[:, 0]
    field = AccelerationField.of(model, states[None, :, 2::4], states[None, :, 3::4])
    start = states[0, [0, 4, 1, 5]][:, None, None]
    places, _ = replay(field, model, friction, np.zeros((2, 1, 1)), start)
    assert STEP == 0.004
    way = np.abs(np.diff(states[:, 0::4], axis=0)).sum()
    assert way > 0.1
    assert np.abs(places[:, :, 0, 0] - states[:, 0::4]).max() < 0.005 * way


@pytest.mark.long
def test_a_minimisation_says_why_it_stopped(found):
    fit = found.fit
    long = minimise(fit.problem, fit.theta[None], fit.starts, 300)
    assert long.termination.reason == "converged"
    assert 2 <= long.termination.steps < 300
    assert "converged after" in str(long.termination)
    again = minimise(fit.problem, long.theta, long.starts, 300)
    assert again.termination.steps == 2
    assert long.cost[0] - again.cost[0] <= 2 * TOLERANCE * long.cost[0]
    away = fit.theta.copy()
    away[fit.problem.names.index("rolling")] *= 2
    short = minimise(fit.problem, away[None], fit.starts, 1)
    assert short.termination.reason == "step limit reached"
    assert short.termination.steps == short.termination.step_limit == 1
    assert "limit of 1 steps" in str(short.termination)


def test_bootstrap_intervals_of_a_linear_fit_cover_the_truth_as_often_as_they_say():
    rng, truth, covered = np.random.default_rng(5), np.array([1.0, -2.0]), 0
    for _ in range(200):
        slopes = rng.normal(size=(15, 20, 2))
        noise = rng.normal(size=(15, 20)) * rng.uniform(0.5, 2, (15, 1))
        r, normal = noise, np.einsum("wmi,wmj->wij", slopes, slopes)
        step = np.linalg.solve(normal.sum(axis=0), np.einsum("wmi,wm->i", slopes, r))
        left = r - slopes @ step
        fit = estimate(truth + step, normal, np.einsum("wmi,wm->wi", slopes, left))
        covered += int(abs(fit.value[0] - truth[0]) <= fit.half_width[0])
    assert 180 <= covered <= 199
