"""The page that says how good the shadow is."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np

from twin.shadow.alarms import THRESHOLD
from twin.shadow.horizon import MEDIAN
from twin.shadow.injections import DURATION, HEALTHY, KINDS, RAMP
from twin.shadow.matrix import (
    CALIBRATED,
    HEALTHY_SCENARIOS,
    IN_TIME,
    INJECTED,
    JUDGED,
    Trial,
    hours_between_alarms,
    inside,
    interval,
)


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
        "on) of which the truth is known. Each rig is drawn at random (friction, breakaway, dead "
        "time, level), and its twin knows it but for the errors of an identification. Shares in "
        "percent with their 95 % interval.",
        "",
        "## Healthy rigs",
        "",
        *_healthy(learned, judged),
        "",
        "## Rigs that something happens to",
        "",
        f"While the ball follows the path of `excite`; at 20 s, half of them along a ramp of "
        f"{RAMP:g} s where there can be one. In time: an alarm within {IN_TIME:g} s of the "
        "complete change. Right: the right cause is named, or among those not told apart; wrong: "
        "it is not. Early: an alarm before anything had happened.",
        "",
        "| what happens | rigs | alarm in time [%] | right, of these [%] | wrong [%] | early |",
        "|---|--:|--:|--:|--:|--:|",
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


def _healthy(learned: Sequence[Trial], judged: Sequence[Trial]) -> list[str]:
    hours = len(judged) * DURATION / 3600
    alarms = sum(each.alarm is not None for each in judged)
    rate = hours_between_alarms([each.largest for each in learned], THRESHOLD, DURATION)
    squares = np.concatenate([each.squares for each in judged])
    errors = np.concatenate([each.errors for each in judged])
    # none in this time: with 95 % confidence at most three
    most = -np.log(0.05) / hours if alarms == 0 else float("nan")
    said = f"{alarms} in {hours:.2f} h" + (f" (below {most:.1f} per hour)" if alarms == 0 else "")
    return [
        f"Scenarios {', '.join(HEALTHY_SCENARIOS)} by turns, {DURATION:g} s each; the rate is "
        f"worked out from {len(learned)} rigs, everything else judged on {len(judged)} others.",
        "",
        "| | |",
        "|---|--:|",
        f"| hours between false alarms, by the extreme-value fit | {_short(rate)} |",
        f"| false alarms on the others | {said} |",
        f"| median score (1: as predicted) | {np.sqrt(np.median(squares) / MEDIAN):.2f} |",
        f"| replays of 1 s inside their 95 % band | {inside(judged):.1f} % of {len(squares)} |",
        f"| replay error after 1 s, median | {1000 * np.median(errors):.2f} mm |",
    ]


def _short(hours: float) -> str:
    return f"{hours:.3g}" if hours < 1e4 else "more than 10000"


def _row(name: str, some: Sequence[Trial]) -> str:
    early = [each for each in some if each.alarm is not None and each.alarm < 20.0]
    rest = [each for each in some if each not in early]
    timely = [each for each in rest if each.in_time]
    right = sum(each.named for each in timely)
    return (
        f"| {name} | {len(some)} | {interval(len(timely), len(rest))} | "
        f"{interval(right, len(timely))} | {interval(len(timely) - right, len(timely))} | "
        f"{len(early)} |"
    )


def _confusion(found: Sequence[Trial]) -> list[str]:
    rows = {
        kind.name: Counter(
            each.causes[0] if each.in_time and each.causes else "no alarm in time"
            for each in found
            if each.kind == kind
        )
        for kind in KINDS
        if kind != HEALTHY
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
