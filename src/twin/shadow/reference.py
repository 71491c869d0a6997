"""The twin of a rig from a log of it while it was well: the reference for other logs."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from twin.base.settings import settings_of
from twin.identify.any_logs import read_any
from twin.identify.any_rig import identify_axes
from twin.identify.axis_identification import AxisIdentification
from twin.identify.axis_logs import AnyLog
from twin.identify.balls import GRAVITY_SHARES, ball_factor
from twin.identify.end_stops import find_ends
from twin.identify.log_columns import AXIS_COLUMNS, wanted_columns
from twin.identify.logs import Log, read
from twin.identify.parameters import DEFAULT_PARAMETERS, FITTED_SHARE
from twin.identify.prepare import prepare
from twin.identify.report import write
from twin.identify.twin_model import identify_twin
from twin.identify.verdicts import IDENTIFIED_VERDICT, Identification
from twin.run.files import run_name
from twin.scenario.load import load
from twin.shadow.evidence import gaps
from twin.shadow.follow import Shadow, median_score
from twin.shadow.learning import HealthyTwin, ball_track, learn, prepare_for
from twin.shadow.report import examine_log, make_twin, read_watched, watched_twin
from twin.sim.plant.interface import Parts
from twin.sim.plant.rim import NO_ENDS, Ends

HEIGHT_BOUNDS_M = settings_of(Parts)["height"].bounds
"""Least and largest height of a plate's surface above its axes."""
MIN_WIDTH_M = 1e-6
"""Smallest width of an interval of the lever that counts in a weight."""
MAX_GAIN_ERROR = 0.05
"""Share by which the gain of a rig may differ from its ball's gain. The gains of hollow and solid
balls differ by 19 %."""


@dataclass(frozen=True)
class Reference:
    """The twin that a reference log gives.

    Attributes:
        found: What was identified.
        file: The identified parameters; None if there are none.
        on: Rig, or file of parameters, that they lie over; empty for the thesis's rig.
        ends: Where end stops or rims stop the ball along x and y, m, as the log shows them.
        assumed: What was taken of ball and height, as the log shows them, in words.
    """

    found: Identification
    file: Path | None
    on: str = ""
    ends: tuple[Ends, ...] = (NO_ENDS, NO_ENDS)
    assumed: tuple[str, ...] = ()

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
        stops = []
        for axis, ends in zip(AXIS_COLUMNS, self.ends, strict=True):
            places = " and ".join(f"{1000 * end:.1f}" for end in ends if math.isfinite(end))
            if places:
                stops.append(f"walls at {places} mm along {axis}: the time there is not evaluated")
        words = "; ".join((what, *self.assumed, *stops))
        return f"reference {self.found.source}: identified: {words}."

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "source": self.found.source,
            "parameters": [each.as_dict() for each in self.found.verdicts],
        }


def _gravity_shares(found: AxisIdentification) -> Array:
    """Share of gravity that accelerates the ball along each axis with an identified gain."""
    gains = [
        each.value
        for each in found.verdicts
        if each.name.startswith("gain_") and each.word == IDENTIFIED_VERDICT and each.value
    ]
    return np.abs(gains) / found.ball.gravity


def _balls_with(shares: Array) -> list[tuple[str, float]]:
    """The balls, by name and share of gravity, that some shares can be of."""
    return [
        (name, factor)
        for name, factor in GRAVITY_SHARES.items()
        if np.all(np.abs(shares / factor - 1) <= MAX_GAIN_ERROR)
    ]


def _with_doubted_ball(found: AxisIdentification) -> AxisIdentification:
    """What was identified with a stated ball, with a note where its gains fit a different one.

    The ball stays as it is stated: a plate that tilts further than commanded shows the same gains.
    """
    shares = _gravity_shares(found)
    near = _balls_with(shares) if len(shares) else []
    if len(near) != 1 or np.any(np.abs(shares / found.factor - 1) <= MAX_GAIN_ERROR):
        return found
    ((name, factor),) = near
    note = (
        f"the gain is that of a {name} ball, {factor:.2g} of gravity, not of the stated "
        f"{found.factor:.2g}: --ball {name}, or the plate tilts {shares.mean() / found.factor:.2g} "
        "times as far as commanded"
    )
    return replace(found, notes=(*found.notes, note))


