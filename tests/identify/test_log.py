"""`twin.identify.logs`: What can be no log of the rig is refused in one line."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from twin.base.errors import LogError
from twin.identify.logs import LOG_COLUMN_UNITS, read
from twin.identify.parameters import DEFAULT_PARAMETERS, PARAMETER_CHOICES, choose_parameters
from twin.identify.prepare import prepare
from twin.identify.samples import find_noise
from twin.identify.twin_fit import TwinProblem
from twin.identify.twin_model import identify_twin, replay_log
from twin.identify.verdicts import HOLD_OUT, score
from twin.run.finished import record_run, run
from twin.run.logs import NEEDED_COLUMNS
from twin.run.opened import open_run
from twin.scenario import load


@pytest.fixture(scope="module")
def exact_folder(tmp_path_factory):
    """A run folder of the exact plant, for what is refused before anything is fitted."""
    path = tmp_path_factory.mktemp("exact") / "excite"
    record_run(run(load("excite", ["duration=14", "plant.kind=lagrange"])), path)
    return path


@pytest.fixture(scope="module")
def exact_columns(exact_folder):
    """The columns of its log in SI units by name."""
    (opened,) = open_run(exact_folder)
    return {name: opened.rows[name] for name in LOG_COLUMN_UNITS if name in opened.rows}


def scaled(factor):
    return lambda values: values * factor


def shifted_back(time):
    return time - 3.0 * (np.arange(len(time)) >= 5000)


@pytest.mark.short("changes[1358]-*")
@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"measured_x": scaled(1000)}, "measured_x: reaches .* millimetres"),
        ({"measured_y": scaled(100)}, "measured_y: reaches .* centimetres"),
        ({"measured_phi": scaled(57.3)}, "measured_phi: reaches .* degrees"),
        ({"time": scaled(1000)}, "milliseconds"),
        ({"time": shifted_back}, "times must increase"),
        (
            {"measured_x": scaled(-1)},
            "measured_x accelerates -[0-9.]+ times as much as measured_phi",
        ),
        ({"measured_x": scaled(0.1)}, "measured_x accelerates .* times as much"),
        ({"applied_phi_acc": scaled(57.3)}, "measured_phi moves .* times as far"),
        ({"touched": scaled(0)}, "the ball is never detected"),
        ({"measured_x": scaled(0), "measured_y": scaled(0)}, "too quiet"),
    ],
)
def test_a_log_that_cannot_be_so_is_refused_in_one_line(
    exact_columns, tmp_path, changes, says, write
):
    changed = {name: change(exact_columns[name]) for name, change in changes.items()}
    log = read(write(tmp_path / "log.csv", exact_columns | changed))
    with pytest.raises(LogError, match=says) as caught:
        identify_twin(log, DEFAULT_PARAMETERS)
    assert "\n" not in str(caught.value)
    assert "log.csv" in str(caught.value)


@pytest.mark.parametrize("rows", [50, 600, 2000])
def test_a_log_that_is_too_short_is_refused_in_one_line(exact_columns, tmp_path, rows, write):
    log = read(write(tmp_path / "log.csv", exact_columns, rows=range(rows)))
    with pytest.raises(LogError, match=r"too short|too quiet|no stretch") as caught:
        identify_twin(log, DEFAULT_PARAMETERS)
    assert "\n" not in str(caught.value)


def test_a_file_without_its_columns_names_those_that_are_missing(exact_columns, tmp_path, write):
    less = {name: values for name, values in exact_columns.items() if name != "measured_theta"}
    with pytest.raises(LogError, match=r"no column measured_theta \(it has time, measured_x"):
        read(write(tmp_path / "log.csv", less, rows=range(5)))


def test_a_ball_is_told_by_the_share_of_gravity_that_accelerates_it(
    exact_folder, exact_columns, tmp_path, write
):
    log = read(write(tmp_path / "log.csv", exact_columns, rows=range(5)))
    solid = log.with_ball(5 / 7).model
    assert solid.inertia == pytest.approx(2 / 5 * solid.mass * solid.radius**2)
    with pytest.raises(LogError, match="--ball: not allowed; a run states"):
        read(exact_folder).with_ball(5 / 7)


def test_a_word_among_numbers_is_named_with_its_line(exact_columns, tmp_path, write):
    texts = {(2, "measured_y"): "n/a"}
    with pytest.raises(LogError, match=r"line 4: measured_y: 'n/a' is not a number"):
        read(write(tmp_path / "log.csv", exact_columns, rows=range(5), texts=texts))


def test_a_unit_that_is_none_is_refused_with_those_known(exact_columns, tmp_path, write):
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
    table = pa.table(
        {name: ["a", "b"] if name == "measured_y" else [0.0, 1.0] for name in NEEDED_COLUMNS}
    )
    pq.write_table(table, tmp_path / "log.parquet")
    with pytest.raises(LogError, match="measured_y: is not one column of numbers"):
        read(tmp_path / "log.parquet")


def test_an_unknown_parameter_is_refused_with_those_known():
    with pytest.raises(LogError, match="no 'frction'") as caught:
        choose_parameters("rolling,frction")
    assert all(name in str(caught.value) for name in PARAMETER_CHOICES)


@pytest.mark.long
@pytest.mark.parametrize("rate", [50, 200])
def test_the_ball_that_stays_stays_where_it_was_at_the_last_sample(tmp_path, rate):
    """On a screen of few frames some bins have no sample; a ball on a circle tells by its way."""
    touch = f"sensors.touch.frame_rate={rate}"
    done = run(load("circle", ("duration=16", "plant.kind=lagrange", touch)))
    record_run(done, tmp_path)
    log = prepare(read(tmp_path))
    names = ("delay", "rolling")
    theta = np.array([0.042, done.scenario.plant.friction.rolling_mm * 1e-3])
    fit = SimpleNamespace(
        problem=TwinProblem(None, names, log.model), found=SimpleNamespace(theta=theta[None])
    )
    found = replay_log(log, fit, 0.0)
    still = score(found).median["stays"]
    (recorded,) = open_run(tmp_path)
    rows = recorded.rows
    ball = np.stack((rows["true_x"], rows["true_y"]), axis=1)
    for ahead, off in zip(HOLD_OUT.horizons_s[:2], still, strict=False):
        steps = round(ahead / 0.002)
        way = np.hypot(*(ball[steps:] - ball[:-steps]).T)
        assert off == pytest.approx(float(np.median(way)), rel=0.1), ahead


def test_the_noise_of_samples_of_a_smooth_motion_is_found():
    time = np.arange(20_000) / 60
    moved = 0.05 * np.sin(2 * np.pi * 0.3 * time)
    noise = np.random.default_rng(1).standard_normal((2, len(time)))
    ball = np.stack((moved + 4e-4 * noise[0], 2e-3 * noise[1]), axis=-1)
    # the median of n independent absolute values scatters by 1.2 / sqrt(n), of second differences,
    # which overlap, by up to twice that: 2.5 of these
    assert find_noise(ball) == pytest.approx([4e-4, 2e-3], rel=5 * 1.2 / np.sqrt(len(time)))
    assert find_noise(ball[:, 0]) == find_noise(ball)[0]
