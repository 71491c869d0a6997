"""The twin in the viewer of a run: its ball in the run's scene, score, band and alarms."""

from __future__ import annotations

import numpy as np

from twin.identify.replay import STEP
from twin.scenario.schema import Scenario
from twin.shadow.horizon import DRAWN, Replays
from twin.shadow.shown import Shown, Tell
from twin.view.recording import add_twin, begin_twin, new_stream
from twin.view.twin_stream import Scores, TwinStream


def scores(run: Replays) -> Scores:
    """Replays as the view draws them."""
    told = run.take(run.counted)
    begin, steps = run.time[:, None], DRAWN * STEP * np.arange(run.path.shape[1])
    return Scores(
        told.time + told.ahead,
        told.score,
        1000 * told.distance,
        1000 * told.band,
        (begin + steps).ravel(),
        run.path.reshape(-1, 2),
    )


def drawing(scenario: Scenario, shown: Shown) -> Tell:
    """What draws the twin of a run, told what is new."""
    twin = TwinStream(shown.name, scenario)
    stream = new_stream(shown.name, shown.recording)
    stream.connect_grpc(shown.url)
    begin_twin(stream, twin)

    def tell(replays: Replays | None, events: list[tuple[float, str]]) -> None:
        found = None if replays is None or not len(replays.time) else scores(replays)
        add_twin(stream, twin, found, events)
        stream.flush()

    return tell
