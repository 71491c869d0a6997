"""From a run folder or a log to several futures of one moment, and their folder."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.interfaces import Measurement
from twin.errors import RecordError, ScenarioError
from twin.identify.logs import read, read_any, wanted_columns
from twin.identify.prepare import check_ranges
from twin.jobs import SecondProcess
from twin.run.assemble import assemble
from twin.run.files import WHATIF, forget, free, is_record, record_of, short_key, slug
from twin.run.finished import Run, drawn, open_run, record_run, versions
from twin.run.loop import drive
from twin.run.metrics import Motion
from twin.run.record import Recorder
from twin.scenario.load import check, load, put, setting
from twin.scenario.schema import JUMPS, RAMPS, Scenario
from twin.whatif.moment import LOOK_BACK, Moment, estimated, exact, judge, take_over
from twin.writing import write_json, write_whole

CONTROL = ("controller.", "observer.", "predictor.", "reference.")
"""Beginnings of the keys that belong to the controller and its task."""


def branch(scenario: Scenario, at: float, end: float, settings: Sequence[str]) -> Scenario:
    """The scenario of a future in which something is changed at a moment.

    What belongs to the controller is another one from the beginning; what belongs to the plant
    changes at the moment, as ``[[change]]`` does.

    Args:
        scenario: Of the run.
        at: The moment, s.
        end: Time of the run in s at which the future ends.
        settings: ``key=value`` each.

    Raises:
        ScenarioError: If a key cannot change while a rig runs, or a value is out of range.
    """
    values = dict(map(setting, settings))
    plant = {key: value for key, value in values.items() if key in RAMPS + JUMPS}
    for key in values:
        if key not in plant and not key.startswith(CONTROL):
            raise ScenarioError(
                f"--set {key}: cannot change while a plant runs (what can: "
                f"{', '.join(f'{begin}*' for begin in CONTROL)}, {', '.join(RAMPS + JUMPS)})"
            )
    tables = scenario.model_dump(mode="json")
    control = {key: value for key, value in values.items() if key not in plant}
    tables = put(tables, [*control.items(), ("duration", end), ("baseline", False)])
    later: list[Mapping[str, Any]] = [each for each in tables["change"] if each["at"] < end]
    tables["change"] = [*later, *([{"at": at, "set": plant}] if plant else [])]
    tables["metrics"]["start"] = max(at, min(scenario.metrics.start, at + (end - at) / 2))
    what = ", ".join(settings) or "unchanged"
    tables["title"] = f"{scenario.title} ({what} from {at:g} s on)"
    return check(tables, "what-if")


@dataclass(frozen=True)
class Future:
    """What would have happened.

    Attributes:
        settings: What was changed, ``key=value`` each; none for nothing.
        run: The run from the moment on.
        max_difference: Largest distance in m of its ball from the recorded one, where the record
            goes on; None if it does not.
    """

    settings: tuple[str, ...]
    run: Run
    max_difference: float | None

    @property
    def label(self) -> str:
        """What it is called in pictures and tables."""
        return ", ".join(self.settings) or "unchanged"

    @property
    def name(self) -> str:
        """The label in its shortest form, as the name of its folder."""
        pairs = (text.partition("=") for text in self.settings)
        return slug("-".join(f"{short_key(key)}={value}" for key, _, value in pairs) or self.label)

    def as_dict(self) -> dict[str, Any]:
        """For JSON."""
        return {
            "set": [*self.settings],
            **self.run.metrics,
            "max_difference_m": self.max_difference,
        }


def future(moment: Moment, scenario: Scenario, settings: tuple[str, ...]) -> Future:
    """Go on from a moment.

    Args:
        moment: The moment.
        scenario: Of the branch.
        settings: What it changes.

    Raises:
        TwinError: If the branch cannot be assembled.
    """
    rig, controller = assemble(scenario)
    rig.LEVELLING_TIME = 0.0
    period = scenario.rig.period

    def begin(_: Measurement) -> Measurement:
        take_over(controller, moment.controller(), moment.scenario, scenario)
        return moment.put(rig)

    ticks = round(scenario.duration / period) - round(moment.at / period)
    record = Recorder(ticks, 1, period, rig.channels, controller.observer.knows)
    (outcome,) = drive(rig, controller, scenario.duration, record, begin=begin)
    run = Run.of(
        scenario,
        record,
        outcome,
        controller.reference,
        real_time_factor=float("nan"),
        journal=rig.journal,
    )
    return Future(settings, run, difference(moment.recorded, run.motion, period))


def difference(recorded: Motion, motion: Motion, period: float) -> float | None:
    """Largest distance in m of a motion's ball from the recorded one at the periods of both."""
    ticks = [np.rint(time / period).astype(int) for time in (recorded.time, motion.time)]
    _, known, own = np.intersect1d(*ticks, return_indices=True)
    apart = np.hypot(*(recorded.ball[known] - motion.ball[own]).T)
    apart = apart[np.isfinite(apart)]
    return float(apart.max()) if len(apart) else None


POOR = 5.0
"""Millimetres that twin and record may be apart before a branch that is to be trusted."""


def agreement(moment: Moment) -> str:
    """How well the twin knows where the futures begin, in words."""
    state = "the run's own state" if moment.exact else "the state estimated from the log"
    begins = f"{moment.name} from {moment.at:g} s on, {state}"
    before = moment.before_mm
    if before is None:
        return f"{begins}; nothing says whether the twin is right: no whole {LOOK_BACK:g} s before"
    poor = ": the twin does not fit, and a future is no better" if before > POOR else ""
    return f"{begins}; twin and record are {before:.2g} mm apart at most in the second before{poor}"


