"""The public benchmark: the same tasks on the same rigs for every law, entries that are verified.

A law is compared rig by rig and noise by noise with the same reference law. The commands on some
rigs are kept, so that an entry is verified by a replay, without running code of others. Besides the
frozen rigs, which anyone may tune on, a season has some that only its key draws.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple
from zipfile import BadZipFile

import numpy as np
import pandas as pd
import scipy
from pyarrow.parquet import ParquetFile
from pydantic import Field

from controllers.arrays import Array
from twin.base.data_file import DataError, check_regular, read_regular
from twin.base.errors import LawError, RecordError, ScenarioError, nearest, plural
from twin.base.shipped import folder as scenarios_folder
from twin.base.shipped import model_path
from twin.base.validation import Checked, read_model
from twin.base.writing import why, write_json, write_whole
from twin.lab import SCORES_FILE
from twin.lab.bench_entries import Entry, carry_out_entry, enter
from twin.lab.bench_replay import commands_of, register_commands, replay_of
from twin.lab.bench_scores import (
    EFFORT_METRIC,
    SCORING,
    BenchScore,
    Scoring,
    compare_runs,
    interquartile,
    interval,
)
from twin.lab.handing_out import format_toml
from twin.run.loop import simulate
from twin.scenario.schema import MetricsTable, Scenario
from twin.study.experiments import CHUNK_RUNS, Store, carry
from twin.study.schema import Point, Variant, draw_rigs, read_family
from twin.study.work import Builder, ScenarioRuns, carry_out, digest

FAMILY_NAME = "uncertain"
"""The family from which all rigs are drawn."""
SEASON_KEY_PATTERN = re.compile("[!-~]{16,}")
"""Pattern of a season's key: its fingerprint is public, so nobody may be able to guess it."""
LOCKED_FILES = ("bench.toml", "faults.toml", "rigs.csv", "reference.csv")
MODEL_FILES = ("ballplate.xml", "cams.json")


@dataclass(frozen=True, kw_only=True)
class TimingRuns:
    """How the processor time of all runs is estimated.

    Attributes:
        durations_s: Durations in s of the beginnings of runs that are timed, one after the other.
        enough_s: Computing time in s after which no longer beginning is timed.
    """

    durations_s: tuple[float, ...] = (0.05, 0.25, 1.0)
    enough_s: float = 1.0


TIMING_RUNS = TimingRuns()


class Bench(Checked):
    """A benchmark; see the comments in its file.

    Each of the ``tasks`` of every rig is a scenario, shipped or in the benchmark's folder.
    """

    schema_: Annotated[Literal["ballplate/bench/v1"], Field(alias="schema")]
    title: str
    rigs: str
    seeds: Annotated[int, Field(ge=1)]
    reference: str
    metric: str
    most: float
    replayed: int
    set: tuple[str, ...]
    tasks: Annotated[tuple[Variant, ...], Field(min_length=1)]
    laws: dict[str, Entry]


class BenchRun(NamedTuple):
    """One run of an entry: the task's name, the numbers of rig and noise, the scenario."""

    task: str
    rig: int
    noise: int
    scenario: Scenario

    @property
    def label(self) -> tuple[str, int, int]:
        """The three that tell it from the other runs of an entry: ``LABEL_COLUMNS``."""
        return self.task, self.rig, self.noise


LABEL_COLUMNS = ("task", "rig", "noise")
"""Columns by which runs of entries are matched."""


