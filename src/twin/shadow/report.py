"""What is written of a shadow: the page, the scores as Parquet, and the verdict in words."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from twin.html import inline, render
from twin.identify.replay import STEP
from twin.shadow import dead_time
from twin.shadow.alarms import THRESHOLD
from twin.shadow.causes import likely
from twin.shadow.figures import picture
from twin.shadow.follow import Shadow
from twin.shadow.horizon import DRAWN
from twin.shadow.proposal import Proposal
from twin.writing import write_json, write_whole


def sentences(found: Shadow, proposal: Proposal | None) -> list[str]:
    """The verdict in words."""
    told, length = found.told, found.length
    words = []
    if found.verdict == "healthy":
        words.append(
            f"Healthy as far as the log tells: in the {told:.0f} of {length:.0f} s in which the "
            "ball moved, nothing but the twin is needed to explain it."
        )
    elif found.verdict == "cannot tell":
        words.append(
            f"Cannot tell: the ball moved for {told:.0f} of {length:.0f} s, and a ball at rest "
            "shows neither friction nor level nor dead time. That is no sign of health."
        )
    words += [f"Reality has left the model. Alarm at {alarm.words}." for alarm in found.alarms]
    score, inside, error = found.score_median, found.inside_band, found.error_1s
    if found.replays is not None and score is not None:
        words.append(
            f"A replay of {found.replays.ahead:g} s strays {score:.2f} times as far as the twin "
            f"predicts of itself (median), and {inside:.0f} % of them end in their 95 % band."
        )
    if error is not None:
        words.append(f"After 1 s a replay is {1000 * error:.2f} mm off (median).")
    if len(found.gaps):
        missing = float(np.diff(found.gaps, axis=1).sum())
        words.append(
            f"{len(found.gaps)} gaps of {missing:.2f} s in all are in the log; they are shown grey."
        )
    if proposal is not None:
        words.append(f"{'Proposal: ' if proposal.text else ''}{proposal.why}.")
    return words


def page(found: Shadow, proposal: Proposal | None) -> str:
    """The report as one HTML file."""
    alarms = [
        {
            "time": f"{alarm.time:.1f}",
            "since": f"{alarm.since:.1f}",
            "causes": [
                (cause.name, f"{100 * cause.probability:.1f}", cause.change)
                for cause in likely(alarm.causes)
            ],
        }
        for alarm in found.alarms
    ]
    changed = [] if proposal is None else [(k, a, b) for k, (a, b) in proposal.changed.items()]
    return render(
        "shadow/report.html.j2",
        title=f"The twin beside {found.source}",
        good=found.verdict == "healthy",
        sentences=sentences(found, proposal),
        figure=inline(picture(found)),
        alarms=alarms,
        changed=changed,
        threshold=f"{THRESHOLD:g}",
        late_threshold=f"{dead_time.THRESHOLD:g}",
        notes=found.notes,
    )


def numbers(found: Shadow, proposal: Proposal | None, file: Path | None) -> dict[str, Any]:
    """All of it for ``--json``."""
    proposed = None if proposal is None else proposal.as_dict(file)
    return {**found.as_dict(), "proposal": proposed}


def write(found: Shadow, proposal: Proposal | None, file: Path | None, folder: Path) -> None:
    """Write shadow.html, shadow.json and, if there are replays, shadow.parquet.

    Raises:
        RecordError: If a file cannot be written.
    """
    text = page(found, proposal)
    write_whole(folder / "shadow.html", lambda path: path.write_text(text, encoding="utf-8"))
    write_json(folder / "shadow.json", numbers(found, proposal, file))
    if found.replays is not None:
        write_whole(folder / "shadow.parquet", lambda path: _scores(found, path))


def _scores(found: Shadow, path: Path) -> None:
    """One row a replay: when, error, spread, score, the test's statistic, the twin's way."""
    import pyarrow as pa  # noqa: PLC0415  heavy: loaded when needed
    import pyarrow.parquet as pq  # noqa: PLC0415  heavy: loaded when needed

    run = found.replays
    assert run is not None
    end = run.time + run.ahead
    before = np.searchsorted(found.time, end, side="right") - 1
    values = {
        "time": ("s", end),
        "error_x": ("m", run.error[:, 0]),
        "error_y": ("m", run.error[:, 1]),
        "spread_x": ("m", np.sqrt(run.spread[:, 0, 0])),
        "spread_y": ("m", np.sqrt(run.spread[:, 1, 1])),
        "score": ("1", run.score),
        "distance": ("m", run.distance),
        "band": ("m", run.band),
        "told": ("1", run.counted.astype(float)),
        "log_likelihood_ratio": ("1", np.where(before >= 0, found.ratio[before], 0.0)),
        "dead_time_ratio": ("1", np.where(before >= 0, found.delayed[before], 0.0)),
    }
    fields = [pa.field(name, pa.float64(), metadata={"unit": u}) for name, (u, _) in values.items()]
    paths = {name: run.path[..., axis].tolist() for axis, name in enumerate(("twin_x", "twin_y"))}
    listed = pa.list_(pa.float64())
    fields += [pa.field(name, listed, metadata={"unit": "m"}) for name in paths]
    about = {"horizon": run.ahead, "threshold": THRESHOLD, "log": found.source}
    content = json.dumps({**about, "step": DRAWN * STEP, "record": found.record})
    schema = pa.schema(fields, metadata={"ballplate": content})
    columns = [pa.array(column) for _, column in values.values()]
    columns += [pa.array(path, listed) for path in paths.values()]
    pq.write_table(pa.Table.from_arrays(columns, schema=schema), path)
