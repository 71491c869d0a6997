"""The twin of a rig from a log of it while it was well, by which other logs are judged."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.identify.any_rig import AxisIdentification, identify_axes
from twin.identify.logs import GRAVITY_SHARES, ball_factor, read, read_any, wanted_columns
from twin.identify.parameters import DEFAULT_PARAMETERS, FITTED_SHARE
from twin.identify.report import write
from twin.identify.twin_model import identify_twin
from twin.identify.verdicts import IDENTIFIED_VERDICT, Identification
from twin.scenario.load import load

MAX_GAIN_ERROR = 0.05
"""Share by which the gain of a rig may differ from that of its ball. The gains of hollow and solid
balls differ by 19 %."""


@dataclass(frozen=True)
class Reference:
    """The twin that a reference log gives.

    Attributes:
        found: What was identified.
        file: The identified parameters; None if there are none.
        on: Rig, or file of parameters, that they lie over; empty for the thesis's rig.
    """

    found: Identification
    file: Path | None
    on: str = ""

    @property
    def overrides(self) -> tuple[str, ...]:
        """The twin of the rig as settings of the shadow."""
        source = self.file or self.on
        return (f"parameters={source}",) if source else ()

    def describe(self) -> str:
        """What the twin knows of the rig, in a sentence."""
        known = [
            f"{each.label} {each.interval}" + (f" {each.about.unit}" if each.about.unit else "")
            for each in self.found.verdicts
            if each.word == IDENTIFIED_VERDICT
        ]
        what = (
            "; ".join(known) or "nothing, so that the twin is the rig as the project describes it"
        )
        ball = [
            note
            for note in self.found.notes
            if note.startswith(("the ball is taken as", "the gain is neither"))
        ]
        return f"reference {self.found.source}: identified: {what}{'; '.join(('', *ball))}."

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "source": self.found.source,
            "parameters": [each.as_dict() for each in self.found.verdicts],
        }


def _with_shown_ball(found: AxisIdentification) -> AxisIdentification:
    """What was identified, with the only ball that its gains can be of: hollow or solid.

    A log shows only the product of tilt per command and the ball's share of gravity, so that this
    is what is written; a ball that is not the rig's makes a different twin all the same, where the
    product is beyond what a scenario takes as an error of the tilt.
    """
    gains = [
        each.value
        for each in found.verdicts
        if each.name.startswith("gain_") and each.word == IDENTIFIED_VERDICT and each.value
    ]
    if not gains:
        return found
    shown = np.abs(gains) / found.ball.gravity
    near = [
        (name, factor)
        for name, factor in GRAVITY_SHARES.items()
        if np.all(np.abs(shown / factor - 1) <= MAX_GAIN_ERROR)
    ]
    if len(near) != 1:
        note = "the gain is neither that of a solid nor that of a hollow ball; give --ball"
        return replace(found, notes=(*found.notes, note))
    ((name, factor),) = near
    if factor == found.factor:
        return found
    note = f"the ball is taken as {name}, which the gain is nearest to; --ball states it"
    return replace(found, factor=factor, notes=(*found.notes, note))


def learn_reference(
    log: Path,
    folder: Path,
    *,
    on: str = "",
    columns: str | None = None,
    separator: str | None = None,
    ball: str | float | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Reference:
    """Identify a rig from a log of it while it was well.

    Args:
        log: Run folder, ``run.parquet`` or log, preferably recorded with the scenario ``excite``.
        folder: Where the report of the identification and its parameters go.
        on: Rig, or file of parameters, that what is found is to lie over; empty for the rig of the
            log's run.
        columns: Of a log of any rig, as ``identify`` takes them.
        separator: Between these.
        ball: Of such a log: hollow, solid, or the share of gravity that accelerates it; None for
            that of ``on``, or without it for the one that the log shows.
        progress: Called with the share of the work done.

    Raises:
        LogError: If the log cannot be read, or nothing can be learned from it.
        ScenarioError: If there is no such rig.
        RecordError: If a file cannot be written.
    """
    found: Identification
    rig = load("hold", [f"parameters={on}"]).plant.model if on else None
    if columns is None:
        found = identify_twin(read(log), DEFAULT_PARAMETERS, FITTED_SHARE, progress)
    else:
        logged = read_any(log, wanted_columns(columns), separator)
        found = identify_axes(
            [logged],
            1 - FITTED_SHARE,
            factor=None if ball is None else ball_factor(ball),
            progress=lambda share, _: progress(share),
            ball=rig,
        )
        if ball is None and not on:
            found = _with_shown_ball(found)
    if on:
        found = replace(found, on=on)
    write(found, folder)
    known = any(each.word == IDENTIFIED_VERDICT for each in found.verdicts)
    return Reference(found, folder / "parameters.toml" if known else None, on)
