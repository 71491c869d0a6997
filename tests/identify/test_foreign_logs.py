"""`twin.identify.log_tables`.

Logs of other programs: the first bytes decide what a file is, and damaged rows are left out."""

import gzip
import io
import pickle
import zipfile

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import savemat

import ballplate
from twin.base.errors import LogError
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.logs import read
from twin.run.exporters import export
from twin.run.files import sorted_out
from twin.run.logs import read_csv, read_log

T = np.arange(0.0, 4.0, 0.02)
X = 0.05 * np.sin(1.3 * T)
U = 0.02 * np.cos(T)
COLUMNS = wanted_columns("time=t,measured_x=x,command_phi=u")


def archived(**files):
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as archive:
        for name, content in files.items():
            archive.writestr(name.replace("__", "/"), content)
    return target.getvalue()


FOREIGN = {
    "a.bag": (b"#ROSBAG V2.0\n" + bytes(99), "a ROS bag.*rostopic"),
    "a.zip": (archived(a="1"), "a ZIP archive.*unpack"),
    "a.csv.gz": (gzip.compress(b"t,x,u\n" * 99), "a gzip file.*gunzip"),
    "a.pkl": (pickle.dumps({"t": T.tolist()}), "a Python pickle"),
    "a.html": (b"<!DOCTYPE html><html>", "an XML or HTML file"),
    "b.pkl": (pickle.dumps({"t": T.tolist()}, 2), "a Python pickle"),
    "a.bin": (bytes(range(256)) * 4, "a binary file of a kind not known"),
    "a.blf": (b"LOGG" + bytes(99), "a CAN trace of Vector.*ballplate trace"),
}


@pytest.mark.parametrize("name", FOREIGN)
@pytest.mark.parametrize("ending", ["", ".csv", ".txt"])
def test_what_is_no_log_is_named_by_its_first_bytes_whatever_it_is_called(tmp_path, name, ending):
    content, words = FOREIGN[name]
    file = tmp_path / f"{name}{ending}"
    file.write_bytes(content)
    for reader in (lambda: read_any(file, COLUMNS), lambda: read(file), lambda: read_csv(file, {})):
        with pytest.raises(LogError, match=f"is {words}") as caught:
            reader()
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["a.parquet", "a.csv", "a"])
def test_a_parquet_file_that_has_the_columns_is_read(tmp_path, name):
    file = tmp_path / name
    table = pa.table({"t": T, "x": pa.array(1e3 * X), "u": U, "what": ["a"] * len(T)})
    fields = [pa.field(f.name, f.type, metadata={"unit": "mm"} if f.name == "x" else None)
              for f in table.schema]  # fmt: skip
    pq.write_table(table.cast(pa.schema(fields)), file)
    axis = read_any(file, COLUMNS).axes["x"]
    assert axis.time == pytest.approx(T)
    assert axis.ball == pytest.approx(X)
    by_number = wanted_columns("time=1,measured_x=2:mm,command_phi=3")
    assert read_any(file, by_number).axes["x"].ball == pytest.approx(X)
    with pytest.raises(LogError, match=r"no column y \(it has t, x \[mm\], u"):
        read_any(file, wanted_columns("time=t,measured_x=y,command_phi=u"))
    with pytest.raises(LogError, match="no column 9: there are 4"):
        read_any(file, wanted_columns("time=9,measured_x=x,command_phi=u"))


def test_times_and_gaps_of_a_parquet_file_are_numbers(tmp_path):
    stamps = pa.array((1_700_000_000_000 + 1e3 * T).astype("datetime64[ms]"))
    seen = [None if 20 <= k < 25 else float(x) for k, x in enumerate(X)]
    pq.write_table(pa.table({"t": stamps, "x": seen, "u": U.astype("f4")}), tmp_path / "a.parquet")
    axis = read_any(tmp_path / "a.parquet", COLUMNS).axes["x"]
    assert axis.time == pytest.approx(T, abs=1e-6)
    assert len(axis.ball) == len(T) - 5


def test_a_stream_of_arrow_is_read(tmp_path):
    table = pa.table({"t": T, "x": X, "u": U})
    with pa.ipc.new_stream(tmp_path / "a.arrows", table.schema) as writer:
        writer.write_table(table)
    assert read_any(tmp_path / "a.arrows", COLUMNS).axes["x"].ball == pytest.approx(X)


