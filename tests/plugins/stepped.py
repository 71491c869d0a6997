"""Two emulated drives and the host's servos on them, run in one loop."""

import numpy as np
import pytest

from twin.devices.akd import conditions as c
from twin.devices.akd.conditions import DriveError
from twin.emulator.lockstep import LockstepDrives


def still(_):
    """No motion."""
    return 0.0, 0.0


class SteppedDrives(LockstepDrives):
    """A context manager; ``seen`` are all faults so far."""

    def __enter__(self):
        self.seen = []
        return self

    def __exit__(self, *_):
        self.servos.stop()
        self.adapter.shutdown()

    def enabled(self):
        """Start and enable, and run until both drives follow."""
        self.servos.start()
        self.servos.enable()
        for _ in range(50):
            if self.servos.enabled:
                break
            self.run(self.config.period)
        return self

    def run(self, seconds, rates=still):
        """Run the loop; rates: motor rates in rad/s by bus time. The faults that came up."""
        before = len(self.seen)
        for _ in range(round(seconds / self.config.period)):
            self.servos.receive()
            self.servos.command(np.array([rates(self.bus.time)]))
            self.servos.send()
            self.seen.extend(self.servos.faults())
            self.adapter.sleep(self.config.period)
        return self.seen[before:]


def refused(rig, condition=c.WRONG_SETTING):
    """What a start that ends in a condition says, in one line."""
    with pytest.raises(DriveError) as caught:
        rig.servos.start()
    assert caught.value.fault.condition == condition
    assert "\n" not in str(caught.value)
    assert not rig.servos.enabled
    return str(caught.value)
