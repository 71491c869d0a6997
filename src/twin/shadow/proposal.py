"""A better twin, proposed: identified on the last minutes, and only if it proves better."""

from __future__ import annotations

from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from twin.data_file import parse_toml
from twin.errors import LogError
from twin.identify.judged import IDENTIFIED, REJECTED
from twin.identify.logs import Log
from twin.identify.parameters import SHARE
from twin.identify.prepare import prepare
from twin.identify.report import parameters
from twin.identify.twin_model import identify
from twin.report.numbers import flat
from twin.scenario.load import check, put
from twin.shadow.belief import Belief
from twin.shadow.evidence import gaps
from twin.shadow.horizon import replays
from twin.writing import write_whole

LAST = 180.0
"""Seconds at the end of a log that are fitted and held out."""
LEAST_GAIN = 0.05
"""Share by which the replay error on what was held out must fall."""
AHEAD = 1.0
"""Horizon in s of that error."""
OFTEN = 0.25
"""Seconds between the starts of its replays."""
FITTED = (IDENTIFIED, REJECTED)
"""Verdicts on parameters that may be proposed: what was held out decides, not their intervals."""
NAMES = ("rolling", "breakaway", "delay", "servo", "level")


@dataclass(frozen=True)
class Proposal:
    """What came of an identification on the last minutes.

    Attributes:
        text: The parameter file; empty if nothing is proposed.
        changed: Key to what is believed and what is proposed.
        before: Median replay error in m of the belief on what was held out; None if unknown.
        after: The same of the proposed twin.
        why: In words.
        file: Where it was written.
    """

    text: str
    changed: dict[str, tuple[Any, Any]]
    before: float | None
    after: float | None
    why: str
    file: Path | None = None

    def as_dict(self) -> dict[str, Any]:
        """For ``--json``."""
        return {
            "file": None if self.file is None else str(self.file),
            "changed": {key: list(pair) for key, pair in self.changed.items()},
            "held_out_error_before_mm": None if self.before is None else 1000 * self.before,
            "held_out_error_after_mm": None if self.after is None else 1000 * self.after,
            "why": self.why,
        }


def propose(log: Log, belief: Belief, since: float = -np.inf) -> Proposal:
    """Identify the last minutes of a log, and compare on the part held out.

    Args:
        log: What was recorded.
        belief: The twin so far.
        since: Time in s before which the rig was another.
    """
    begin = max(since, float(np.nanmax(log.time)) - LAST)
    last = replace(log, model=belief.model).rows(log.time >= begin)
    try:
        found = identify(last, NAMES, SHARE)
        text = parameters(found, FITTED)
        settings = flat(parse_toml(text))
        _, held_out = prepare(last).split(SHARE)
    except LogError as error:
        return Proposal("", {}, None, None, f"No proposal: {error}")
    if not settings or not held_out.segments:
        return Proposal("", {}, None, None, "No proposal: the last minutes identify nothing")
    tables = belief.scenario.model_dump(mode="json")
    known = flat(tables)
    better = Belief.of(check(put(tables, settings.items()), "the proposal"), last)
    errors = []
    for twin in (belief, better):
        run = replays(held_out, twin, gaps(last, held_out.period), AHEAD, OFTEN)
        if run is None or not run.counted.any():
            return Proposal("", {}, None, None, "No proposal: too little was held out")
        errors.append(float(np.median(np.hypot(*run.error[run.counted].T))))
    before, after = errors
    changed = {key: (known.get(key, {}), value) for key, value in settings.items()}
    gain = 1 - after / before
    numbers = f"{1000 * before:.2f} to {1000 * after:.2f} mm on what was held out"
    if gain < LEAST_GAIN:
        why = f"No proposal: the replay error would go from {numbers}, a gain below 5 %"
        return Proposal("", {}, before, after, why)
    names = dict.fromkeys(each.about.key for each in found.verdicts if each.word in FITTED)
    believed = ", ".join(f"{key} = {known.get(key, {})}" for key in names)
    why = f"the replay error falls from {numbers} ({100 * gain:.0f} %)"
    head = [
        f"# Proposed by `ballplate shadow`: {why}.",
        f"# parent: {log.source}'s own twin, with {believed}",
        f"# data: {log.source}, {last.time[0]:.2f} to {last.time[-1]:.2f} s, the last "
        f"{100 * (1 - SHARE):.0f} % held out",
        f"# version: ballplate {version('ballplate')}",
    ]
    return Proposal("\n".join([*head, text]), changed, before, after, why)


def written(proposal: Proposal, folder: Path) -> Proposal:
    """A proposal written as ``parameters-N.toml``, N being the first number that is free.

    Raises:
        RecordError: If it cannot be written.
    """
    taken = [path.stem.rpartition("-")[2] for path in folder.glob("parameters-*.toml")]
    number = 1 + max((int(text) for text in taken if text.isdecimal()), default=0)
    file = folder / f"parameters-{number}.toml"
    write_whole(file, proposal.text)
    return replace(proposal, file=file)
