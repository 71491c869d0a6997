"""What is told of a rig after its run."""

from types import SimpleNamespace

import pytest

from ballplate.hardware import tell_timing
from ballplate.reporter import Reporter
from twin.devices.timing import TimingLog
from twin.hal.faults import Severity
from twin.hal.rig import Entry


class Heard(Reporter):
    """Keeps what it is told."""

    def __init__(self):
        self.lines = []

    def note(self, line, *, weighty=False):
        self.lines.append(line)


@pytest.mark.parametrize(
    ("severity", "told"),
    [(Severity.WARNING, False), (Severity.LEVEL, True), (Severity.STOP, True)],
)
def test_a_late_computer_is_told_first_where_a_condition_ended_the_run(severity, told):
    timing = TimingLog(0.002)
    for _ in range(20):
        timing.tick(0.004)
    note = SimpleNamespace(condition=SimpleNamespace(severity=severity), text="PDOs unsteady")
    clock = SimpleNamespace(timing=timing)
    rig = SimpleNamespace(clock=clock, scheduling=(), journal=[Entry(0.37, note)])
    heard = Heard()
    tell_timing(rig, heard)
    assert heard.lines[0].startswith("this computer was too late") is told
    assert heard.lines[-1] == f"0.370 s {severity}: PDOs unsteady"
