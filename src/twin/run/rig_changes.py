"""Changes rigs while they run, as the tables ``[[change]]`` of their scenarios state."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from twin.base.errors import ScenarioError
from twin.base.settings import from_scenarios, settings_of
from twin.hal.interface import Transmission
from twin.hal.rig import Rig
from twin.run.plants import PLANTS, with_calibration_error
from twin.scenario.changing import at_time, times
from twin.scenario.schema import TIME_TOLERANCE_S, Scenario
from twin.sim.drives import DriveModel
from twin.sim.plant.friction import Friction, SurfaceModel
from twin.sim.plant.interface import Parts
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel
from twin.sim.transmission import TransmissionError, WrongTransmission

OF_PLANTS = (Friction, SurfaceModel, Parts)
"""Dataclasses of what plants are made of."""
OF_DEVICES: tuple[type[Any], ...] = (TouchModel, EncoderModel, DriveModel)
"""Dataclasses of what is wrong with screen, encoders and drives."""


def differ(old: Sequence[Scenario], new: Sequence[Scenario], *classes: type) -> bool:
    """Whether scenarios say something else of the settings of some dataclasses."""
    pairs = [pair for pair in zip(old, new, strict=True) if pair[0] is not pair[1]]
    return any(
        about.of(before) != about.of(after)
        for cls in classes
        for about in settings_of(cls).values()
        for before, after in pairs
    )


Act = Callable[[Sequence[Scenario], Sequence[Scenario]], None]
"""Called with the former and the new scenarios of N rigs."""


class RigChanges:
    """Changes of N rigs while they run; call it with the time before each period passes.

    Args:
        scenarios: One per rig.
        act: Makes the rigs what the scenarios say from now on.
    """

    def __init__(self, scenarios: Sequence[Scenario], act: Act) -> None:
        self.scenarios = tuple(scenarios)
        self._act = act
        self._times = times(scenarios)
        self.done = 0
        """How many of the times at which something changes have passed."""

    def stages(self) -> list[list[Scenario]]:
        """Scenarios from each of those times on."""
        return [[at_time(each, time) for each in self.scenarios] for time in self._times]

    def now(self) -> list[Scenario]:
        """Present scenarios."""
        if not self.done:
            return list(self.scenarios)
        return [at_time(each, self._times[self.done - 1]) for each in self.scenarios]

    def catch_up(self, time: float) -> None:
        """Let everything have happened that was due by a time in s, and nothing else."""
        self.done = 0
        if any(each < time + TIME_TOLERANCE_S for each in self._times):
            self(time)

    def follow(self, scenarios: Sequence[Scenario], time: float) -> None:
        """Go on with scenarios that say the same until a time in s, and perhaps more from then."""
        self.scenarios = tuple(scenarios)
        self._times = times(scenarios)
        self.done = sum(each < time - TIME_TOLERANCE_S for each in self._times)

    def __call__(self, time: float) -> None:
        """Change what has to be changed by a time in s."""
        before = self.done
        while self.done < len(self._times) and time > self._times[self.done] - TIME_TOLERANCE_S:
            self.done += 1
        if self.done > before:
            old = self._times[before - 1] if before else -1.0
            self._act([at_time(each, old) for each in self.scenarios], self.now())


def change_devices(
    devices: SimulatedDevices,
    old: Sequence[Scenario],
    new: Sequence[Scenario],
    *,
    plant: bool = True,
) -> None:
    """Make simulated devices and their plant what scenarios say now.

    Args:
        devices: Of N rigs.
        old: The former scenarios, one per rig.
        new: The new scenarios.
        plant: Whether the plant is to go on as they say, too.

    Raises:
        ModelError: If a number is out of range.
    """
    if plant and differ(old, new, *OF_PLANTS):
        PLANTS[new[0].plant.kind].change(devices.plant, new)
    for model in OF_DEVICES:
        if differ(old, new, model):
            devices.change(from_scenarios(model, new))


def change_transmission(
    rig: Rig, known: Transmission, old: Sequence[Scenario], new: Sequence[Scenario]
) -> None:
    """Give rigs the errors of what they know of their cams that scenarios have now.

    Args:
        rig: The rigs.
        known: The transmission without errors.
        old: The former scenarios, one per rig.
        new: The new scenarios.
    """
    if differ(old, new, TransmissionError):
        rig.replace_transmission(with_calibration_error(known, new))


def without_error(transmission: Transmission) -> Transmission:
    """Cam transmission that a rig would assume without a calibration error."""
    if isinstance(transmission, WrongTransmission):
        return transmission.known
    return transmission


def changing(
    rig: Rig,
    devices: SimulatedDevices,
    transmission: Transmission,
    scenarios: Sequence[Scenario],
) -> RigChanges:
    """The changes of simulated rigs, made ready so that none of them takes long.

    Args:
        rig: The rigs.
        devices: What they are made of.
        transmission: Of the rigs.
        scenarios: One per rig.

    Raises:
        ScenarioError: If rigs on the exact equations would have different balls.
        ModelError: If a number is out of range.
    """
    known = without_error(transmission)

    def act(old: Sequence[Scenario], new: Sequence[Scenario]) -> None:
        change_devices(devices, old, new)
        change_transmission(rig, known, old, new)

    changes = RigChanges(scenarios, act)
    for stage in changes.stages():
        balls = {(each.plant.ball.mass, each.plant.ball.inertia) for each in stage}
        if len(balls) > 1 and stage[0].plant.kind == "lagrange":
            raise ScenarioError(
                "change: plant.ball: on the exact equations all rigs of a batch have one ball"
            )
        PLANTS[stage[0].plant.kind].foresee(devices.plant, stage)
    return changes
