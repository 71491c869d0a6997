"""The twin of a run, live or saved, as entities of that run: a ghost, score, band and alarms."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import rerun as rr

from controllers.arrays import Array
from twin.errors import RecordError
from twin.run.finished import Run
from twin.scenario.schema import Scenario
from twin.settings import changed
from twin.sim.plant.model import load_model
from twin.sim.plant.parts import Parts
from twin.view.scene import Scene, in_view
from twin.view.signals import BLACK, GREY, PINK, VERMILION, WORDS
from twin.view.streams import Batch


def fingerprint(x: Array, y: Array) -> int:
    """Tells one record from another, by the measured ball, shape (K,) each."""
    return crc32(np.ascontiguousarray(np.stack((x, y)), dtype=float).tobytes())


GHOST = (204, 121, 167, 150)
"""Colour of the twin's ball, half transparent."""
TWIN_WORDS = {
    "twin_score": f"replay error over predicted spread {WORDS[VERMILION]}, "
    f"1 as predicted {WORDS[BLACK]}",
    "twin_error_mm": f"distance of the ball from its twin {WORDS[GREY]}, 95 % band {WORDS[PINK]}",
}
"""Group of the plots of the twin, and which line has which colour."""

TWIN_RANGES = {"twin_score": (-0.4, 12.0), "twin_error_mm": (-0.4, 12.0)}
"""What their axes show: where a ball may or may not stop, its band is as wide as the plate."""


class Scores(NamedTuple):
    """What is drawn of replays.

    Attributes:
        time: When each ended, s, shape (W,).
        score: Error over predicted spread, shape (W,).
        distance: Error in mm, shape (W,).
        band: How far the 95 % band reaches in its direction, mm, shape (W,).
        ball_time: When the twin's ball was where, s, shape (K,).
        ball: There, m, shape (K, 2).
    """

    time: Array
    score: Array
    distance: Array
    band: Array
    ball_time: Array
    ball: Array


class TwinStream:
    """The twin of one run, drawn among the run's entities.

    Args:
        name: The run's name, the root of its entities.
        scenario: What is run.
    """

    def __init__(self, name: str, scenario: Scenario) -> None:
        self.root = f"/{rr.escape_entity_path_part(name)}"
        model = load_model(parts=changed(Parts, scenario))
        self._scene = Scene(model, f"{self.root}/mechanism")
        self._ball = f"{self._scene.plate}/twin_ball"

    def fixed(self) -> Iterator[tuple[str, rr.AsComponents]]:
        """What does not change: the ghost's shape, and the looks of the lines."""
        radius = self._scene.radius
        solid = rr.components.FillMode.Solid
        yield (
            f"{self._ball}/ball",
            rr.Ellipsoids3D(half_sizes=[3 * [radius]], colors=[GHOST], fill_mode=solid),
        )
        yield (
            f"{self.root}/plate_mm/twin",
            rr.Points2D.from_fields(colors=[GHOST], radii=[9.0]),
        )
        for entity, colour, called in (
            ("twin_score/score", VERMILION, "score"),
            ("twin_error_mm/distance", GREY, "distance"),
        ):
            yield (
                f"{self.root}/{entity}",
                rr.SeriesPoints(
                    colors=[colour], marker_sizes=[4.0], names=[called], markers=["circle"]
                ),
            )
        for entity, colour, called in (
            ("twin_score/as_predicted", BLACK, "as predicted"),
            ("twin_error_mm/band", PINK, "95 % band"),
        ):
            yield (
                f"{self.root}/{entity}",
                rr.SeriesLines(colors=[colour], widths=[1.2], names=[called]),
            )

    def batches(
        self, scores: Scores | None, events: Sequence[tuple[float, str]]
    ) -> Iterator[Batch]:
        """What is new, as columns for the viewer.

        Args:
            scores: Of replays.
            events: Time in s and text of what happened.
        """
        if scores is not None and len(scores.time):
            for entity, values in (
                ("twin_score/score", scores.score),
                ("twin_score/as_predicted", np.ones(len(scores.time))),
                ("twin_error_mm/distance", scores.distance),
                ("twin_error_mm/band", scores.band),
            ):
                yield Batch(
                    f"{self.root}/{entity}", scores.time, rr.Scalars.columns(scalars=values)
                )
        if scores is not None and len(scores.ball_time):
            high = np.full(len(scores.ball), self._scene.surface + self._scene.radius)
            place = np.column_stack((scores.ball, high))
            yield Batch(self._ball, scores.ball_time, rr.Transform3D.columns(translation=place))
            yield Batch(
                f"{self.root}/plate_mm/twin",
                scores.ball_time,
                rr.Points2D.columns(positions=in_view(scores.ball)),
            )
        if events:
            yield Batch(
                f"{self.root}/events",
                np.array([when for when, _ in events]),
                rr.TextLog.columns(text=[text for _, text in events], level=["WARN"] * len(events)),
            )


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