@pytest.mark.parametrize("kept", [4, 60, -9])
def test_a_parquet_file_that_is_cut_is_one_line(tmp_path, kept):
    pq.write_table(pa.table({"t": T, "x": X, "u": U}), tmp_path / "a.parquet")
    (tmp_path / "a.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:kept])
    with pytest.raises(LogError, match=r"a\.parquet: cannot be read") as caught:
        read_any(tmp_path / "a.parquet", COLUMNS)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("named", ["a.mcap", "a.csv"])
def test_a_run_exported_as_mcap_is_read_again(tmp_path, named):
    columns = {"time": T, "measured_x": X, "measured_y": 0.5 * X, "measured_phi": U}
    columns |= {"measured_theta": 0.5 * U, "age": np.zeros(len(T))}
    units = dict(zip(columns, ("s", "m", "m", "rad", "rad", "s"), strict=True))
    export(tmp_path / "b.mcap", columns, units, {"scenario": {}})
    (tmp_path / "b.mcap").rename(tmp_path / named)
    log = read(tmp_path / named)
    assert log.ball == pytest.approx(np.stack((X, 0.5 * X), axis=1))
    assert log.plate == pytest.approx(np.stack((U, 0.5 * U), axis=1))
    told = wanted_columns("time=time,measured_x=measured_x,measured_phi=measured_phi")
    axis = read_any(tmp_path / named, told).axes["x"]
    assert axis.ball == pytest.approx(X)
    assert axis.tilt == pytest.approx(U)


@pytest.mark.parametrize("kept", [9, 30, 300, -5])
def test_an_mcap_file_that_is_cut_is_one_line(tmp_path, kept):
    columns = {"time": T, "measured_x": X, "measured_y": X}
    export(tmp_path / "a.mcap", columns, {"time": "s"}, {})
    content = (tmp_path / "a.mcap").read_bytes()
    (tmp_path / "a.mcap").write_bytes(content[:kept])
    with pytest.raises(LogError, match=r"a\.mcap: cannot be read") as caught:
        read(tmp_path / "a.mcap")
    assert "\n" not in str(caught.value)


def rows(separator=",", comma="."):
    return [
        separator.join(("t", "x", "u")),
        *(
            separator.join(f"{value:.6f}".replace(".", comma) for value in values)
            for values in zip(T, X, U, strict=True)
        ),
    ]


def written(tmp_path, lines, name="a.csv"):
    (tmp_path / name).write_text("\n".join(lines) + "\n")
    return tmp_path / name


def without_front(row, separator=","):
    return row.partition(separator)[2]


@pytest.mark.parametrize("header", [True, False])
@pytest.mark.parametrize(("separator", "comma"), [(",", "."), (";", ","), ("\t", "."), (" ", ".")])
def test_a_first_row_that_is_cut_at_its_front_is_left_out_and_said(
    tmp_path, separator, comma, header
):
    text = rows(separator, comma)
    text[1] = without_front(text[1], separator)
    told = COLUMNS if header else wanted_columns("time=1,measured_x=2,command_phi=3")
    log = read_any(written(tmp_path, text[not header :]), told)
    assert log.axes["x"].time == pytest.approx(T[1:] - T[1])
    assert log.axes["x"].ball == pytest.approx(X[1:], abs=1e-6)
    assert "the first row left out: not the usual 3 cells" in " ".join(log.notes)


def test_a_last_row_and_single_ones_that_are_cut_are_left_out_and_said(tmp_path):
    text = rows()
    text[50] = text[50] + text[51]
    text[-1] = text[-1].rpartition(",")[0]
    log = read_any(written(tmp_path, text), COLUMNS)
    assert len(log.axes["x"].ball) == len(T) - 2
    assert "2 rows left out: not the usual" in " ".join(log.notes)


def test_rows_that_end_where_nothing_is_seen_are_no_damage(tmp_path):
    text = ["t,u,x"] + [
        f"{t:.3f},{u:.5f}" + (f",{x:.6f}" if k % 10 else "")
        for k, (t, x, u) in enumerate(zip(T, X, U, strict=True))
    ]
    log = read_any(written(tmp_path, text), COLUMNS)
    assert len(log.axes["x"].ball) == len(T) * 9 // 10
    assert len(log.axes["x"].time) == len(T) - 1  # the first ends there as well


@pytest.mark.parametrize(
    ("lines", "says"),
    [
        ([], "is empty"),
        (["", "  ", "# a remark"], "is empty"),
        (rows()[:1], "contains hardly any numbers"),
        (rows()[:2], "1 usable row,"),
        (["t,x,x", *rows()[1:]], "two columns are called x"),
        (["t,x", *rows()[1:]], "its header names 2 columns, its rows have 3"),
        (["x,u", *rows()[1:]], "its header names 2 columns, its rows have 3"),
        (["t s x m u", *rows(" ")[1:]], "its header names 5 columns, its rows have 3"),
    ],
)
def test_a_text_that_is_no_log_is_refused_in_one_line(tmp_path, lines, says):
    with pytest.raises(LogError, match=says) as caught:
        read_any(written(tmp_path, lines), COLUMNS)
    assert "\n" not in str(caught.value)


def test_a_title_above_the_numbers_is_no_header(tmp_path):
    file = written(tmp_path, ["Measured on Monday", *rows()[1:]])
    by_number = wanted_columns("time=1,measured_x=2,command_phi=3")
    assert read_any(file, by_number).axes["x"].ball == pytest.approx(X, abs=1e-6)


def test_rows_of_one_time_that_complete_each_other_are_one_row(tmp_path):
    text = ["t,x,u"]
    for t, x, u in zip(T, X, U, strict=True):
        text += [f"{t:.3f},{x:.6f},", f"{t:.3f},,{u:.6f}", f"{t:.3f},9,9"]
    log = read_any(written(tmp_path, text), COLUMNS)
    assert log.axes["x"].ball == pytest.approx(X, abs=1e-6)
    assert log.axes["x"].tilt == pytest.approx(U, abs=1e-6)
    assert f"{len(T)} rows joined with the one before, of the same time" in log.notes[0]
    assert f"{len(T)} rows of a time that does not rise left out" in log.notes[1]


def test_cells_in_quotes_keep_their_commas(tmp_path):
    text = [",".join(f'"{cell}"' for cell in row.split(";")) for row in rows(";", ",")]
    assert read_any(written(tmp_path, text), COLUMNS).axes["x"].ball == pytest.approx(X, abs=1e-6)


def test_a_separator_at_the_end_of_every_row_is_no_column(tmp_path):
    text = rows()
    log = read_any(written(tmp_path, [text[0], *(f"{row}," for row in text[1:])]), COLUMNS)
    assert log.axes["x"].ball == pytest.approx(X, abs=1e-6)
    assert not log.notes


NAMED = "time,measured_x,measured_y,measured_phi,measured_theta"


def of_names(tmp_path, change):
    lines = [NAMED, *(f"{t:.3f},{x:.5f},0,{u:.5f},0" for t, x, u in zip(T, X, U, strict=True))]
    return written(tmp_path, change(lines))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda lines: [lines[0], without_front(lines[1]), *lines[2:]], "line 2: has 4 cells"),
        (lambda lines: [without_front(lines[0]), *lines[1:]], "no column time"),
        (lambda lines: [lines[0], f"{lines[1]},7", *lines[2:]], "line 2: has 6 cells"),
        (lambda lines: [lines[0].replace("measured_y", "time"), *lines[1:]], "time: two columns"),
    ],
)
def test_a_log_of_known_names_is_not_read_a_column_off(tmp_path, change, says):
    with pytest.raises(LogError, match=says) as caught:
        read_log(of_names(tmp_path, change))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-16", "utf-8-sig"])
