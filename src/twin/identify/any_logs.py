"""Reads a log of any rig: chosen columns in SI units, as rows of one time, without false samples.

What is left out or assumed on the way becomes a note of the log.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import scipy

from controllers.arrays import Array, Mask
from twin.base.errors import LogError, plural
from twin.identify.axis_logs import MAX_COMMAND_GAP_S, AnyLog, AxisLog
from twin.identify.cells import are_times_of_day, describe_hexadecimal, parse_numbers
from twin.identify.clocks import unwrap
from twin.identify.log_columns import (
    AXIS_COLUMNS,
    ROLE_UNITS,
    ROLES_OF_BOTH_AXES,
    ROW_NAME,
    ColumnWanted,
    is_count,
    unit_factor,
)
from twin.identify.log_tables import (
    counts_rows,
    find_column,
    open_content,
    split_content,
)
from twin.identify.samples import are_copies, find_held, resolution, runs
from twin.run.units import UNIT_SCALES

MIN_MOTION_M, MAX_MOTION_M = 1e-3, 3.0
"""Distance in m from the middle of its positions that a ball on a plate comes to."""
MIN_SHARED_STAMPS, MIN_WHOLE_SHARE = 0.9, 0.95
"""Share of stamps with more than one row above which a clock is coarse, and the smallest share of
rows of such a log that have a command."""
MAX_STAMP_RATIO = 1.5
"""Time between two stamps of a coarse clock, over the usual one, above which rows are missing."""
MIN_SHARED_ROWS = 0.1
"""Share of the rows with a position along one axis that has to have one along the other, too."""
SPEED_WINDOW_S = 0.2
"""Time in s over which a speed is seen."""
REST_SPEED_M_S = 0.005
"""Speed in m/s below which a ball may as well rest."""
MIN_JUMP_M = 0.004
"""Way in m at once before or after a repeated reading by which it is false or held."""
MAX_ACCELERATION_M_S2 = 2.0
"""Acceleration of a ball in m/s^2 up to which its way between two samples is no jump."""


def read_any(
    path: Path,
    wanted: Mapping[str, ColumnWanted],
    separator: str | None = None,
) -> AnyLog:
    """Read a log of any rig.

    Args:
        path: A text file with columns, with or without a header, or a file of one of
            ``foreign_logs.READERS_BY_KIND``.
        wanted: Role to column.
        separator: Between columns of text; None to find it.

    Raises:
        LogError: If it cannot be read, lacks a column, or a column is of an unknown unit.
    """
    header, cells, clocks, notes = split_content(path.name, open_content(path), wanted, separator)
    columns: dict[str, Array] = {}
    units: dict[str, str] = {}
    times: dict[str, Array] = {}
    roles: dict[int, str] = {}
    for role, column in wanted.items():
        if role == "time" and counts_rows(header, column):
            columns[role] = _number_rows(path.name, column, max(map(len, cells), default=0))
            units[role] = "s"
            continue
        index, unit = find_column(path.name, header, role, column)
        if (other := roles.setdefault(index, role)) != role:
            raise LogError(
                f"--columns: {other} and {role}: both are column {column.name} of {path.name}; "
                "give each role its own"
            )
        unit = column.unit or unit
        factor = unit_factor(unit, ROLE_UNITS[role]) if unit else 1.0
        if factor is None:
            raise LogError(
                f"{path.name}: {role}: unit '{unit}' of {column.name}; give it, as "
                f"{role}=NAME:{list(UNIT_SCALES[ROLE_UNITS[role]])[-1]}, with a factor before it "
                "(a pixel of half a millimetre as NAME:0.5mm, a count as NAME:0.24deg)"
            )
        if index >= len(cells):
            raise LogError(f"{path.name}: {role}: no column {column.name}: there are {len(cells)}")
        values, broken = parse_numbers(cells[index])
        if broken > 0.2 * len(values) or not np.isfinite(values).any():
            raise LogError(f"{path.name}: {role}: {column.name} contains hardly any numbers")
        if broken:
            notes.append(
                f"{plural(broken, 'cell')} of {column.name} without a number: taken as empty"
            )
        if said := describe_hexadecimal(cells[index]):
            notes.append(f"{column.name}: {said}")
        if role == "time":
            values, wraps = unwrap(values, of_day=are_times_of_day(cells[index]))
            if wraps:
                notes.append(
                    f"the clock {column.name} wraps {plural(wraps, 'time')}: taken as going on"
                )
        columns[role] = column.to_si(values, factor)
        if index in clocks:
            times[role] = clocks[index]
        counted = ROLE_UNITS[role] == "rad" and is_count(unit)
        units[role] = "count" if counted else ROLE_UNITS[role]
    notes += _describe_copies(columns, wanted)
    rows = _on_one_clock(path.name, columns, times, notes)
    return _clean_log(path.name, rows, units, notes, merged=rows is not columns)


def _number_rows(source: str, column: ColumnWanted, count: int) -> Array:
    """Times of rows at a constant rate, from 0, shape (count,).

    Raises:
        LogError: If the rate is not given.
    """
    factor = unit_factor(column.unit, "s") if column.unit else None
    if factor is None:
        raise LogError(
            f"{source}: time: give the rate of the rows, as time={ROW_NAME}:100Hz, or the time "
            f"between two, as time={ROW_NAME}:10ms"
        )
    return column.to_si(np.arange(count, dtype=float), factor)


def _describe_copies(
    columns: Mapping[str, Array], wanted: Mapping[str, ColumnWanted]
) -> Iterator[str]:
    """Columns that are the same for both axes in every row, up to the sign, in words.

    Args:
        columns: Role to values in SI units.
        wanted: Role to column.
    """
    for role, other in ROLES_OF_BOTH_AXES:
        if {role, other} <= columns.keys() and are_copies(columns[role], columns[other]):
            yield (
                f"{other}: {wanted[other].name} equals {wanted[role].name} ({role}) in every row, "
                "up to the sign: a column that was written twice? Then one of them has a wrong "
                "name, and what is fitted to it is wrong"
            )


def _on_one_clock(
    source: str, columns: dict[str, Array], times: Mapping[str, Array], notes: list[str]
) -> dict[str, Array]:
    """The columns as rows of one time, empty where a column has no sample.

    Args:
        source: What to call the file in messages.
        columns: Role to values in SI units.
        times: Role to times in s, of columns that have times of their own.
        notes: Receives what was done.

    Raises:
        LogError: If there is no time, or a column has a different number of rows.
    """
    if "time" in columns:
        base = times.get("time")

        def shares_rows(each: Array) -> bool:
            if base is None:
                return len(each) == len(columns["time"])
            return np.array_equal(each, base)

        times = {k: each for k, each in times.items() if k != "time" and not shares_rows(each)}
    missing = [role for role in columns if role not in times]
    if missing and "time" not in columns:
        raise LogError(
            f"{source}: {missing[0]} has no times; give time in --columns, too: a column, or for "
            f"rows at a constant rate time={ROW_NAME}:100Hz"
        )
    for role in missing:
        if len(columns[role]) != len(columns["time"]):
            raise LogError(
                f"{source}: {role}: has {plural(len(columns[role]), 'row')}, time "
                f"{len(columns['time'])}"
            )
    if not times:
        return columns
    clocks = {role: times[role] if role in times else columns["time"] for role in columns}
    if "measured_y" in columns and "measured_x" in columns:
        x, y = clocks["measured_x"], clocks["measured_y"]
        if len(x) != len(y) or (x != y).any():
            columns["measured_y"] = _interpolate(x, y, columns["measured_y"])
            clocks["measured_y"] = x
            notes.append("measured_y has times of its own: taken at those of measured_x")
    every = np.unique(np.concatenate(list(clocks.values())))
    every = every[np.isfinite(every)]
    rows = {"time": every}
    for role in filter(lambda role: role != "time", columns):
        at, first = np.unique(clocks[role], return_index=True)
        at, first = at[np.isfinite(at)], first[np.isfinite(at)]
        rows[role] = np.full(len(every), np.nan)
        rows[role][np.searchsorted(every, at)] = columns[role][first]
    for role in {"age", "touched"} & columns.keys():
        rows[role] = _hold(rows[role])
    rates = sorted({float(f"{_rate(each):.3g}") for each in clocks.values()})
    if len(rates) > 1:
        listed = ", ".join(f"{each:g} Hz" for each in rates)
        notes.append(f"columns have times of their own, at {listed}")
    return rows


def _interpolate(at: Array, time: Array, values: Array) -> Array:
    """Values at some times by straight lines; NaN outside."""
    known = np.isfinite(time) & np.isfinite(values)
    order = np.argsort(time[known], kind="stable")
    return np.interp(at, time[known][order], values[known][order], left=np.nan, right=np.nan)


def _hold(values: Array) -> Array:
    """Values with the newest one where there is none."""
    newest = np.maximum.accumulate(np.where(np.isfinite(values), np.arange(len(values)), 0))
    return values[newest]


def _rate(time: Array) -> float:
    """Rows per second; 0 of a clock that stands."""
    step = float(np.median(np.diff(time))) if len(time) > 1 else 0.0
    return 1 / step if step > 0 else 0.0


def _clean_log(
    source: str,
    columns: dict[str, Array],
    units: dict[str, str],
    notes: list[str],
    *,
    merged: bool = False,
) -> AnyLog:
    """A log of columns in SI units, without what is false in it.

    Args:
        source: What to call the file in messages.
        columns: Role to values, shape (K,) each.
        units: Role to unit.
        notes: What was left out or assumed before.
        merged: Whether columns with times of their own became rows of one time.

    Raises:
        LogError: If too little is left.
    """
    columns = _keep_rising_rows(columns, notes)
    _join_rows_of_two_axes(columns, notes)
    time = columns["time"]
    balls = [columns[ball] for ball, _ in AXIS_COLUMNS.values() if ball in columns]
    ball = np.stack(balls, axis=-1)
    # of columns with times of their own two may be as close as it happens
    sampled_at = time[np.isfinite(ball).all(axis=-1)] if merged else time
    step = float(np.median(np.diff(sampled_at))) if len(sampled_at) > 1 else 0.0
    if len(time) < 50 or not 2e-5 < step < MAX_COMMAND_GAP_S:
        hint = "; milliseconds? give time=NAME:ms" if step >= MAX_COMMAND_GAP_S else ""
        raise LogError(
            f"{source}: {plural(len(time), 'usable row')}, {step:.3g} s apart: at least 50 are "
            f"needed, at most {MAX_COMMAND_GAP_S:g} s apart{hint}"
        )
    seen = columns.get("touched", np.ones_like(time)) > 0.5
    sampled = time - np.nan_to_num(columns.get("age", np.zeros_like(time)))
    seen &= np.isfinite(ball).all(axis=-1)
    if not seen.any():
        raise LogError(f"{source}: no row has a ball that is seen, with its whole position")
    middle = np.nanmedian(ball, axis=0)
    far = float(np.nanpercentile(np.abs(ball - middle), 99))
    # on a plate, and hardly moved from there: no other unit makes a moving ball of it
    resting = far < MIN_MOTION_M < np.abs(middle).max() < MAX_MOTION_M
    if far == 0 or resting:
        raise LogError(
            f"{source}: the ball does not move: it stays within {far:.3g} m of one place, and must "
            f"roll for {MIN_MOTION_M:g} m at least"
        )
    if not MIN_MOTION_M < far < MAX_MOTION_M:
        either = "the ball hardly moves, or " if far <= MIN_MOTION_M else ""
        raise LogError(
            f"{source}: the ball's positions lie within {far:.3g} m of their middle, a plate's "
            f"within {MIN_MOTION_M:g} to {MAX_MOTION_M:g} m: {either}give the unit, as "
            "measured_x=NAME:mm"
        )
    rows = np.flatnonzero(seen)
    repeats, period = find_held(ball[rows])
    if repeats.any() and "age" not in columns:
        seen[rows[repeats]] = False
        notes.append(
            f"the ball's position is new in one row of {period}: the rows between hold the last "
            "one, and are left out"
        )
    false = _find_false_samples(ball, seen, sampled)
    if false.any():
        notes.append(
            f"{plural(int(false.sum()), 'ball position')} left out: held, or far off their "
            "neighbours"
        )
    shown = np.flatnonzero(seen & ~false)
    if len(shown) < 10:
        raise LogError(
            f"{source}: the ball is seen in {plural(len(shown), 'row')}, too few to identify; "
            "record a longer log"
        )
    shown = shown[np.argsort(sampled[shown], kind="stable")]
    # rows of one frame, recognised by its age, are one sample
    shown = shown[np.diff(sampled[shown], prepend=-np.inf) > min(step / 2, 1e-4)]
    axes, tilts = {}, {}
    seen_along = {
        axis: columns[name][shown] for axis, (name, _) in AXIS_COLUMNS.items() if name in columns
    }
    for axis, place in seen_along.items():
        angle = AXIS_COLUMNS[axis][1]
        role = f"measured_{angle}" if f"measured_{angle}" in columns else f"command_{angle}"
        known = np.isfinite(columns[role])
        held, at = role.startswith("command"), sampled[shown]
        across = (_speed(at, e) for e in seen_along.values() if e is not place and not held)
        axes[axis] = AxisLog(time[known], columns[role][known], held, at, place, *across)
        tilts[axis] = units[role]
    return AnyLog(source, axes, tilts, tuple(notes))


def _keep_rising_rows(columns: Mapping[str, Array], notes: list[str]) -> dict[str, Array]:
    """Columns with the rows of a later time than all before, from zero on.

    Args:
        columns: Role to values, shape (K,) each.
        notes: Of the log, to which is added what was done.
    """
    there = np.isfinite(columns["time"])
    there[_begin_of_unfilled_end(columns) :] = False
    if unfilled := int(np.isfinite(columns["time"]).sum() - there.sum()):
        notes.append(f"{plural(unfilled, 'row')} at the end left out: all numbers are 0")
    columns = {role: values[there] for role, values in columns.items()}
    if not there.any():
        return columns
    false = _find_false_times(columns["time"])
    if false.any():
        notes.append(
            f"{plural(int(false.sum()), 'row')} left out: the time is far from both neighbours"
        )
    columns = {role: values[~false] for role, values in columns.items()}
    time: Array = columns["time"] - columns["time"][:1]
    back = np.flatnonzero(np.diff(time) < -MAX_COMMAND_GAP_S)
    for row in back:  # a clock that begins anew: a new part, after a gap
        time[row + 1 :] += time[row] - time[row + 1] + 10 * MAX_COMMAND_GAP_S
    if len(back):
        notes.append(
            f"the clock begins anew {plural(len(back), 'time')}: taken as parts of their own"
        )
    time = _spread_coarse_stamps(time, columns, notes)
    steps = np.delete(np.diff(time), back)
    gaps = steps[steps > MAX_COMMAND_GAP_S]
    if len(gaps):
        notes.append(
            f"{plural(len(gaps), 'gap')} of {gaps.sum():.3g} s in all without rows: nothing is "
            "fitted or predicted across one"
        )
    kept = np.concatenate(([True], np.diff(np.maximum.accumulate(time)) > 0))
    joined = _join_rows_of_one_time(time, kept, columns)
    if joined:
        notes.append(f"{plural(joined, 'row')} joined with the one before, of the same time")
    if (left := int((~kept).sum()) - joined) > 0:
        notes.append(f"{plural(left, 'row')} of a time that does not rise left out")
    return {role: values[kept] for role, values in (columns | {"time": time}).items()}


def _begin_of_unfilled_end(columns: Mapping[str, Array]) -> int:
    """The first of the rows at the end that are all 0, as of a table that was not filled.

    A single such row is kept.

    Args:
        columns: Role to values, shape (K,) each.
    """
    filled = np.flatnonzero(np.any([values != 0 for values in columns.values()], axis=0))
    count = len(columns["time"])
    begin = int(filled[-1]) + 1 if len(filled) else 0
    return begin if begin < count - 1 else count


def _find_false_times(time: Array) -> Mask:
    """Rows with a time far from both neighbours, which follow each other, shape (K,)."""
    before, here, after = time[:-2], time[1:-1], time[2:]
    follow = (after > before) & (after - before < MAX_COMMAND_GAP_S)
    far = (here < before - MAX_COMMAND_GAP_S) | (here > after + MAX_COMMAND_GAP_S)
    return np.pad(follow & far, 1)[: len(time)]


def _spread_coarse_stamps(time: Array, columns: Mapping[str, Array], notes: list[str]) -> Array:
    """Times of rows that share stamps nearly everywhere, as of a clock in whole seconds, spread.

    The first row of each stamp but the first keeps it, and the others follow evenly. Where rows
    lack a command, two of one time may be one row, and all stay: see ``_join_rows_of_one_time``.

    Args:
        time: Of the rows, s, shape (K,).
        columns: Role to values, shape (K,) each.
        notes: Of the log, to which is added what was done.
    """
    tilts = [columns[angle] for angle in columns if angle.endswith(("_phi", "_theta"))]
    whole = all(np.isfinite(values).mean() > MIN_WHOLE_SHARE for values in tilts)
    first = np.flatnonzero(np.diff(time, prepend=-np.inf) != 0)
    counts = np.diff(first)
    if len(first) < 4 or not whole or np.mean(counts > 1) < MIN_SHARED_STAMPS:
        return time
    apart = np.diff(time[first])
    usual = float(np.median(apart))
    step = usual / float(np.median(counts))
    # rows before a pause do not fill it, and the last stamp ends with the log
    steps = np.append(np.where(apart < MAX_STAMP_RATIO * usual, apart / counts, step), step)
    which = np.cumsum(np.diff(time, prepend=-np.inf) != 0) - 1
    spread = time + steps[which] * (np.arange(len(time)) - first[which])
    # the first stamp may begin earlier than the log
    early = np.arange(first[1])
    spread[early] = time[first[1]] - step * (first[1] - early)
    notes.append(
        f"about {np.median(counts):g} rows share each stamp of {usual:g} s: taken as evenly spread"
    )
    return np.asarray(spread)


def _join_rows_of_one_time(time: Array, kept: Mask, columns: dict[str, Array]) -> int:
    """Fill the empty cells of rows from later rows of the same time, in place; how many of these.

    Programs write what they measure and what they command as rows of their own.

    Args:
        time: Of the rows, s, shape (K,).
        kept: Rows of a later time than all before, shape (K,).
        columns: Role to values, shape (K,) each.
    """
    first = np.flatnonzero(kept)[np.cumsum(kept) - 1]
    again = np.flatnonzero(~kept & (time == time[first]))
    used = np.zeros(len(time), bool)
    for values in columns.values():
        fills = again[np.isfinite(values[again]) & ~np.isfinite(values[first[again]])]
        fills = fills[np.unique(first[fills], return_index=True)[1]]  # of several the earliest
        values[first[fills]] = values[fills]
        used[fills] = True
    return int(used.sum())


def _join_rows_of_two_axes(columns: dict[str, Array], notes: list[str]) -> None:
    """Take y at the times of x, in place, where hardly any row has both.

    Args:
        columns: Role to values, shape (K,) each, by rising time.
        notes: Of the log, to which is added what was done.
    """
    if not {"measured_x", "measured_y"} <= columns.keys():
        return
    x, y = (np.isfinite(columns[ball]) for ball in ("measured_x", "measured_y"))
    if (x & y).sum() >= MIN_SHARED_ROWS * min(x.sum(), y.sum()):
        return
    time = columns["time"]
    columns["measured_y"] = np.where(x, _interpolate(time, time, columns["measured_y"]), np.nan)
    notes.append("measured_y has rows of its own: taken at the times of measured_x")


def _speed(time: Array, place: Array) -> Array:
    """Times in s and speeds in m/s, 0 of a slow ball, shape (2, N).

    A speed is the slope of a parabola through the samples of ``SPEED_WINDOW_S``.
    """
    step = float(np.median(np.diff(time)))
    even = np.arange(time[0], time[-1], step)
    count = min(2 * round(SPEED_WINDOW_S / step / 2) + 3, (len(even) - 1) // 2 * 2 + 1)
    speed = scipy.signal.savgol_filter(np.interp(even, time, place), count, 2, deriv=1, delta=step)
    return np.stack((even, np.where(np.abs(speed) > REST_SPEED_M_S, np.abs(speed), 0.0)))


def _find_false_samples(ball: Array, seen: Mask, sampled: Array) -> Mask:
    """Samples that repeat an earlier one or show no ball, shape (K,).

    A reading that repeats before or after a jump is a value held while no ball was detected; a
    ball at rest does not jump. Up to four false ones in sequence are far off the median of their
    neighbours, and come or go at once; so is the ball where it turns, seen by a slow camera, but
    its velocity changes no faster than a ball accelerates.

    Args:
        ball: Positions in m, shape (K, A).
        seen: Rows with one, shape (K,).
        sampled: When they were taken, s, shape (K,).
    """
    false = np.zeros_like(seen)
    at = np.flatnonzero(seen)
    if len(at) < 9:
        return false
    here = ball[at]
    grid = max(resolution(here[:, axis]) for axis in range(here.shape[1]))
    usual = np.median(np.abs(np.diff(here, n=2, axis=0)), axis=0).max()
    turn = MAX_ACCELERATION_M_S2 * float(np.median(np.diff(sampled[at]))) ** 2
    jump = max(MIN_JUMP_M, 2.5 * grid, 8 * usual, turn / 2)
    step = np.concatenate((np.abs(np.diff(here, axis=0)).max(axis=1), [0.0]))
    for first, stop in runs(np.asarray(step[:-1] == 0)):
        after = step[stop]
        before = step[first - 1] if first else 0.0
        if stop - first >= 2 and max(before, after) > jump:
            false[at[first + (before <= jump) : stop + 1]] = True
    at = np.flatnonzero(seen & ~false)
    here = ball[at]
    off = np.abs(here - scipy.ndimage.median_filter(here, size=(9, 1), mode="nearest")).max(axis=1)
    far = np.asarray(off > np.maximum(jump, 3 * np.percentile(off, 90)))
    bend = np.abs(np.diff(here, n=2, axis=0, prepend=here[:1], append=here[-1:])).max(axis=1)
    for first, stop in runs(far):
        if bend[max(first - 1, 0) : stop + 1].max() > turn:
            false[at[first:stop]] = True
    return false
