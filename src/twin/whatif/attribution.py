"""Attribution of a scenario's error to the effects that a clean model leaves out, and its picture.

The scenario is run with all effects, without each and with each alone.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from controllers.arrays import Array
from controllers.references import Circle
from twin.base.data_file import read_packaged
from twin.base.errors import LawError, ModelError, ScenarioError
from twin.base.followers import DEFAULT, SHAPE
from twin.base.jobs import cores
from twin.base.settings import Setting
from twin.base.writing import write_whole
from twin.run.finished import Run
from twin.run.metrics import Ending
from twin.run.plants import linkage_of
from twin.run.together import run_together, work_in_batches
from twin.scenario.rig_tables import CAMS_ONLY, LEFT_OUT, REGISTER
from twin.scenario.schema import Scenario

Overrides = Mapping[str, Any]
"""Dotted key to value; None takes the key out, so that its default holds."""


@dataclass(frozen=True, kw_only=True)
class Effect:
    """A property of a rig that the clean model lacks.

    Attributes:
        name: One word.
        label: Its name in tables and pictures.
        off: Overrides that switch it off: those of its settings, and those of law, observer and
            predictor that assume it.
    """

    name: str
    label: str
    off: Overrides


def effects_of(
    settings: Mapping[str, Setting], labels: Mapping[str, Mapping[str, Any]]
) -> tuple[Effect, ...]:
    """The effects that settings make, in the order of a table of their names.

    Args:
        settings: A register: every setting by its key.
        labels: Rows of ``label``, and perhaps ``along``: what is switched off with it.

    Raises:
        ModelError: If a setting is of an effect that is not in the table, or one in it has none.
    """
    off: dict[str, dict[str, Any]] = {name: {} for name in labels}
    for key, about in settings.items():
        effect = about.followed_by.explain
        if isinstance(effect, str):
            continue
        if effect.name not in off:
            raise ModelError(f"{key}: no effect '{effect.name}' in twin/whatif/effects.toml")
        if effect.off is not SHAPE:
            off[effect.name][key] = about.default if effect.off is DEFAULT else effect.off
    for name, row in labels.items():
        if not off[name]:
            raise ModelError(f"effects.toml: {name}: no setting is switched off by it")
        also = row.get("along", {}).items()
        off[name] |= {key: None if value == "default" else value for key, value in also}
    return tuple(Effect(name=name, label=labels[name]["label"], off=off[name]) for name in labels)


EFFECTS = effects_of(REGISTER, read_packaged("twin.whatif", "effects.toml"))
"""Every effect that can be switched separately."""


def apply_overrides(scenario: Scenario, overrides: Iterable[Overrides]) -> Scenario:
    """The scenario with overrides put in."""
    tables = scenario.model_dump(exclude_unset=True)
    for each in overrides:
        for key, value in each.items():
            *path, name = key.split(".")
            table = tables
            for part in path:
                table = table.get(part, {}) if value is None else table.setdefault(part, {})
            if value is None:
                table.pop(name, None)
            else:
                table[name] = value
    return Scenario.model_validate(tables, strict=False)


def effects_present(scenario: Scenario) -> tuple[Effect, ...]:
    """The effects of a scenario, of those that its plant can leave out."""
    now = scenario.model_dump()
    on_rods = CAMS_ONLY if linkage_of(scenario) else ()
    other = {*LEFT_OUT.get(scenario.plant.kind, LEFT_OUT["mujoco"]), *on_rods}
    return tuple(
        effect
        for effect in EFFECTS
        if not any(key in other for key in effect.off)
        and apply_overrides(scenario, [effect.off]).model_dump() != now
    )


def without(scenario: Scenario, effects: Iterable[Effect]) -> Scenario:
    """The scenario with effects switched off."""
    return apply_overrides(scenario, [effect.off for effect in effects])


MIN_EVALUATED_S = 4.0
"""Evaluated time in s below which the beginning of a run decides its error."""
ALL, NONE = "all", "none"
"""Names of the cases that belong to no effect."""


@dataclass(frozen=True, kw_only=True)
class EffectCase:
    """Result of one run with a choice of effects.

    Attributes:
        outcome: Its ending in a word, and the reason if it did not finish.
        error: Reference minus ball in m after ``metrics.start``, shape (K, 2).
        percent: e_tt of (C.7) in %; None for a reference that rests at 0, or a run cut short.
        rms: Root mean square of the distance from the reference in m; None for a run cut short.
    """

    outcome: str
    error: Array
    percent: float | None = None
    rms: float | None = None


@dataclass(frozen=True, kw_only=True)
class Contribution:
    """The contribution of one effect to the error.

    Attributes:
        effect: The effect.
        without: All effects but this one.
        alone: This one and no other.
        share: Its share of the whole error, dimensionless; None if a run needed for it was cut
            short.
    """

    effect: Effect
    without: EffectCase
    alone: EffectCase
    share: float | None


@dataclass(frozen=True, kw_only=True)
class Explanation:
    """The contribution of each effect to a scenario's error.

    Attributes:
        scenario: The scenario.
        whole: With all effects.
        none: With every effect switched off, on the scenario's plant.
        contributions: One per effect, the largest share first.
        base: Share that remains with every effect off, dimensionless.
        rest: Share that belongs to no single effect, because of interactions between effects.
    """

    scenario: Scenario
    whole: EffectCase
    none: EffectCase
    contributions: tuple[Contribution, ...]
    base: float | None
    rest: float | None

    @property
    def in_percent(self) -> bool:
        """Whether errors are given as e_tt in %, else as root mean squares in mm."""
        return self.whole.percent is not None

    def size(self, case: EffectCase) -> float:
        """The error of a case in % or mm; NaN for a run cut short."""
        value, factor = (case.percent, 1) if self.in_percent else (case.rms, 1000)
        return np.nan if value is None else factor * value


def describe_short_run(scenario: Scenario) -> str:
    """Why shares of a scenario's error mean nothing yet; empty if it is long enough for them."""
    begin, least = scenario.metrics.start, MIN_EVALUATED_S
    evaluated = scenario.duration - begin
    omega = scenario.reference.settings.get("omega", Circle.omega)
    if scenario.reference.kind == Circle.name and omega:
        least = max(least, 2 * np.pi / abs(omega))  # once round
    if evaluated >= least:
        return ""
    return (
        f"too short to evaluate: {evaluated:.3g} s, from metrics.start = {begin:.3g} s on; "
        f"shares need at least {least:.3g} s, so a longer duration"
    )


