"""From a run folder or a log to several futures of one moment, and their folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from twin.errors import RecordError
from twin.jobs import SecondProcess
from twin.run.assemble import build_reference
from twin.run.files import WHATIF, forget_listed, free, record_of
from twin.run.finished import Run, drawn, open_run, versions
from twin.run.metrics import Motion
from twin.scenario.load import load
from twin.scenario.schema import Scenario
from twin.whatif.branch import branch
from twin.whatif.exact import exact
from twin.whatif.future import Future, future, save
from twin.whatif.moment import Moment
from twin.whatif.page import page
from twin.whatif.recorded import save_recorded
from twin.writing import write_json, write_whole

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


def moment_of(path: Path, at: float, scenario: str | None = None) -> Moment:
    """A moment of a run or a log.

    Args:
        path: Run folder, its Parquet file, or a CSV log.
        at: The moment, s; taken to the nearest control period.
        scenario: What ran, for a log that does not say.

    Raises:
        TwinError: If there is no such run or moment, or nothing can go on from it.
    """
    if path.suffix == ".csv":
        if scenario is None:
            raise RecordError(f"{path}: a log does not say what ran; give --scenario NAME")
        chosen = load(scenario)
        at, rounded = _nearest(at, chosen)
        return _noted(_estimated(path.stem, path, chosen, at), rounded)
    if scenario is not None:
        raise RecordError(f"--scenario: {path} is a record and says itself what ran; leave it out")
    (run,) = open_run(path)
    file = record_of(path)
    if run.branch:
        raise RecordError(f"{file}: a branch itself; branch off from the run that it came from")
    run.require()
    at, rounded = _nearest(at, run.scenario)
    later = (*rounded, *_not_repeated(run, at))
    run = replace(run, scenario=run.controlled(at))
    other = [
        f"{name} {run.versions.get(name, 'unknown')} (here {version})"
        for name, version in versions().items()
        if run.versions.get(name) != version
    ]
    if "true_x" not in run.rows or "lateness" in run.rows or other:
        moment = _estimated(run.name, file, run.scenario, at)
        note = f"recorded with {', '.join(other)}: gone on with from its estimated state"
        return _noted(moment, (note,) if other else (), later)
    first, last = run.rows["time"][[0, -1]]
    if not first - 1e-9 <= at <= last + 1e-9:
        raise RecordError(f"--at {at:g}: {file} goes from {first:g} to {last:g} s")
    return _noted(exact(run, file, at), later)


def _nearest(at: float, scenario: Scenario) -> tuple[float, tuple[str, ...]]:
    """The control period nearest to a time in s, and in a sentence that it is another time."""
    period = scenario.rig.period
    found = period * round(at / period)
    if abs(found - at) < 1e-9:
        return found, ()
    return found, (f"--at {at:.12g}: goes on from {found:.12g} s, where a control period begins",)


def _noted(moment: Moment, *notes: tuple[str, ...]) -> Moment:
    """A moment with more that should be known of it."""
    return replace(moment, notes=sum(notes, moment.notes))


def _not_repeated(run: Run, at: float) -> tuple[str, ...]:
    """What a person did after a time in s that no future repeats."""
    pushes = sum(push[0] > at for push in run.driven.get("pushes", ()))
    controllers = sum(each["since"] > at for each in run.driven.get("controllers", ()))
    if not (pushes or controllers):
        return ()
    return (
        f"driven by hand: {pushes} pushes and {controllers} changes of the controller after "
        f"{at:g} s are not repeated",
    )


def _estimated(name: str, file: Path, scenario: Scenario, at: float) -> Moment:
    """A moment of what was measured."""
    from twin.identify.log import read  # noqa: PLC0415  heavy: loaded when needed
    from twin.whatif.estimated import estimated  # noqa: PLC0415
    from twin.whatif.judge import judge  # noqa: PLC0415

    return estimated(name, judge(read(file), scenario, at), scenario, at)


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
    """Write a folder of run folders, of record and futures, with a picture and a page of all.

    Args:
        moment: Where they begin.
        found: The futures.
        folder: Where; made if missing.
        beside: A process that draws while the rest is written.

    Raises:
        RecordError: If it cannot be written.
    """
    area = moment.scenario.rig.limits.area
    title = f"What if: {moment.name} from {moment.at:g} s on"
    picture = beside.begin(drawn, shown(moment, found), title, area)
    forget_listed(folder, WHATIF)
    folders = []
    for each in found:
        folders.append(free(folder / each.name))
        save(each, moment, folders[-1])
    period = moment.scenario.rig.period
    end = period + max(each.run.motion.time[-1] for each in found)
    save_recorded(moment, moment.at - SHOWN_BEFORE, end, folder / "recorded")
    kept = {"folders": ["recorded", *(own.name for own in folders)]}
    write_json(folder / WHATIF, summary(moment, found) | kept)
    drawing = picture()
    write_whole(folder / "picture.png", lambda path: path.write_bytes(drawing))
    text = page(moment, found, drawing)
    write_whole(folder / "report.html", lambda path: path.write_text(text, encoding="utf-8"))


def shown(moment: Moment, found: Sequence[Future]) -> dict[str, Motion]:
    """What the picture shows: record and futures by label."""
    recorded = moment.recorded
    end = max(each.run.motion.time[-1] for each in found)
    rows = (recorded.time > moment.at - SHOWN_BEFORE) & (recorded.time <= end)
    time, ball, plate, u = (values[rows] for values in recorded)
    ball = ball.copy()
    for begin, until in moment.gaps:
        ball[(time >= begin) & (time <= until)] = np.nan
    reference = build_reference(moment.scenario)(time)[0]
    known = Motion(time=time, ball=ball, plate=plate, u=u, reference=reference)
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
