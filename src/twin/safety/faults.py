"""The fault matrix: its rows, as ``cases.toml`` has them.

What is done to a rig is one of the causes (`causes`), what must come of it has limits (`limits`).
A row without a name of its own gets its name from the words of its cause.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

from twin.base.data_file import read_packaged
from twin.base.errors import ScenarioError
from twin.devices import common, realtime
from twin.devices import rig as hardware
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.lumio import conditions as lumio
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.rig import HardwareRig
from twin.emulator.fault_lines import MATRIX_ROWS, fault_name
from twin.emulator.power_stage import Power
from twin.emulator.screen import Protocol
from twin.emulator.serve import BALL_TIMEOUT_S
from twin.hal import agreement, supervisor
from twin.hal.interface import Condition
from twin.safety.causes import act_of, words_of
from twin.safety.limits import FaultCase, Stopper

BRING_UP = akd.NODE_ABSENT.within
"""Longest time in s from switching on to drives that could be enabled, or a refusal."""
CONDITION_SOURCES = {
    "drives": akd,
    "screen": lumio,
    "supervisor": supervisor,
    "agreement": agreement,
    "rig": hardware,
    "devices": common,
    "loop": realtime,
}
"""Where conditions stand."""
WAIT_LIMITS_S = {
    "bring_up": BRING_UP,
    "power_on": HardwareRig.POWER_ON,
    "patience": BALL_TIMEOUT_S,
    "period": AkdConfig().period,  # what is done after a period's commands shows in the next one's
    "stale": PlausibilityLimits().stale,
}
"""What may pass before the device concerned is asked, s."""


def _condition(name: str) -> Condition:
    source, _, which = name.partition(".")
    return getattr(CONDITION_SOURCES[source], which)


KEY_READERS: dict[str, Callable[[Any], Any]] = {
    "act": act_of,
    "begins": act_of,
    "expected": _condition,
    "first": _condition,
    "stopped_by": lambda names: tuple(Stopper[name] for name in names),
    "states": lambda names: tuple(Power[name] for name in names),
    "protocol": lambda name: Protocol[name],
    "wait": lambda names: sum(WAIT_LIMITS_S[name] for name in names),
    "host": lambda table: AkdConfig(**table | {"watch": MonitorConfig(**table.get("watch", {}))}),
    "gate": lambda table: PlausibilityLimits(**table),
}
"""What a key's value stands for, where that is not the value itself."""


def _case(row: dict[str, Any]) -> FaultCase:
    given = {
        key: KEY_READERS[key](value) if key in KEY_READERS else value for key, value in row.items()
    }
    return FaultCase(**{"name": words_of(row["act"][0]), "expected": None} | given)


_CASE_TABLES = read_packaged("twin.safety", "cases.toml")
CASE_GROUPS = {name: tuple(map(_case, rows)) for name, rows in _CASE_TABLES.items()}
"""The rows by what they are about."""
CASES = tuple(chain(*CASE_GROUPS.values()))
"""Every row of the matrix."""


def choose_cases(words: Sequence[str]) -> list[int]:
    """Indices of the cases with all of the words in name or condition; all if there are none.

    The beginning of a word is enough, in capital or small letters. A row is also found by the name
    of the fault that it gives a run.

    Raises:
        ScenarioError: If no case has the words of a text.
    """
    if not words:
        return list(range(len(CASES)))
    chosen: set[int] = set()
    for text in words:
        wanted = text.lower().split()
        row = MATRIX_ROWS.get(fault_name(text) or "")
        found = {
            index
            for index, case in enumerate(CASES)
            if case.name == row
            or (
                row is None
                and all(re.search(rf"\b{re.escape(word)}", _search_text(case)) for word in wanted)
            )
        }
        if not found or not wanted:
            raise ScenarioError(
                f"--only '{text:.80}': no fault or condition contains these words; "
                "`ballplate safety --list` lists all"
            )
        chosen |= found
    return sorted(chosen)


def _search_text(case: FaultCase) -> str:
    """The text of a case that words are looked up in, in small letters."""
    return f"{case.name} {case.expected.name if case.expected else 'none'}".lower()
