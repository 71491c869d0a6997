import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner
from scipy.io import loadmat

from twin.cli import main
from twin.cli.look import export as command
from twin.identify.log import read
from twin.run.finished import run, save
from twin.run.record import read_run
from twin.scenario import load


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A short run with noise, dead time and friction."""
    where = tmp_path_factory.mktemp("run")
    done = run(load("circle", ("plant.kind=lagrange", "duration=0.3", "metrics.start=0")))
    save(done, where, {"circle": done.motion})
    return where


def exported(folder, file, *options):
    result = CliRunner().invoke(command, [str(folder), str(file), *options], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return file


@pytest.fixture(scope="module")
def recorded(folder):
    return read_run(folder / "run.parquet")


def test_identify_reads_the_csv_as_it_reads_the_record(folder, tmp_path):
    ours = read(folder)
    foreign = read(exported(folder, tmp_path / "log.csv"))
    for name in ("time", "ball", "plate", "age", "touched", "command"):
        np.testing.assert_array_equal(getattr(foreign, name), getattr(ours, name))


def test_the_csv_says_its_units_and_loses_no_digit(folder, recorded, tmp_path):
    columns, units, _ = recorded
    file = exported(folder, tmp_path / "log.csv")
    header, *rows = file.read_text(encoding="utf-8").splitlines()
    assert header.split(",") == [f"{name} [{units[name]}]" for name in columns]
    table = np.array([[float(cell) for cell in row.split(",")] for row in rows])
    np.testing.assert_array_equal(table, np.stack(list(columns.values()), axis=1))


def test_the_mat_file_has_every_column_and_unit(folder, recorded, tmp_path):
    columns, units, _ = recorded
    found = loadmat(exported(folder, tmp_path / "log.mat"), simplify_cells=True)
    for name, values in columns.items():
        np.testing.assert_array_equal(found[name], values)
        assert found["units"][name] == units[name]


def test_the_parquet_file_has_units_and_no_scenario(folder, recorded, tmp_path):
    columns, units, _ = recorded
    table = pq.read_table(exported(folder, tmp_path / "log.parquet"))
    assert table.schema.metadata is None
    for name, values in columns.items():
        np.testing.assert_array_equal(table[name].to_numpy(), values)
        assert table.schema.field(name).metadata[b"unit"].decode() == units[name]


def test_some_columns_of_every_tenth_row(folder, recorded, tmp_path):
    options = ("--columns", "true_y, true_x", "--every", "10")
    header, *rows = exported(folder, tmp_path / "log.csv", *options).read_text().splitlines()
    assert header == "time [s],true_y [m],true_x [m]"
    assert len(rows) == 15
    assert float(rows[2].split(",")[0]) == recorded[0]["time"][20]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        (["log.xlsx"], "log.xlsx: the ending says what is written; known: .csv, .mat, .parquet"),
        (["log.csv", "--columns", "true_z"], "--columns: no column 'true_z'; did you mean 'true_"),
    ],
)
def test_wrong_requests_are_one_line_and_write_nothing(
    folder, tmp_path, monkeypatch, capsys, options, expected
):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as end:
        main(["export", str(folder), *options])
    assert end.value.code == 2
    text = capsys.readouterr().err
    assert expected in text
    assert text.count("\n") == 1
    assert not list(tmp_path.iterdir())