class Benchmark:
    """A frozen benchmark in a folder, on its frozen rigs or on those of a season.

    Args:
        folder: Its folder; by default the shipped benchmark's.
        key: Key from which the rigs of a season are drawn; None for the frozen ones.
        scoring: How errors become scores.

    Attributes:
        points: Values of each rig by key.
        seeds: Seed of the first noise of each rig.
        season: The fingerprint of the season's key; empty for the frozen rigs.

    Raises:
        ScenarioError: If it is none, or the key is too short or has other characters.
    """

    def __init__(
        self, folder: Path | None = None, *, key: str | None = None, scoring: Scoring = SCORING
    ) -> None:
        self.folder = folder or scenarios_folder() / "bench" / "v1"
        self.about: Bench = read_model(Bench, self.folder / "bench.toml")
        table = pd.read_csv(self.folder / self.about.rigs, dtype=str).map(json.loads)
        self.season, table = ("", table) if key is None else season(key)
        self.seeds: list[int] = table.pop("seed").tolist()
        self.points: list[Point] = table.to_dict("records")
        self.scoring = scoring
        self._known: pd.DataFrame | None = None

    def out(self, name: str) -> Path:
        """The default folder of an entry of this name, a different one for every season."""
        return Path("runs") / "-".join(filter(None, ("bench", name, self.season)))

    def entry(self, name: str | Path) -> tuple[str, Entry, Path]:
        """Name, entry and folder of a shipped entry, of an entry's folder or of a law's file.

        Raises:
            ScenarioError: If there is none.
        """
        path = Path(name)
        if str(name) in self.about.laws:
            return str(name), self.about.laws[str(name)], self.folder
        if path.suffix == ".py" and path.is_file():
            table, place = path.with_name("entry.toml"), path.parent.resolve()
            if table.is_file() and (found := read_model(Entry, table)).file == path.name:
                return path.stem, found, place
            return path.stem, Entry(title=path.stem, file=path.name), place
        if (path / "entry.toml").is_file():
            return path.resolve().name, read_model(Entry, path / "entry.toml"), path.resolve()
        raise ScenarioError(
            f"entry '{name}': neither a shipped law, a law's file, nor a folder with an entry.toml"
            f"{nearest(str(name), self.about.laws)}"
        )

    def runs(self, fixed: Sequence[str], *, rigs: int | None = None) -> list[BenchRun]:
        """The runs of all tasks on the first rigs, under overrides.

        Raises:
            ScenarioError: If an override is wrong.
        """
        found = []
        for task in self.about.tasks:
            own = self.folder / task.scenario
            build = Builder(str(own) if own.suffix else task.scenario)
            for rig, point in enumerate(self.points[:rigs]):
                for noise in range(self.about.seeds):
                    seed = f"seed={self.seeds[rig] + noise}"
                    overrides = (*self.about.set, *task.set, *fixed, seed)
                    found.append(BenchRun(task.name, rig, noise, build(overrides, point)))
        return found

    def run_entry(
        self, entry: Entry, place: Path, store: Store, *, rigs: int | None = None, **how: Any
    ) -> pd.DataFrame:
        """Carry out what is missing: a row for each run, with task, rig, noise and indicators.

        Args:
            entry: The entry.
            place: Folder of its file.
            store: Store of finished runs.
            rigs: Number of rigs; all by default.
            how: Processes or a cluster, as for ``carry``.

        Raises:
            LawError: If its code fails: file, line and error.
            ScenarioError: If it sets keys that are not an entry's.
        """
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=rigs)
        text = read_regular(place / entry.file).hex() if entry.file else ""
        mark = digest(" ".join((text, *entry.command))) if text else ""
        work = ScenarioRuns((each.scenario for each in listed), mark=mark)
        do = partial(carry_out_entry, entry, place) if text else None
        rows = carry(work, store, do=do, **how).to_pandas()
        for reason in rows.loc[rows["outcome"] == "refused", "reason"]:
            raise LawError(f"{entry.title}: {reason}")
        labels = pd.DataFrame([each.label for each in listed], columns=list(LABEL_COLUMNS))
        return labels.join(rows[["outcome", self.about.metric, EFFORT_METRIC]])

    def processor_time(self, entry: Entry, place: Path, timing: TimingRuns = TIMING_RUNS) -> float:
        """Estimated processor time of all runs, s, from the time of the beginnings of some.

        Args:
            entry: The entry.
            place: Folder of its file.
            timing: Which beginnings are timed.

        Raises:
            LawError: If its code fails.
        """
        took, durations = [0.0], [0.0]
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=math.ceil(CHUNK_RUNS / self.about.seeds))
            some = [each.scenario for each in listed if each.task == listed[0].task]
            for duration in timing.durations_s:
                durations.append(duration)
                brief = {"duration": duration, "metrics": MetricsTable(start=0.0)}
                begin = time.perf_counter()
                simulate([each.model_copy(update=brief) for each in some])
                took.append(time.perf_counter() - begin)
                if took[-1] > timing.enough_s:
                    break
        rate = (took[-1] - took[-2]) / (durations[-1] - durations[-2])
        whole = sum({each.task: each.scenario.duration for each in listed}.values())
        return rate * whole * len(self.points) * self.about.seeds / len(some)

    def known(self, **how: Any) -> pd.DataFrame:
        """The reference law's error in each run: frozen, or of a season computed once and kept.

        It is kept in runs/season-FINGERPRINT, next to the folders of entries.

        Args:
            how: Processes or a cluster for missing runs, as for ``carry``.
        """
        if self._known is None and not self.season:
            self._known = pd.read_csv(self.folder / "reference.csv")
        if self._known is None:
            store = Store(Path("runs") / f"season-{self.season}")
            law = self.about.laws[self.about.reference]
            self._known = self.as_reference(self.run_entry(law, self.folder, store, **how))
        return self._known

    def as_reference(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Runs of the reference law with their ``reference`` error; its largest where lost."""
        error = rows[self.about.metric]
        most = error.groupby(rows["task"]).transform("max")
        return rows[["task", "rig", "noise"]].assign(reference=error.fillna(most))

    def relative(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows with ``error``, relative to the reference law's on the same rig and noise.

        A lost ball counts as the worst possible error, ``most``, and so does a run that is missing
        in the rows.
        """
        both = rows.merge(self.known(), "right", on=["task", "rig", "noise"], validate="1:1")
        part = both[self.about.metric] / both["reference"]
        lost = (both["outcome"] != "finished") | ~np.isfinite(part)
        return both.assign(error=part.clip(upper=self.about.most).mask(lost, self.about.most))

    def scores(self, rows: pd.DataFrame) -> list[BenchScore]:
        """The scores of an entry, task by task."""
        scoring, found = self.scoring, []
        strata = [point.get(scoring.stratum_key) for point in self.points]
        for task, its in self.relative(rows).groupby("task", sort=False):
            table = its.pivot_table(index="rig", columns="noise", values="error")
            low, high = interval(table.to_numpy(), [strata[rig] for rig in table.index], scoring)
            errors = np.sort(table.to_numpy().ravel())
            worst = errors[-max(1, int(scoring.worst_share * len(errors))) :]
            good = its["outcome"].eq("finished").groupby(its["rig"]).all()
            test = scipy.stats.binomtest(int(good.sum()), len(good))
            share = test.proportion_ci(scoring.confidence, method="wilson")
            found.append(
                BenchScore(
                    str(task),
                    float(interquartile(errors, scoring)),
                    low,
                    high,
                    float(worst.mean()),
                    int(good.sum()),
                    float(share.low),
                    float(share.high),
                    float(its[EFFORT_METRIC].median()),
                )
            )
        return found

    def differences(self, *, rigs: int = 2) -> Iterator[str]:
        """Differences of the benchmark from its frozen state, in words: files, errors of laws.

        Args:
            rigs: Number of rigs on which the errors of the laws in ``lock.toml`` are computed.
        """
        lock, tasks = read_model(Lock, self.folder / "lock.toml"), self.about.tasks
        for name, wanted in lock.files.items():
            if hash_file(self.folder, name) != wanted:
                yield f"{name}: not the file that was frozen"
        if not rigs:
            return
        for law, errors in lock.expected.items():
            rows = self.run_entry(self.about.laws[law], self.folder, Store(None), rigs=rigs)
            runs, near = rigs * self.about.seeds, lock.rounding[law]
            expected = np.concatenate([errors[task.name][:runs] for task in tasks])
            apart = np.concatenate([near.get(task.name, (0.0,) * runs)[:runs] for task in tasks])
            yield from self._compare(rows, expected, self.about.metric, law, 2 * apart)

    def replay(self, folder: Path, **how: Any) -> Iterator[str]:
        """Differences of an entry's folder from its replay and its scores, in words.

        Args:
            folder: Folder of the entry.
            how: Processes or a cluster for missing runs of the reference law, as for ``carry``.

        Raises:
            RecordError: If it contains no finished entry, or one on other rigs.
        """
        written, its = scores_of(folder)
        if its != self.season:
            raise RecordError(f"{folder}: on {rigs_of(its)}, not on {rigs_of(self.season)}")
        self.known(**how)
        try:
            rows, commands = self._rows_of(folder), commands_of(folder)
            same = [each._asdict() for each in self.scores(rows)] == written
        except (OSError, LookupError, TypeError, ValueError, BadZipFile) as error:
            raise RecordError(f"{folder}: contains no finished entry: {why(error)}") from error
        if not same:
            yield "scores.json: not the scores of runs.parquet"
        whole = self.relative(rows)
        first = whole[whole["rig"] < self.about.replayed].reset_index(drop=True)
        if [each.shape[1:] for each in commands] != [(2,)] * len(first):
            yield "commands.npz: not those of every run on the first rigs"
            return
        for row, kept in zip(first.itertuples(), commands, strict=True):
            if not kept.size or not np.isfinite(kept).all():
                where = f"{row.task}, rig {row.rig}, noise {row.noise}"
                what = "a command that is no number" if kept.size else "no commands"
                yield f"commands.npz: {where}: has {what}"
                return
        with register_commands(commands) as name:
            listed = self.runs((f"controller.kind={name}",), rigs=self.about.replayed)
            work = ScenarioRuns(
                each.scenario.model_copy(update={"controller": replay_of(name, number)})
                for number, each in enumerate(listed)
            )
            again = pd.DataFrame(carry_out(work.jobs(work.tasks)))
        both = first.assign(**again[["outcome", self.about.metric, EFFORT_METRIC]])
        errors, efforts = (first[each].to_numpy() for each in (self.about.metric, EFFORT_METRIC))
        yield from self._compare(both, errors, self.about.metric, "replay")
        yield from self._compare(both, efforts, EFFORT_METRIC, "replay, effort", unit="rad/s^2")

    def _compare(
        self,
        rows: pd.DataFrame,
        expected: Array,
        metric: str,
        what: str,
        free: Array | float = 0.0,
        unit: str = "m",
    ) -> Iterator[str]:
        """``compare_runs`` with the tolerance of this benchmark's platforms."""
        tolerance = self.scoring.platform_tolerance
        return compare_runs(rows, expected, metric, what, free, unit, tolerance)

    def _rows_of(self, folder: Path) -> pd.DataFrame:
        """The runs of a finished entry, after a check that it has all runs of the benchmark."""
        file = folder / "runs.parquet"
        check_regular(file.lstat())
        expected = len(self.points) * self.about.seeds * len(self.about.tasks)
        if (count := ParquetFile(file).metadata.num_rows) > expected:
            raise ValueError(
                f"runs.parquet has {plural(count, 'row')}, of {plural(expected, 'run')}"
            )
        return pd.read_parquet(file)

    @property
    def confirmed(self) -> str:
        """The message of an entry without differences."""
        rigs, count = min(self.about.replayed, len(self.points)), len(self.points)
        return (
            f"confirmed on {rigs} of {plural(count, 'rig')} replayed: the same errors and efforts; "
            "the scores are those of its runs"
        )

    def write(
        self, folder: Path, entry: Entry, place: Path, rows: pd.DataFrame
    ) -> list[BenchScore]:
        """Write a finished entry: its runs, scores, and the commands on the first rigs."""
        found = self.scores(rows)
        kept: dict[tuple[str, int, int], Array] = {}
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=self.about.replayed)
            alike = [task.alike for task in ScenarioRuns(each.scenario for each in listed).tasks]
            for kind in dict.fromkeys(alike):
                its = [each for each, own in zip(listed, alike, strict=True) if own == kind]
                these: list[Array] = []
                simulate([each.scenario for each in its], requested=these)
                kept |= {each.label: u for each, u in zip(its, these, strict=True)}
        ordered = [kept[each.label] for each in listed]

        def commands(path: Path) -> None:
            with path.open("wb") as file:
                np.savez_compressed(file, *ordered)

        for name in filter(None, (entry.file, "README.md")):
            with suppress(DataError):  # a README may be missing, and a link is not followed
                write_whole(folder / name, read_regular(place / name))
        write_whole(folder / "entry.toml", format_toml(entry.model_dump()))
        write_whole(folder / "runs.parquet", lambda path: rows.to_parquet(path, index=False))
        write_whole(folder / "commands.npz", commands)
        scores = {"season": self.season, "scores": [each._asdict() for each in found]}
        write_json(folder / SCORES_FILE, scores)
        return found


