"""Other futures from a moment of a run or a log, and their folder."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from controllers.interfaces import Law, Measurement
from twin.base.errors import RecordError, ScenarioError
from twin.base.jobs import SecondProcess
from twin.base.page import round_plainly
from twin.base.writing import write_json, write_whole
from twin.hal.supervisor import INJECTED_BEGIN
from twin.identify.any_logs import read_any
from twin.identify.log_columns import wanted_columns
from twin.identify.logs import read
from twin.identify.prepare import check_ranges
from twin.run.assemble import assemble
from twin.run.files import WHATIF_FILE, forget, free, is_log, is_record, record_of, short_key, slug
from twin.run.finished import Run, draw_runs, record_run, versions
from twin.run.logs import check_second_axis
from twin.run.loop import drive
from twin.run.metrics import Motion
from twin.run.opened import open_run
from twin.run.record import Recorder
from twin.scenario.load import check, load
from twin.scenario.merging import put, setting, split_settings
from twin.scenario.schema import JUMP_KEYS, RAMP_KEYS, Scenario, choices
from twin.whatif.moments import (
    SYNCHRONISATION,
    Moment,
    Synchronisation,
    estimate_moment,
    exact,
    make_replayable,
    take_over,
)

CONTROL_KEY_PREFIXES = ("controller.", "observer.", "predictor.", "reference.")
"""Beginnings of the keys that belong to the controller and its task."""


def branch(scenario: Scenario, at: float, end: float, settings: Sequence[str]) -> Scenario:
    """The scenario of a future with changed settings from a moment.

    Settings of the controller are new from the beginning; settings of the plant change at the
    moment, as ``[[change]]`` does.

    Args:
        scenario: Scenario of the run.
        at: The moment, s.
        end: Time of the run in s at which the future ends.
        settings: ``key=value`` each.

    Raises:
        ScenarioError: If a key cannot change while a rig runs, or a value is out of range.
    """
    values = dict(map(setting, settings))
    plant = {key: value for key, value in values.items() if key in RAMP_KEYS + JUMP_KEYS}
    for key in values:
        if key not in plant and not key.startswith(CONTROL_KEY_PREFIXES):
            raise ScenarioError(
                f"--set {key}: cannot change during a run (allowed: "
                f"{', '.join(f'{begin}*' for begin in CONTROL_KEY_PREFIXES)}, "
                f"{', '.join(RAMP_KEYS + JUMP_KEYS)})"
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
    """A simulated run from a moment on.

    Attributes:
        settings: The changes, ``key=value`` each; empty for none.
        run: The run from the moment on.
        max_difference: Largest distance in m of its ball from the recorded one, where the record
            goes on; None if it does not.
    """

    settings: tuple[str, ...]
    run: Run
    max_difference: float | None

    @property
    def label(self) -> str:
        """Its name in pictures and tables."""
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
    """Simulate a run from a moment on.

    Args:
        moment: The moment.
        scenario: Scenario of the branch.
        settings: Its changes.

    Raises:
        TwinError: If the branch cannot be assembled.
    """
    rig, controller = assemble(scenario, unseen=True)
    period = scenario.rig.period

    def begin(_: Measurement) -> Measurement:
        take_over(controller, moment.controller(), moment.scenario, scenario, moment.at)
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


def agreement(moment: Moment, synchronisation: Synchronisation = SYNCHRONISATION) -> str:
    """How well the twin agrees with the record before a moment, as a text."""
    state = "the run's own state" if moment.exact else "the state estimated from the log"
    begins = f"{moment.name} from {moment.at:g} s on, {state}"
    before = moment.before_mm
    if before is None:
        seconds = synchronisation.compared_s
        return f"{begins}; the twin could not be checked: no whole {seconds:g} s before"
    bad = before > synchronisation.max_distance_mm
    poor = ": the twin does not fit, and a future is no better" if bad else ""
    apart = f"twin and record are {round_plainly(before)} mm apart at most in the second before"
    return f"{begins}; {apart}{poor}"


SHOWN_BEFORE_S = 2.0
"""Time in s before the moment that the picture shows."""


def branches_of(settings: Sequence[str], more: Sequence[str]) -> list[tuple[str, ...]]:
    """The settings of every branch.

    Args:
        settings: ``key=value`` of all branches.
        more: One text per branch, ``key=value; key=value``; empty for one branch.

    Raises:
        ScenarioError: If a branch has a key twice, or two branches are equal.
    """
    found = [(*settings, *own) for own in map(split_settings, more or [""])]
    changes = [list(map(setting, each)) for each in found]
    for pairs, text in zip(changes, more or [""], strict=True):
        keys = [key for key, _ in pairs]
        if twice := [key for key in keys if keys.count(key) > 1]:
            where = f"--branch '{text}'" if text else "--set"
            raise ScenarioError(f"{where}: {twice[0]} is given twice; give it once")
    for number, pairs in enumerate(changes):
        if any(dict(pairs) == dict(each) for each in changes[:number]):
            raise ScenarioError(f"--branch '{more[number]}': equal to an earlier one; give it once")
    return found


def _left_out(run: Run) -> Iterator[str]:
    """A sentence on the faults that a virtual rig had on demand; none without."""
    faults = [
        f"{each['text'].removeprefix(INJECTED_BEGIN)}, at {each['time']:g} s"
        for each in run.events
        if each["text"].startswith(INJECTED_BEGIN)
    ]
    if faults:
        yield f"its faults are left out of what the twin simulates: {'; '.join(faults)}"


def moment_of(
    path: Path,
    at: float,
    scenario: str | None = None,
    settings: Sequence[str] = (),
    columns: str | None = None,
    separator: str | None = None,
    branches: Sequence[tuple[str, ...]] = (),
) -> Moment:
    """A moment of a run or a log.

    Args:
        path: Run folder, its Parquet file, or a CSV log.
        at: The moment, s; taken to the nearest control period.
        scenario: The scenario that ran, for a log, which does not state it.
        settings: Its changes, ``key=value`` each.
        columns: Columns of a log of any rig, as for ``identify``.
        separator: Separator of its columns.
        branches: Changes of futures that are to follow, checked before anything is simulated.

    Raises:
        TwinError: If there is no such run or moment, the twin cannot continue from it, or a change
            is none.
    """
    if is_log(path) or (columns is not None and not is_record(path)):
        if scenario is None:
            raise RecordError(f"{path}: a log does not state its scenario; give --scenario NAME")
        chosen = load(scenario, settings)
        at = _nearest(at, chosen)
        _check_branches(chosen, at, branches)
        if columns is None:
            log = read(path)
            check_ranges(log)
        else:
            log = read_any(path, wanted_columns(columns), separator).on(chosen)
        check_second_axis(path.name, log.ball[:, 1], chosen)
        return estimate_moment(path.stem, make_replayable(log, chosen, at), chosen, at)
    options = {"scenario": scenario, "on": settings, "columns": columns, "separator": separator}
    if given := [name for name, value in options.items() if value]:
        raise RecordError(
            f"--{given[0]}: {path} is a record, which states what ran; remove this option"
        )
    (run,) = open_run(path)
    file = record_of(path)
    if run.branch:
        raise RecordError(f"{file}: is itself a branch; give the run that it came from")
    run.require()
    at = _nearest(at, run.scenario)
    run = replace(run, scenario=run.controlled(at))
    _check_branches(run.scenario, at, branches)
    other = [
        f"{name} {run.versions.get(name, 'unknown')} (here {version})"
        for name, version in versions().items()
        if run.versions.get(name) != version
    ]
    law: type[Law] = choices("controller")[run.scenario.controller.kind]
    steering = ("pushes", "goals") if law.replans else ("pushes",)
    steered = any(map(run.driven.get, steering)) or len(run.driven.get("controllers", ())) > 1
    if "true_x" not in run.rows or "lateness" in run.rows or other or steered:
        whole = read(file)
        check_ranges(whole)
        log = make_replayable(whole, run.scenario, at)
        moment = estimate_moment(run.name, log, run.scenario, at)
        notes = [f"recorded with {', '.join(other)}: continued from its estimated state"]
        return replace(moment, notes=(*moment.notes, *notes[: len(other)], *_left_out(run)))
    first, last = run.rows["time"][[0, -1]]
    if not first - 1e-9 <= at <= last + 1e-9:
        raise RecordError(f"--at {at:g}: {file} goes from {first:g} to {last:g} s")
    return exact(run, at)


def _check_branches(scenario: Scenario, at: float, branches: Sequence[tuple[str, ...]]) -> None:
    at = max(at, 0.0)  # whether the log has this moment is checked where it is read
    for settings in branches:
        branch(scenario, at, at + scenario.rig.period, settings)


def _nearest(at: float, scenario: Scenario) -> float:
    """The beginning in s of the control period nearest to a time."""
    period = float(scenario.rig.period)
    if not math.isfinite(at):
        raise RecordError(f"--at {at:g}: must be a finite time in s")
    return period * round(at / period)


def futures(moment: Moment, lasting: float, branches: Sequence[tuple[str, ...]]) -> list[Future]:
    """Simulate several runs from a moment on.

    Args:
        moment: The moment.
        lasting: Duration of each, s.
        branches: The changes of each.

    Raises:
        TwinError: If one cannot be assembled; before the first is simulated.
    """
    period = moment.scenario.rig.period
    end = moment.at + period * max(1, round(lasting / period))
    chosen = [branch(moment.scenario, moment.at, end, settings) for settings in branches]
    return [future(moment, *each) for each in zip(chosen, branches, strict=True)]


def write(moment: Moment, found: Sequence[Future], folder: Path, drawing: SecondProcess) -> None:
    """Write a folder of run folders, one per future, with a picture of record and all futures.

    Args:
        moment: The moment at which they begin.
        found: The futures.
        folder: The folder; made if missing.
        drawing: A process that draws while the rest is written.

    Raises:
        RecordError: If it cannot be written.
    """
    title = f"What if: {moment.name} from {moment.at:g} s on"
    picture = drawing.begin(
        draw_runs, motions_shown(moment, found), title, moment.scenario.dimensions
    )
    forget(folder, WHATIF_FILE)
    folders = []
    for each in found:
        folders.append(free(folder / each.name))
        changed = {"exact": moment.exact, "set": [*each.settings]}
        origin = {"of": moment.name, "at": moment.at, **changed}
        record_run(each.run, folders[-1], {"branch": origin})
    kept = {"folders": [own.name for own in folders]}
    write_json(folder / WHATIF_FILE, summary(moment, found) | kept)
    write_whole(folder / "picture.png", picture())


def motions_shown(moment: Moment, found: Sequence[Future]) -> dict[str, Motion]:
    """The motions of the picture: record and futures by label."""
    recorded = moment.recorded
    end = max(each.run.motion.time[-1] for each in found)
    rows = (recorded.time > moment.at - SHOWN_BEFORE_S) & (recorded.time <= end)
    parts = {name: getattr(recorded, name)[rows] for name in ("time", "plate", "u", "reference")}
    known = Motion(ball=recorded.ball[rows], **parts)
    return {"recorded": known} | {each.label: each.run.motion for each in found}


def summary(moment: Moment, found: Sequence[Future]) -> dict[str, Any]:
    """The numbers of the futures, for ``--json``."""
    return {
        "run": moment.name,
        "at": moment.at,
        "exact": moment.exact,
        "before_mm": moment.before_mm,
        "gaps": [[*gap] for gap in moment.gaps],
        "notes": [*moment.notes],
        "branches": [each.as_dict() for each in found],
    }
