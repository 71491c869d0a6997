"""The public benchmark: the same tasks on the same rigs for every law, entries that are verified.

A law is judged rig by rig and noise by noise beside the same reference law. What was commanded on
some rigs is kept, so that whoever verifies an entry replays it and runs no code of others. Beside
the frozen rigs, which anyone may tune on, a season has some that only its key draws.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, NamedTuple
from zipfile import BadZipFile, ZipFile

import numpy as np
import pandas as pd
from pyarrow.parquet import ParquetFile
from pydantic import Field
from scipy import stats

from controllers import catalog
from controllers.arrays import Array
from controllers.interfaces import Feedback, Law, Reference
from twin.base.data_file import DataError, check_regular, read_regular
from twin.base.errors import LawError, RecordError, ScenarioError, nearest
from twin.base.shipped import folder as scenarios_folder
from twin.base.shipped import model_path
from twin.base.validation import Checked, read_model
from twin.base.writing import why, write_json, write_whole
from twin.lab.process import ANSWER_NAME, AnswerProcess, answering
from twin.lab.schema import AnswerTable, toml
from twin.run.loop import simulate
from twin.scenario.schema import ControllerChoice, MetricsTable, Scenario
from twin.study.experiments import CHUNK_RUNS, Store, carry
from twin.study.schema import Point, Variant, draw_rigs, read_family
from twin.study.work import Builder, Job, Row, ScenarioRuns, carry_out, digest

EFFORT = "u_rms"
"""The indicator of a run that its effort is, rad/s^2."""
MAX_COMMANDS_BYTES = 1 << 30
"""Sum of the commands of an entry, unpacked."""
ENTRY_TABLES = ("controller", "observer", "predictor")
"""The tables of a scenario that are an entry's."""
MAX_CHUNK_CPU_S = 300.0
"""Seconds of a processor that an entry's code may take for ``CHUNK`` runs, or fewer."""
BOOTSTRAP_DRAWS = 2000
"""Samples of the bootstrap."""
STRATUM_KEY = "sensors.touch.frame_rate"
"""The rigs with equal values of this key are drawn among themselves."""
FAMILY_NAME = "uncertain"
"""The family that all rigs are drawn from."""
TIMED_SECONDS = (0.05, 0.25, 1.0)
"""Of how many seconds of a run the time that all runs take is told beforehand."""
ENOUGH_TIMING_S = 1.0
"""Seconds after which no longer beginning is timed."""
SEASON_RIGS = 64
"""Rigs of a season."""
SEASON_KEY_PATTERN = re.compile("[!-~]{16,}")
"""What a season's key may be: its fingerprint is public, so nobody must guess it."""
LOCKED_FILES = ("bench.toml", "faults.toml", "rigs.csv", "reference.csv")
MODEL_FILES = ("ballplate.xml", "cams.json")
PLATFORM_TOLERANCE = 0.02
"""Relative difference of an error that another platform may make: friction magnifies last bits."""


class Entry(Checked):
    """A law, as ``entry.toml`` says.

    Attributes:
        title: What it is called.
        authors: Whose it is.
        citation: Where it is described.
        knows: What it was told of the rigs beyond the nominal one.
        tuning: On how many seconds of rigs it was tuned.
        computing: How long one of its commands takes, s; 0 for not said.
        kind: Of what its file has one class, or what its program is.
        file: Its code; none if settings of shipped laws say all.
        command: A program in another language and its arguments, ``file`` among them.
        set: Overrides ``key=value`` of ``ALLOWED`` tables.
    """

    title: str
    authors: tuple[str, ...] = ()
    citation: str = ""
    knows: str = ""
    tuning: Annotated[float, Field(ge=0)] = 0.0
    computing: Annotated[float, Field(ge=0)] = 0.0
    kind: Literal["law", "observer"] = "law"
    file: str = ""
    command: tuple[str, ...] = ()
    set: tuple[str, ...] = ()


