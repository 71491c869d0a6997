"""`twin.devices`: what every kind of servos and every kind of screen keeps.

Truth is the simulated plant behind the devices, and the emulated drives' own power stages.
"""

import math

import numpy as np
import pytest
from every_setting import QUIET
from mixed_rigs import AkdWithCamera, OwnWithLumio, PlantCamera

from twin.devices.kinds import members
from twin.devices.lumio.config import LumioConfig
from twin.devices.own import SeparateScreen
from twin.devices.own_config import OwnScreenConfig
from twin.emulator.lockstep import LockstepRig, LockstepScreen, LockstepScreenPort
from twin.emulator.screen import Protocol, ScreenLine
from twin.hal.interface import PoweredScreen, PoweredServos, Severity

LEVEL = np.zeros((1, 2))


def serious(faults):
    return [each for each in faults if each.condition.severity is not Severity.WARNING]


class Servos:
    """Servos on a plant, exchanged with period by period."""

    def __init__(self, rig, die, torque):
        self.rig, self.servos, self.period = rig, rig.servos, rig.period
        self.die, self.torque = die, torque
        self.commanded = LEVEL

    @property
    def plate(self):
        """True plate angles in rad, (1, 2)."""
        return self.rig.plant.devices.state[:, 2::4].copy()

    def run(self, seconds, rate=0.0, until=lambda: False):
        """Turn the plate at a rate of both axes; the faults that came up."""
        seen, motor = [], self.rig._transmission.motor
        for _ in range(round(seconds / self.period)):
            if until():
                break
            following = self.commanded + self.period * rate
            self.servos.command((motor(following) - motor(self.commanded)) / self.period)
            self.commanded = following
            self.servos.send()
            self.rig.sleep(self.period)
            self.servos.receive()
            seen += self.servos.faults()
        return seen

    def powered(self):
        """Bring them up on a level plate."""
        self.servos.start()
        self.servos.enable()
        seen = self.run(1.0, until=lambda: self.servos.enabled)
        self.servos.home(LEVEL, self.rig._transmission.motor(LEVEL))
        self.commanded = LEVEL
        assert self.servos.enabled
        assert not serious(seen)
        return self


def akd(scenario):
    rig = LockstepRig(scenario(*QUIET))
    drives = rig.lockstep.drives
    return Servos(
        rig, lambda: rig.lockstep.bus.faults.silence(1), lambda: any(d.enabled for d in drives)
    )


def own(scenario):
    rig = OwnWithLumio(scenario(*QUIET))
    hardware = rig.hardware
    return Servos(rig, lambda: setattr(hardware, "silent", True), lambda: hardware.torque)


