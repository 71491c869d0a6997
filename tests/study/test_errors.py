"""`twin.study.experiments`.

What a user gets wrong about a study: one clear line, and nothing lost."""

from __future__ import annotations

import errno
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from command_line import called

from twin.study import experiments as store

STUDY = """
title = "short"
scenario = "hold"
set = ["plant.kind=lagrange", "duration=0.1"]
method = "grid"
metrics = ["rms_error"]

[parameters."plant.friction.rolling_mm"]
values = [0.1, 0.2]
"""
KEY, VALUES = "plant.friction.rolling_mm", "values = [0.1, 0.2]"


@pytest.fixture
def study(capsys, tmp_path: Path, monkeypatch):
    """Runs the command on the study with one piece of text changed: exit code, output, error."""
    monkeypatch.chdir(tmp_path)

    def call(old: str = "", new: str = "", *arguments: str) -> tuple[int, str, str]:
        (tmp_path / "short.toml").write_text(STUDY.replace(old, new) if old else STUDY)
        return called(capsys, "study", "short.toml", "--processes", "1", *arguments)

    return call


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        (KEY, "plant.friction.roling_mm", "study short.toml: hold.toml: plant.friction.roling_mm"),
        (KEY, "plant.level_deg.7", "plant.level_deg.7: no such number (0 to 1)"),
        (KEY, "duration.0", "duration.0: no such number (it is no list)"),
        (VALUES, "values = []", "values: must not be empty"),
        (VALUES, "uniform = [0.2, 0.2]", "empty range: 0.2 is not below 0.2"),
        (VALUES, "uniform = [0.3, 0.2]", "empty range"),
        (VALUES, "uniform = [-1.0, 0.2]", "rolling_mm: must be greater than or equal to 0, got -1"),
        (VALUES, "loguniform = [0.0, 0.2]", "loguniform: must begin above 0"),
        (VALUES, "normal = [0.1, 0.0, 0.05, 0.2]", "the standard deviation must be above 0"),
        (VALUES, 'values = ["rough"]', 'rolling_mm: must be a number, got "rough"'),
        (VALUES, 'values = [0.1, "0.2"]', "values: must be all numbers or all texts"),
        (VALUES, "values = [0.1]\nrelativ = true", "relativ"),
        (VALUES, "values = [1e400]", "rolling_mm"),
        ('["rms_error"]', '["rms_eror"]', "no 'rms_eror'; did you mean 'rms_error'?"),
        ('"grid"', '"gird"', "method"),
        (
            'method = "grid"\n',
            "",
            "short.toml: method: missing; give 'grid', 'lhs', 'montecarlo' or 'sobol'",
        ),
        ("title = ", "samples = 8 #", "title: missing; it has no default"),
        (
            '"grid"',
            '"grid"\nfamily = "uncertian"',
            "family 'uncertian': not found; did you",
        ),
        ('"grid"', '"grid"\nfamily = 3', "family: must be a text, got 3"),
        (f'[parameters."{KEY}"]\n{VALUES}', "", "parameters: name at least one"),
        ('"hold"', '"holt"', "scenario 'holt': not found; did you mean 'hold'"),
        ('"grid"', '"sobol"', "sobol needs a distribution"),
        ("duration=0.1", "duration", "override 'duration': write key=value"),
        ("title", "titel", "titel"),
        ('"grid"', '"sobol"\nsamples = 12', "sobol needs a power of 2, such as 8 or 16, got 12"),
        (
            VALUES,
            VALUES + '\n[[variants]]\nname = "a"\n[[variants]]\nname = "a"',
            "variants: two of them are called 'a'",
        ),
        (
            VALUES,
            VALUES + '\n[[variants]]\nname = "a"\nscenario = "cuer"',
            "scenario 'cuer': not found; did you mean 'cure'",
        ),
        ('title = "short"', "title = ", "not a TOML file"),
        (
            f'"{KEY}"]',
            '"plant.spring.preload"]\nrelative = true',
            "plant.spring.preload: relative needs a number",
        ),
    ],
)
def test_a_mistake_in_a_study_is_one_line_that_says_where_and_what_is_allowed(
    study, tmp_path, old, new, expected
) -> None:
    code, out, err = study(old, new)
    assert code == 2
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert expected in err
    assert not (tmp_path / "runs").exists()


def test_samples_given_by_option_are_checked_like_those_of_the_file(study) -> None:
    code, _, err = study('"grid"', '"sobol"\nsamples = 16', "--samples", "100")
    assert code == 2
    assert "short.toml: samples: sobol needs a power of 2, such as 64 or 128, got 100" in err


def test_a_folder_of_another_version_is_refused_and_left_as_it_is(study, tmp_path) -> None:
    folder = tmp_path / "runs" / "study-short" / "chunks"
    folder.mkdir(parents=True)
    old = folder / "old.parquet"
    pq.write_table(pa.table({"key": ["a"], "speed": [1.0]}), old)
    before = old.read_bytes()
    code, _, err = study()
    assert code == 2
    assert "another version" in err
    assert old.read_bytes() == before


@pytest.mark.long
def test_a_full_disk_is_one_line_and_leaves_what_is_finished(study, tmp_path, monkeypatch) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    assert study()[0] == 0
    folder = tmp_path / "runs" / "study-short" / "chunks"
    before = {path.name: path.read_bytes() for path in folder.iterdir()}
    with monkeypatch.context() as patched:
        patched.setattr(store.pq, "write_table", full)
        code, _, err = study(VALUES, "values = [0.1, 0.2, 0.3]")
    assert code == 2
    assert "No space left on device" in err
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
    assert study(VALUES, "values = [0.1, 0.2, 0.3]")[0] == 0


@pytest.mark.long
def test_a_scheduler_where_nobody_listens_is_one_line(study) -> None:
    code, _, err = study("", "", "--scheduler", "tcp://127.0.0.1:9")
    assert code == 2
    assert "no scheduler answers there" in err


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("key", [1, 2]),
        ("rms_error", ["a", "b"]),
        ("outcome", [b"a", b"b"]),
        ("outcome", pa.nulls(2, pa.string())),
        ("key", pa.nulls(2, pa.string())),
        ("", None),
    ],
)
def test_a_damaged_chunk_is_one_line_that_names_it(study, tmp_path, name, values) -> None:
    assert study()[0] == 0
    (chunk,) = (tmp_path / "runs" / "study-short" / "chunks").glob("*.parquet")
    if name:
        table = pq.read_table(chunk)
        place = table.schema.get_field_index(name)
        pq.write_table(table.set_column(place, name, pa.array(values)), chunk)
    else:
        chunk.write_bytes(chunk.read_bytes()[:50])
    code, _, err = study()
    assert code == 2
    assert len(err.strip().splitlines()) == 1
    assert chunk.name in err
    assert "delete it" in err
