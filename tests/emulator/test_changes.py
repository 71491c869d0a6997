"""[[change]] on the emulated rig: its plant, its screen and what the host knows change."""

from pathlib import Path

import numpy as np
import pytest

from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen import Protocol
from twin.emulator.serve import BEGIN, VirtualRig, follow_changes
from twin.run.assemble import build_controller
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario.load import load
from twin.scenario.rig import check_rig

AT = 0.4


def measured(change):
    scenario = load("circle", ["duration=0.8", f"change={change}"])
    rig = LockstepRig(scenario)
    follow_changes(rig, scenario, rig.plant.transmission, rig.plant.begin)
    record = Recorder(400, 1, rig.period)
    drive(rig, build_controller(scenario), scenario.duration, record)
    return record["measured"][:, 0]


@pytest.fixture(scope="module")
def unchanged():
    return measured("[]")


@pytest.mark.long
@pytest.mark.parametrize(
    "values",
    [
        '"plant.level_deg"=[1.0, 1.0]',
        '"sensors.touch.dead_time"=0.07',
        '"rig.cam_error_percent"=[10.0, 10.0]',
    ],
)
def test_the_emulated_rig_is_another_from_the_time_of_a_change_on(unchanged, values):
    found = measured(f"[{{at={AT}, set={{{values}}}}}]")
    same = (found == unchanged).all(axis=1)
    # what happens in one period of the bus is seen at the end of the next at the latest
    assert same[: round(AT / 0.002)].all()
    assert not same[round(AT / 0.002) + 60 :].all()
    assert np.isfinite(found).all()


def test_the_virtual_rig_counts_from_when_it_is_told_that_the_run_begins():
    later = load("circle", [f"change=[{{at={AT}, set={{'sensors.touch.dead_time'=0.07}}}}]"])
    with VirtualRig(later) as rig:
        rig.plant.advance(1.0)
        assert rig.plant.dead_time == 0.042
        rig.obey(BEGIN)
        rig.plant.advance(AT / 2)
        assert rig.plant.dead_time == 0.042
        rig.plant.advance(AT)
        assert rig.plant.dead_time == 0.07


@pytest.mark.parametrize(
    ("protocol", "transport"), [(Protocol.ELO, "serial"), (Protocol.HID_0006, "hidraw")]
)
def test_the_rig_file_of_a_virtual_rig_names_its_ports_and_what_they_speak(
    scenario, protocol, transport
):
    with VirtualRig(scenario("plant.kind=lagrange"), protocol) as rig:
        found = check_rig(rig.tables(), "virtual")
        assert Path(found.touch.port).is_char_device()
        assert Path(found.bus.channel).is_char_device()
    assert (found.touch.transport, found.touch.protocol) == (transport, str(protocol))
    assert found.bus.interface == "slcan"
