"""The model that laws and observers are designed on."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Unpack

from ballplate.changes import Changes, Settings, changes_of, scenario_of

if TYPE_CHECKING:
    from controllers.ballplate import BallPlate


def model(
    scenario: str | Path | None = None, settings: Settings = (), **changes: Unpack[Changes]
) -> BallPlate:
    """The exact equations of ball and plate, the model that controllers are designed on.

    ``A, B, C = model().linear()`` about the level plate; ``derivative(x, u)``, ``jacobian(x)`` and
    more are functions of any state.

    Args:
        scenario: Whose ball it has, on which the scenario's controller is designed unless
            ``controller.model`` says otherwise; the nominal one by default.
        settings: What is changed of that scenario, by dotted keys or as texts ``KEY=VALUE``.
        changes: What is changed of that scenario, by tables.

    Raises:
        TwinError: If there is no such scenario, or anything in it is unknown or out of range.
    """
    from controllers.ballplate import BallPlate

    if scenario is None:
        return BallPlate()
    found: BallPlate = scenario_of(scenario, changes_of(settings, changes)).plant.ball.model
    return found
