"""`twin.base.shipped`: a wrong path is answered with what lies next to it."""

from pathlib import Path

import pytest

from twin.base.errors import RecordError, ScenarioError
from twin.base.shipped import find, nearest_neighbour
from twin.run.record import read_run


@pytest.mark.parametrize(
    ("path", "near"),
    [
        ("runs/cure", "runs/cure-baseline=false"),  # its beginning
        ("runs/circel", "runs/circle"),
        ("runs/hold-rig=emulated", "runs/hold-duration=8-rig=emulated"),  # all of its changes
        ("runs/excite", None),  # half of its letters are those of circle
        ("runs/ci", None),  # the beginning of much
        ("runs/.hid", None),
        ("nowhere/cure", None),
        ("cure", None),
    ],
)
def test_a_path_that_is_not_there_gets_the_nearest_of_its_folder(path, near, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("cure-baseline=false", "circle", ".hidden", "hold-duration=8-rig=emulated"):
        (tmp_path / "runs" / name).mkdir(parents=True)
    hint = f"; did you mean '{near}'?" if near else ""
    assert nearest_neighbour(Path(path)) == hint
    if near:
        with pytest.raises(ScenarioError, match="not found" + hint.replace("?", r"\?")):
            find(path)
        with pytest.raises(RecordError, match="no such run folder" + hint.replace("?", r"\?")):
            read_run(Path(path))