def plan(scenario: Scenario) -> dict[str, Scenario]:
    """The runs that explain a scenario, by name: ``all``, ``none``, ``-e``, ``+e``.

    Raises:
        ScenarioError: If the scenario changes its plant while it runs.
    """
    if scenario.change:
        raise ScenarioError(
            "change: explain compares effects that last the whole run; leave [[change]] out"
        )
    effects = effects_present(scenario)
    cases = {ALL: scenario, NONE: without(scenario, effects)}
    for effect in effects:
        others = [other for other in effects if other is not effect]
        cases[f"-{effect.name}"] = without(scenario, [effect])
        cases[f"+{effect.name}"] = without(scenario, others)
    return cases


def explain(
    scenario: Scenario,
    progress: Callable[[float], None] = lambda _: None,
    processes: int | None = None,
) -> Explanation:
    """Explain a scenario's error.

    Args:
        scenario: The scenario.
        progress: Called with the number of runs done.
        processes: Number of processes; None for one per processor.

    Raises:
        TwinError: If a run cannot be assembled.
    """
    wanted = plan(scenario)
    different = {variant.model_dump_json(): variant for variant in wanted.values()}
    found: dict[str, EffectCase] = {}
    for some in work_in_batches(attempt, different, processes or cores()):
        found |= some
        progress(len(found))
    cases = {name: found[variant.model_dump_json()] for name, variant in wanted.items()}
    return attribute(scenario, cases)


def attempt(scenarios: Sequence[Scenario]) -> list[EffectCase]:
    """Run cases that share a batch.

    Raises:
        TwinError: If one cannot be assembled, or its law fails.
        KeyboardInterrupt: If the user interrupts.
    """
    cases = []
    for scenario, done in zip(scenarios, run_together(scenarios), strict=True):
        if isinstance(done, LawError):
            raise done
        cases.append(_case_of(scenario, done))
    return cases


def _case_of(scenario: Scenario, done: Run) -> EffectCase:
    """The case of a run."""
    error = done.motion.error[done.motion.time >= scenario.metrics.start - 1e-9]
    whole = done.outcome == Ending.FINISHED
    reason = f": {done.metrics['reason']}" if done.metrics["reason"] else ""
    when = "" if whole else f" at {done.metrics['outcome_time']:.1f} s{reason}"
    return EffectCase(
        outcome=f"{done.outcome}{when}",
        error=error,
        percent=done.metrics["tracking_error_percent"] if whole else None,
        rms=float(np.sqrt((error**2).sum(axis=1).mean())) if whole else None,
    )


