"""What is written of an identification: the HTML report with its figures, and a parameter file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from twin.identify import any_report
from twin.identify.any_rig import AnyIdentification
from twin.identify.identify import Identification
from twin.identify.search import BestFit
from twin.identify.verdict import (
    BOUNDED,
    IDENTIFIED,
    NOT,
    REJECTED,
    Horizons,
    ParameterVerdict,
    Whiteness,
)
from twin.identify.windows import LOOKBACK
from twin.page import Block, Picture, Table, Text, Verdict, digits, html
from twin.run.picture import COLOURS, drawn
from twin.writing import write_whole

SHOWN = 6
"""This many windows of the fit are drawn."""
HEADS = ("parameter", "value", "95 % interval", "unit", "verdict")


Found = Identification | AnyIdentification
"""What a log shows, of a rig like the twin's or of any."""


def sentences(found: Found) -> list[str]:
    """The verdict in words."""
    words = []
    for said, among in (
        ("Identified", (IDENTIFIED,)),
        ("Fitted, but the log rejects the model, so that no error is known", (REJECTED,)),
        ("Not identified from this log", (BOUNDED, NOT)),
    ):
        names = dict.fromkeys(
            each.about.name if isinstance(found, Identification) else _name(each)
            for each in found.verdicts
            if each.word in among
        )
        if names:
            words.append(f"{said}: {', '.join(names)}.")
    if isinstance(found, AnyIdentification):
        return [*words, *any_report.judged(found)]
    horizons = found.horizons
    if horizons is not None:
        k = int(abs(horizons.ahead - 1.0).argmin())
        if not math.isnan(horizons.twin[k]):
            words.append(
                f"On what was held out, a replay is {1000 * horizons.twin[k]:.2f} mm off after "
                f"{horizons.ahead[k]:g} s (median of {horizons.replays[k]}); without friction it "
                f"would be {1000 * horizons.frictionless[k]:.1f} mm, and a ball that stays "
                f"{1000 * horizons.still[k]:.1f} mm."
            )
    words.append(found.whiteness.words[0].upper() + found.whiteness.words[1:] + ".")
    return words


def page(found: Found) -> str:
    """The report as one HTML file."""
    verdicts = [(*row, each.why) for row, each in zip(rows(found), found.verdicts, strict=True)]
    blocks: list[Block] = [
        Verdict(sentences(found), any(each.word == IDENTIFIED for each in found.verdicts)),
        Table(
            "Parameters",
            (*HEADS, "why, and what would show it"),
            verdicts,
            words=(0, 3, 4, 5),
            note="Intervals: wild bootstrap over the windows of the fitted part. Fitted jointly "
            "with the ball's start in every window.",
        ),
    ]
    if isinstance(found, AnyIdentification):
        log = f"{found.log.source}: {found.seconds:.1f} s were fitted."
        blocks += [*any_report.blocks(found), Text([log, *found.notes], "The log")]
        return html(f"Identification from {found.log.source}", blocks)
    if found.horizons is not None:
        blocks += _held_out(found.horizons)
    note = "Windows of the fitted part, the ball as measured (points) and replayed (lines)."
    log = (
        f"{found.log.source}: {found.log.length:.1f} usable seconds, of which "
        f"{found.fitted_time:.1f} were fitted, in {len(found.fit.problem.windows)} windows; "
        f"{found.fit.termination}."
    )
    white = f"{found.whiteness.words}."
    blocks += [
        Picture("Fit", _fit_figure(found.fit), note),
        Picture("What is left over", _white_figure(found.whiteness), white),
        Text([log, *found.notes], "The log"),
    ]
    return html(f"Identification from {found.log.source}", blocks)


def _held_out(horizons: Horizons) -> list[Block]:
    """How a replay fares on what was held out, drawn and as a table."""
    compared = ("fitted twin [mm]", "frictionless twin [mm]", "ball stays [mm]")
    errors = (horizons.twin, horizons.frictionless, horizons.still)
    rows = [
        (f"{ahead:g}", *(f"{1000 * error[k]:.2f}" for error in errors), str(horizons.replays[k]))
        for k, ahead in enumerate(horizons.ahead)
    ]
    note = (
        "Median distance between replayed and measured ball; the screen's noise alone makes "
        f"{1000 * horizons.noise:.2f} mm of it."
    )
    return [
        Picture("Replay of what was held out", _horizon_figure(horizons)),
        Table("", ("ahead [s]", *compared, "replays"), rows, note=note),
    ]


def rows(found: Found) -> list[tuple[str, str, str, str, str]]:
    """The verdicts as a table under ``HEADS``."""
    return [
        (_name(each), digits(each.value), interval(each), each.about.unit, each.word)
        for each in found.verdicts
    ]