def test_a_log_of_known_names_may_be_of_any_encoding(tmp_path, encoding):
    file = of_names(tmp_path, lambda lines: [f"{lines[0]},Größe", *(f"{x},1" for x in lines[1:])])
    file.write_bytes(file.read_text("utf-8").encode(encoding))
    assert read_log(file)["measured_x"] == pytest.approx(X, abs=1e-5)


def test_a_last_row_that_is_cut_ends_a_log_of_known_names(tmp_path):
    found = read_log(of_names(tmp_path, lambda lines: [*lines[:-1], lines[-1][:8]]))
    assert len(found["time"]) == len(T) - 1


def test_a_comparison_takes_them_for_logs(tmp_path):
    pq.write_table(pa.table({"t": T, "x": X, "u": U}), tmp_path / "a.parquet")
    savemat(tmp_path / "a.mat", {"t": T, "x": X, "u": U})
    given = ["circle", str(tmp_path / "a.parquet"), str(tmp_path / "a.mat")]
    with_columns = sorted_out(given, of_any_rig=True)
    assert with_columns == (("circle",), (), (tmp_path / "a.parquet", tmp_path / "a.mat"))
    assert sorted_out(given) == (("circle",), (tmp_path / "a.parquet",), (tmp_path / "a.mat",))
    with pytest.raises(LogError, match=r"a\.mat: no column time, .*--columns"):
        ballplate.compare("circle", tmp_path / "a.mat")


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be", "utf-32"])
def test_wide_letters_without_a_mark_are_text(tmp_path, encoding):
    lines = ["t,x,u", *(f"{t:.3f},{x:.6f},{u:.6f}" for t, x, u in zip(T, X, U, strict=True))]
    (tmp_path / "a.csv").write_bytes("\n".join(lines).encode(encoding))
    assert len(read_any(tmp_path / "a.csv", COLUMNS).axes["x"].ball) == len(T)


