"""What a host does when the scenario of its virtual rig changes the rig while it runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from twin.hal.interface import Transmission
from twin.hal.rig import Rig
from twin.run.changes import Changes, change_transmission, without_error
from twin.scenario.schema import Scenario


def follow_changes(
    rig: Rig, scenario: Scenario, transmission: Transmission, begin: Callable[[], None]
) -> None:
    """Let the virtual rig's changes begin with the run, and the host's own knowledge change.

    Args:
        rig: The host's, not switched on.
        scenario: Of the virtual rig.
        transmission: What the host knows of the cams.
        begin: Tells the virtual rig that the run's time is zero now; must not wait.
    """
    if not scenario.change:
        return
    known = without_error(transmission)

    def act(old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        change_transmission(rig, known, old, new)

    changes = Changes([scenario], act)
    begun = False

    def passing(time: float) -> None:
        nonlocal begun
        if not begun:
            begun = True
            begin()
        changes(time)

    rig.changes = passing
