"""Tests of `twin.run.finished`."""

import json
import shutil

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from twin.base.errors import RecordError
from twin.run.finished import record_run, run
from twin.run.opened import open_run, open_runs
from twin.scenario import load


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A whole record, as a table."""
    folder = tmp_path_factory.mktemp("run")
    keys = ("plant.kind=lagrange", "duration=0.1", "metrics.start=0")
    record_run(run(load("hold", keys)), folder)
    return pq.read_table(folder / "run.parquet")


@pytest.fixture
def rewritten(recorded, tmp_path):
    """Writes the record with some of its metadata replaced, or with other metadata altogether."""

    def write(table=None, metadata=None, **changed):
        whole = json.loads(recorded.schema.metadata[b"ballplate"]) | changed
        encoded = json.dumps(whole) if metadata is None else metadata
        table = recorded if table is None else table
        pq.write_table(
            table.replace_schema_metadata({"ballplate": encoded}), tmp_path / "run.parquet"
        )
        return tmp_path

    return write


def refusal(folder):
    with pytest.raises(RecordError) as caught:
        open_run(folder)
    text = str(caught.value)
    assert "\n" not in text
    assert "run.parquet" in text
    return text


TIMES = {"number": 1, "p50_us": 1, "p99_us": 1, "max_us": 1}


def test_a_whole_record_is_opened_with_what_it_holds(rewritten):
    event = {"time": 1, "severity": "warning", "text": "late", "more": 1}
    ledger = {"lateness": TIMES, "stages": {"read": TIMES}, "round_trip": TIMES, "ticks": 3}
    (replay,) = open_run(rewritten(events=[event], ledger=ledger, others={"a": 1}))
    assert replay.events == (event,)
    assert replay.ledger == ledger
    assert replay.metrics["outcome"] == "finished"


@pytest.mark.parametrize(
    ("metadata", "expected"),
    [
        ("nonsense", "metadata 'ballplate': not JSON"),
        (b"\xff\xfe{", "metadata 'ballplate': not JSON"),
        ("[1, 2]", "metadata 'ballplate': not a JSON object"),
        ("3", "metadata 'ballplate': not a JSON object"),
        ("[" * 3000 + "]" * 3000, "metadata 'ballplate': nested deeper"),
        (f'{{"scenario": {"9" * 5000}}}', "metadata 'ballplate': an integer beyond 64 bit"),
        ("{}", "no scenario in its metadata"),
        ('{"scenario": [1]}', "different version"),
        ('{"scenario": null}', "different version"),
    ],
)
def test_foreign_metadata_is_one_line(rewritten, metadata, expected):
    assert expected in refusal(rewritten(metadata=metadata))


@pytest.mark.parametrize(("name", "wrong"), [("events", 3), ("metrics", [1]), ("ledger", [1])])
def test_metadata_of_a_wrong_shape_is_one_line_that_names_it(rewritten, name, wrong):
    assert f"{name}: is damaged" in refusal(rewritten(**{name: wrong}))


def _with(table, name, values):
    return table.set_column(table.schema.get_field_index(name), name, pa.array(values))


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (lambda t: t.drop_columns(["estimated_theta_rate"]), "no estimated_theta_rate"),
        (lambda t: t.drop_columns(["true_y"]), "no true_y"),
        (lambda t: t.append_column("motor_phi_rad", t["time"]), "no motor_theta_rad"),
        (lambda t: t.append_column("time", t["time"]), "not a readable Parquet file"),
        (lambda t: t.slice(0, 0), "ended before its first period"),
        (lambda t: _with(t, "time", ["now"] * len(t)), "no time"),
        (
            lambda t: _with(t, "time", np.full(len(t), np.nan)),
            "time: must be a number in every row",
        ),
        (lambda t: _with(t, "time", np.zeros(len(t))), "time: must rise from row to row"),
        (lambda t: _with(t, "supervisor", np.full(len(t), 9.0)), "supervisor: no state 9"),
    ],
)
def test_rows_that_are_no_run_are_one_line(rewritten, recorded, change, expected):
    assert expected in refusal(rewritten(change(recorded)))


def test_a_unit_in_another_encoding_is_no_reason_to_refuse_a_record(rewritten, recorded):
    field = pa.field("time", pa.float64(), metadata={"unit": b"\xff"})
    table = recorded.cast(recorded.schema.set(0, field))
    (replay,) = open_run(rewritten(table))
    assert replay.units["time"] == "\N{REPLACEMENT CHARACTER}"


def test_folders_of_runs_and_patterns_lead_to_every_run(rewritten, tmp_path):
    single = rewritten()
    several = tmp_path / "compare"
    for name in ("afl", "lqr"):
        shutil.copytree(single, several / name, ignore=shutil.ignore_patterns("compare"))
    (several / "compare.png").write_bytes(b"a picture")
    assert [run.name for run in open_runs((several,))] == ["afl", "lqr"]
    assert [run.name for run in open_runs(tuple(sorted(several.iterdir())))] == ["afl", "lqr"]
    with pytest.raises(RecordError, match=r"contains 2 runs; give one of them, such as .*afl"):
        open_run(several)
    both = open_runs((single, several / "lqr"))
    assert [run.name for run in both] == [tmp_path.name, "lqr"]


def test_pictures_alone_are_no_runs(tmp_path):
    for name in ("a.png", "b.png"):
        (tmp_path / name).write_bytes(b"a picture")
    with pytest.raises(RecordError, match=r"a\.png: not a run; give run folders"):
        open_runs((tmp_path / "a.png", tmp_path / "b.png"))
