"""How far the nominal loop of a scenario's controller is from instability."""

from __future__ import annotations

from typing import NamedTuple

from controllers.analysis import Loop, margins, sampled_loop, unstable
from controllers.interfaces import Law, Observer
from controllers.observers import Ideal
from twin.run.assemble import build_controller
from twin.scenario import Scenario


class NominalLoop(NamedTuple):
    """Margins of a sampled loop about the level plate, without friction.

    Attributes:
        disk: Least disk margin at any of its cuts, dimensionless; 0 if it is unstable, None if it
            cannot be linearised.
        delay: Least further dead time in s at any cut; None as well where none destabilises it.
        observed: Whether observer, predictor and dead time are in it. Without, as for an observer
            that learns and so cannot be linearised, it is the law with the full state. None if
            there is no controller.
        refused: Why there is none, in one line.
    """

    disk: float | None
    delay: float | None
    observed: bool | None = True
    refused: str | None = None

    @classmethod
    def none(cls, error: Exception) -> NominalLoop:
        """Of a controller that is refused."""
        return cls(None, None, None, str(error))


def nominal_loop(scenario: Scenario) -> NominalLoop:
    """The loop of law, observer and predictor on the linear plant with the scenario's dead time.

    Raises:
        ScenarioError: If law, observer or reference refuse their settings.
    """
    controller = build_controller(scenario)
    return loop_margins(
        controller.law, controller.observer, dead_time=scenario.sensors.touch.dead_time
    )


def loop_margins(law: Law, observer: Observer, *, dead_time: float) -> NominalLoop:
    """Least margins of a sampled loop over its cuts.

    Args:
        law: Any law.
        observer: Any observer, or a predictor around one.
        dead_time: Of the ball's measurement in s.
    """
    try:
        return _least(sampled_loop(law, observer, dead_time=dead_time))
    except ValueError:
        pass
    try:
        loop = sampled_loop(law, Ideal(model=law.model, period=observer.period))
    except ValueError:  # a law that switches
        return NominalLoop(None, None, observed=False)
    return _least(loop)._replace(observed=False)


def _least(loop: Loop) -> NominalLoop:
    if len(unstable(loop.eigenvalues())):
        return NominalLoop(0.0, 0.0)
    found = [margins(loop, cut, points=150) for cut in ("u1", "u2", "x", "y")]
    known = [each for each in found if each is not None]
    delays = [each.delay for each in known if each.delay is not None]
    disk = min((each.disk for each in known), default=0.0)
    return NominalLoop(disk, min(delays, default=None))
