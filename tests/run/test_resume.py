"""run --resume: an interrupted run goes on and ends as if nothing had been."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli import ballplate
from twin.errors import RecordError
from twin.run import execute
from twin.run.past import interrupted
from twin.run.record_file import read_run
from twin.scenario.load import load
from twin.scenario.title import titled

KEYS = ("plant.kind=lagrange", "duration=6.0", "metrics.start=2.0", "baseline=false")


def scenario(*keys):
    return load("circle", [*KEYS, *keys])


def stopped_at(seconds):
    def progress(time):
        if time >= seconds:
            raise KeyboardInterrupt

    return progress


@pytest.fixture(scope="module")
def whole():
    return execute.run(scenario())


@pytest.fixture
def folder(tmp_path):
    done = execute.run(scenario(), stopped_at(5.5))
    assert done.interrupted
    execute.save(done, tmp_path, {"run": done.motion})
    return tmp_path


def test_a_resumed_run_is_the_uninterrupted_one_to_the_bit(whole, folder):
    past = interrupted(folder, scenario(), execute.versions())
    assert past.snapshots[-1].time == 5.0
    done = execute.run(scenario(), past=past)
    assert list(done.record.data) == [name for name in whole.record.data if name != "plant"]
    for name, values in done.record.data.items():
        assert np.array_equal(values, whole.record.data[name], equal_nan=True), name
    assert done.metrics == whole.metrics


@pytest.mark.long
def test_what_cannot_be_resumed_is_one_line(whole, folder, tmp_path):
    def refused(*keys, versions=None):
        with pytest.raises(RecordError) as refusal:
            interrupted(folder, scenario(*keys), versions or execute.versions())
        return str(refusal.value)

    assert "of another scenario or other settings" in refused("seed=3")
    assert "recorded with mujoco" in refused(versions={"mujoco": "0.1"})
    execute.save(whole, folder, {"run": whole.motion})
    assert "was not interrupted" in refused()
    early = execute.run(scenario(), stopped_at(1.0))
    execute.save(early, folder, {"run": early.motion})
    assert "before its first snapshot" in refused()
    with pytest.raises(RecordError, match="no such record"):
        interrupted(tmp_path / "nothing", scenario(), {})


@pytest.mark.long
def test_the_command_goes_on_with_the_run_in_its_folder(whole, tmp_path):
    stopped = execute.run(titled(scenario(), KEYS), stopped_at(5.5))
    execute.save(stopped, tmp_path, {"run": stopped.motion})
    keys = [word for key in KEYS for word in ("--set", key)]
    command = ["run", "circle", *keys, "--out", str(tmp_path), "--resume", "--json"]
    result = CliRunner().invoke(ballplate, command, catch_exceptions=False)
    assert json.loads(result.stdout)["rms_error"] == whole.metrics["rms_error"]
    columns, _, _ = read_run(tmp_path / "run.parquet")
    assert np.array_equal(columns["true_x"], whole.record["state"][:, 0, 0])
