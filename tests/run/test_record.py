"""Tests of `twin.run.record`."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest

from twin.base.errors import RecordError
from twin.base.writing import write_whole
from twin.run.files import STREAM_FILE
from twin.run.finished import run, run_metadata, save
from twin.run.opened import open_run
from twin.run.record import Recorder, read_run, stream, write_run

pytestmark = pytest.mark.usefixtures("no_pictures")


def test_a_written_record_reads_back_with_units_and_metadata(tmp_path):
    record = Recorder(4, 1, 0.002, ("torque_phi_Nm",))
    for tick in range(3):
        channels = {"state": np.full((1, 8), tick), "age": np.full(1, tick / 10)}
        record.append(0.002 * tick, channels | {"plant": np.full((1, 1), 1.5)})
    write_run(tmp_path, record, {"seed": 3})
    table = pq.read_table(tmp_path / "run.parquet")
    assert table["true_theta"].to_pylist() == [0.0, 1.0, 2.0]
    assert table["time"].to_pylist() == [0.0, 0.002, 0.004]
    assert table.schema.field("true_phi_rate").metadata == {b"unit": b"rad/s"}
    assert table.schema.field("torque_phi_Nm").metadata == {b"unit": b"Nm"}
    assert json.loads(table.schema.metadata[b"ballplate"]) == {"seed": 3}


def test_a_failing_write_leaves_nothing_behind(tmp_path):
    def half(path):
        path.write_text("half")
        raise OSError(28, "No space left on device")

    with pytest.raises(RecordError, match="No space left"):
        write_whole(tmp_path / "file.txt", half)
    assert list(tmp_path.iterdir()) == []


def test_a_record_of_an_earlier_version_has_todays_columns(tmp_path, scenario):
    done = run(scenario())
    save(done, tmp_path, {"run": done.motion})
    file = tmp_path / "run.parquet"
    table = pq.read_table(file)
    old = [name.replace("requested_", "wished_") for name in table.column_names]
    assert old != table.column_names
    renamed = table.rename_columns(old).replace_schema_metadata(table.schema.metadata)
    pq.write_table(renamed, file)
    (replay,) = open_run(tmp_path)
    requested = replay.rows["requested_phi_acc"]
    assert np.array_equal(requested, done.record["requested"][:, 0, 0])
    assert replay.units["requested_phi_acc"] == "rad/s^2"


def test_a_thinned_record_keeps_the_largest_effort_since_the_instant_before():
    record = Recorder(6, 1, 0.002, every=3)
    for tick, effort in enumerate((1.0, 2.0, -5.0, 3.0, 0.5, 0.1)):
        record.append(0.002 * tick, {"applied": np.full((1, 2), effort)})
    assert record.time == pytest.approx([0.0, 0.006])
    assert record["applied"][:, 0, 0].tolist() == [1.0, -5.0]


@pytest.fixture
def streamed(tmp_path, scenario):
    """A run, its folder, and where in its stream each of four pieces ends."""
    done = run(scenario())
    columns = {"time": done.record.time}
    columns |= {name: values for name, _, values in done.record.columns()}
    ends = []
    units = done.record.units
    with stream(
        list(columns), tmp_path / STREAM_FILE, units, run_metadata(done.scenario)
    ) as append:
        for piece in np.array_split(np.arange(done.record.length), 4):
            append({name: values[piece] for name, values in columns.items()})
            ends.append((tmp_path / STREAM_FILE).stat().st_size)
    return done, tmp_path, ends


def test_a_stream_that_breaks_off_anywhere_is_read_up_to_there(streamed):
    done, folder, ends = streamed
    whole = (folder / STREAM_FILE).read_bytes()
    pieces = np.cumsum([len(piece) for piece in np.array_split(done.record.time, 4)])
    for length in [*range(ends[1], ends[2], 997), ends[1], ends[2] - 1, ends[2], ends[3]]:
        (folder / STREAM_FILE).write_bytes(whole[:length])
        rows, units, _ = read_run(folder / STREAM_FILE)
        known = pieces[sum(end <= length for end in ends) - 1]
        assert np.array_equal(rows["true_x"], done.record["state"][:known, 0, 0])
        assert units["true_phi_rate"] == "rad/s"


def test_a_stream_opens_as_a_run_that_was_killed_and_goes_when_the_run_is_kept(streamed):
    done, folder, _ = streamed
    (found,) = open_run(folder)
    assert found.scenario == done.scenario
    assert found.metrics["outcome"] == "aborted"
    assert found.metrics["reason"].startswith("killed")
    assert found.metrics["outcome_time"] == pytest.approx(done.record.end)
    assert found.metrics["rms_error"] == pytest.approx(done.metrics["rms_error"])
    save(done, folder, {"run": done.motion})
    assert not (folder / STREAM_FILE).exists()
    assert open_run(folder)[0].metrics["outcome"] == "finished"


def test_a_stream_of_nothing_is_one_line(tmp_path):
    (tmp_path / STREAM_FILE).write_bytes(b"")
    with pytest.raises(RecordError, match=r"run\.arrows: nothing has been recorded yet"):
        open_run(tmp_path)
