"""What a person drives: a rig with its controller, and its clean model beside it."""

from __future__ import annotations

import numpy as np

from controllers.arrays import Array
from controllers.controller import Controller, SampledReference
from controllers.interfaces import Measurement, Reference
from twin.play.driven import Driven
from twin.play.ghost import Ghost, push
from twin.play.kept import Kept
from twin.run.assemble import assemble
from twin.run.changes import Changes
from twin.run.state import Snapshot
from twin.scenario.schema import Scenario
from twin.whatif.moment import take_over


class DrivenRig:
    """Rig, controller and clean model, as at the beginning of what was driven.

    Args:
        driven: What was driven so far.

    Attributes:
        rig: The rig.
        controller: Of it.
        ghost: The clean model.
    """

    def __init__(self, driven: Driven) -> None:
        self._controlled = driven.scenario
        self.rig, self.controller = assemble(self._controlled, changeable=True)
        self.rig.LEVELLING_TIME = 0.0
        self.ghost = Ghost(self._controlled, driven.reference)
        self._before: tuple[Controller, Scenario] | None = None
        self.follow(driven.reference)

    def follow(self, reference: Reference) -> None:
        """Let rig and clean model follow another path from now on."""
        self.controller.reference = SampledReference(reference, self.rig.period)
        self.ghost.follow(reference)

    def push(self, x_rate: float, y_rate: float) -> None:
        """Change both balls' velocity at once, m/s."""
        push(self.rig, x_rate, y_rate)
        self.ghost.push(x_rate, y_rate)

    def change(self, scenario: Scenario, time: float) -> None:
        """Let the rig be what a scenario says from a time in s on."""
        assert isinstance(self.rig.changes, Changes)
        self.rig.changes.follow([scenario], time)

    def control(self, controller: Controller, scenario: Scenario) -> None:
        """Have another controller, that of a scenario, once a state is gone on from."""
        self._before = self.controller, self._controlled
        self.controller, self._controlled = controller, scenario

    def kept(self, measurement: Measurement, row: int, driven: Driven, *, acted: bool) -> Kept:
        """The state of this moment; it must not hold what the path ahead was taken to be.

        Args:
            measurement: The one that begins the period.
            row: Of the record.
            driven: What was driven so far.
            acted: Whether the person did something.
        """
        self.follow(driven.reference)
        taken = Snapshot.take(self.rig, self.controller, measurement)
        return Kept(measurement.time, row, driven, taken, self.ghost.taken(), acted)

    def go_on(self, state: Kept) -> tuple[Measurement, bool]:
        """Be in a state that was kept, with the controller that was chosen.

        Returns:
            The measurement that begins the period, and whether the controller is another.
        """
        before, self._before = self._before, None
        if before is None:
            measurement = state.rig.restore(self.rig, self.controller)
            self.ghost.restore(state.ghost)
        else:
            measurement = state.rig.restore(self.rig)
            take_over(self.controller, *before, self._controlled)
        return measurement, before is not None

    def picture(
        self, time: float, driven: Driven, applied: Array | None, factor: float
    ) -> tuple[float, ...]:
        """The numbers of a picture, in the order of ``sight.COLUMNS``.

        Args:
            time: Of it, s.
            driven: What was driven so far.
            applied: Plate accelerations since the picture before, rad/s^2.
            factor: Simulated seconds a second of the clock.
        """
        desired = self.controller.reference(time)[0].ravel()
        goal = desired if driven.goals is None else np.array(driven.goals.points[-1][1:])
        state = self.rig.devices.state[0]
        ball, plate = state[0::4], state[2::4]
        clean = self.ghost.state[0::4] if self.ghost.on_plate else np.full(2, np.nan)
        errors = np.hypot(*(np.stack((ball, clean)) - desired).T)
        effort = np.nan if applied is None else np.sqrt((applied**2).mean())
        numbers = ([time], ball, plate, goal, desired, clean, errors, [effort, factor])
        return tuple(np.concatenate(numbers).tolist())
