"""The clean model beside the rig: the same controller and goals, none of the imperfections."""

from __future__ import annotations

from controllers.arrays import Array
from controllers.controller import SampledReference
from controllers.interfaces import Reference
from twin.run.assemble import assemble, build_controller
from twin.run.state import Snapshot
from twin.scenario.load import clean
from twin.scenario.schema import Scenario
from twin.sim.rig import SimulatedRig
from twin.whatif.moment import take_over


class Ghost:
    """A clean model that is stepped period by period.

    Args:
        scenario: Of the rig it goes beside.
        reference: The path to follow.
    """

    def __init__(self, scenario: Scenario, reference: Reference) -> None:
        self._scenario = clean(scenario)
        self._rig, self._controller = assemble(self._scenario)
        self._rig.LEVELLING_TIME = 0.0
        self._rig.__enter__()
        self._measurement = self._rig.read()
        self.follow(reference)
        self._controller.start(self._measurement)
        self._rig.start()

    @property
    def state(self) -> Array:
        """Its state in the order of (5.5), shape (8,)."""
        state: Array = self._rig.devices.state[0]
        return state

    @property
    def on_plate(self) -> bool:
        """Whether its ball has not left the plate."""
        return not bool(self._rig.fallen[0])

    def step(self) -> None:
        """One control period."""
        step = self._controller.command(self._measurement)
        self._controller.applied(self._rig.write(step.rate))
        self._rig.wait()
        self._measurement = self._rig.read()

    def follow(self, reference: Reference) -> None:
        """Follow another path from now on."""
        self._controller.reference = SampledReference(reference, self._rig.period)

    def control(self, scenario: Scenario) -> None:
        """Have the controller of a scenario from now on."""
        now = clean(scenario)
        controller = build_controller(now)
        controller.start(self._measurement)
        take_over(controller, self._controller, self._scenario, now)
        self._scenario, self._controller = now, controller

    def push(self, x_rate: float, y_rate: float) -> None:
        """Change its ball's velocity at once, m/s."""
        push(self._rig, x_rate, y_rate)

    def taken(self) -> Snapshot:
        """Its state."""
        return Snapshot.take(self._rig, self._controller, self._measurement)

    def restore(self, snapshot: Snapshot) -> None:
        """Go on from a state of one with the same controller."""
        self._measurement = snapshot.restore(self._rig, self._controller)


def push(rig: SimulatedRig, x_rate: float, y_rate: float) -> None:
    """Change the velocity of a rig's ball at once, m/s, plate axes."""
    ball = rig.devices.state[:, (0, 1, 4, 5)].copy()
    ball[:, 1] += x_rate
    ball[:, 3] += y_rate
    rig.devices.place(ball)