class Lock(Checked):
    """The state of a benchmark when it was frozen.

    Attributes:
        files: SHA-256 of its files and of the model's, by name.
        expected: By law and task, errors in m on the first rigs, noise by noise.
        rounding: For tasks in which the ball is held, in the same order, the differences of the
            errors in m when it begins up to 3 um away: under some laws the last bit decides where
            it sticks.
    """

    files: dict[str, str]
    expected: dict[str, dict[str, tuple[float, ...]]]
    rounding: dict[str, dict[str, tuple[float, ...]]]


SEASON_RIGS = 64
"""Number of rigs of a season."""


def season(key: str) -> tuple[str, pd.DataFrame]:
    """The fingerprint of a season's key, 12 digits of its SHA-256, and the rigs that it draws.

    Raises:
        ScenarioError: If the key is too short or has other characters.
    """
    if not SEASON_KEY_PATTERN.fullmatch(key):
        raise ScenarioError("--season: a key is 16 or more letters, digits or signs of ASCII")
    code = hashlib.sha256(key.encode()).hexdigest()
    rigs = draw_rigs(read_family(FAMILY_NAME), int(code, 16), SEASON_RIGS)
    return code[:12], pd.DataFrame([{**rig.point, "seed": rig.seed} for rig in rigs])


def rigs_of(season: str) -> str:
    """The rigs of a season's fingerprint in words; of an empty one the frozen rigs."""
    return f"the rigs of season {season}" if season else "the frozen rigs"