SHOWN_BEFORE = 2.0
"""Time in s before the moment that the picture shows."""
SEPARATOR = ";"
"""Between the settings of one branch."""


def branches_of(settings: Sequence[str], more: Sequence[str]) -> list[tuple[str, ...]]:
    """The settings of every branch.

    Args:
        settings: ``key=value`` of all branches.
        more: One text a branch, ``key=value; key=value``; none for one branch.
    """
    each = [tuple(part.strip() for part in text.split(SEPARATOR) if part.strip()) for text in more]
    return [(*settings, *own) for own in each or [()]]


def moment_of(
    path: Path,
    at: float,
    scenario: str | None = None,
    settings: Sequence[str] = (),
    columns: str | None = None,
    separator: str | None = None,
) -> Moment:
    """A moment of a run or a log.

    Args:
        path: Run folder, its Parquet file, or a CSV log.
        at: The moment, s; taken to the nearest control period.
        scenario: What ran, for a log that does not say.
        settings: ``key=value`` each, what was changed of it.
        columns: Of a log of any rig, as ``identify`` takes them.
        separator: Between these.

    Raises:
        TwinError: If there is no such run or moment, or nothing can go on from it.
    """
    if path.suffix == ".csv" or (columns is not None and not is_record(path)):
        if scenario is None:
            raise RecordError(f"{path}: a log does not say what ran; give --scenario NAME")
        chosen = load(scenario, settings)
        at = _nearest(at, chosen)
        if columns is None:
            log = read(path)
            check_ranges(log)
        else:
            log = read_any(path, wanted_columns(columns), separator).on(chosen)
        return estimated(path.stem, judge(log, chosen, at), chosen, at)
    told = {"scenario": scenario, "on": settings, "columns": columns}
    if given := [name for name, value in told.items() if value]:
        raise RecordError(
            f"--{given[0]}: {path} is a record and says itself what ran; leave it out"
        )
    (run,) = open_run(path)
    file = record_of(path)
    if run.branch:
        raise RecordError(f"{file}: a branch itself; branch off from the run that it came from")
    run.require()
    at = _nearest(at, run.scenario)
    run = replace(run, scenario=run.controlled(at))
    other = [
        f"{name} {run.versions.get(name, 'unknown')} (here {version})"
        for name, version in versions().items()
        if run.versions.get(name) != version
    ]
    if "true_x" not in run.rows or "lateness" in run.rows or other:
        whole = read(file)
        check_ranges(whole)
        log = judge(whole, run.scenario, at)
        moment = estimated(run.name, log, run.scenario, at)
        note = f"recorded with {', '.join(other)}: gone on with from its estimated state"
        return replace(moment, notes=(*moment.notes, note)) if other else moment
    first, last = run.rows["time"][[0, -1]]
    if not first - 1e-9 <= at <= last + 1e-9:
        raise RecordError(f"--at {at:g}: {file} goes from {first:g} to {last:g} s")
    return exact(run, file, at)


def _nearest(at: float, scenario: Scenario) -> float:
    """The beginning in s of the control period nearest to a time."""
    period = float(scenario.rig.period)
    return period * round(at / period)


def futures(moment: Moment, lasting: float, branches: Sequence[tuple[str, ...]]) -> list[Future]:
    """Go on from a moment in several ways.

    Args:
        moment: The moment.
        lasting: How long, s.
        branches: What each of them changes.

    Raises:
        TwinError: If one cannot be assembled; before the first is simulated.
    """
    period = moment.scenario.rig.period
    end = moment.at + period * max(1, round(lasting / period))
    chosen = [branch(moment.scenario, moment.at, end, settings) for settings in branches]
    return [future(moment, *each) for each in zip(chosen, branches, strict=True)]


def write(moment: Moment, found: Sequence[Future], folder: Path, beside: SecondProcess) -> None:
    """Write a folder of run folders, one a future, with a picture of record and all.

    Args:
        moment: Where they begin.
        found: The futures.
        folder: Where; made if missing.
        beside: A process that draws while the rest is written.

    Raises:
        RecordError: If it cannot be written.
    """
    title = f"What if: {moment.name} from {moment.at:g} s on"
    picture = beside.begin(drawn, shown(moment, found), title, moment.scenario.dimensions)
    forget(folder, WHATIF)
    folders = []
    for each in found:
        folders.append(free(folder / each.name))
        changed = {"exact": moment.exact, "set": [*each.settings]}
        origin = {"of": moment.name, "at": moment.at, **changed}
        record_run(each.run, folders[-1], {"branch": origin})
    kept = {"folders": [own.name for own in folders]}
    write_json(folder / WHATIF, summary(moment, found) | kept)
    write_whole(folder / "picture.png", picture())


def shown(moment: Moment, found: Sequence[Future]) -> dict[str, Motion]:
    """What the picture shows: record and futures by label."""
    recorded = moment.recorded
    end = max(each.run.motion.time[-1] for each in found)
    rows = (recorded.time > moment.at - SHOWN_BEFORE) & (recorded.time <= end)
    parts = {name: getattr(recorded, name)[rows] for name in ("time", "plate", "u", "reference")}
    known = Motion(ball=recorded.ball[rows], **parts)
    return {"recorded": known} | {each.label: each.run.motion for each in found}


def summary(moment: Moment, found: Sequence[Future]) -> dict[str, Any]:
    """What ``--json`` prints."""
    return {
        "run": moment.name,
        "at": moment.at,
        "exact": moment.exact,
        "before_mm": moment.before_mm,
        "gaps": [[*gap] for gap in moment.gaps],
        "notes": [*moment.notes],
        "branches": [each.as_dict() for each in found],
    }
