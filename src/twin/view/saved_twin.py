"""What the twin said of a run, read from the files that `ballplate shadow` left in its folder."""

from __future__ import annotations

import json
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from twin.errors import RecordError
from twin.run.finished import Run
from twin.view.fingerprint import fingerprint
from twin.view.twin_stream import Scores

COLUMNS = ("time", "told", "score", "distance", "band", "twin_x", "twin_y")


class Saved(NamedTuple):
    """Scores as they are drawn, and time in s and text of every alarm."""

    scores: Scores
    events: list[tuple[float, str]]


def saved_twin(run: Run) -> Saved | None:
    """What was said of this very record; None if nothing was, or only of another one before it.

    Raises:
        RecordError: If a file is damaged.
    """
    folder = run.folder
    if folder is None or not (folder / "shadow.parquet").is_file():
        return None
    try:
        table = pq.read_table(folder / "shadow.parquet")
        about = json.loads(table.schema.metadata[b"ballplate"])
        measured = run.rows["measured_x"], run.rows["measured_y"]
        if about.get("record") != fingerprint(*measured):
            return None
        scores = _scores({name: table[name].to_pylist() for name in COLUMNS}, about)
        alarms = json.loads((folder / "shadow.json").read_text(encoding="utf-8"))["alarms"]
        events = [(float(each["time"]), f"alarm at {each['words']}") for each in alarms]
    except (OSError, pa.ArrowException, KeyError, TypeError, ValueError) as error:
        raise RecordError(
            f"{folder}/shadow.parquet: not what `ballplate shadow` writes ({error}); run it again"
        ) from error
    return Saved(scores, events)


def _scores(columns: dict[str, list[Any]], about: dict[str, Any]) -> Scores:
    told = np.array(columns["told"]) > 0
    end, score, distance, band = (
        np.array(columns[name], dtype=float) for name in ("time", "score", "distance", "band")
    )
    path = np.stack([np.array(columns[name], dtype=float) for name in ("twin_x", "twin_y")], -1)
    begin, steps = end - float(about["horizon"]), float(about["step"]) * np.arange(path.shape[1])
    return Scores(
        end[told],
        score[told],
        1000 * distance[told],
        1000 * band[told],
        (begin[:, None] + steps).ravel(),
        path.reshape(-1, 2),
    )
