"""Logs of simulated rigs, as they would be read from a file."""

from __future__ import annotations

from collections.abc import Sequence

from twin.identify.logs import Log, of_columns
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.schema import Scenario


def logs(pairs: Sequence[tuple[Scenario, Scenario]]) -> list[Log]:
    """Logs of rigs that run side by side, each with what is believed of it.

    Args:
        pairs: Belief and truth of each.
    """
    truths = [truth for _, truth in pairs]
    duration, period = truths[0].duration, truths[0].rig.period
    keep = ("measured", "age", "touched", "applied")
    record = Recorder(round(duration / period), len(pairs), period, keep=keep)
    drive(*assemble(truths, threads=1), duration, record)
    columns = {name: values.reshape(len(pairs), -1) for name, _, values in record.columns()}
    return [
        of_columns(
            {"time": record.time.copy(), **{name: v[number] for name, v in columns.items()}},
            {"scenario": belief.model_dump(mode="json")},
            f"rig {number}",
        )
        for number, (belief, _) in enumerate(pairs)
    ]
