"""The twin of a run as entities of that run: a ghost of its ball, score, band and alarms."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
import rerun as rr

from controllers.arrays import Array
from twin.scenario.schema import Scenario
from twin.settings import changed
from twin.sim.plant.model import load_model
from twin.sim.plant.parts import Parts
from twin.view.scene import Scene
from twin.view.signals import BLACK, GREY, PINK, VERMILION, WORDS
from twin.view.streams import Batch
from twin.view.top_view import in_view

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
