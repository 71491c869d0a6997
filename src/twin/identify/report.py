"""Writes an identification: the HTML report with its figures, and a parameter file."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from twin.base import page
from twin.base.errors import plural
from twin.base.page import Block, Picture, Table, Text, Verdict, digits
from twin.base.writing import write_whole
from twin.identify.verdicts import (
    BOUNDED_VERDICT,
    GIVEN_VERDICT,
    IDENTIFIED_VERDICT,
    NOT_IDENTIFIABLE,
    PLAIN_VERDICT,
    PREDICTOR_NAMES,
    REJECTED_VERDICT,
    HoldOutPrediction,
    Identification,
    PredictionScore,
)
from twin.run.picture import RUN_COLOURS, styled_figure

TABLE_HEADINGS = ("parameter", "value", "95 % interval", "unit", "verdict")
BASELINE_NAMES = {"stays": "a ball that stays", "goes on": "one that goes on at its velocity"}
LEVEL_FOLLOWED = "level followed"
UNFITTED_AXIS_NOTE = "not identified: "
"""Beginning of the note on an axis without a full fit; axis and reason follow."""
WORSE_SHARE = 0.02
"""Share by which a model may be worse than a baseline before the report mentions it."""

MIN_WINDOWS = 5
"""Windows in which the ball moves below which predictions are not compared with no model."""
MIN_HELD_OUT_S = 6
"""Time in s of a moving ball that has so many: they begin every half second, after 2.4 s, and end 1
s later."""


def sentences(found: Identification) -> list[str]:
    """The verdict in words: what the model predicts, then what is known of its parameters."""
    words = list(_describe_scores(found))
    for heading, among in (
        ("Identified", (IDENTIFIED_VERDICT,)),
        ("Of a plain model, with wide intervals", (PLAIN_VERDICT,)),
        (
            "Best fit only, as the log rejects the model: no error is known",
            (REJECTED_VERDICT,),
        ),
        ("Not identified from this log", (BOUNDED_VERDICT, NOT_IDENTIFIABLE)),
        ("Held at its given value, not fitted", (GIVEN_VERDICT,)),
    ):
        labels = [each.label for each in found.verdicts if each.word in among]
        names = [each.removeprefix("plant.").removeprefix("sensors.") for each in labels]
        if names:
            words.append(f"{heading}: {', '.join(names)}.")
    return [*words, *found.remarks]


def _describe_scores(found: Identification) -> Iterator[str]:
    """The errors of the model on the held-out part, in sentences."""
    ahead = found.how.horizons_s.index(1.0)
    for each in found.scores:
        name = "both axes together" if len(each.axes) > 1 else each.axes
        if not each.windows:
            yield f"Held-out part, {name}: the ball moves nowhere, so no error can be given."
            continue
        short = each.known[ahead] < MIN_WINDOWS
        if short:
            yield (
                f"Held-out part, {name}: too short to show how well the model predicts: it has "
                f"{plural(each.known[ahead], 'window')} in which the ball moves and is seen after "
                f"1 s, at least {MIN_WINDOWS} are needed. Record for longer, so that the ball "
                f"moves for {MIN_HELD_OUT_S} s of what is held out, or hold out a second log."
            )
        if not each.known[ahead]:
            continue
        off = {who: 1000 * each.median[who][ahead] for who in each.median}
        level = (
            f"{off[LEVEL_FOLLOWED]:.1f} mm with a level that is followed, "
            if LEVEL_FOLLOWED in off
            else ""
        )
        yield (
            f"On what was held out, {name}: {off['model']:.1f} mm off after 1 s (median of "
            f"{plural(each.known[ahead], 'window')} in which the ball moves; 90 % within "
            f"{1000 * each.ninety['model'][ahead]:.1f} mm), {level}"
            f"{off['without friction']:.1f} mm without friction; a ball that stays "
            f"{off['stays']:.1f} mm, one that goes on {off['goes on']:.1f} mm."
        )
        if short:
            continue
        models = [who for who in PREDICTOR_NAMES[:2] if who in each.median]
        lost = {who: set(_find_lost_horizons(each, who, found.how)) for who in models}
        if both := set.intersection(*lost.values()):
            how_far = _describe_losses(each, "model", both, found.how)
            yield (
                f"WORSE THAN NO MODEL, {name}: {how_far}. Do not predict this rig by it so far "
                "ahead."
            )
        elif lost["model"]:
            how_far = _describe_losses(each, "model", lost["model"], found.how)
            yield f"{name}: follow the level: without, {how_far}."
        elif lost.get(LEVEL_FOLLOWED):
            how_far = _describe_losses(each, LEVEL_FOLLOWED, lost[LEVEL_FOLLOWED], found.how)
            yield f"{name}: do not follow the level: with it, {how_far}."
    if not found.scores:
        yield "Nothing was held out that could judge it: no stretch of 3 s with the ball seen."


def _find_lost_horizons(score: PredictionScore, who: str, how: HoldOutPrediction) -> Iterator[int]:
    """Indices of the horizons at which the better baseline has a smaller error than a model.

    Of horizons with enough windows.
    """
    for k in range(len(how.horizons_s)):
        least = min(score.median[baseline][k] for baseline in BASELINE_NAMES)
        if score.known[k] >= MIN_WINDOWS and score.median[who][k] > (1 + WORSE_SHARE) * least:
            yield k


def _describe_losses(
    score: PredictionScore, who: str, lost: Collection[int], how: HoldOutPrediction
) -> str:
    """The errors of the better baseline and of a model at some horizons, by their indices."""
    parts = []
    for k in sorted(lost):
        best = min(BASELINE_NAMES, key=lambda who: score.median[who][k])
        least, own = 1000 * score.median[best][k], 1000 * score.median[who][k]
        parts.append(
            f"after {how.horizons_s[k]:g} s {BASELINE_NAMES[best]} is {least:.1f} mm off, the "
            f"model {own:.1f} mm"
        )
    return "; ".join(parts)


def _held_out(found: Identification) -> list[Block]:
    """The held-out part, as a table and in pictures."""
    if not found.scores:
        return []
    heads = ["axes", "by"]
    for ahead in found.how.horizons_s:
        heads += [f"{ahead:g} s, median [mm]", f"{ahead:g} s, 90 % [mm]"]
    rows = [
        (
            " and ".join(each.axes),
            who,
            *(
                digits(1000 * table[who][k]) if math.isfinite(table[who][k]) else "-"
                for k in range(len(found.how.horizons_s))
                for table in (each.median, each.ninety)
            ),
        )
        for each in found.scores
        for who in each.median
    ]
    note = (
        f"Where the ball moves by more than {1000 * found.how.min_motion_m:g} mm. Every prediction "
        "begins with what 0.4 s before show of place and velocity."
    )
    if LEVEL_FOLLOWED in found.scores[0].median:
        note += (
            " The level is followed only while that has predicted better in what was seen by then."
        )
    out: list[Block] = [Table("Prediction of what was held out", heads, rows, (0, 1), note=note)]
    if found.predictions:
        out.append(Picture("The median window after 1 s", _prediction_figure(found)))
    return out


def rows(found: Identification) -> list[tuple[str, str, str, str, str]]:
    """The verdicts as a table under ``HEADS``."""
    return [
        (each.label, digits(each.value), each.interval, each.about.unit, each.word)
        for each in found.verdicts
    ]


def labels_by_reason(found: Identification) -> dict[str, list[str]]:
    """What is wrong with parameters, each reason with the labels of all that have it."""
    return {
        why: [each.label for each in found.verdicts if each.why == why]
        for why in dict.fromkeys(each.why for each in found.verdicts if each.why)
    }


def reasons(found: Identification) -> list[str]:
    """What is wrong with parameters, in words; each reason once."""
    return [f"{', '.join(labels)}: {why}" for why, labels in labels_by_reason(found).items()]


def further_notes(found: Identification) -> list[str]:
    """The notes, without those that repeat a reason of the parameters."""
    whys = labels_by_reason(found)

    def repeats(note: str) -> bool:
        reason = note.partition(UNFITTED_AXIS_NOTE)[2].partition(": ")[2]
        return bool(reason) and any(why.endswith(reason) for why in whys)

    return [note for note in found.notes if not repeats(note)]


def parameters(found: Identification, words: tuple[str, ...] = (IDENTIFIED_VERDICT,)) -> str:
    """Parameters as TOML that a scenario may name, those with one of these verdicts."""
    lines = [
        f"# Identified from {found.source} by `ballplate identify`; a scenario takes it by",
        '# parameters = "this file", a run by --set parameters=FILE.',
        *(f"{key} = {value}" for key, value in sorted(found.settings(words).items())),
    ]
    return "\n".join(lines) + "\n"


def write(found: Identification, folder: Path) -> None:
    """Write report.html and, if anything was identified, parameters.toml.

    Raises:
        RecordError: If a file cannot be written.
    """
    good = any(each.word == IDENTIFIED_VERDICT for each in found.verdicts)
    first = {why: labels[0] for why, labels in labels_by_reason(found).items()}
    verdicts = [
        (*row, each.why if first.get(each.why, row[0]) == row[0] else f"as for {first[each.why]}")
        for row, each in zip(rows(found), found.verdicts, strict=True)
    ]
    blocks: list[Block] = [
        Verdict(sentences(found), good),
        Table(
            "Parameters",
            (*TABLE_HEADINGS, "why, and what would show it"),
            verdicts,
            words=(0, 3, 4, 5),
            note="Intervals: wild bootstrap over the windows of the fitted part. Fitted jointly "
            "with the ball's start in every window.",
        ),
        *_held_out(found),
        Text([found.extent, *further_notes(found)], "The log"),
    ]
    page.write(folder / "report.html", f"Identification from {found.source}", blocks)
    if good:
        write_whole(folder / "parameters.toml", parameters(found))


def _prediction_figure(found: Identification) -> Figure:
    axes = found.predictions
    with styled_figure(12, 4) as figure:
        panels = figure.subplots(1, len(axes), squeeze=False)[0]
        for panel, (axis, each) in zip(panels, axes.items(), strict=True):
            errors = np.abs(each.errors("model", 1.0))
            errors[~each.moves] = np.nan
            if not np.isfinite(errors).any():
                continue
            w = int(np.nanargmin(np.abs(errors - np.nanmedian(errors))))
            seen = np.isfinite(each.ball[w])
            ahead = each.ahead[w, seen]
            panel.plot(ahead, 1000 * each.ball[w, seen], ".", color="0.4", ms=4)
            models = [who for who in PREDICTOR_NAMES[:3] if who in each.by]
            for colour, who in zip(RUN_COLOURS, models, strict=False):
                panel.plot(ahead, 1000 * each.by[who][w, seen], color=colour, label=who)
            panel.axvline(0, color="0.5", lw=1, ls=":")
            panel.set_title(f"{axis}: {1000 * errors[w]:.1f} mm, at {each.begin[w]:.1f} s")
            panel.legend(fontsize=8)
        figure.supxlabel("seconds ahead")
        figure.supylabel("position [mm]")
    return figure
