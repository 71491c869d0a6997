"""What is told of a rig after its run."""

from types import SimpleNamespace

import numpy as np
import pytest

from ballplate.hardware import tell_timing
from ballplate.reporter import Reporter
from twin.devices.timing import TimingLog
from twin.hal.faults import Severity
from twin.hal.rig import Entry
from twin.run import plants
from twin.scenario.load import load


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


@pytest.mark.parametrize(
    "keys", [(), ("rig.cam_error_percent=[2.0, 0.0]",), ("rig.cams=per_axis",)]
)
def test_what_a_rig_believes_of_its_cams_needs_no_mechanism(keys, monkeypatch):
    scenario, angle = load("circle", keys), np.array([[0.03, -0.02]])
    wanted = plants.build_plant([scenario])[1].motor(angle)
    monkeypatch.setattr(plants, "build_plant", None)
    assert np.array_equal(plants.believed(scenario).motor(angle), wanted)