@pytest.mark.parametrize("kind", [akd, own], ids=["akd", "own"])
class TestServos:
    @pytest.fixture
    def servos(self, kind, scenario):
        return kind(scenario)

    def test_they_have_every_member_of_the_protocol(self, servos):
        missing = [each for each in members(PoweredServos) if not hasattr(servos.servos, each)]
        assert missing == []
        assert len(members(PoweredServos)) == 22

    def test_a_start_and_a_stop_without_motion_leave_the_plate_where_it_was(self, servos):
        before = servos.plate
        servos.servos.start()
        assert not servos.servos.enabled
        servos.run(0.2)
        servos.servos.stop()
        assert servos.plate == pytest.approx(before, abs=1e-4)
        assert not servos.torque()

    def test_they_have_torque_within_a_second_of_the_request_and_not_before(self, servos):
        assert not servos.torque()
        servos.powered()
        assert servos.torque()

    def test_home_declares_the_angles_of_plate_and_motors(self, servos):
        servos.powered()
        if servos.servos.encoders and isinstance(servos.rig, LockstepRig):  # they are incremental
            at = np.array([[0.03, -0.02]])
            servos.servos.home(at, 5 * at)
            assert servos.servos.plate() == pytest.approx(at, abs=1e-4)
            assert servos.servos.motor() == pytest.approx(5 * at, abs=1e-3)
        else:  # theirs are absolute
            assert servos.servos.plate() == pytest.approx(servos.plate, abs=1e-4)

    def test_the_plate_turns_as_it_is_commanded_and_is_measured_there(self, servos):
        servos.powered()
        begin = servos.plate
        rate = np.array([[0.1, -0.05]])
        assert not serious(servos.run(0.5, rate))
        assert not serious(servos.run(0.1))
        assert servos.plate - begin == pytest.approx(0.5 * rate, abs=1e-3)
        assert servos.servos.plate() == pytest.approx(servos.plate, abs=1e-3)
        assert (servos.servos.age() < 3 * servos.period).all()
        assert (servos.servos.age() >= 0).all()

    def test_at_rate_zero_the_plate_stands_where_it_is(self, servos):
        servos.powered()
        servos.run(0.5, 0.1)
        servos.run(0.1)
        begin = servos.plate
        servos.run(0.5)
        assert servos.plate == pytest.approx(begin, abs=2e-4)

    def test_what_is_no_number_is_never_followed_and_is_a_fault(self, servos):
        servos.powered()
        begin = servos.plate
        servos.servos.command(np.full((1, 2), math.nan))
        servos.servos.send()
        assert [each.condition.severity for each in serious(servos.servos.faults())]
        servos.run(0.3)
        assert np.abs(servos.plate - begin).max() < 1e-3

    def test_servos_that_no_longer_answer_are_reported_once_within_a_third_of_a_second(
        self, servos
    ):
        servos.powered()
        servos.die()
        before = servos.rig.now()
        seen = []
        while not seen and servos.rig.now() < before + 2:
            seen = serious(servos.run(servos.period, 0.1))
        assert servos.rig.now() - before < 1 / 3
        assert len({(each.condition.name, each.where) for each in seen}) == len(seen)
        names = {(each.condition.name, each.where) for each in seen}
        later = serious(servos.run(0.5))
        assert not names & {(each.condition.name, each.where) for each in later}

    def test_a_quick_stop_in_motion_ends_it(self, servos):
        servos.powered()
        servos.run(0.3, 0.2)
        servos.servos.quick_stop()
        for _ in range(50):
            servos.servos.quick_stop()
            servos.servos.send()
            servos.rig.sleep(servos.period)
            servos.servos.receive()
        begin = servos.plate
        servos.rig.sleep(0.05)
        assert servos.plate == pytest.approx(begin, abs=2e-4)

    def test_stopping_takes_the_torque_away_and_is_done_once_however_often_it_is_asked(
        self, servos
    ):
        servos.servos.stop()  # nothing has been started
        servos.powered()
        servos.run(0.3, 0.1)
        servos.servos.stop()
        assert not servos.torque()
        assert not servos.servos.enabled
        at = servos.rig.now()
        servos.servos.stop()
        assert servos.rig.now() == at
        assert getattr(servos.rig, "hardware", None) is None or servos.rig.hardware.stopped == 1

    def test_after_the_stop_nothing_is_sent_moved_or_reported(self, servos):
        servos.powered()
        servos.servos.stop()
        servos.servos.faults()
        begin, heard = servos.plate, sent(servos)
        servos.die()
        assert servos.run(0.5, 0.2) == []
        assert servos.plate == pytest.approx(begin, abs=1e-4)
        assert sent(servos) == heard

    def test_they_start_again_after_a_stop_even_after_a_fault(self, servos):
        servos.powered()
        servos.servos.stop()
        servos.powered()
        assert serious(servos.run(0.2, 0.1)) == []

    def test_warnings_are_warnings_with_their_place(self, servos):
        servos.powered()
        for each in servos.servos.warnings():
            assert each.condition.severity is Severity.WARNING
            assert each.where


def sent(servos):
    """What has arrived of commands at the devices."""
    if isinstance(servos.rig, OwnWithLumio):
        return servos.rig.hardware.commands
    return [(drive.rate, drive.state) for drive in servos.rig.lockstep.drives]


class Screen:
    """A screen with a ball on it, asked once per ms; ``cut`` lets it say nothing more."""

    TICK = 0.001
    PLACE = (0.1, -0.05)

    def __init__(self):
        self.time, self.balls, self.plate = 5.0, [self.PLACE], LEVEL

    def run(self, seconds):
        """Let time pass; what was read last, and the faults with their times."""
        seen, touch = [], None
        for _ in range(round(seconds / self.TICK)):
            self.time += self.TICK
            self.screen.receive()
            self.screen.note_plate(self.plate)
            touch = self.screen.read()
            seen += [(self.time, each) for each in self.screen.faults()]
        return touch, seen


class Lumio(Screen):
    def __init__(self, protocol, transport):
        super().__init__()
        self.line = ScreenLine(lambda: self.balls, protocol=protocol, dead_time=0.01)
        self.port = LockstepScreenPort(self.line, lambda: self.time)
        config = LumioConfig(port="emulated", transport=transport, protocol=str(protocol))
        self.screen = LockstepScreen(config, lambda: self.time, port=self.port)

    def cut(self):
        self.line.step = lambda _: []

    def break_down(self):
        self.port.plugged = False

    def reads(self):
        return self.screen.stream.heard


class Camera(Screen):
    def __init__(self):
        super().__init__()
        self.hardware = PlantCamera(lambda: self.balls, lambda: self.time)
        self.screen = SeparateScreen(self.hardware, OwnScreenConfig(backend=""))

    def cut(self):
        self.hardware.silent = True

    def break_down(self):
        self.hardware.error = OSError("cable gone")

    def reads(self):
        return self.hardware.calls


