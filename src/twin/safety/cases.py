"""The fault matrix's rows: what is done to a rig that tracks a circle, and what must come of it.

They are written in ``cases.toml``.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import chain
from typing import Any

from twin.data_file import packaged
from twin.devices import realtime
from twin.devices.akd import conditions as akd
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.devices.lumio import conditions as lumio
from twin.devices.lumio.config import PlausibilityLimits
from twin.devices.rig import HardwareRig
from twin.emulator.drive import Power
from twin.emulator.lockstep import PATIENCE, LockstepRig
from twin.emulator.screen import Protocol
from twin.hal import supervisor
from twin.hal.interface import Condition
from twin.safety import acts
from twin.safety.case import BRING_UP, FaultCase, Stopper
from twin.safety.causes import OF_DRIVES, OF_RIG

SOURCES = {"drives": akd, "screen": lumio, "supervisor": supervisor, "loop": realtime}
"""Where conditions stand."""
WAITS = {
    "bring_up": BRING_UP,
    "power_on": HardwareRig.POWER_ON,
    "patience": PATIENCE,
    "period": AkdConfig().period,  # what is done after a period's commands shows in the next one's
    "stale": PlausibilityLimits().stale,
}
"""What may pass before the device concerned is asked, s."""


def _condition(name: str) -> Condition:
    source, _, which = name.partition(".")
    found: Condition = getattr(SOURCES[source], which)
    return found


def _done(given: list[Any]) -> Callable[[LockstepRig], Any]:
    """What a cause of the drives, of the rig, or a function does with a rig."""
    name, *arguments = given
    if cause := OF_DRIVES.get(name):
        return lambda rig: cause(rig.lockstep)
    function = OF_RIG.get(name) or getattr(acts, name)
    return lambda rig: function(rig, *arguments)


def _words(name: str) -> str:
    """What a cause or a function does, in words."""
    cause = OF_DRIVES.get(name) or OF_RIG.get(name)
    return cause.words if cause else (getattr(acts, name).__doc__ or "").rstrip(".")


def _host(table: dict[str, Any]) -> AkdConfig:
    return AkdConfig(**table | {"watch": MonitorConfig(**table.get("watch", {}))})


READ: dict[str, Callable[[Any], Any]] = {
    "act": _done,
    "begins": _done,
    "expected": _condition,
    "first": _condition,
    "stopped_by": lambda names: tuple(Stopper[name] for name in names),
    "states": lambda names: tuple(Power[name] for name in names),
    "protocol": lambda name: Protocol[name],
    "wait": lambda names: sum(WAITS[name] for name in names),
    "host": _host,
    "gate": lambda table: PlausibilityLimits(**table),
}
"""What a key's value stands for, where that is not the value itself."""


def _case(row: dict[str, Any]) -> FaultCase:
    given = {key: READ[key](value) if key in READ else value for key, value in row.items()}
    return FaultCase(**{"name": _words(row["act"][0]), "expected": None} | given)


_ROWS = packaged("twin.safety", "cases.toml")
GROUPS = {name: tuple(map(_case, rows)) for name, rows in _ROWS.items()}
"""The rows by what they are about."""
CASES = tuple(chain(*GROUPS.values()))
"""Every row of the matrix."""
