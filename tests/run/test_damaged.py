"""`twin.run.files`.

Damaged and hostile records: each is noticed in one line, and none fills the memory."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from at_once import is_at_once
from hypothesis import given, settings
from hypothesis import strategies as st

from twin.base.errors import LogError, RecordError
from twin.run.files import STREAM_FILE
from twin.run.finished import record_run, run, run_metadata
from twin.run.logs import COLUMN_UNITS, NEEDED_COLUMNS, read_columns
from twin.run.opened import open_run
from twin.run.record import CHECKSUM_KEY, read_metadata, read_run, stream
from twin.run.units import split_unit


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The two forms of a record of 200 periods, and what is in it."""
    from twin.scenario.load import load

    scenario = load("hold", ["plant.kind=lagrange", "duration=0.4"])
    done, folder = run(scenario), tmp_path_factory.mktemp("made")
    record_run(done, folder / "whole")
    rows = dict(done.rows)
    with stream([*rows], folder / STREAM_FILE, done.units, run_metadata(scenario)) as append:
        for first in range(0, 200, 20):
            append({name: values[first : first + 20] for name, values in rows.items()})
    return folder / "whole" / "run.parquet", folder / STREAM_FILE, rows


def damaged(content, rng):
    """A file with a byte changed, a sector of zeros or its end cut off."""
    at, kind = int(rng.integers(len(content))), int(rng.integers(4))
    if kind == 0:
        return content[:at]
    if kind == 1:
        sector = at // 512 * 512
        return (
            content[:sector] + bytes(len(content[sector : sector + 512])) + content[sector + 512 :]
        )
    changed = bytearray(content)
    changed[at] ^= 1 << int(rng.integers(8))
    return bytes(changed)


@pytest.mark.parametrize("form", [0, 1], ids=["parquet", "arrows"])
@pytest.mark.parametrize(
    "times", [60, pytest.param(1500, marks=pytest.mark.long)], ids=["some", "many"]
)
def test_no_damage_changes_a_number_without_a_word(made, tmp_path, form, times):
    content, rows = made[form].read_bytes(), made[2]
    _, units, metadata = read_run(made[form])
    rng, file, noticed = np.random.default_rng(times), tmp_path / made[form].name, 0
    for number in range(times):
        file.write_bytes(damaged(content, rng))
        try:
            found, its, said = read_run(file)
        except RecordError as refused:
            noticed += str(refused).count("\n") == 0
            continue
        count = len(found["time"])
        lacks = said.pop("incomplete", [])
        noticed += bool(lacks)
        assert (its, said) == (units, metadata), number
        assert set(found) == set(rows), number
        for name, values in rows.items():
            assert np.array_equal(found[name], values[:count], equal_nan=True), (number, name)
        assert count == 200 or (form and lacks and count % 20 == 0), number
    assert noticed > 0.8 * times