SCREENS = {
    "lumio serial": lambda: Lumio(Protocol.MICROTOUCH, "serial"),
    "lumio hid": lambda: Lumio(Protocol.HID_0007, "hidraw"),
    "own": Camera,
}


@pytest.mark.parametrize("kind", SCREENS)
class TestScreen:
    @pytest.fixture
    def made(self, kind):
        return SCREENS[kind]()

    @pytest.fixture
    def screen(self, made):
        made.screen.start()
        made.run(0.3)
        return made

    def test_it_has_every_member_of_the_protocol(self, made):
        missing = [each for each in members(PoweredScreen) if not hasattr(made.screen, each)]
        assert missing == []
        assert len(members(PoweredScreen)) == 7
        assert made.screen.where

    def test_before_it_has_started_nothing_is_touched_and_the_age_is_infinite(self, made):
        touch = made.screen.read()
        assert touch.age.tolist() == [math.inf]
        assert touch.touched.tolist() == [False]
        assert touch.position.shape == (1, 2)

    def test_the_ball_is_where_it_lies_and_no_older_than_two_frames_and_a_dead_time(self, screen):
        touch, seen = screen.run(0.2)
        assert touch.position == pytest.approx(np.array([screen.PLACE]), abs=1e-3)
        assert touch.touched.tolist() == [True]
        assert 0 <= touch.age[0] <= 0.06
        assert serious(each for _, each in seen) == []

    def test_a_position_ages_as_time_passes_and_is_not_touched_for_long(self, screen):
        before, _ = screen.run(0.001)
        screen.cut()
        after, _ = screen.run(0.03)
        more = after.age[0] - before.age[0]
        assert more == pytest.approx(0.03, abs=0.02)
        last, _ = screen.run(0.05)
        assert last.age[0] - after.age[0] == pytest.approx(0.05, abs=1e-6)

    def test_a_ball_that_is_lifted_is_not_touched_within_a_fifth_of_a_second(self, screen):
        screen.balls = []
        touch, _ = screen.run(0.2)
        assert touch.touched.tolist() == [False]

    def test_a_screen_that_says_nothing_more_is_reported_once_within_a_third_of_a_second(
        self, screen
    ):
        begin = screen.time
        screen.cut()
        _, seen = screen.run(1.0)
        found = [(at, each) for at, each in seen if each.condition.severity is Severity.LEVEL]
        assert found[0][0] - begin < 1 / 3
        names = [each.condition.name for _, each in found]
        assert len(set(names)) == len(names)

    def test_a_screen_that_fails_levels_the_plate_within_three_ms_and_stops_nothing(self, screen):
        begin = screen.time
        screen.break_down()
        _, seen = screen.run(0.02)
        at, fault = next((at, each) for at, each in seen if serious([each]))
        assert at - begin <= 0.003
        assert fault.condition.severity is Severity.LEVEL
        assert "\n" not in str(fault)

    def test_a_ball_that_never_moves_on_a_steep_plate_is_a_fault(self, screen):
        screen.plate = np.array([[0.0, 0.1]])
        _, seen = screen.run(1.5)
        names = {each.condition.name for _, each in seen if serious([each])}
        assert names & {"position frozen", "touch frozen"}

    def test_a_ball_that_rests_on_a_level_plate_is_none(self, screen):
        _, seen = screen.run(3.0)
        assert serious(each for _, each in seen) == []

    def test_nothing_is_read_or_reported_after_it_is_closed_however_often(self, screen):
        screen.screen.stop()
        screen.screen.stop()
        reads = screen.reads()
        touch, seen = screen.run(1.0)
        assert seen == []
        assert screen.reads() == reads
        assert touch.touched.tolist() == [False]

    def test_it_starts_again_and_knows_nothing_of_what_was_before(self, screen):
        screen.screen.stop()
        screen.balls = []
        screen.screen.start()
        touch, _ = screen.run(0.001)
        assert touch.age.tolist() == [math.inf]
        screen.balls = [(0.02, 0.03)]
        touch, _ = screen.run(0.3)
        assert touch.position == pytest.approx(np.array([[0.02, 0.03]]), abs=1e-3)

    def test_a_stop_before_the_start_is_harmless(self, made):
        made.screen.stop()
        made.screen.start()
        touch, _ = made.run(0.3)
        assert touch.touched.tolist() == [True]


def test_both_mixes_are_made_of_devices_that_keep_the_contract(scenario):
    """The rigs of `test_mixed` have these devices and no others."""
    assert isinstance(AkdWithCamera(scenario()).screen, SeparateScreen)
    assert isinstance(OwnWithLumio(scenario()).screen, LockstepScreen)
