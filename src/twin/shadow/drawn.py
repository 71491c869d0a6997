"""The twin in the viewer of a run: its ball in the run's scene, score, band and alarms."""

from __future__ import annotations

import numpy as np

from twin.identify.replay import STEP
from twin.scenario.schema import Scenario
from twin.shadow.horizon import BAND, DRAWN, Replays
from twin.shadow.live import Shown, Tell
from twin.view.recording import new_stream, send
from twin.view.twin_stream import Scores, TwinStream


def scores(run: Replays) -> Scores:
    """Replays as the view draws them."""
    told = run.take(run.counted)
    distance = np.hypot(told.error[:, 0], told.error[:, 1])
    # as far as the 95 % ellipse reaches in the direction of the error
    band = distance * np.sqrt(BAND / np.maximum(told.square, 1e-12))
    begin, steps = run.time[:, None], DRAWN * STEP * np.arange(run.path.shape[1])
    return Scores(
        told.time + told.ahead,
        told.score,
        1000 * distance,
        1000 * band,
        (begin + steps).ravel(),
        run.path.reshape(-1, 2),
    )


def drawing(scenario: Scenario, shown: Shown) -> Tell:
    """What draws the twin of a run, told what is new."""
    twin = TwinStream(shown.name, scenario)
    stream = new_stream(shown.name, shown.recording)
    stream.connect_grpc(shown.url)
    for entity, shape in twin.fixed():
        stream.log(entity, shape, static=True)

    def tell(replays: Replays | None, events: list[tuple[float, str]]) -> None:
        found = None if replays is None or not len(replays.time) else scores(replays)
        for batch in twin.batches(found, events):
            send(stream, batch)
        stream.flush()

    return tell
