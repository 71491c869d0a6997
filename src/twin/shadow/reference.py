"""The twin of a rig from a log of it while it was well, by which other logs are judged."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.ballplate import BallPlate
from twin.identify.any_rig import AxisIdentification, identify_axes
from twin.identify.end_stops import find_ends
from twin.identify.logs import (
    AXIS_COLUMNS,
    GRAVITY_SHARES,
    AnyLog,
    Log,
    ball_factor,
    read,
    read_any,
    wanted_columns,
)
from twin.identify.parameters import DEFAULT_PARAMETERS, FITTED_SHARE
from twin.identify.prepare import prepare
from twin.identify.report import write
from twin.identify.twin_model import identify_twin
from twin.identify.verdicts import IDENTIFIED_VERDICT, Identification
from twin.scenario.load import load
from twin.sim.plant.rim import NO_ENDS, Ends

MIN_BALL_RADIUS_M = 0.002
"""Smallest radius of a ball that a lever shows."""
MIN_ARM_M = 1.1e-5
"""Smallest arm of rolling friction that such a ball is left: a mechanism takes no smaller one."""
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
        ends: Where end stops or rims stop the ball along x and y, m, as the log shows them.
        height: Of the plate's surface above its axes, m, as the log shows it; None if it does not.
    """

    found: Identification
    file: Path | None
    on: str = ""
    ends: tuple[Ends, ...] = (NO_ENDS, NO_ENDS)
    height: float | None = None

    @property
    def overrides(self) -> tuple[str, ...]:
        """The twin of the rig as settings of the shadow."""
        source = self.file or self.on
        rig = (f"parameters={source}",) if source else ()
        return rig if self.height is None else (*rig, f"plant.plate.height={self.height:.6g}")

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
        stops = []
        for axis, ends in zip(AXIS_COLUMNS, self.ends, strict=True):
            places = " and ".join(f"{1000 * end:.1f}" for end in ends if math.isfinite(end))
            if places:
                stops.append(f"walls at {places} mm along {axis}: the time there is not evaluated")
        return f"reference {self.found.source}: identified: {'; '.join((what, *ball, *stops))}."

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


def _with_shown_lever(found: AxisIdentification) -> tuple[AxisIdentification, float | None]:
    """What was identified, over a plate as high and with a ball as large as its levers show.

    A ball that is far above the axis of the plate feels how fast that turns. Of a log of any rig
    the height is not known, and that of the thesis's rig makes a different twin where the log shows
    another lever: height + radius + J / (m r). A lever smaller than that of the ball alone is that
    of a smaller ball.

    Returns:
        That, and the height of the surface in m; None where the log allows that of the ball's rig.
    """
    levers = [
        (each.low, each.high)
        for each in found.verdicts
        if each.name.startswith("lever_") and each.low is not None and each.high is not None
    ]
    ball = found.ball
    own = ball.height + ball.radius / found.factor
    if not levers or all(low <= own <= high for low, high in levers):
        return found, None
    shown = float(np.mean([(low + high) / 2 for low, high in levers]))
    frictions = [each.value for each in found.verdicts if each.name.startswith("friction_")]
    braking = float(np.mean([each for each in frictions if each] or [np.inf]))
    least = max(MIN_BALL_RADIUS_M, MIN_ARM_M * found.factor * ball.gravity / braking)
    radius = min(max(found.factor * shown, least), ball.radius)
    height = max(0.0, shown - radius / found.factor)
    return replace(found, ball=replace(ball, radius=radius)), height


def _read_reference(
    log: Path, on: str, columns: str | None, separator: str | None
) -> tuple[Log | AnyLog, BallPlate | None]:
    """The reference log and the ball of the rig ``on``; arguments as of ``learn_reference``."""
    rig = load("hold", [f"parameters={on}"]).plant.model if on else None
    if columns is None:
        return read(log), rig
    return read_any(log, wanted_columns(columns), separator), rig


def check_reference(
    log: Path, on: str = "", columns: str | None = None, separator: str | None = None
) -> None:
    """Make sure that a reference log can be read; arguments as of ``learn_reference``.

    Raises:
        LogError: If it cannot.
        ScenarioError: If there is no such rig.
    """
    recorded, _ = _read_reference(log, on, columns, separator)
    if isinstance(recorded, Log):
        prepare(recorded)


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
    ends: tuple[Ends, ...] = (NO_ENDS, NO_ENDS)
    height: float | None = None
    recorded, rig = _read_reference(log, on, columns, separator)
    if isinstance(recorded, Log):
        if not recorded.scenario:
            ends = find_ends(recorded)
            recorded = replace(recorded, walls=recorded.walls.narrowed(ends))
        found = identify_twin(recorded, DEFAULT_PARAMETERS, FITTED_SHARE, progress)
    else:
        found = identify_axes(
            [recorded],
            1 - FITTED_SHARE,
            factor=None if ball is None else ball_factor(ball),
            progress=lambda share, _: progress(share),
            ball=rig,
        )
        ends = find_ends(recorded.axes)
        if not on:
            found, height = _with_shown_lever(_with_shown_ball(found) if ball is None else found)
    if on:
        found = replace(found, on=on)
    write(found, folder)
    known = any(each.word == IDENTIFIED_VERDICT for each in found.verdicts)
    return Reference(found, folder / "parameters.toml" if known else None, on, ends, height)