class Bench(Checked):
    """A benchmark; see the comments in its file.

    ``tasks`` are what every rig is to do, each a scenario, shipped or in the benchmark's folder.
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
    """One run of an entry: the task's name, the number of the rig and of the noise, what runs."""

    task: str
    rig: int
    noise: int
    scenario: Scenario


class BenchScore(NamedTuple):
    """What an entry came to in a task; errors are parts of the reference law's.

    Attributes:
        task: Its name.
        error: Interquartile mean of the relative error over all rigs and noises.
        low: Where its 95 % interval begins, by bootstrap over the rigs.
        high: Where it ends.
        worst: Mean of the worst tenth.
        kept: Rigs on which no ball was lost.
        kept_low: Least share of such rigs, Wilson's 95 % interval.
        kept_high: Largest.
        effort: Median of the RMS control effort, rad/s^2.
    """

    task: str
    error: float
    low: float
    high: float
    worst: float
    kept: int
    kept_low: float
    kept_high: float
    effort: float


class Benchmark:
    """A frozen benchmark in a folder, on its frozen rigs or on those of a season.

    Args:
        folder: Where it lies; the shipped one by default.
        key: Draws the rigs of a season; None for the frozen ones.

    Attributes:
        points: What each rig is.
        seeds: Of the first noise of each.
        season: The fingerprint of the season's key; empty for the frozen rigs.

    Raises:
        ScenarioError: If it is none, or the key is too short or has other characters.
    """

    def __init__(self, folder: Path | None = None, *, key: str | None = None) -> None:
        self.folder = folder or scenarios_folder() / "bench" / "v1"
        self.about: Bench = read_model(Bench, self.folder / "bench.toml")
        table = pd.read_csv(self.folder / self.about.rigs, dtype=str).map(json.loads)
        self.season, table = ("", table) if key is None else season(key)
        self.seeds: list[int] = table.pop("seed").tolist()
        self.points: list[Point] = table.to_dict("records")
        self._known: pd.DataFrame | None = None

    def out(self, name: str) -> Path:
        """The folder that an entry of this name has by default, another one for every season."""
        return Path("runs") / "-".join(filter(None, ("bench", name, self.season)))

    def entry(self, name: str | Path) -> tuple[str, Entry, Path]:
        """An entry, what it is called and where its files lie: shipped, a folder, or a law's file.

        Raises:
            ScenarioError: If there is none.
        """
        path = Path(name)
        if str(name) in self.about.laws:
            return str(name), self.about.laws[str(name)], self.folder
        if path.suffix == ".py" and path.is_file():
            table, place = path.with_name("entry.toml"), path.parent.resolve()
            if table.is_file() and (said := read_model(Entry, table)).file == path.name:
                return path.stem, said, place
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
                    said = (*self.about.set, *task.set, *fixed, seed)
                    found.append(BenchRun(task.name, rig, noise, build(said, point)))
        return found

    def carried_out(
        self, entry: Entry, place: Path, store: Store, *, rigs: int | None = None, **how: Any
    ) -> pd.DataFrame:
        """Carry out what is missing: a row for each run, with task, rig, noise and indicators.

        Args:
            entry: Whose runs.
            place: Where its file lies.
            store: Where finished runs are, and are put.
            rigs: So many of them; all by default.
            how: Who carries them out, as for ``carry``.

        Raises:
            LawError: If its code fails: file, line and error.
            ScenarioError: If it sets what is not its own.
        """
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=rigs)
        text = read_regular(place / entry.file).hex() if entry.file else ""
        mark = digest(" ".join((text, *entry.command))) if text else ""
        work = ScenarioRuns((each.scenario for each in listed), mark=mark)
        do = partial(_carried_out, entry, place) if text else None
        rows = carry(work, store, do=do, **how).to_pandas()
        for reason in rows.loc[rows["outcome"] == "refused", "reason"]:
            raise LawError(f"{entry.title}: {reason}")
        labels = pd.DataFrame([each[:3] for each in listed], columns=list(BenchRun._fields[:3]))
        return labels.join(rows[["outcome", self.about.metric, EFFORT]])

    def processor_time(self, entry: Entry, place: Path) -> float:
        """About how long all runs take a processor, s: the first moments of some are timed.

        Args:
            entry: Whose runs.
            place: Where its file lies.

        Raises:
            LawError: If its code fails.
        """
        took, lasts = [0.0], [0.0]
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=math.ceil(CHUNK_RUNS / self.about.seeds))
            some = [each.scenario for each in listed if each.task == listed[0].task]
            for duration in TIMED_SECONDS:
                lasts.append(duration)
                brief = {"duration": duration, "metrics": MetricsTable(start=0.0)}
                begin = time.perf_counter()
                simulate([each.model_copy(update=brief) for each in some])
                took.append(time.perf_counter() - begin)
                if took[-1] > ENOUGH_TIMING_S:
                    break
        rate = (took[-1] - took[-2]) / (lasts[-1] - lasts[-2])
        whole = sum({each.task: each.scenario.duration for each in listed}.values())
        return rate * whole * len(self.points) * self.about.seeds / len(some)

    def known(self, **how: Any) -> pd.DataFrame:
        """The reference law's error in each run: frozen, or of a season run here once and kept.

        It is kept in runs/season-FINGERPRINT, beside what entries have and say.

        Args:
            how: Who carries out what is missing, as for ``carry``.
        """
        if self._known is None and not self.season:
            self._known = pd.read_csv(self.folder / "reference.csv")
        if self._known is None:
            store = Store(Path("runs") / f"season-{self.season}")
            law = self.about.laws[self.about.reference]
            self._known = self.as_reference(self.carried_out(law, self.folder, store, **how))
        return self._known

    def as_reference(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Runs of the reference law with ``reference``, its error; its worst in a task if lost."""
        error = rows[self.about.metric]
        most = error.groupby(rows["task"]).transform("max")
        return rows[["task", "rig", "noise"]].assign(reference=error.fillna(most))

    def relative(self, rows: pd.DataFrame) -> pd.DataFrame:
        """Rows with ``error``, the part of the reference law's on the same rig and noise.

        A lost ball counts as much as the worst that is possible, ``most``, and so does a run that
        is not among the rows.
        """
        both = rows.merge(self.known(), "right", on=["task", "rig", "noise"], validate="1:1")
        part = both[self.about.metric] / both["reference"]
        lost = (both["outcome"] != "finished") | ~np.isfinite(part)
        return both.assign(error=part.clip(upper=self.about.most).mask(lost, self.about.most))

    def scores(self, rows: pd.DataFrame) -> list[BenchScore]:
        """What an entry came to, task by task."""
        strata = [point.get(STRATUM_KEY) for point in self.points]
        found = []
        for task, its in self.relative(rows).groupby("task", sort=False):
            table = its.pivot_table(index="rig", columns="noise", values="error")
            low, high = interval(table.to_numpy(), [strata[rig] for rig in table.index])
            errors = np.sort(table.to_numpy().ravel())
            good = its["outcome"].eq("finished").groupby(its["rig"]).all()
            share = stats.binomtest(int(good.sum()), len(good)).proportion_ci(method="wilson")
            found.append(
                BenchScore(
                    str(task),
                    float(interquartile(errors)),
                    low,
                    high,
                    float(errors[-max(1, len(errors) // 10) :].mean()),
                    int(good.sum()),
                    float(share.low),
                    float(share.high),
                    float(its[EFFORT].median()),
                )
            )
        return found

    def differences(self, *, rigs: int = 2) -> Iterator[str]:
        """What of the benchmark is not as it was frozen, in words: files, then errors of laws.

        Args:
            rigs: On so many rigs the errors of the laws in ``lock.toml`` are found again.
        """
        lock, tasks = read_model(Lock, self.folder / "lock.toml"), self.about.tasks
        for name, wanted in lock.files.items():
            if hash_file(self.folder, name) != wanted:
                yield f"{name}: not the file that was frozen"
        for law, told in lock.expected.items() if rigs else ():
            rows = self.carried_out(self.about.laws[law], self.folder, Store(None), rigs=rigs)
            runs, near = rigs * self.about.seeds, lock.rounding[law]
            expected = np.concatenate([told[task.name][:runs] for task in tasks])
            apart = np.concatenate([near.get(task.name, (0.0,) * runs)[:runs] for task in tasks])
            yield from unlike(rows, expected, self.about.metric, law, 2 * apart)

    def replayed(self, folder: Path, **how: Any) -> Iterator[str]:
        """What is not as an entry's folder says when it is replayed and scored again, in words.

        Args:
            folder: Of the entry.
            how: Who carries out what is missing of the reference law, as for ``carry``.

        Raises:
            RecordError: If it holds no finished entry, or one on other rigs.
        """
        told, its = scores_of(folder)
        if its != self.season:
            raise RecordError(f"{folder}: on {rigs_of(its)}, not on {rigs_of(self.season)}")
        self.known(**how)
        try:
            rows = self._rows_of(folder)
            Replayed.commands = commands_of(folder)
            same = [each._asdict() for each in self.scores(rows)] == told
        except (OSError, LookupError, TypeError, ValueError, BadZipFile) as error:
            raise RecordError(f"{folder}: holds no finished entry: {why(error)}") from error
        if not same:
            yield "scores.json: not the scores of runs.parquet"
        whole = self.relative(rows)
        first = whole[whole["rig"] < self.about.replayed].reset_index(drop=True)
        if [each.shape[1:] for each in Replayed.commands] != [(2,)] * len(first):
            yield "commands.npz: not those of every run on the first rigs"
            return
        for row, kept in zip(first.itertuples(), Replayed.commands, strict=True):
            if not kept.size or not np.isfinite(kept).all():
                where = f"{row.task}, rig {row.rig}, noise {row.noise}"
                what = "a command that is no number" if kept.size else "no commands"
                yield f"commands.npz: {where}: has {what}"
                return
        catalog.register(Replayed)
        try:
            listed = self.runs((f"controller.kind={Replayed.name}",), rigs=self.about.replayed)
            work = ScenarioRuns(
                each.scenario.model_copy(update={"controller": _replaying(number)})
                for number, each in enumerate(listed)
            )
            again = pd.DataFrame(carry_out(work.jobs(work.tasks)))
        finally:
            catalog.unregister(Replayed.name)
        both = first.assign(**again[["outcome", self.about.metric, EFFORT]])
        yield from unlike(both, first[self.about.metric].to_numpy(), self.about.metric, "replay")
        efforts = first[EFFORT].to_numpy()
        yield from unlike(both, efforts, EFFORT, "replay, effort", unit="rad/s^2")

    def _rows_of(self, folder: Path) -> pd.DataFrame:
        """The runs of a finished entry, once their number is known to be that of the benchmark."""
        file = folder / "runs.parquet"
        check_regular(file.lstat())
        expected = len(self.points) * self.about.seeds * len(self.about.tasks)
        if (count := ParquetFile(file).metadata.num_rows) > expected:
            raise ValueError(f"runs.parquet has {count} rows, of {expected} runs")
        return pd.read_parquet(file)

    @property
    def confirmed(self) -> str:
        """What it says of an entry that nothing of it differs, in words."""
        rigs, count = min(self.about.replayed, len(self.points)), len(self.points)
        return (
            f"confirmed on {rigs} of {count} rigs replayed: the same errors and efforts; "
            "the scores are those of its runs"
        )

    def write(
        self, folder: Path, entry: Entry, place: Path, rows: pd.DataFrame
    ) -> list[BenchScore]:
        """Write a finished entry: its runs, scores, and what was commanded on the first rigs."""
        found = self.scores(rows)
        kept: dict[tuple[str, int, int], Array] = {}
        with enter(entry, place) as (fixed, _):
            listed = self.runs(fixed, rigs=self.about.replayed)
            alike = [task.alike for task in ScenarioRuns(each.scenario for each in listed).tasks]
            for kind in dict.fromkeys(alike):
                its = [each for each, own in zip(listed, alike, strict=True) if own == kind]
                these: list[Array] = []
                simulate([each.scenario for each in its], requested=these)
                kept |= {each[:3]: u for each, u in zip(its, these, strict=True)}
        said = [kept[each[:3]] for each in listed]

        def commands(path: Path) -> None:
            with path.open("wb") as file:
                np.savez_compressed(file, *said)

        for name in filter(None, (entry.file, "README.md")):
            with suppress(DataError):  # a README may be missing, and a link is not followed
                write_whole(folder / name, read_regular(place / name))
        write_whole(folder / "entry.toml", toml(entry.model_dump()))
        write_whole(folder / "runs.parquet", lambda path: rows.to_parquet(path, index=False))
        write_whole(folder / "commands.npz", commands)
        told = {"season": self.season, "scores": [each._asdict() for each in found]}
        write_json(folder / "scores.json", told)
        return found


class Lock(Checked):
    """What a benchmark was when it was frozen.

    Attributes:
        files: SHA-256 of its files and of the model's, by name.
        expected: By law and task, errors in m on the first rigs, noise by noise.
        rounding: Of tasks in which the ball is held, in the same order, how far apart they were, m,
            with it begun up to 3 um beside: where it sticks, under some laws, goes by the last bit.
    """

    files: dict[str, str]
    expected: dict[str, dict[str, tuple[float, ...]]]
    rounding: dict[str, dict[str, tuple[float, ...]]]


@dataclass(frozen=True, kw_only=True)
class Replayed(Law):
    """Commands that were recorded."""

    name: ClassVar[str] = "replayed"
    commands: ClassVar[list[Array]] = []
    """Plate accelerations in rad/s^2 of each run, shape (ticks, 2)."""

    number: int = 0
    """Index of the run."""

    def start(self, x: Array, reference: Reference, period: float) -> float:
        """The control period."""
        return period

    def command(self, now: Feedback) -> Array:
        """What was commanded at this time, shape (..., 2)."""
        kept = self.commands[self.number]  # as long as the longest run beside it
        u = kept[min(round(now.time / now.plan), len(kept) - 1)]
        return np.broadcast_to(u, now.rate.shape)


def _replaying(number: int) -> ControllerChoice:
    return ControllerChoice.model_validate({"kind": Replayed.name, "number": number})


@contextmanager
def enter(
    entry: Entry, place: Path, runs: int = 0
) -> Iterator[tuple[tuple[str, ...], AnswerProcess | None]]:
    """The overrides that put an entry into a scenario, and the process that its code runs in.

    Args:
        entry: Which.
        place: Where its file lies.
        runs: For how many runs; more than ``CHUNK`` have more time.

    Raises:
        LawError: If its code cannot be loaded.
        ScenarioError: If it sets what is not its own.
    """
    for text in entry.set:
        if re.split(r"[.=]", text)[0] not in ENTRY_TABLES:
            raise ScenarioError(
                f"set: '{text}': an entry sets {', '.join(ENTRY_TABLES)} and no more"
            )
    if not entry.file and not entry.command:
        yield entry.set, None
        return
    if Path(entry.file).name != entry.file or not (place / entry.file).is_file():
        raise ScenarioError(f"file: '{entry.file}': must be a file beside the entry.toml")
    table = "controller" if entry.kind == "law" else "observer"
    if any(re.match(rf"{table}(\.kind)?=", text) for text in entry.set):
        raise ScenarioError(f"set: {table}: is the entry's own file; leave one of them out")
    said = entry.model_dump(include={"kind", "file", "command"})
    about = AnswerTable.model_validate(
        {**said, "seconds": MAX_CHUNK_CPU_S * max(1, runs / CHUNK_RUNS)}
    )
    with answering(place / entry.file, about) as process:
        yield (*entry.set, f"{table}.kind={ANSWER_NAME}"), process


def _carried_out(entry: Entry, place: Path, jobs: Sequence[Job]) -> list[Row]:
    """Carry out runs of an entry that has code; one that fails is refused at once."""
    with enter(entry, place, len(jobs)) as (_, process):
        rows = carry_out(jobs)
        if process is not None and process.failure is not None:
            raise LawError(process.failure)
    return rows


def interquartile(errors: Array, axis: int | None = None) -> Any:
    """The mean without the lowest and the highest quarter."""
    return stats.trim_mean(errors, 0.25, axis=axis)


def interval(errors: Array, strata: Sequence[Any]) -> tuple[float, float]:
    """The 95 % interval of the interquartile mean: rigs drawn again, stratum by stratum.

    Args:
        errors: Relative errors, shape (rigs, noises).
        strata: To which each rig belongs.
    """
    rng, rigs = np.random.default_rng(0), np.array([repr(each) for each in strata])
    places = [np.flatnonzero(rigs == each) for each in np.unique(rigs)]
    drawn = [each[rng.integers(len(each), size=(BOOTSTRAP_DRAWS, len(each)))] for each in places]
    means = interquartile(errors[np.hstack(drawn)].reshape(BOOTSTRAP_DRAWS, -1), axis=1)
    low, high = np.quantile(means, [0.025, 0.975])
    return float(low), float(high)


def unlike(
    rows: pd.DataFrame,
    told: Array,
    metric: str,
    what: str,
    free: Array | float = 0.0,
    unit: str = "m",
) -> Iterator[str]:
    """The runs whose error is not as it was told, beyond what platforms differ by, in words.

    Args:
        rows: Of the runs.
        told: The error of each, in the unit.
        metric: The column that has it.
        what: Which law, for the words.
        free: By how much an error may be another, in the unit, beside ``TOLERANCE`` of it.
        unit: Of the column.
    """
    free = np.broadcast_to(free, len(rows))
    for row, wanted, by in zip(rows.itertuples(), np.asarray(told, float), free, strict=True):
        value = getattr(row, metric)
        if not np.isclose(value, wanted, rtol=PLATFORM_TOLERANCE, atol=by, equal_nan=True):
            where = f"{what}: {row.task}, rig {row.rig}, noise {row.noise}"
            yield f"{where}: {value:.9g} {unit}, told {wanted:.9g} {unit}"


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
    """What the rigs are called that a season's fingerprint stands for, or none."""
    return f"the rigs of season {season}" if season else "the frozen rigs"


def scores_of(folder: Path) -> tuple[list[dict[str, Any]], str]:
    """What a finished entry says that it came to, task by task, and its season's fingerprint.

    Raises:
        RecordError: If it holds none.
    """
    try:
        found: dict[str, Any] = json.loads(read_regular(folder / "scores.json"))
        return found["scores"], str(found.get("season", ""))
    except (OSError, ValueError, LookupError, TypeError) as error:
        raise RecordError(f"{folder}: holds no finished entry: {why(error)}") from error


def commands_of(folder: Path) -> list[Array]:
    """What a finished entry says that it commanded, run by run, each of shape (ticks, 2), rad/s^2.

    Raises:
        TwinError: If the file may not be opened, or is too large.
        OSError: If it cannot be read.
        ValueError: If it has something else than numbers.
        BadZipFile: If it is none of numpy's files.
    """
    file = folder / "commands.npz"
    check_regular(file.lstat())
    with ZipFile(file) as packed:
        if sum(each.file_size for each in packed.infolist()) > MAX_COMMANDS_BYTES:
            raise ValueError(f"commands.npz unpacks to more than {MAX_COMMANDS_BYTES >> 20} MB")
    with np.load(file) as commands:
        return [np.asarray(commands[f"arr_{i}"], float) for i in range(len(commands.files))]


def beside(folders: Sequence[Path]) -> tuple[dict[str, list[dict[str, Any]]], str]:
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
