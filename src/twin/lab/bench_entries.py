"""Entries of the public benchmark: laws of others, and how they get into a scenario."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from twin.base.errors import LawError, ScenarioError
from twin.base.validation import Checked
from twin.lab.process import ANSWER_NAME, AnswerProcess, answering
from twin.lab.schema import AnswerTable
from twin.study.experiments import CHUNK_RUNS
from twin.study.work import Job, Row, carry_out

ENTRY_TABLES = ("controller", "observer", "predictor")
"""The tables of a scenario that an entry may set."""
MAX_CHUNK_CPU_S = 300.0
"""Processor time in s of an entry's code for ``CHUNK_RUNS`` runs, or fewer."""


class Entry(Checked):
    """A law, as ``entry.toml`` describes it.

    Attributes:
        title: Its name for people.
        authors: Its authors.
        citation: Its publication.
        knows: Knowledge of the rigs beyond the nominal one.
        tuning: Time in s on rigs for which it was tuned.
        computing: Computing time of one command, s; 0 for not given.
        kind: Kind of the one class in its file, or of its program.
        file: Its code; empty if settings of shipped laws are enough.
        command: A program in a language other than Python and its arguments, ``file`` among them.
        set: Overrides ``key=value`` of ``ENTRY_TABLES``.
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


@contextmanager
def enter(
    entry: Entry, place: Path, runs: int = 0
) -> Iterator[tuple[tuple[str, ...], AnswerProcess | None]]:
    """The overrides that put an entry into a scenario, and the process of its code.

    Args:
        entry: The entry.
        place: Folder of its file.
        runs: Number of runs; more than ``CHUNK_RUNS`` have more time.

    Raises:
        LawError: If its code cannot be loaded.
        ScenarioError: If it sets keys that are not an entry's.
    """
    for text in entry.set:
        if re.split(r"[.=]", text)[0] not in ENTRY_TABLES:
            raise ScenarioError(f"set: '{text}': an entry may set {', '.join(ENTRY_TABLES)} only")
    if not entry.file and not entry.command:
        yield entry.set, None
        return
    if Path(entry.file).name != entry.file or not (place / entry.file).is_file():
        raise ScenarioError(f"file: '{entry.file}': must be a file next to the entry.toml")
    table = "controller" if entry.kind == "law" else "observer"
    if any(re.match(rf"{table}(\.kind)?=", text) for text in entry.set):
        raise ScenarioError(f"set: {table}: is the entry's own file; leave one of them out")
    described = entry.model_dump(include={"kind", "file", "command"})
    seconds = MAX_CHUNK_CPU_S * max(1, runs / CHUNK_RUNS)
    about = AnswerTable.model_validate({**described, "seconds": seconds})
    with answering(place / entry.file, about) as process:
        yield (*entry.set, f"{table}.kind={ANSWER_NAME}"), process


def carry_out_entry(entry: Entry, place: Path, jobs: Sequence[Job]) -> list[Row]:
    """Carry out runs of an entry that has code; one that fails is refused at once."""
    with enter(entry, place, len(jobs)) as (_, process):
        rows = carry_out(jobs)
        if process is not None and process.failure is not None:
            raise LawError(process.failure)
    return rows