def attribute(scenario: Scenario, cases: Mapping[str, EffectCase]) -> Explanation:
    """Attribute the error of the run with all effects to the single ones.

    An effect's share is the change of the error by the effect, projected on the whole error: so
    noise counts by its variance, and an offset by its distance. The change is averaged over adding
    the effect first (to none) and last (to all others).
    """
    whole, none = cases[ALL], cases[NONE]
    contributions = []
    for effect in effects_present(scenario):
        less, alone = cases[f"-{effect.name}"], cases[f"+{effect.name}"]
        first, last = _along(whole, alone, none), _along(whole, whole, less)
        share = None if first is None or last is None else (first + last) / 2
        contributions.append(Contribution(effect=effect, without=less, alone=alone, share=share))
    base = _along(whole, none, None)
    shares = [base, *(each.share for each in contributions)]
    known = [share for share in shares if share is not None]
    return Explanation(
        scenario=scenario,
        whole=whole,
        none=none,
        contributions=tuple(sorted(contributions, key=lambda each: -(each.share or 0.0))),
        base=base,
        rest=1 - sum(known) if len(known) == len(shares) else None,
    )


def _along(whole: EffectCase, case: EffectCase, other: EffectCase | None) -> float | None:
    """Change of error from a second case to this one (from None: itself), along the whole error."""
    runs = [run for run in (whole, case, other) if run is not None]
    if any(run.rms is None for run in runs):
        return None
    size = float((whole.error**2).sum())
    change = case.error - (0.0 if other is None else other.error)
    return float((change * whole.error).sum()) / size if size > 0 else None


def summary(explanation: Explanation) -> dict[str, Any]:
    """The numbers of an explanation, for ``--json``."""

    def numbers(case: EffectCase) -> dict[str, Any]:
        return {
            "outcome": case.outcome,
            "tracking_error_percent": case.percent,
            "rms_distance": case.rms,
        }

    return {
        "scenario": explanation.scenario.title,
        "all": numbers(explanation.whole),
        "none": numbers(explanation.none),
        "share_left_with_none": explanation.base,
        "share_not_additive": explanation.rest,
        "too_short": describe_short_run(explanation.scenario),
        "effects": {
            each.effect.name: {
                "label": each.effect.label,
                "off": each.effect.off,
                "without": numbers(each.without),
                "alone": numbers(each.alone),
                "share": each.share,
            }
            for each in explanation.contributions
        },
    }


def draw(path: Path, explanation: Explanation) -> None:
    """Draw an explanation into a PNG file: error without each effect, and with it alone.

    Raises:
        RecordError: If the file cannot be written.
    """
    from twin.run.picture import RUN_COLOURS, literal, styled_figure  # noqa: PLC0415  heavy

    alone_colour, without_colour = RUN_COLOURS[:2]
    whole, none = explanation.size(explanation.whole), explanation.size(explanation.none)
    parts = explanation.contributions
    with styled_figure(10, 2.2 + 0.36 * max(len(parts), 3)) as figure:
        title = f"{explanation.scenario.title}: what makes the error"
        figure.suptitle(literal(title), fontsize=12, fontweight="bold", wrap=True)
        panel = figure.subplots()
        for y, part in enumerate(parts):
            for case, other, at, colour, label in (
                (part.without, whole, y - 0.13, without_colour, "all but this one"),
                (part.alone, none, y + 0.13, alone_colour, "this one alone"),
            ):
                size = explanation.size(case)
                once = "" if y else label
                panel.plot([other, size], [at] * 2, "-o", color=colour, lw=2, label=once)
                if case.rms is None:
                    panel.text(np.fmax(whole, none), at, f" {case.outcome}", color=colour, size=7)
        panel.axvline(whole, color=without_colour, lw=1, ls="--", label="all effects")
        panel.axvline(none, color=alone_colour, lw=1, ls="--", label="none of them")
        shares = ("" if p.share is None else f" ({100 * p.share:z.1f} %)" for p in parts)
        labels = [part.effect.label + share for part, share in zip(parts, shares, strict=True)]
        panel.set_yticks(range(len(labels)), labels)
        panel.invert_yaxis()
        percent = explanation.in_percent
        panel.set_xlabel("tracking error $e_{tt}$ [%]" if percent else "RMS distance [mm]")
        panel.legend()
        write_whole(path, lambda target: figure.savefig(target, dpi=110, format="png"))
