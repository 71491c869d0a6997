"""A scenario on the twin of a rig before the rig runs it: does the ball stay on the plate?"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ballplate.changes import KeyChange, scenario_of
from ballplate.reporter import Reporter
from twin.base.errors import LawError, RigError, TwinError

if TYPE_CHECKING:
    from twin.run.finished import Run
    from twin.scenario.rig import RigFile
    from twin.scenario.schema import Scenario

REHEARSED_S = 30.0
"""Simulated time in s of a rehearsal."""
SLOWER_DRIVES, LATER_BALL = 1.35, 1.15
"""Factors of the drives' lag and of the ball's dead time that the ball must stay at as well: how
far a rig may be from what its owner believes."""
SMALLER_LENGTHS = (0.5, 0.25)
"""Shares of the reference's lengths that are tried where the whole ones lose the ball."""


def rehearse(
    name: str | Path, changed: Sequence[KeyChange], reporter: Reporter, on: str, rig: RigFile
) -> None:
    """Run a scenario on the twin as it is believed to be, and on one that is later.

    Args:
        name: A shipped scenario, or a TOML file.
        changed: What is changed of it.
        reporter: Receives progress, and what the rig's option is called.
        on: The rig that waits.
        rig: Its file; its limits are the twin's as well.

    Raises:
        RigError: If a ball is lost, with a change under which none is, if one is found.
    """
    chosen = rig.limited(scenario_of(name, changed))
    with reporter.progress("twin", 1.0):
        lost = _lost(chosen)
        if not lost:
            return
        for change in _remedies(chosen):
            try:
                other = rig.limited(scenario_of(name, [*changed, change]))
                kept = not _lost(other)
            except TwinError:
                continue
            if kept:
                remedy = f"it stays with {change.text}"
                break
        else:
            remedy = "a slower law or a smaller reference may keep it"
    where = reporter.name_of("on")
    raise RigError(f"{where} {on}: on the twin of this rig {lost}; {remedy}")


def _lost(scenario: Scenario) -> str:
    """How a ball is lost, in words; empty if none is."""
    from twin.run.together import run_together
    from twin.scenario.derived import cut_short

    short = cut_short(scenario, min(scenario.duration, REHEARSED_S))
    for label, done in zip(
        ("", " if its drives and its picture are later than believed"),
        run_together([short, _later(short)]),
        strict=True,
    ):
        if isinstance(done, LawError):
            return f"the law fails{label}: {done}"
        if done.outcome != "finished":
            return f"{_words(done)}{label}"
    return ""


def _words(done: Run) -> str:
    at, why = float(done.metrics["outcome_time"]), done.metrics["reason"]
    return f"the run ends after {at:.1f} s, {done.outcome}: {why}"


def _later(scenario: Scenario) -> Scenario:
    """The same on slower drives, with a later ball."""
    servo, touch = scenario.plant.servo, scenario.sensors.touch
    slower = servo.model_copy(update={"bandwidth_hz": servo.bandwidth_hz / SLOWER_DRIVES})
    later = touch.model_copy(update={"dead_time": touch.dead_time * LATER_BALL})
    return scenario.model_copy(
        update={
            "plant": scenario.plant.model_copy(update={"servo": slower}),
            "sensors": scenario.sensors.model_copy(update={"touch": later}),
        }
    )


def _remedies(scenario: Scenario) -> Iterator[KeyChange]:
    """Changes that may keep the ball, the ones that cost least first."""
    _, lag = scenario.lateness
    if lag and not scenario.rig.plate_lag:
        yield KeyChange.of("rig.plate_lag", float(f"{lag:.2g}"))
    settings = scenario.reference.settings
    from twin.scenario.schema import choices

    lengths = getattr(choices("reference")[scenario.reference.kind], "lengths", ())
    for share in SMALLER_LENGTHS:
        for key in lengths:
            if settings.get(key):
                yield KeyChange.of(f"reference.{key}", _scale_lengths(settings[key], share))


def _scale_lengths(value: object, share: float) -> object:
    """Lengths in m times a share; those of a list each."""
    if isinstance(value, list | tuple):
        return [_scale_lengths(each, share) for each in value]
    return float(f"{value * share:.4g}") if isinstance(value, int | float) else value
