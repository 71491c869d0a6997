"""Finds end stops in a log: walls at which a ball bounces or rests against the tilt.

A wall shows by its impulse. Over a visit of the ball to the end of its way,

    impulse = change of velocity - int (gain u(t - delay) + level) dt

is zero for a ball that only turns there, minus what the tilt does while a wall holds it, and minus
the change of velocity of a bounce. The fit leaves visits with an impulse out; predictions simulate
the wall.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import median_filter

from controllers.arrays import Array
from twin.identify.axis_logs import AxisLog, EndStops
from twin.identify.command_model import TiltHistory
from twin.identify.first_look import FirstLook, look_first
from twin.identify.log_columns import AXIS_COLUMNS
from twin.identify.logs import Log
from twin.identify.prepare import log_of_axes
from twin.identify.samples import find_noise, runs
from twin.sim.plant.rim import NO_ENDS, Ends


@dataclass(frozen=True, kw_only=True)
class WallSearch:
    """Constants of the search for end stops.

    Attributes:
        end_quantile: Share of the positions up to which the way goes.
        min_margin_m: Least width of the band at an end of the way; a visit is a stay in it.
        margin_noise_stds: Least width of that band in standard deviations of the noise of a
            position; the larger of the two widths holds.
        speed_window_s: Time before and after a visit over which the speed is fitted.
        min_samples: Smallest number of samples for a speed.
        merged_gap_s: Visits with no more time between are one: a ball that bounces to rest.
        min_impulse_m_s: Smallest impulse of a wall.
        push_share: Impulse, as a share of what the tilt does in the visit, that an error of the
            gain or the delay explains.
        speed_stds: Impulse, in standard deviations of the measured speeds, that noise explains.
        min_touches: Smallest number of visits with an impulse for a wall; one is enough where the
            other end has a wall.
        min_touch_share: Smallest share of such visits.
        placing_visits: Number of the longest such visits whose median place is the wall's.
        guard_s: Time before and after a visit that is left out as well.
        min_bounce_m_s: Speed towards a wall above which a bounce shows its restitution.
        max_bounce_s: Longest visit of a single bounce.
    """

    end_quantile: float = 0.995
    min_margin_m: float = 0.002
    margin_noise_stds: float = 4.0
    speed_window_s: float = 0.1
    min_samples: int = 4
    merged_gap_s: float = 0.08
    min_impulse_m_s: float = 0.02
    push_share: float = 0.4
    speed_stds: float = 4.0
    min_touches: int = 4
    min_touch_share: float = 0.3
    placing_visits: int = 4
    guard_s: float = 0.02
    min_bounce_m_s: float = 0.05
    max_bounce_s: float = 0.15


WALL_SEARCH = WallSearch()
SINGLE_TOUCH_SEARCH = replace(WALL_SEARCH, min_touches=1)
"""For what is left out where a single touch of a wall may raise an alarm."""


@dataclass(frozen=True)
class _Visit:
    """A visit of the ball to the end of its way.

    Where a log begins or ends with it, or has a gap next to it, a speed and the impulse are NaN.

    Attributes:
        begin: Its first sample, s.
        end: Its last sample, s.
        towards: Speed towards the end before it, m/s.
        away: Speed away from the end after it, m/s.
        impulse: Away from the end, without what the tilt does, m/s.
        explained: Largest impulse that friction, noise and an error of the gain explain, m/s.
        place: Position of the wall, towards the end, m.
    """

    begin: float
    end: float
    towards: float
    away: float
    impulse: float
    explained: float
    place: float


def find_end_stops(log: AxisLog, look: FirstLook, how: WallSearch = WALL_SEARCH) -> EndStops | None:
    """The end stops of an axis, and when the ball touches them; None if there is none.

    Args:
        log: The axis.
        look: Its gain, delay, level and friction.
        how: Constants.
    """
    ends, touches, bounces = [], list[_Visit](), list[_Visit]()
    every = {side: list(_find_visits(log, look, side, how)) for side in (-1.0, 1.0)}
    touched = {
        side: [each for each in visits if each.impulse > each.explained]
        for side, visits in every.items()
    }
    # whoever puts a wall at one end puts one at the other: a single touch shows where
    enough = 1 if max(map(len, touched.values())) >= how.min_touches else how.min_touches
    for side, visits in every.items():
        held = touched[side]
        measured = sum(not math.isnan(each.impulse) for each in visits)
        if len(held) < max(enough, how.min_touch_share * measured):
            ends.append(side * np.inf)
            continue
        longest = sorted(held, key=lambda each: each.begin - each.end)[: how.placing_visits]
        ends.append(side * float(np.median([each.place for each in longest])))
        touches += visits  # where there is a wall, a visit without an impulse may touch it as well
        bounces += [
            each
            for each in held
            if each.towards > how.min_bounce_m_s and each.end - each.begin < how.max_bounce_s
        ]
    if not touches:
        return None
    touches.sort(key=lambda each: each.begin)
    spans = np.array([(each.begin - how.guard_s, each.end + how.guard_s) for each in touches])
    kept = [each.away / each.towards for each in bounces]
    restitution = float(np.clip(np.median(kept), 0.0, 1.0)) if len(kept) >= how.min_touches else 0.0
    return EndStops(low=ends[0], high=ends[1], restitution=restitution, touches=spans.T)


def find_ends(logs: Mapping[str, AxisLog] | Log) -> tuple[Ends, ...]:
    """Where walls stop the ball along x and along y, m, as a log shows it by one touch or more.

    Args:
        logs: The axes, x or y; or a log of known columns.
    """
    axes = log_of_axes(logs) if isinstance(logs, Log) else logs
    ends = dict.fromkeys(AXIS_COLUMNS, NO_ENDS)
    for axis, log in axes.items():
        look = look_first(log)
        if look and (stops := find_end_stops(log, look, SINGLE_TOUCH_SEARCH)):
            ends[axis] = (stops.low, stops.high)
    return tuple(ends.values())


def describe_stops(axis: str, log: AxisLog) -> list[str]:
    """A note on the end stops of an axis and on what was left out; none without any."""
    if (stops := log.stops) is None:
        return []
    ends = " and ".join(f"{1000 * end:.1f}" for end in (stops.low, stops.high) if np.isfinite(end))
    share = float(log.touching.mean())
    return [
        f"{axis}: an end stop at {ends} mm: the ball touches it in {100 * share:.0f} % of the log, "
        f"which is left out; {100 * (1 - share):.0f} % was used, and predictions bounce there with "
        f"a restitution of {stops.restitution:.2f}"
    ]


def _find_visits(log: AxisLog, look: FirstLook, side: float, how: WallSearch) -> Iterator[_Visit]:
    """Visits to the lower (side -1) or upper (1) end of the way, with their impulses."""
    time, place = log.sampled, side * log.ball
    step = float(np.median(np.diff(time)))
    noise = float(find_noise(place))
    smooth = median_filter(place, size=3, mode="nearest")
    fast = float(np.quantile(np.abs(np.diff(smooth)) / np.maximum(np.diff(time), 1e-6), 0.9))
    top = float(np.quantile(smooth, how.end_quantile))
    margin = max(how.min_margin_m, how.margin_noise_stds * noise) + fast * step / 2
    tilt = TiltHistory(log)
    push_time = np.arange(time[0], time[-1] + step, step / 2)
    push = side * (
        look.gain * tilt.scale * tilt.at(push_time - look.delay, 0.0)
        + look.level
        + look.camber * np.interp(push_time, time, log.ball)
    )
    pushed, sizes = (np.cumsum(each) * step / 2 for each in (push, np.abs(push)))
    window = max(how.speed_window_s, how.min_samples * step)
    speed_std = noise * np.sqrt(12 / max(window / step, how.min_samples)) / window
    merged = [list(each) for each in runs(np.asarray(smooth > top - margin))]
    for first, stop in list(merged):
        earlier = [each for each in merged if each[0] < first]
        if earlier and time[first] - time[earlier[-1][1] - 1] < how.merged_gap_s:
            earlier[-1][1] = stop
            merged.remove([first, stop])
    for first, stop in merged:
        begin, end = float(time[first]), float(time[stop - 1])
        before = _fit_speed(time, place, begin - window, begin)
        after = _fit_speed(time, place, end, end + window)
        over = np.searchsorted(push_time, (begin - window / 2, end + window / 2))
        over = np.minimum(over, len(push_time) - 1)
        gained, size = (float(each[over[1]] - each[over[0]]) for each in (pushed, sizes))
        lasting = end - begin + window
        explained = max(how.min_impulse_m_s, how.speed_stds * np.sqrt(2) * speed_std)
        explained += how.push_share * size + look.friction * lasting
        yield _Visit(
            begin=begin,
            end=end,
            towards=before,
            away=-after,
            impulse=gained - (after - before),
            explained=explained,
            # a ball that rests is at the wall in the middle of the visit, one that bounces once
            place=float(
                place[first:stop].max()
                if end - begin < how.max_bounce_s
                else np.median(smooth[first:stop])
            ),
        )


def _fit_speed(time: Array, place: Array, begin: float, end: float) -> float:
    """Speed of a straight line through the samples between two times in s; NaN of less than 3."""
    some = slice(*np.searchsorted(time, (begin - 1e-9, end + 1e-9)))
    at, where = time[some], place[some]
    if len(at) < 3:
        return math.nan
    since = at - at.mean()
    return float(since @ where / (since @ since))