def scores_of(folder: Path) -> tuple[list[dict[str, Any]], str]:
    """The scores in a finished entry's folder, task by task, and its season's fingerprint.

    Raises:
        RecordError: If it holds none.
    """
    try:
        found: dict[str, Any] = json.loads(read_regular(folder / SCORES_FILE))
        return found["scores"], str(found.get("season", ""))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RecordError(f"{folder}: contains no finished entry: {why(error)}") from error


def scores_side_by_side(folders: Sequence[Path]) -> tuple[dict[str, list[dict[str, Any]]], str]:
    """The scores of finished entries by their folder, and the fingerprint of their one season.

    Raises:
        RecordError: If one holds none, or they are on different rigs.
    """
    found = {str(each): scores_of(each) for each in folders}
    (first, (_, season)), *_ = found.items()
    for name, (_, its) in found.items():
        if its != season:
            raise RecordError(f"{name}: on {rigs_of(its)}, but {first} on {rigs_of(season)}")
    return {name: scores for name, (scores, _) in found.items()}, season


def hash_file(folder: Path, name: str) -> str:
    """SHA-256 of a file of a benchmark, or of the model."""
    path = model_path(name) if name in MODEL_FILES else folder / name
    return hashlib.sha256(path.read_bytes()).hexdigest()
