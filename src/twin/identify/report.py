"""What is written of an identification: HTML report, parameter file, numbers for programs."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from twin.html import inline, render
from twin.identify.figures import fit_figure, horizon_figure, white_figure
from twin.identify.identify import Identification
from twin.identify.verdict import IDENTIFIED, Verdict
from twin.run.record import write_whole


def summary(found: Identification) -> dict[str, Any]:
    """The numbers, for ``--json``."""
    horizons = found.horizons
    ahead = None
    if horizons is not None:
        ahead = {
            name: [None if math.isnan(v) else float(v) for v in getattr(horizons, name)]
            for name in ("ahead", "twin", "frictionless", "still")
        } | {"noise": horizons.noise}
    return {
        "log": found.data.source,
        "usable_seconds": found.data.length,
        "fitted_seconds": found.fitted_time,
        "parameters": [each.as_dict() for each in found.verdicts],
        "replay_error": ahead,
        "residuals": {
            "misfit": found.whiteness.misfit,
            "lags_outside": found.whiteness.outside,
            "words": found.whiteness.words,
        },
        "notes": list(found.notes),
    }


def sentences(found: Identification) -> list[str]:
    """The verdict in words."""
    good = [each.about.name for each in found.verdicts if each.word == IDENTIFIED]
    rest = [each.about.name for each in found.verdicts if each.word != IDENTIFIED]
    words = []
    if good:
        words.append(f"Identified: {', '.join(dict.fromkeys(good))}.")
    if rest:
        words.append(f"Not identified from this log: {', '.join(dict.fromkeys(rest))}.")
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


def page(found: Identification) -> str:
    """The report as one HTML file."""
    horizons = found.horizons
    rows = [
        {
            "key": _name(each),
            "value": digits(each.value),
            "interval": interval(each),
            "unit": each.about.unit,
            "verdict": each.word,
            "why": each.why,
        }
        for each in found.verdicts
    ]
    steps = []
    if horizons is not None:
        steps = [
            (f"{ahead:g}", *(f"{1000 * value:.2f}" for value in values), str(count))
            for ahead, *values, count in zip(
                horizons.ahead,
                horizons.twin,
                horizons.frictionless,
                horizons.still,
                horizons.replays,
                strict=True,
            )
        ]
    return render(
        "identify/report.html.j2",
        title=f"Identification from {found.data.source}",
        good=any(each.word == IDENTIFIED for each in found.verdicts),
        sentences=sentences(found),
        rows=rows,
        horizons=steps,
        horizon_figure=inline(horizon_figure(horizons)) if horizons is not None else "",
        noise=f"{1000 * horizons.noise:.2f}" if horizons is not None else "",
        fit_figure=inline(fit_figure(found.fit)),
        white_figure=inline(white_figure(found.whiteness)),
        whiteness=found.whiteness.words,
        log=(
            f"{found.data.source}: {found.data.length:.1f} usable seconds, of which "
            f"{found.fitted_time:.1f} were fitted, in {len(found.fit.problem.windows)} windows."
        ),
        notes=found.notes,
    )


def parameters(found: Identification) -> str:
    """The identified parameters as TOML that a scenario may name."""
    tables: dict[str, list[str]] = {}
    levels: dict[str, Verdict] = {}
    for each in found.verdicts:
        if each.word != IDENTIFIED or each.value is None:
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
        f"# Identified from {found.data.source} by `ballplate identify`; a scenario takes it by",
        '# parameters = "this file", a run by --set parameters=FILE.',
    ]
    for table in sorted(tables):
        lines += ["", f"[{table}]", *tables[table]]
    return "\n".join(lines) + "\n"


def write(found: Identification, folder: Path) -> None:
    """Write report.html and, if anything was identified, parameters.toml.

    Raises:
        RecordError: If a file cannot be written.
    """
    text = page(found)
    write_whole(folder / "report.html", lambda path: path.write_text(text, encoding="utf-8"))
    if any(each.word == IDENTIFIED for each in found.verdicts):
        settings = parameters(found)
        write_whole(
            folder / "parameters.toml", lambda path: path.write_text(settings, encoding="utf-8")
        )


def digits(value: float | None) -> str:
    """A number in the digits worth reading."""
    return "-" if value is None else f"{value:.4g}"


def interval(each: Verdict) -> str:
    """Its interval in words."""
    if each.low is None and each.high is None:
        return "-"
    if each.high is None:
        return f"above {digits(each.low)}"
    return f"{digits(each.low)} to {digits(each.high)}"


def _name(each: Verdict) -> str:
    axis = {"level_phi": " (phi)", "level_theta": " (theta)"}.get(each.name, "")
    return each.about.key + axis
