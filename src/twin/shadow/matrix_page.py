"""The page that says how good the shadow is."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Sequence

import numpy as np
from scipy import stats

from twin.shadow import dead_time
from twin.shadow.alarms import THRESHOLD
from twin.shadow.horizon import MEDIAN
from twin.shadow.injections import AT, DURATION, HEALTHY, KINDS, RAMP
from twin.shadow.matrix import (
    CALIBRATED,
    HEALTHY_SCENARIOS,
    IN_TIME,
    INJECTED,
    JUDGED,
    Trial,
    bounds,
    hours_between_alarms,
    inside,
    interval,
)

UNEVEN = (0, 2.5, 5, 10, 15, 20.1)
"""Percent by which screens are uneven, between which replays are told apart."""
GOALS = 4
"""Kinds, the first ones, that have goals."""


def page(found: Sequence[Trial], command: str) -> str:
    """The page in Markdown.

    Args:
        found: What was said of every rig.
        command: That makes this page.
    """
    learned = [each for each in found if CALIBRATED <= each.seed < JUDGED]
    judged = [each for each in found if JUDGED <= each.seed < INJECTED]
    lines = [
        "# How good the shadow is",
        "",
        f"Made by `{command}`; every number comes from simulated rigs (the mechanism, everything "
        "on) of which the truth is known. Healthy rigs are drawn from the family `uncertain` "
        "(friction, uneven screens, level, drives, play, cams, screen clocks); those that "
        "something happens to are like the one the project describes, friction, breakaway, dead "
        "time and level drawn. The twin of each knows it but for the errors of an "
        "identification. Shares in percent with their 95 % interval (Clopper and Pearson). The "
        "alarms' thresholds, and by how much a healthy rig may scatter and drift, were chosen on "
        "rigs that are not counted here.",
        "",
        "## Against the goals",
        "",
        *goals(found, judged),
        "",
        "## Healthy rigs",
        "",
        *_healthy(found, learned, judged),
        "",
        "## Rigs that something happens to",
        "",
        f"While the ball follows the path of `excite`; at 20 s, half of them along a ramp of "
        f"{RAMP:g} s where there can be one. In time: an alarm within {IN_TIME:g} s of the "
        "complete change. Right: the right cause is named, or among those not told apart; wrong: "
        "it is not. Early: a false alarm, before anything had happened. After: seconds from the "
        "complete change by which half and 95 % of the others have had their alarm, if they have.",
        "",
        "| what happens | rigs | alarm in time [%] | right, of these [%] | wrong [%] | early | "
        "after [s] |",
        "|---|--:|--:|--:|--:|--:|--:|",
        *[_row(kind.name, [each for each in found if each.kind == kind]) for kind in KINDS],
        "",
        "## What each is held to be",
        "",
        "The most probable cause of the first alarm, if it came in time.",
        "",
        *_confusion(found),
        "",
    ]
    return "\n".join(lines)


def _early(some: Sequence[Trial]) -> list[Trial]:
    """Those with an alarm before anything had happened."""
    return [each for each in some if each.alarm is not None and each.alarm < AT]


def _false(judged: Sequence[Trial], changed: Sequence[Trial]) -> list[tuple[int, float]]:
    """False alarms, and in how many hours: healthy rigs, and others before something happens."""
    alarms = sum(each.alarm is not None for each in judged)
    early = len(_early(changed)), len(changed) * AT / 3600
    return [(alarms, len(judged) * DURATION / 3600), early]


def _counted(alarms: int, hours: float) -> str:
    low, high = rates(alarms, hours)
    return f"{alarms} in {hours:.2f} h ({low:.2f} to {high:.2f} per hour)"


def _healthy(
    found: Sequence[Trial], learned: Sequence[Trial], judged: Sequence[Trial]
) -> list[str]:
    every, late = (
        hours_between_alarms([each.largest[test] for each in learned], threshold, DURATION)
        for test, threshold in enumerate((THRESHOLD, dead_time.THRESHOLD))
    )
    both = 1 / (1 / every + 1 / late)
    squares = np.concatenate([each.squares for each in judged])
    errors = np.concatenate([each.errors for each in judged])
    changed = [each for each in found if each.kind != HEALTHY]
    others, before = (_counted(*each) for each in _false(judged, changed))
    return [
        f"Scenarios {', '.join(HEALTHY_SCENARIOS)} by turns, {DURATION:g} s each; the rate is "
        f"worked out from {len(learned)} rigs, everything else judged on {len(judged)} others. Of "
        "an uneven screen the twin knows how uneven it is; the friction of a place it learns when "
        "the ball has been there, which is always before the start of a replay.",
        "",
        "| | |",
        "|---|--:|",
        f"| hours between false alarms, by the extreme-value fit | {_short(both)} |",
        f"| of the test of all causes alone | {_short(every)} |",
        f"| of the test of the dead time alone | {_short(late)} |",
        f"| false alarms on the others | {others} |",
        f"| false alarms on the rigs below, before anything happens to them | {before} |",
        f"| median score (1: as predicted) | {np.sqrt(np.median(squares) / MEDIAN):.2f} |",
        f"| replays of 1 s inside their 95 % band | {inside(judged):.1f} % of {len(squares)} |",
        f"| replay error after 1 s, median | {1000 * np.median(errors):.2f} mm |",
        *[_by_screen(judged, *between) for between in itertools.pairwise(UNEVEN)],
    ]


def _by_screen(judged: Sequence[Trial], least: float, most: float) -> str:
    """The replay error on screens of some unevenness in percent."""
    some = [each.errors for each in judged if least <= each.uneven < most]
    errors = np.concatenate([np.zeros(0), *some])
    median = f"{1000 * np.median(errors):.2f} mm" if len(errors) else "-"
    return f"| on screens uneven by {least:g} to {most:g} % ({len(some)} rigs), median | {median} |"


def rates(alarms: int, hours: float) -> tuple[float, float]:
    """The exact 95 % interval of a rate per hour (Poisson)."""
    low = stats.chi2.ppf(0.025, 2 * alarms) / 2 if alarms else 0.0
    return float(low) / hours, float(stats.chi2.ppf(0.975, 2 * alarms + 2)) / 2 / hours


def goals(found: Sequence[Trial], judged: Sequence[Trial]) -> list[str]:
    """What was to be reached, what was, and whether so few rigs can tell."""
    lines = ["| goal | reached | |", "|---|--:|---|"]

    def share(name: str, hits: int, count: int, least: float = 0.0, most: float = 100.0) -> None:
        if count == 0:
            lines.append(f"| {name} | - | no rig |")
            return
        low, high = bounds(hits, count)
        word = "too few rigs to tell"
        if low >= least and high <= most:
            word = "met"
        elif high < least or low > most:
            word = "**not met**"
        lines.append(f"| {name} | {interval(hits, count)} % of {count} | {word} |")

    for kind in KINDS[:GOALS]:
        own = [each for each in found if each.kind == kind]
        rest = [each for each in own if each.alarm is None or each.alarm >= AT]
        timely = [each for each in rest if each.in_time]
        right = sum(each.named for each in timely)
        share(f"alarm in time for 95 %: {kind.name}", len(timely), len(rest), least=95)
        share(f"right cause in 90 %: {kind.name}", right, len(timely), least=90)
        share(f"wrong cause below 3 %: {kind.name}", len(timely) - right, len(timely), most=3)
    changed = [each for each in found if each.kind != HEALTHY]
    alarms, hours = (sum(each) for each in zip(*_false(judged, changed), strict=True))
    low, high = rates(int(alarms), hours)
    word = "met" if high < 1 / 24 else "**not met**" if low > 1 / 24 else "too few hours to tell"
    lines.append(
        f"| healthy: less than one false alarm in 24 h | {24 * alarms / hours:.2g} "
        f"({24 * low:.2g} to {24 * high:.2g}) in 24 h | {word} |"
    )
    error = 1000 * float(np.median(np.concatenate([each.errors for each in judged])))
    word = "met" if error <= 1 else "**not met**"
    lines.append(
        f"| healthy: replay error at 1 s at most 1 mm (median) | {error:.2f} mm | {word} |"
    )
    within = inside(judged)
    word = "met" if 93 <= within <= 97 else "**not met**"
    lines.append(f"| healthy: 93 to 97 % inside the 95 % band | {within:.1f} % | {word} |")
    return lines


def _short(hours: float) -> str:
    return f"{hours:.3g}" if hours < 1e4 else "more than 10000"


def _row(name: str, some: Sequence[Trial]) -> str:
    early = _early(some)
    rest = [each for each in some if each not in early]
    timely = [each for each in rest if each.in_time]
    right = sum(each.named for each in timely)
    return (
        f"| {name} | {len(some)} | {interval(len(timely), len(rest))} | "
        f"{interval(right, len(timely))} | {interval(len(timely) - right, len(timely))} | "
        f"{len(early)} | {_after(rest)} |"
    )


def _after(some: Sequence[Trial]) -> str:
    """Seconds from the complete change to the alarm, for half and 95 % of the rigs."""
    if not some:
        return "-"
    late = np.array([np.inf if each.alarm is None else each.alarm - each.complete for each in some])
    half, most = np.quantile(late, (0.5, 0.95), method="inverted_cdf")
    return ", ".join("never" if np.isinf(each) else f"{each:.0f}" for each in (half, most))


def _confusion(found: Sequence[Trial]) -> list[str]:
    rows = {
        kind.name: Counter(
            each.causes[0] if each.in_time and each.causes else "no alarm in time"
            for each in found
            if each.kind == kind
        )
        for kind in KINDS
    }
    columns = sorted({cause for row in rows.values() for cause in row})
    return [
        f"| | {' | '.join(columns)} |",
        f"|---|{'--:|' * len(columns)}",
        *[
            f"| {name} | {' | '.join(str(row[cause]) if row[cause] else '' for cause in columns)} |"
            for name, row in rows.items()
        ],
    ]
