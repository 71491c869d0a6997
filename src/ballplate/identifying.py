"""From a log to the parameters of the rig that recorded it."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ballplate.notebook import page, paragraphs, table
from ballplate.reporter import Reporter, default

if TYPE_CHECKING:
    from ballplate.results import Result
    from twin.identify.identify import Identification
    from twin.identify.log import Log
    from twin.identify.verdict import ParameterVerdict

HOLD_OUT = 1 / 3
"""Share of a log that is held out from the fit."""


class Identified:
    """What a log shows of its rig; shows itself in a notebook.

    Attributes:
        found: The fit with its intervals, checks on what was held out, and notes.
    """

    def __init__(self, found: Identification) -> None:
        self.found = found

    @property
    def verdicts(self) -> tuple[ParameterVerdict, ...]:
        """The parameters asked for: value, interval, whether it is identified, and why not."""
        return self.found.verdicts

    @property
    def sentences(self) -> list[str]:
        """The verdict in words."""
        from twin.identify.report import sentences

        return sentences(self.found)

    @property
    def settings(self) -> dict[str, Any]:
        """The identified parameters as ``run`` takes them: ``run("circle", found.settings)``."""
        from twin.data_file import parse_toml
        from twin.identify.report import parameters

        return parse_toml(parameters(self.found))

    def save(self, folder: str | Path) -> Path:
        """Write report.html and parameters.toml into a folder; returns it.

        Raises:
            RecordError: If a file cannot be written.
        """
        from twin.identify.report import write

        write(self.found, Path(folder))
        return Path(folder)

    def _repr_html_(self) -> str:
        """For a notebook: the verdict in words, and each parameter with its interval."""
        from twin.identify.report import HEADS, rows

        title = f"Identification from {self.found.log.source}"
        return page(title, table(HEADS, rows(self.found)), paragraphs(self.sentences))


def identify(
    log: str | Path | Result,
    parameters: str | Iterable[str] = (),
    *,
    hold_out: float = HOLD_OUT,
    reporter: Reporter | None = None,
) -> Identified:
    """Fit friction, dead time, drives and level to a recorded motion.

    Args:
        log: Run folder, ``run.parquet`` or CSV file with named columns, or a result; preferably
            recorded with the scenario ``excite``.
        parameters: Names of those to fit, as ``rolling`` or ``dead_time``; the usual ones if none.
        hold_out: Share of the log held out from the fit, 0 to 0.8.
        reporter: Who is told progress; a notebook has its own.

    Raises:
        TwinError: If the log cannot be read, or nothing can be learned from it.
    """
    from twin.errors import ScenarioError
    from twin.identify.identify import identify as fit
    from twin.identify.parameters import chosen

    if not 0 <= hold_out <= 0.8:
        raise ScenarioError(f"hold_out: must be 0 to 0.8, got {hold_out:g}")
    names = [parameters] if isinstance(parameters, str) else parameters
    wanted = chosen(",".join(names) or None)
    recorded = _recorded(log)
    report = reporter or default()
    with report.progress(f"identifying from {recorded.source}", 1.0) as advance:
        return Identified(fit(recorded, wanted, 1 - hold_out, advance))


def _recorded(log: str | Path | Result) -> Log:
    from ballplate.results import Result
    from twin.identify.log import COLUMNS, of_columns, read

    if not isinstance(log, Result):
        return read(Path(log))
    if log.folder is not None:
        return read(log.folder)
    scenario = log.scenario.model_dump(mode="json")
    return of_columns(
        {name: log[name] for name in COLUMNS if name in log}, {"scenario": scenario}, log.name
    )
