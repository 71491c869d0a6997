"""Studies: many runs over drawn or listed values and rigs, their statistics and their report."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.reporter import Reporter, check_processes, default, png, showable, writable
from twin.base.errors import ScenarioError, plural
from twin.base.page import Block, Picture, Text, fragment

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from matplotlib.figure import Figure

    from twin.study.answers import Answer
    from twin.study.experiments import Do
    from twin.study.screen import Screen, Screened
    from twin.study.work import Work


MAX_FAMILY_RIGS = 100_000
"""Maximum number of rigs of a family, and maximum number of a draw."""


@dataclass(repr=False, eq=False)
class StudyResult:
    """Result of a study; shows itself in a notebook.

    Attributes:
        work: Its runs, with the study as it was asked.
        rows: Key, outcome, reason and indicators of every run, as an Arrow table.
        answers: Statistics, one per variant.
        screened: What many more points on the exact equations add, if the study was screened.

    Examples:
        >>> import ballplate as bp
        >>> from pathlib import Path
        >>> file = Path("own.toml")
        >>> _ = file.write_text('''
        ... title = "Speed of the circle"
        ... scenario = "circle"
        ... set = ["plant.kind=lagrange", "baseline=false", "duration=1.0"]
        ... method = "grid"
        ... [parameters."reference.omega"]
        ... values = [0.5, 1.0]
        ... unit = "rad/s"
        ... ''')
        >>> found = bp.study(file, seeds=1, processes=1)
        >>> found, len(found.to_pandas()), len(found.answers)
        (<StudyResult 'Speed of the circle': 2 runs>, 2, 1)
    """

    work: Work
    rows: pa.Table
    answers: list[Answer]
    screened: Screened | None = None

    @property
    def title(self) -> str:
        """Subject of the study, in a line."""
        return self.work.study.title

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.title!r}: {plural(self.rows.num_rows, 'run')}>"

    @property
    def sentences(self) -> list[str]:
        """Its results, in sentences."""
        from twin.study.report import sentences

        return sentences(self.work.study, self.answers)

    def to_pandas(self) -> pd.DataFrame:
        """A row per run: variant, point, seed, parameters, outcome, indicators."""
        from twin.study.experiments import label_rows

        return label_rows(self.work.labels, self.rows).to_pandas()

    def pairs(self) -> pd.DataFrame:
        """A row per pair of variants: mean difference of the first metric, first minus second.

        ``half`` is the half-width of its 95 % interval, ``better`` and ``worse`` count the runs in
        which the first has the smaller value, or alone finished. Both met the same points and
        noises.
        """
        import pandas as pd

        from twin.study.report import pairs_of

        columns = ["first", "second", "mean", "half", "better", "worse", "both_failed"]
        found = pairs_of(self.work.study, self.answers)
        return pd.DataFrame([vars(each) for each in found], columns=columns)

    def plot(self) -> dict[str, Figure]:
        """Its figures by name: ``curves``, ``indices`` or ``scatter``, as the method has."""
        from twin.study.report import figures

        found = figures(self.work.study, self.answers)
        return {name: showable(figure) for name, figure in found.items()}

    def save(self, folder: str | Path) -> Path:
        """Write report.html, figures, rows.parquet and rows.csv into a folder; returns it.

        Of a screened study ``screened.csv``, too, with a row for each run beyond the study's own.

        Raises:
            RecordError: If a file cannot be written.
        """
        from twin.study.report import write

        write(self.work, self.rows, self.answers, Path(folder), self._screened_blocks)
        if self.screened is not None:
            from twin.study.screen_report import write_rows

            write_rows(self.screened, Path(folder))
        return Path(folder)

    @property
    def _screened_blocks(self) -> list[Block]:
        if self.screened is None:
            return []
        from twin.study.screen_report import blocks

        return blocks(self.work.study, self.screened)

    def _repr_html_(self) -> str:
        """For a notebook: sentences, a row per variant, figures."""
        from twin.study.report import compare_variants

        found = compare_variants(self.work.study, self.answers)
        pictures = [Picture("", png(figure)) for figure in self.plot().values()]
        blocks = [Text(self.sentences), found, *pictures, *self._screened_blocks]
        return fragment(self.title, blocks)


def study(
    name: str | Path | Mapping[str, Any],
    *,
    out: str | Path | None = None,
    processes: int | None = None,
    scheduler: str | None = None,
    reporter: Reporter | None = None,
    screen: int | None = None,
    **keys: Any,
) -> StudyResult:
    """Run a study: a shipped one by name, a TOML file, or a dictionary with its keys.

    Args:
        name: Its name or file, or its tables, as ``{"title": ..., "scenario": "circle",
            "parameters": {...}, ...}``.
        out: Folder for its report and its finished runs: an interrupted study continues there, a
            finished one answers at once. None keeps nothing.
        processes: Processes to use; all processors by default.
        scheduler: Address of a Dask scheduler that has the workers.
        reporter: Receives progress; a notebook has its own.
        screen: Number of further points on the exact equations for each point on the mechanism, in
            compiled C where possible, of a ``montecarlo`` or ``sobol`` study. The estimates for
            the mechanism combine both and correct the bias of the exact equations; the worst and
            the best points are run again on the mechanism.
        keys: Keys that replace those of the study, as ``samples=8`` or ``seeds=2``.

    Raises:
        TwinError: If there is no such study, or anything in it is unknown or out of range.

    Examples:
        >>> import ballplate as bp
        >>> friction = {
        ...     "title": "Rolling friction",
        ...     "scenario": "circle",
        ...     "set": ["plant.kind=lagrange", "baseline=false", "duration=1.0"],
        ...     "method": "grid",
        ...     "parameters": {"plant.friction.rolling_mm": {"values": [0.1, 0.2], "unit": "mm"}},
        ... }
        >>> rows = bp.study(friction, seeds=1, processes=1).to_pandas()
        >>> rows["outcome"].tolist()
        ['finished', 'finished']
    """
    from twin.study.answers import answers
    from twin.study.experiments import Store, carry, executors

    report = reporter or default()
    check_processes(processes, report)
    called = name if isinstance(name, Mapping) else str(name)
    work, screening = screened_work_of(called, keys, screen, report)
    folder = writable(out, report)
    store = Store(folder)
    with executors(processes, scheduler) as (executor, count):

        def finish(some: Work, title: str = work.study.title) -> pa.Table:
            do: Do | None = None
            if some.study.engine == "c":
                from twin.study.compiled import carry_out_compiled

                do = carry_out_compiled
            with report.progress(title, some.different, "runs") as advance:
                return carry(
                    some,
                    store,
                    executor=executor,
                    processes=count,
                    do=do,
                    progress=lambda done, failed: advance(done, f"{failed} failed"),
                )

        rows = finish(work)
        screened = None if screening is None else screening.carry_out(rows, finish)
    found = StudyResult(work, rows, answers(work, rows), screened)
    if folder is not None:
        found.save(folder)
    return found


def screened_work_of(
    name: str | Mapping[str, Any], keys: Mapping[str, Any], times: int | None, reporter: Reporter
) -> tuple[Work, Screen | None]:
    """The runs of a study, and those of its screen if it has one.

    Args:
        name: Name, file or tables of the study.
        keys: Keys in place of the study's own.
        times: Points on the exact equations for each on the mechanism; None for no screen.
        reporter: Has the names of the arguments in messages.

    Raises:
        ScenarioError: If the study is wrong or cannot be screened.
    """
    if times is not None and keys.get("engine") == "c":
        engine, screen = map(reporter.name_of, ("engine", "screen"))
        raise ScenarioError(
            f"{engine} c: not with {screen}: its runs on the mechanism need Python; leave it out: "
            "the further runs are in C where all their settings allow it"
        )
    work = work_of(name, keys)
    return work, None if times is None else screen_of(name, work, times)


def screen_of(name: str | Mapping[str, Any], work: Work, times: int) -> Screen:
    """The runs of a screened study, each of them checked.

    Args:
        name: Name, file or tables of the study.
        work: Its runs on the mechanism.
        times: Points on the exact equations for each on the mechanism.

    Raises:
        ScenarioError: If it cannot be screened, as when the exact equations do not have a setting
            or its points are not drawn independently.
    """
    from twin.study.compiled import knows
    from twin.study.screen import Screen

    try:
        screen = Screen(work, times, "c")
        works = (screen.paired, screen.wide)
        if not knows(each.scenario(task) for each in works for task in each.tasks):
            screen = Screen(work, times)
    except ScenarioError as error:
        called = work.study.title if isinstance(name, Mapping) else name
        raise ScenarioError(f"study {called}: {error}") from error
    return screen


def family(
    source: str | Path | Mapping[str, Any],
    count: int,
    *,
    draw: int = 0,
    scenario: str | Path = "circle",
) -> list[dict[str, Any]]:
    """Draw rigs of a family: settings of each, as ``run(..., settings=...)`` takes them.

    Args:
        source: Name of a shipped family, a TOML file, or its tables.
        count: Number of rigs, 1 to 100,000.
        draw: Number of the draw, 0 or more; no two draws have a rig in common, and the first rigs
            of a draw are the same however many are drawn.
        scenario: Name or file of the scenario of which factors are taken, and entries of a list
            that are not drawn.

    Raises:
        ScenarioError: If there is no such family or scenario, or anything in it, the number of
            rigs or the number of the draw is unknown or out of range.

    Examples:
        >>> import ballplate as bp
        >>> rigs = bp.family("uncertain", 2, draw=1)
        >>> [round(rig["plant.friction.rolling_mm"], 3) for rig in rigs]
        [0.219, 0.181]
        >>> bp.run("circle", settings=rigs[0], duration=0.1).outcome
        'finished'
    """
    from twin.study.schema import draw_rigs, read_family
    from twin.study.work import Builder

    for name, value, low in (("count", count, 1), ("draw", draw, 0)):
        if (
            isinstance(value, bool)
            or not isinstance(value, int)
            or not low <= value <= MAX_FAMILY_RIGS
        ):
            what = f"a whole number from {low} to {MAX_FAMILY_RIGS}"
            raise ScenarioError(f"family: {name} must be {what}, got {value!r:.40}")
    found = read_family(source if isinstance(source, Mapping) else str(source))
    relative = {key for key, parameter in found.parameters.items() if parameter.relative}
    builder = Builder(str(scenario))
    return [
        {**builder.whole_keys((), rig.point, relative), "seed": rig.seed}
        for rig in draw_rigs(found, draw, count)
    ]


def work_of(name: str | Mapping[str, Any], keys: Mapping[str, Any]) -> Work:
    """The runs of a study, each of them checked.

    Args:
        name: Name, file or tables of the study.
        keys: Keys in place of the study's own; None for those that are not.

    Raises:
        ScenarioError: If it does not exist, or anything in it is unknown or out of range.
    """
    from controllers.catalog import in_files_only
    from twin.study.schema import read
    from twin.study.work import Work

    about = read(name, **keys)
    try:
        # a run is kept under the text of its law: one of a notebook has none
        with in_files_only():
            if about.engine == "c":
                from twin.study.compiled import KnownCheck

                check = KnownCheck()
                work = Work(about, check=check)
                check.check_controllers()
                return work
            return Work(about)
    except ScenarioError as error:  # it names the scenario
        called = about.title if isinstance(name, Mapping) else name
        raise ScenarioError(f"study {called}: {error}") from error