def plain(tmp_path):
    lines = ["t,x,u", *(f"{t:.3f},{x:.6f},{u:.6f}" for t, x, u in zip(T, X, U, strict=True))]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    return tmp_path / "a.csv"


@pytest.mark.parametrize("separator", ["", '"', "\n", ";\r"])
def test_what_separates_no_columns_is_one_line(tmp_path, separator):
    with pytest.raises(LogError, match=r"--separator .*: separates no columns; give a sign"):
        read_any(plain(tmp_path), COLUMNS, separator)


def test_a_column_s_number_in_raised_figures_is_none(tmp_path):
    wanted = wanted_columns("time=\N{SUPERSCRIPT TWO},measured_x=x,command_phi=u")
    with pytest.raises(LogError, match="time: no column"):
        read_any(plain(tmp_path), wanted)


@pytest.mark.parametrize("unit", ["0mm", "1e400mm", "1e-400"])
def test_a_unit_that_makes_nothing_of_a_number_is_none(unit):
    with pytest.raises(LogError, match=f"measured_x: unit '{unit}'"):
        wanted_columns(f"time=t,measured_x=x:{unit},command_phi=u")


@pytest.mark.parametrize(
    ("column", "numbers"),
    [
        ("x:mm@60", 1e3 * X + 60),
        ("-x:mm@60", 60 - 1e3 * X),
        ("x:0.5mm@-20", 2e3 * X - 20),
        ("x [mm]:@60", 1e3 * X + 60),
        ("x:mm", 1e3 * X),
    ],
)
def test_a_number_after_the_unit_is_that_of_the_column_at_zero(tmp_path, column, numbers):
    """Positions of a sensor elsewhere, turned or in pixels, are those of one in the middle."""
    file = tmp_path / "a.csv"
    rows = "".join(f"{t},{x},{u}\n" for t, x, u in zip(T, numbers, U, strict=True))
    file.write_text(f"t,x [mm],u\n{rows}")
    axis = read_any(file, wanted_columns(f"time=t,measured_x={column},command_phi=u")).axes["x"]
    assert axis.ball == pytest.approx(X, abs=1e-9)


@pytest.mark.parametrize("zero", ["", "mm", "nan", "1e400"])
def test_what_is_no_number_at_zero_is_refused(zero):
    with pytest.raises(
        LogError, match=f"measured_x: @{zero}: give the column's number at zero, as"
    ):
        wanted_columns(f"time=t,measured_x=x:mm@{zero},command_phi=u")


def test_an_age_has_no_zero_to_choose():
    with pytest.raises(LogError, match="age: @5: only positions, tilts and time have a zero"):
        wanted_columns("time=t,measured_x=x,command_phi=u,age=a:ms@5")
