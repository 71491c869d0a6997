"""`twin.run.finished`: A log without a scenario of its own, laid over what the twin predicts."""

import csv

import numpy as np
import pytest

from ballplate import compare
from twin.base.errors import LogError, ScenarioError
from twin.hal.interface import AXIS_NAMES
from twin.run.finished import run
from twin.run.logs import apart, distances, fitting, log_run, read_log
from twin.scenario.load import load

CHANGES = (
    "plant.kind=lagrange",
    "duration=6",
    "metrics.start=2",
    "plant.step=0.002",
    "controller.kind=lqr",
)
COLUMNS = ("time", "measured_x", "measured_y", "measured_phi", "measured_theta")


@pytest.fixture(scope="module")
def made():
    return run(load("circle", CHANGES))


def write(path, rows, names=COLUMNS, header=COLUMNS, every=1):
    with path.open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow(header)
        writer.writerows(zip(*(rows[name][::every] for name in names), strict=True))
    return path


def test_a_bare_log_lies_on_the_run_it_was_taken_from(made, tmp_path):
    log = read_log(write(tmp_path / "log.csv", made.rows, every=5))
    scenario = load("circle", CHANGES)
    found = log_run(log, scenario, "log")
    # the screen's noise has a deviation of some 0.5 mm per axis; its dead time alone would be 5 mm
    assert apart(found, made.motion) < 1e-3
    expected = made.metrics["tracking_error_percent"]
    assert found.metrics["tracking_error_percent"] == pytest.approx(expected, rel=0.02)
    assert found.metrics["u_rms"] is None
    assert distances({"log": found}, {"log": found.motion, "twin": made.motion})[0].startswith(
        "log and twin are 0."
    )


def test_a_log_of_one_axis_is_apart_from_another_run_along_that_axis():
    rows = {name: np.zeros(20) for name in COLUMNS} | {"time": 0.01 * np.arange(20)}
    found = log_run(rows, load("line", ["parameters=tube", "sensors.touch.dead_time=0"]), "log")
    (said,) = distances({"log": found}, {"log": found.motion, "twin": found.motion})
    assert said == "log and twin are 0 mm (RMS) apart over x."


def test_columns_that_a_log_has_are_used_as_they_are(made, tmp_path):
    log = read_log(write(tmp_path / "log.csv", made.rows, made.rows, made.rows))
    found = log_run(log, load("circle", CHANGES), "log")
    np.testing.assert_array_equal(found.motion.ball, made.motion.ball)
    assert found.metrics["u_rms"] == pytest.approx(made.metrics["u_rms"])


def test_the_prediction_begins_where_the_log_does_and_lasts_as_long(made, tmp_path):
    rows = {name: values[::5][:300] for name, values in made.rows.items()}
    rows = rows | {"measured_x": rows["measured_x"] + 0.05}
    log = read_log(write(tmp_path / "log.csv", rows))
    changes = dict(text.split("=") for text in fitting(log, load("circle", CHANGES)))
    assert float(changes["duration"]) == pytest.approx(3.0)
    assert float(changes["metrics.start"]) == pytest.approx(1.0)
    assert float(changes["plant.start.x"]) == pytest.approx(0.05, abs=3e-3)


@pytest.mark.parametrize(
    ("header", "factor", "words"),
    [
        (("t", *COLUMNS[1:]), 1, "no column time"),
        (COLUMNS, 1000, "measured_x: reaches .* give m, or the unit in the header"),
        (("time", "measured_x [furlong]", *COLUMNS[2:]), 1, "unit 'furlong'"),
        (("time", "measured_x [mm]", *COLUMNS[2:]), 1000, None),
        (("time", "measured_x (mm)", *COLUMNS[2:]), 1000, None),
    ],
)
def test_a_log_that_cannot_be_meant_is_refused(tmp_path, header, factor, words):
    time = np.linspace(0, 1, 50)
    rows = {name: 0.1 * np.sin(time) for name in COLUMNS} | {"time": time}
    scaled = rows | {"measured_x": factor * rows["measured_x"]}
    path = write(tmp_path / "log.csv", scaled, header=header)
    if words is None:
        np.testing.assert_allclose(read_log(path)["measured_x"], rows["measured_x"])
    else:
        with pytest.raises(LogError, match=words):
            read_log(path)


@pytest.mark.long
def test_a_log_of_commands_in_columns_of_any_name_lies_on_the_run_it_was_taken_from(made, tmp_path):
    """A camera of 50 frames/s that sees half millimetres, and the angles that were commanded."""
    rows, period = made.rows, 0.002
    k = np.arange(0, len(rows["time"]), 10)
    tilt = [np.cumsum(np.cumsum(rows[f"applied_{axis}_acc"])) * period**2 for axis in AXIS_NAMES]
    seen = [np.round(2000 * rows[f"measured_{axis}"][k]) / 2 for axis in ("x", "y")]
    cells = np.column_stack((1000 * rows["time"][k], *seen, *(np.degrees(u[k]) for u in tilt)))
    file = tmp_path / "rig.txt"
    np.savetxt(file, cells, fmt="%.6g", delimiter=";", header="millis;X;Y;a;b", comments="")
    columns = "time=millis:ms,measured_x=X:mm,measured_y=Y:mm,command_phi=a:deg,command_theta=b:deg"
    found = compare(str(file), "circle", settings=CHANGES, columns=columns)
    log, twin = found["rig"], found["circle"]
    assert found.logs == ("rig",)
    assert apart(log, twin.motion) < 1.5e-3
    expected = twin.metrics["tracking_error_percent"]
    assert log.metrics["tracking_error_percent"] == pytest.approx(expected, rel=0.05)
    both = log.motion.time[:-500]  # the plate of the log is where the twin's was measured
    measured = np.interp(both, rows["time"], rows["measured_phi"])
    assert np.abs(log.motion.plate[: len(both), 0] - measured).max() < np.radians(0.3)


def test_columns_without_a_log_are_refused():
    with pytest.raises(ScenarioError, match="columns: describe a log"):
        compare("circle", columns="time=t,measured_x=x,command_phi=u")
