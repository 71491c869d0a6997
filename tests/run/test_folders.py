import os
from pathlib import Path

import pytest

from twin.errors import RecordError
from twin.run.folders import former, free, last, run_folder


def kept(folder, when):
    folder.mkdir(parents=True)
    file = folder / "run.parquet"
    file.touch()
    os.utime(file, (when, when))
    return folder


@pytest.mark.parametrize(
    ("name", "overrides", "folder"),
    [
        ("circle", (), "circle"),
        ("mine/own.toml", ("duration=10",), "own-duration=10"),
        ("circle", ("plant.friction.rolling_mm=0",), "circle-friction.rolling_mm=0"),
        ("step", ("controller.kind=lqr", "plant.kind=exact"), "step-controller=lqr-plant=exact"),
        ("circle", ("controller.ball=[3, 3]",), "circle-controller.ball=3,3"),
        ("circle", ("duration=10", "duration=20"), "circle-duration=20"),
    ],
)
def test_a_folder_is_named_by_what_differs(name, overrides, folder):
    assert run_folder(name, overrides) == Path("runs") / folder


def test_names_that_had_to_be_changed_stay_apart():
    long = [run_folder("circle", [f"title={'x' * 200}{end}"]) for end in "ab"]
    strange = [run_folder("circle", [f"parameters={end}/fit.toml"]) for end in "ab"]
    assert len(set(long)) == len(set(strange)) == 2
    assert all(len(path.name) <= 100 and "/" not in path.name for path in (*long, *strange))


def test_the_last_run_is_the_newest_also_within_a_comparison(tmp_path):
    with pytest.raises(RecordError, match="no run in"):
        last(tmp_path / "none")
    kept(tmp_path / "old", 100)
    kept(tmp_path / "compare" / "a", 300)
    kept(tmp_path / "newer", 200)
    (tmp_path / "study").mkdir()
    assert last(tmp_path) == tmp_path / "compare"


def test_what_a_run_replaces_is_said_and_a_rig_replaces_nothing(tmp_path):
    folder = tmp_path / "circle"
    assert former(folder) == ""
    assert free(folder) == folder
    kept(folder, 100)
    assert "replaced the run of" in former(folder)
    assert free(folder) == tmp_path / "circle~2"
