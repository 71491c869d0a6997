"""What an emulated rig truly does: plate, ball and power stages by bus time, whatever is reported.

The host sees frames; this is seen from outside, as a person beside the rig would.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from twin.emulator.drive_power import Power
from twin.emulator.lockstep import LockstepRig

_ANGLES, _RATES, _BALL, _VELOCITY = [2, 6], [3, 7], [0, 4], [1, 5]


class PowerChange(NamedTuple):
    """A drive's power stage goes from one state to another.

    Attributes:
        time: Bus time in s.
        axis: 0 for phi, 1 for theta.
        before: The state it was in.
        after: The state it is in now.
        lost: Whether it lost its torque by that.
        fault: Number of its newest fault, 0 if it has none.
        injected: Whether it was done to it, and is no answer of the rig.
    """

    time: float
    axis: int
    before: Power
    after: Power
    lost: bool
    fault: int
    injected: bool


class MotionTrace:
    """Follows a rig in lockstep from now on, through every step and frame of its bus.

    Args:
        rig: The rig; its first two drives are phi and theta.
    """

    def __init__(self, rig: LockstepRig) -> None:
        self.changes: list[PowerChange] = []
        """What the power stages did, oldest first."""
        self._rig = rig
        self._drives = tuple(rig.lockstep.drives[:2])
        self._states = [drive.state for drive in self._drives]
        self._live = [drive.power.live for drive in self._drives]
        self._rows: list[tuple[float, Array]] = []
        self._moved = rig.lockstep.bus.moved
        rig.lockstep.bus.moved = self._step
        rig.lockstep.bus.heard = self._look

    def note_injection(self) -> None:
        """Take what the power stages did since the last frame for done to them."""
        self._look(injected=True)

    def state(self, axis: int, time: float) -> Power:
        """State of the axis 0 (phi) or 1 (theta) at a bus time in s."""
        changes = [each for each in self.changes if each.axis == axis]
        until = [each.after for each in changes if each.time <= time]
        if until:
            return until[-1]
        return changes[0].before if changes else self._states[axis]

    @property
    def live(self) -> bool:
        """Whether a drive has torque."""
        return any(drive.power.live for drive in self._drives)

    def between(self, begin: float, end: float = np.inf) -> TrueMotion:
        """The motion from one bus time to another, both in s."""
        rows = [(time, state) for time, state in self._rows if begin <= time <= end]
        state = np.array([state for _, state in rows]).reshape(len(rows), 8)
        time = np.array([time for time, _ in rows])
        return TrueMotion(time, *(state[:, each] for each in (_ANGLES, _RATES, _BALL, _VELOCITY)))

    def _step(self, dt: float) -> None:
        self._moved(dt)
        self._look()
        self._rows.append((self._rig.now(), self._rig.plant.devices.state[0]))

    def _look(self, *, injected: bool = False) -> None:
        for axis, drive in enumerate(self._drives):
            before, after = self._states[axis], drive.state
            if after is not before:
                self._states[axis] = after
                fault = drive.fault_numbers[-1] if drive.fault_numbers else 0
                lost = self._live[axis] and not drive.power.live
                self._live[axis] = drive.power.live
                change = PowerChange(self._rig.now(), axis, before, after, lost, fault, injected)
                self.changes.append(change)


class TrueMotion(NamedTuple):
    """The true motion of plate and ball, one row per step of the bus.

    Attributes:
        time: Bus time in s, shape (n,).
        plate: Plate angles (phi, theta) in rad, shape (n, 2).
        rate: Plate rates in rad/s, shape (n, 2).
        ball: Position (x, y) of the ball in m in plate axes, shape (n, 2).
        velocity: Its velocity in m/s, shape (n, 2).
    """

    time: Array
    plate: Array
    rate: Array
    ball: Array
    velocity: Array

    @property
    def tilt(self) -> Array:
        """The larger plate angle of both axes in rad, shape (n,)."""
        return np.asarray(np.abs(self.plate).max(axis=1))

    @property
    def speed(self) -> Array:
        """The larger plate rate of both axes in rad/s, shape (n,)."""
        return np.asarray(np.abs(self.rate).max(axis=1))