def parameters(found: Found, words: tuple[str, ...] = (IDENTIFIED,)) -> str:
    """Parameters as TOML that a scenario may name, those with one of these verdicts."""
    tables: dict[str, list[str]] = {}
    levels: dict[str, ParameterVerdict] = {}
    if isinstance(found, AnyIdentification):
        for key, value in any_report.settings(found).items():
            table, _, name = key.rpartition(".")
            tables.setdefault(table, []).append(f"{name} = {value}")
    for each in () if isinstance(found, AnyIdentification) else found.verdicts:
        if each.word not in words or each.value is None:
            continue
        if each.name.startswith("level_"):
            levels[each.name] = each
            continue
        table, _, name = each.about.key.rpartition(".")
        line = f"{name} = {each.value:.6g}  # {interval(each)}, 95 %"
        tables.setdefault(table, []).append(line)
    if levels:
        pair = [levels.get(name) for name in ("level_phi", "level_theta")]
        values = ", ".join("0.0" if each is None else f"{each.value:.6g}" for each in pair)
        ends = "; ".join("unknown" if each is None else interval(each) for each in pair)
        tables.setdefault("plant", []).append(f"level_deg = [{values}]  # {ends}, 95 %")
    lines = [
        f"# Identified from {found.log.source} by `ballplate identify`; a scenario takes it by",
        '# parameters = "this file", a run by --set parameters=FILE.',
    ]
    for table in sorted(tables):
        lines += ["", f"[{table}]", *tables[table]]
    return "\n".join(lines) + "\n"


def write(found: Found, folder: Path) -> None:
    """Write report.html and, if anything was identified, parameters.toml.

    Raises:
        RecordError: If a file cannot be written.
    """
    write_whole(folder / "report.html", page(found))
    if any(each.word == IDENTIFIED for each in found.verdicts):
        write_whole(folder / "parameters.toml", parameters(found))


def interval(each: ParameterVerdict) -> str:
    """Its interval in words."""
    if each.low is None and each.high is None:
        return "-"
    if each.high is None:
        return f"above {digits(each.low)}"
    return f"{digits(each.low)} to {digits(each.high)}"


def _name(each: ParameterVerdict) -> str:
    axis = each.name.rpartition("_")[2]
    axis = f" ({axis})" if axis in ("phi", "theta", "x", "y") else ""
    return each.about.key + axis


def _horizon_figure(horizons: Horizons) -> Figure:
    """Replay error against horizon with its baselines, and one replay."""
    with drawn(12, 4) as figure:
        left, right = figure.subplots(1, 2)
        for name, values, colour in (
            ("fitted twin", horizons.twin, COLOURS[0]),
            ("frictionless twin", horizons.frictionless, COLOURS[1]),
            ("ball stays", horizons.still, COLOURS[2]),
        ):
            left.loglog(horizons.ahead, 1000 * values, "o-", color=colour, label=name, ms=4)
        left.axhline(1000 * horizons.noise, color="0.5", lw=1, ls="--", label="screen's noise")
        left.set(
            xlabel="seconds ahead", ylabel="median distance [mm]", title="Replay error, held out"
        )
        left.legend(fontsize=8)
        time, measured, replayed = horizons.example
        for axis, name in enumerate("xy"):
            right.plot(time, 1000 * measured[:, axis], ".", color=COLOURS[axis], ms=3, alpha=0.6)
            right.plot(time, 1000 * replayed[:, axis], color=COLOURS[axis], lw=1.2, label=name)
        right.axvline(0, color="0.5", lw=1, ls=":")
        right.set(
            xlabel="seconds ahead of the last sample used",
            ylabel="position [mm]",
            title="A median one of them",
        )
        right.legend(fontsize=8)
    return figure


def _fit_figure(fit: BestFit) -> Figure:
    """Some windows of the fit, evenly chosen."""
    windows = fit.problem.windows
    theta = fit.theta[None]
    delay = np.full((1, 1), fit.theta[fit.problem.names.index("delay")])
    replayed = windows.at_samples(*fit.problem.replayed(theta, fit.starts), delay)[0][0]
    chosen = np.unique(np.linspace(0, len(windows) - 1, SHOWN).round().astype(int))
    with drawn(12, 5) as figure:
        panels = figure.subplots(2, 3).ravel()
        for panel, which in zip(panels, chosen, strict=False):
            there = windows.weight[which, :, 0] > 0
            time = windows.begin[which] + windows.time[which, there]
            for axis, name in enumerate("xy"):
                ball = 1000 * windows.ball[which, there, axis]
                panel.plot(time, ball - ball[0], ".", color=COLOURS[axis], ms=3, alpha=0.6)
                way = 1000 * replayed[which, there, axis] - ball[0]
                panel.plot(time, way, color=COLOURS[axis], lw=1.2, label=name)
            rest = "begun at rest" if windows.resting[which] else "begun in roll"
            panel.set_title(f"{time[0] - LOOKBACK:.1f} s, {rest}", fontsize=9)
        for panel in panels[len(chosen) :]:
            panel.set_axis_off()
        panels[0].legend(fontsize=8)
        figure.supxlabel("time [s]", fontsize=10)
        figure.supylabel("position [mm]", fontsize=10)
    return figure


def _white_figure(whiteness: Whiteness) -> Figure:
    """Autocorrelation of the residuals with its band."""
    with drawn(12, 2.6) as figure:
        panel = figure.subplots()
        lags = 1 + np.arange(len(whiteness.correlation))
        panel.bar(lags, whiteness.correlation, width=0.5, color=COLOURS[0])
        panel.axhspan(-whiteness.band, whiteness.band, color="0.85", zorder=0)
        panel.set(
            xlabel="lag [samples of 16 ms]",
            ylabel="correlation",
            title="Autocorrelation of the residuals; 95 % of white ones within the band",
        )
    return figure
