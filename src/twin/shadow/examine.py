"""A recorded run examined: the twin beside it, a better one if there is reason, and their files."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twin.identify.log import read
from twin.run.files import run_name
from twin.shadow.belief import believed
from twin.shadow.follow import Shadow, shadow
from twin.shadow.proposal import Proposal, propose
from twin.shadow.proposal import write as write_proposal
from twin.shadow.report import page, sentences, write_scores
from twin.writing import write_json, write_whole

FILES = "shadow.html, shadow.json, shadow.parquet"
"""What is written."""


@dataclass(frozen=True)
class Examined:
    """What came of it.

    Attributes:
        found: What the twin says.
        proposal: A better twin, if one was looked for.
        file: Where that is; None if nothing is proposed.
    """

    found: Shadow
    proposal: Proposal | None
    file: Path | None

    @property
    def sentences(self) -> list[str]:
        """In words."""
        tried = [] if self.file is None else [f"try it: --set parameters={self.file}"]
        return [*sentences(self.found, self.proposal), *tried]

    @property
    def numbers(self) -> dict[str, Any]:
        """For ``--json``."""
        proposed = None if self.proposal is None else self.proposal.as_dict(self.file)
        return {**self.found.as_dict(), "proposal": proposed}

    def write(self, folder: Path) -> None:
        """Write shadow.html, shadow.json and, if there are replays, shadow.parquet.

        Raises:
            RecordError: If a file cannot be written.
        """
        text = page(self.found, self.proposal)
        write_whole(folder / "shadow.html", text)
        write_json(folder / "shadow.json", self.numbers)
        if self.found.replays is not None:
            write_whole(folder / "shadow.parquet", lambda path: write_scores(self.found, path))


def examine(
    log: Path,
    folder: Path,
    overrides: Sequence[str] = (),
    horizon: float = 1.0,
    *,
    proposing: bool = True,
    progress: Callable[[float], None] = lambda _: None,
) -> Examined:
    """Let the twin run beside a recorded run, and write what it says.

    Args:
        log: Run folder, ``run.parquet`` or CSV file.
        folder: Where ``FILES`` go, and ``parameters-N.toml`` if a better twin is proposed.
        overrides: ``KEY=VALUE`` each, over what the run was simulated with or believed.
        horizon: Seconds ahead and from one start to the next.
        proposing: Whether a better twin is looked for after an alarm.
        progress: Called with the share of the work done.

    Raises:
        TwinError: If the log cannot be used, an override is wrong, or a file cannot be written.
    """
    recorded = replace(read(log), source=run_name(log))
    belief = believed(recorded, overrides)
    found = shadow(recorded, belief, horizon)
    progress(0.5)
    proposal, file = None, None
    if found.alarms and proposing:
        proposal = propose(recorded, belief, found.alarms[-1].since)
    if proposal is not None and proposal.text:
        file = write_proposal(proposal, folder)
    examined = Examined(found, proposal, file)
    examined.write(folder)
    return examined