def test_a_stream_that_is_damaged_in_the_middle_says_from_when_on(made, tmp_path):
    content = made[1].read_bytes()
    one = content.index(CHECKSUM_KEY, content.index(CHECKSUM_KEY, len(content) // 2) + 1)
    file = tmp_path / STREAM_FILE
    file.write_bytes(content[: one + 600] + b"\x7f" + content[one + 601 :])
    with pytest.raises(RecordError, match=r"run\.arrows: damaged: its rows after 0\.\d+ s do not"):
        open_run(tmp_path)
    with pytest.raises(LogError, match=r"run\.arrows: .*damaged: its rows after"):
        read_columns(file, COLUMN_UNITS, NEEDED_COLUMNS)


def test_rows_that_were_being_written_are_left_out_and_that_is_said(made, tmp_path):
    (tmp_path / STREAM_FILE).write_bytes(made[1].read_bytes()[:-300])
    (found,) = open_run(tmp_path)
    assert len(found.time) == 180
    assert found.incomplete == (
        "run.arrows: its last rows were being written or are damaged; they are left out",
    )


def test_a_stream_without_some_periods_says_how_many(made, tmp_path, scenario):
    rows = {name: np.delete(values, slice(50, 60)) for name, values in made[2].items()}
    with stream([*rows], tmp_path / STREAM_FILE, {}, run_metadata(scenario())) as append:
        append(rows)
    assert open_run(tmp_path)[0].incomplete == (
        "run.arrows: 10 periods not in it: begun too late, or not written",
    )


def test_records_without_a_checksum_are_read(made, tmp_path):
    with pq.ParquetFile(made[0]) as parquet:
        table = parquet.read()
    about = {b"ballplate": table.schema.metadata[b"ballplate"]}
    table = table.replace_schema_metadata(about)
    pq.write_table(table, tmp_path / "run.parquet")
    assert np.array_equal(read_run(tmp_path / "run.parquet")[0]["true_x"], made[2]["true_x"])
    with pa.ipc.new_stream(tmp_path / STREAM_FILE, table.schema) as writer:
        writer.write_table(table)
    found = read_run(tmp_path / STREAM_FILE)
    assert np.array_equal(found[0]["true_x"], made[2]["true_x"])
    assert "incomplete" not in found[2]


@pytest.mark.parametrize("changed", [False, True])
def test_bytes_that_are_read_as_numbers_of_another_type_do_not_match(made, tmp_path, changed):
    with pq.ParquetFile(made[0]) as parquet:
        table, seal = parquet.read(), parquet.metadata.metadata[CHECKSUM_KEY]
    if changed:
        at = table.schema.get_field_index("true_x")
        field = table.schema.field(at)
        values = pa.array(table["true_x"].to_numpy().view(np.int64))
        whole = pa.field(field.name, pa.int64(), metadata=field.metadata)
        table = table.set_column(at, whole, values)
    file = tmp_path / "run.parquet"
    with pq.ParquetWriter(file, table.schema, use_dictionary=False) as writer:
        writer.write_table(table)
        writer.add_key_value_metadata({CHECKSUM_KEY: seal})
    if changed:
        with pytest.raises(RecordError, match="checksum"):
            read_run(file)
    else:
        assert np.array_equal(read_run(file)[0]["true_x"], made[2]["true_x"])


def flat(names, rows):
    """A table that packs into nothing: every value the same."""
    values = pa.chunked_array([pa.repeat(0.0, rows)])
    return pa.table(dict.fromkeys(names, values))


HOSTILE = {
    "rows of 4 columns would take": lambda: flat(("time", "measured_x", "b", "c"), 4_000_000),
    "11000000 rows of 1 column; at most 10000000 of 1000": lambda: flat(("time",), 11_000_000),
    "1 row of 5000 columns": lambda: flat([f"c{i}" for i in range(5000)], 1),
}


@pytest.mark.short("11000000*")
@pytest.mark.parametrize("said", HOSTILE)
def test_a_file_that_would_fill_the_memory_is_refused_by_its_schema(tmp_path, said, monkeypatch):
    file = tmp_path / "run.parquet"
    table = HOSTILE[said]().replace_schema_metadata({"ballplate": "{}"})
    pq.write_table(table, file, compression="zstd")
    assert file.stat().st_size < 2_000_000
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_, **__: 1 / 0)
    with pytest.raises(RecordError, match=said):
        read_run(file)


def test_columns_are_looked_at_before_any_is_read(tmp_path, monkeypatch):
    nested = pa.array([{"x": 1.0}] * 3)
    table = pa.table({"time": nested, "measured_x": [1.0] * 3, "text": ["a"] * 3})
    pq.write_table(table.replace_schema_metadata({"ballplate": "{}"}), tmp_path / "run.parquet")
    monkeypatch.setattr(pq.ParquetFile, "read", lambda *_, **__: 1 / 0)
    with pytest.raises(LogError, match=r"no column measured_phi"):
        read_columns(tmp_path / "run.parquet", COLUMN_UNITS, NEEDED_COLUMNS)
    with pytest.raises(LogError, match="time: is not one column of numbers"):
        read_columns(tmp_path / "run.parquet", COLUMN_UNITS, ("time",))
    monkeypatch.undo()
    assert [*read_run(tmp_path / "run.parquet")[0]] == ["measured_x"]


@pytest.mark.parametrize("form", [0, 1], ids=["parquet", "arrows"])
def test_a_name_that_is_no_text_is_one_line(made, tmp_path, form):
    file = tmp_path / made[form].name
    file.write_bytes(made[form].read_bytes().replace(b"true_x", b"tru\xdf_x"))
    for read in (read_run, read_metadata):
        with pytest.raises(RecordError, match=r"not a readable|damaged"):
            read(file)
    with pytest.raises(LogError, match=f"{file.name}: cannot be read"):
        read_columns(file, COLUMN_UNITS, NEEDED_COLUMNS)


LONG = 40_000
HEADERS = {
    "spaces": lambda size: "x" + " " * size + "y",
    "brackets": lambda size: "[" * size,
    "openings": lambda size: "(a" * (size // 2) + ")" * 9 + "z",
    "name": lambda size: "n" * size,
    "unit": lambda size: f"time [{'u' * size}]",
    "columns": lambda size: ",".join(f"c{number}" for number in range(size // 6)),
}


@pytest.mark.parametrize("header", HEADERS)
def test_a_long_header_is_one_short_line_at_once(tmp_path, header):
    for size in (LONG, LONG // 10):
        (tmp_path / f"{size}.csv").write_text(f"{HEADERS[header](size)}\n1\n")

    def read(size):
        with pytest.raises(LogError) as caught:
            read_columns(tmp_path / f"{size}.csv", COLUMN_UNITS, ("time", "measured_x"))
        assert len(str(caught.value)) < 1200

    assert is_at_once(lambda: read(LONG), lambda: read(LONG // 10))


@given(st.text("ab []()", max_size=12))
@settings(max_examples=200)
def test_a_header_is_a_name_and_in_the_last_brackets_a_unit(text):
    name, unit = split_unit(f"{text.strip('[]() ')} [mm] ")
    assert unit == "mm" or any(bracket in text.strip("[]() ") for bracket in "[(")
    assert split_unit(text)[1] is None or text.strip()[-1] in "])"
    assert name == name.strip()