def _with_shown_ball(found: AxisIdentification) -> AxisIdentification:
    """What was identified, with the only ball that its gains can be of: hollow or solid.

    A log shows only the product of tilt per command and the ball's share of gravity, so that this
    is what is written; a ball that is not the rig's makes a different twin all the same, where the
    product is beyond what a scenario takes as an error of the tilt.
    """
    shares = _gravity_shares(found)
    if not len(shares):
        return found
    near = _balls_with(shares)
    if len(near) != 1:
        note = "the gain fits neither a solid nor a hollow ball; give --ball"
        return replace(found, notes=(*found.notes, note))
    ((name, factor),) = near
    if factor == found.factor:
        return found
    note = f"the ball is taken as {name}, which the gain is nearest to; --ball states it"
    return replace(found, factor=factor, notes=(*found.notes, note))


def _with_shown_lever(found: AxisIdentification) -> AxisIdentification:
    """What was identified, over a plate as high as its levers show.

    A ball that is far above the axis of the plate feels how fast that turns. Of a log of any rig
    the height is not known, and the thesis's height makes a different twin where the log shows
    a different lever: height + radius + J / (m r). The ball stays as it is: a lever that no allowed
    height gives is approached by the nearest one.
    """
    levers = [
        (each.low, each.high)
        for each in found.verdicts
        if each.name.startswith("lever_") and each.low is not None and each.high is not None
    ]
    ball = found.ball
    alone = ball.radius / found.factor
    if not levers or all(low <= ball.height + alone <= high for low, high in levers):
        return found
    lever, differ = _common_lever(levers)
    height = min(max(lever - alone, HEIGHT_BOUNDS_M["ge"]), HEIGHT_BOUNDS_M["le"])
    note = f"plant.plate.height is taken as {height:.3g} m from the lever of {lever:.3g} m"
    if height != lever - alone:
        note += f", the nearest of the heights that are allowed (the ball alone has {alone:.3g} m)"
    if differ:
        note += "; the levers of the axes differ, and this is their weighted mean"
    return replace(found, height=height, notes=(*found.notes, note))


def _common_lever(levers: Sequence[tuple[float, float]]) -> tuple[float, bool]:
    """The lever in m that intervals of it show, and whether they contradict each other.

    It is the middle of what they have in common; of intervals that have nothing in common, the mean
    of their middles, weighted by the inverse squares of their widths.
    """
    low, high = np.transpose(levers)
    if (least := low.max()) <= (most := high.min()):
        return float(least + most) / 2, False
    widths = np.maximum(high - low, MIN_WIDTH_M)
    return float(np.average((low + high) / 2, weights=widths**-2.0)), True


def _read_reference(log: Path, columns: str | None, separator: str | None) -> Log | AnyLog:
    """The reference log; arguments as of ``examine_by_reference``.

    Raises:
        LogError: If it cannot be used.
    """
    if columns is not None:
        return read_any(log, wanted_columns(columns), separator)
    recorded = read(log)
    prepare(recorded)  # reports what is wrong with it before the other logs are read
    return recorded


