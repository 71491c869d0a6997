"""Studies: many runs in batches, and what they say about the parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from ballplate.notebook import page, paragraphs, png_image, showable, table
from ballplate.reporter import Reporter, default
from twin.errors import ScenarioError
from twin.writing import check_writable

if TYPE_CHECKING:
    import pandas as pd
    import pyarrow as pa
    from matplotlib.figure import Figure

    from twin.study.answers import Answer
    from twin.study.work import Work


class StudyResult:
    """What a study found; shows itself in a notebook.

    Attributes:
        work: Its runs, with the study as it was asked.
        rows: Key, outcome, reason and indicators of every run, as an Arrow table.
        answers: Statistics, one per variant.
    """

    def __init__(self, work: Work, rows: pa.Table, answers: Sequence[Answer]) -> None:
        self.work, self.rows, self.answers = work, rows, list(answers)

    @property
    def title(self) -> str:
        """What it is about."""
        return self.work.study.title

    @property
    def sentences(self) -> list[str]:
        """What it found, in words."""
        from twin.study.report import sentences

        return sentences(self.work.study, self.answers)

    def to_pandas(self) -> pd.DataFrame:
        """A row per run: variant, point, seed, parameters, outcome, indicators."""
        from twin.study.experiments import labelled

        found: pd.DataFrame = labelled(self.work.labels, self.rows).to_pandas()
        return found

    def plot(self) -> dict[str, Figure]:
        """Its figures by name: ``curves``, ``indices``, ``spread`` and more, as the method has."""
        from twin.study.figures import figures

        # every variant has the same points in the same order
        tasks = self.work.tasks
        at = [task.point for task in tasks if task.variant == tasks[0].variant]
        found = figures(self.work.study, self.answers, self.work.design[at])
        return {name: showable(figure) for name, figure in found.items()}

    def save(self, folder: str | Path) -> Path:
        """Write report.html, figures, rows.parquet and rows.csv into a folder; returns it.

        Raises:
            RecordError: If a file cannot be written.
        """
        from twin.study.report import write

        write(self.work, self.rows, self.answers, Path(folder))
        return Path(folder)

    def _repr_html_(self) -> str:
        """For a notebook: sentences, a row per variant, figures."""
        from twin.study.report import compared

        found = compared(self.work.study, self.answers)
        rows = table(found.heads, found.rows)
        pictures = [png_image(figure) for figure in self.plot().values()]
        return page(self.title, paragraphs(self.sentences), rows, *pictures)


def study(
    name: str | Path,
    *,
    out: str | Path | None = None,
    processes: int | None = None,
    scheduler: str | None = None,
    reporter: Reporter | None = None,
    **keys: Any,
) -> StudyResult:
    """Run a study: a shipped one by name, or a TOML file.

    Args:
        name: Its name or file.
        out: Folder for its report, where finished runs are kept, too: an interrupted study goes on
            there, a finished one answers at once. None keeps nothing.
        processes: Processes to use; all processors by default.
        scheduler: Address of a Dask scheduler on whose workers it runs.
        reporter: Who is told progress; a notebook has its own.
        keys: Keys in place of the study's own, as ``samples=8`` or ``seeds=2``.

    Raises:
        TwinError: If there is no such study, or anything in it is unknown or out of range.
    """
    return carried_out(
        work_of(str(name), keys),
        out=out,
        processes=processes,
        scheduler=scheduler,
        reporter=reporter or default(),
    )


def carried_out(
    work: Work,
    *,
    out: str | Path | None,
    processes: int | None,
    scheduler: str | None,
    reporter: Reporter,
) -> StudyResult:
    """The runs of a study, those that are missing carried out; arguments as for ``study``."""
    from twin.study.answers import answers
    from twin.study.cluster import Cluster
    from twin.study.experiments import Store, carry

    if out is not None:
        check_writable(Path(out), reporter.name_of("out"))
    with (
        TemporaryDirectory() if out is None else nullcontext(out) as folder,
        nullcontext() if scheduler is None else Cluster(scheduler) as cluster,
    ):
        store = Store(Path(folder))
        with reporter.progress(work.study.title, work.different, "runs") as advance:
            rows = carry(
                work,
                store,
                executor=cluster,
                processes=processes or (cluster.workers if cluster else None),
                progress=lambda done, failed: advance(done, f"{failed} failed"),
            )
    found = StudyResult(work, rows, answers(work, rows))
    if out is not None:
        found.save(out)
    return found


def work_of(name: str, keys: Mapping[str, Any]) -> Work:
    """The runs of a study, each of them checked.

    Args:
        name: Name or file of the study.
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
            return Work(about)
    except ScenarioError as error:  # it names the scenario
        raise ScenarioError(f"study {name}: {error}") from error