def learn_reference(
    recorded: Log | AnyLog,
    folder: Path,
    *,
    on: str = "",
    ball: str | float | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Reference:
    """Identify a rig from a log of it while it was well.

    Args:
        recorded: The log, preferably recorded with the scenario ``excite``.
        folder: Where the report of the identification and its parameters go.
        on: Rig, or file of parameters, that what is found is to lie over; empty for the rig of the
            log's run.
        ball: Of a log that is no run: hollow, solid, or the share of gravity that accelerates it;
            None for the ball of ``on``; without ``on``, for the ball that a log of any rig shows.
        progress: Called with the share of the work done.

    Raises:
        LogError: If nothing can be learned from the log, or a ball is given for a run.
        ScenarioError: If there is no such rig.
        RecordError: If a file cannot be written.
    """
    found: Identification
    ends: tuple[Ends, ...] = (NO_ENDS, NO_ENDS)
    assumed: tuple[str, ...] = ()
    if isinstance(recorded, Log):
        if not recorded.scenario:
            ends = find_ends(recorded)
            recorded = replace(recorded, walls=recorded.walls.narrowed(ends))
        if ball is not None:
            recorded = recorded.with_ball(ball_factor(ball))
        found = identify_twin(recorded, DEFAULT_PARAMETERS, FITTED_SHARE, progress)
    else:
        found = identify_axes(
            [recorded],
            1 - FITTED_SHARE,
            factor=None if ball is None else ball_factor(ball),
            progress=lambda share, _: progress(share),
            ball=_ball_of(on),
        )
        ends = find_ends(recorded.axes)
        if not on and _is_known(found):
            shown = _with_shown_ball(found) if ball is None else _with_doubted_ball(found)
            shown = _with_shown_lever(shown)
            found, assumed = shown, shown.notes[len(found.notes) :]
    if on:
        found = replace(found, on=on)
    write(found, folder)
    file = folder / "parameters.toml" if _is_known(found) else None
    return Reference(found, file, on, ends, assumed)


def learn_twin(
    recorded: Log | AnyLog,
    overrides: Sequence[str] = (),
    *,
    ball: str | float | None = None,
    ends: Sequence[Ends] = (),
) -> HealthyTwin:
    """The twin of a rig after all of a reference log; arguments and errors as of ``examine_log``.

    It is what the beginnings of other logs are compared with. An identification leaves some
    parameters open, and its model has other errors than the twin.
    """
    log, before = watched_twin(recorded, overrides, ball, ends)
    usable = prepare_for(log, before)
    missing = gaps(log, usable.period)
    belief = learn(usable, before, missing)
    return HealthyTwin(belief, ball_track(usable), median_score(usable, belief, missing))


def _ball_of(on: str) -> BallPlate | None:
    """The ball of a rig, or file of parameters; None without one.

    Raises:
        ScenarioError: If there is no such rig.
    """
    return load("hold", [f"parameters={on}"]).plant.model if on else None


def _is_known(found: Identification) -> bool:
    """Whether any parameter is identified."""
    return any(each.word == IDENTIFIED_VERDICT for each in found.verdicts)


def examine_by_reference(
    reference: Path,
    folder: Path,
    logs: Mapping[Path, Path],
    overrides: Sequence[str] = (),
    *,
    columns: str | None = None,
    separator: str | None = None,
    ball: str | float | None = None,
    stage: Callable[[str], AbstractContextManager[Callable[[float], None]]],
) -> tuple[Reference, dict[str, Shadow]]:
    """Identify a rig from a log of its healthy state, and evaluate other logs by that twin.

    Every log is read once, and all mistakes are reported before anything is identified, which takes
    long.

    Args:
        reference: Run folder, ``run.parquet`` or log, preferably recorded with the scenario
            ``excite``.
        folder: Where the report of the identification and its parameters go.
        logs: The other logs, and the folder of the report of each.
        overrides: ``KEY=VALUE`` each over the twin; ``parameters=NAME`` states the rig, or file of
            parameters, that what is identified is to lie over.
        columns: Of logs of any rig, as ``identify`` takes them.
        separator: Between these.
        ball: Of logs that are no runs: hollow, solid, or the share of gravity that accelerates it;
            None for the ball of the stated rig; without one, for the ball that the reference shows.
        stage: Shows a stage of the work by its name while it lasts; gives what is called with the
            share of it that is done.

    Returns:
        The reference, and the report of each log by its name.

    Raises:
        TwinError: If a log cannot be used, an override is wrong, or a file cannot be written.
    """
    rigs = [text for text in overrides if text.partition("=")[0].strip() == "parameters"]
    others = [text for text in overrides if text not in rigs]
    on = "".join(text.partition("=")[2].strip() for text in rigs)
    _ball_of(on)
    first = _read_reference(reference, columns, separator)
    watched = {log: read_watched(log, columns, separator) for log in logs}
    for each in watched.values():
        make_twin(each, (*rigs, *others), ball)
    with stage(f"identifying from {run_name(reference)}") as advance:
        learned = learn_reference(first, folder, on=on, ball=ball, progress=advance)
    twin = (*learned.overrides, *others)
    with stage(f"the twin of {run_name(reference)}"):
        healthy = learn_twin(first, twin, ball=ball, ends=learned.ends)
    found = {}
    for log, each in watched.items():
        with stage(f"the twin of {run_name(log)}"):
            found[run_name(log)] = examine_log(
                each,
                logs[log],
                twin,
                ball=ball,
                learning=True,
                ends=learned.ends,
                reference=healthy,
            )
    return learned, found
