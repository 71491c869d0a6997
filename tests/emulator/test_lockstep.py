"""`twin.emulator.lockstep`.

The rig of the hardware on emulated devices in bus time: the same loop, every byte."""

from dataclasses import replace
from types import MethodType

import numpy as np
import pytest

from controllers.interfaces import Law
from twin.base.errors import LawError
from twin.devices.akd.config import AkdConfig, MonitorConfig
from twin.emulator.lockstep import LockstepRig
from twin.emulator.screen import FRAME_INTERVAL_S, Protocol
from twin.emulator.serve import VirtualRig
from twin.hal.supervisor import State
from twin.run.controller_building import build_controller
from twin.run.finished import run
from twin.run.loop import drive
from twin.run.metrics import Ending
from twin.run.record import Recorder
from twin.scenario import load
from twin.scenario.rig import check_rig


def tracked(chosen, config=None, rig=None):
    rig, controller = rig or LockstepRig(chosen, config=config), build_controller(chosen)
    record = Recorder(round(chosen.duration / rig.period), 1, rig.period)
    (outcome,) = drive(rig, controller, chosen.duration, record)
    return rig, record, outcome


def test_the_emulated_screen_sees_what_the_scenarios_sees_and_as_often():
    where = ("plant.kind=lagrange", "plant.start.x=0.1", "plant.start.y=0.05", "seed=2")

    def plant(*more):
        return LockstepRig(load("hold", (*where, "sensors.touch.variance=[0,0]", *more))).plant

    turned = plant("sensors.touch.rotation_deg=30")
    seen = np.array([[np.sqrt(3) / 2, 0.5], [-0.5, np.sqrt(3) / 2]]) @ (0.1, 0.05)
    assert turned.ball()[0] == pytest.approx(seen, abs=1e-6)
    assert plant("sensors.touch.hidden=[0.05,0.0,0.15,0.1]").ball() == ()
    assert len(plant("sensors.touch.hidden=[0.05,0.0,0.15,0.04]").ball()) == 1
    looked = []
    line = turned.screen_line(lambda: looked.append(0) or (), Protocol.MICROTOUCH)
    camera = plant(
        "sensors.touch.frame_rate=25", "sensors.touch.lost=0.5", "sensors.touch.jitter=0.003"
    )
    assert len(camera.ball()) == 1
    slower = camera.screen_line(lambda: looked.append(1) or (), Protocol.MICROTOUCH)
    for tick in range(2000):
        line.step(0.001 * tick)
        slower.step(0.001 * tick)
    assert looked.count(1) == pytest.approx(25, abs=4 * np.sqrt(50 * 0.5 * 0.5))
    assert looked.count(0) == pytest.approx(2 / FRAME_INTERVAL_S, abs=2)


@pytest.mark.short("hid-timed")
@pytest.mark.parametrize("protocol", [Protocol.HID_0006, Protocol.HID_TIMED])
def test_a_screen_on_usb_is_no_flooded_line(protocol, scenario):
    rig = LockstepRig(scenario("plant.kind=lagrange"), protocol=protocol)
    with rig:
        rig.start()
        for _ in range(200):
            rig.read()
            rig.write(np.zeros((1, 2)))
            rig.wait()
    assert [note.text for _, note in rig.journal] == []


def test_what_a_virtual_rig_tells_its_host_of_slow_servos_and_lost_frames():
    def tables(*settings):
        chosen = load("circle", settings)
        with VirtualRig(chosen) as virtual:
            return virtual.tables(), virtual.plant

    told, plant = tables("parameters=three_legs")
    assert told["drives"]["shaft_lag"] == pytest.approx(1 / (2 * np.pi * 1.45))
    line = plant.screen_line(lambda: ((0.0, 0.0),), Protocol.MICROTOUCH)
    times = [0.005 * n for n in range(30_000) if line.step(0.005 * n)]
    gap = np.diff(times).max()
    assert 0.1 < gap < plant.longest_gap == told["touch"]["gate"]["stale"] < 0.4
    assert told["touch"]["gate"]["lost"] == pytest.approx(plant.longest_gap + 0.04)
    usual = tables()[0]
    assert usual["drives"]["shaft_lag"] == 0.0
    assert usual["touch"]["gate"] == {"stale": 0.06, "lost": 0.1}


@pytest.mark.long
def test_a_run_in_lockstep_is_the_same_every_time(scenario):
    chosen = scenario("plant.kind=lagrange", "duration=0.6")
    one, other = tracked(chosen)[1], tracked(chosen)[1]
    for channel in one.data:
        np.testing.assert_array_equal(one[channel], other[channel])


def test_the_record_of_a_hardware_run_has_its_timing_and_no_truth(scenario):
    rig, record, outcome = tracked(scenario("plant.kind=lagrange", "duration=0.6"))
    assert outcome.ending is Ending.FINISHED
    assert "state" not in record.data
    assert np.isfinite(record["timing"][1:]).all()
    assert rig.account()["ledger"]["missed"] == 0
    assert rig.supervisor.state[0] == State.OFF
    assert not any(each.enabled for each in rig.lockstep.drives)


def test_interrupted_while_it_takes_hold_a_rig_is_switched_off(scenario, monkeypatch):
    def interrupt(_):
        raise KeyboardInterrupt

    rig = LockstepRig(scenario("plant.kind=lagrange"))
    monkeypatch.setattr(rig, "_anchor", MethodType(interrupt, rig))
    with pytest.raises(KeyboardInterrupt), rig:
        pass
    assert rig.supervisor.state[0] == State.OFF
    assert not any(each.enabled for each in rig.lockstep.drives)


@pytest.mark.long
def test_a_dead_band_of_the_servos_is_no_frozen_motor_on_an_emulated_rig():
    still = ("sensors.touch.lost=0", "sensors.touch.jitter=0", "duration=1.2")
    chosen = load("circle", ("parameters=three_legs", *still))
    files = []
    for each in (chosen, load("circle"), load("circle", ("plant.servo.deadband_deg=1.5",))):
        with VirtualRig(each) as virtual:
            files.append(virtual.tables()["drives"]["watch"]["travel"])
    told, usual, most = files
    assert usual == MonitorConfig().travel
    assert most == 0.1  # no rig file may have more
    assert told == pytest.approx(0.005 + np.radians(0.3))  # its motors turn as far as its plate
    assert tracked(chosen)[2].reason.endswith(
        "motor position frozen: no count over 0.005 rad commanded"
    )
    outcome = tracked(chosen, AkdConfig(watch=MonitorConfig(travel=told)))[2]
    assert outcome.ending is Ending.FINISHED


def as_served(chosen, protocol=Protocol.MICROTOUCH):
    """A rig in bus time with the host's settings of the rig file that a virtual rig writes."""
    with VirtualRig(chosen, protocol) as virtual:
        file = check_rig(virtual.tables(), "virtual")
    config = replace(file.servos(chosen.rig.period), silence=0.06)
    return LockstepRig(chosen, config=config, touch=file.screen(), protocol=protocol)


HEALTHY = {
    "slow servos": ("circle", "parameters=hobby", "reference.amplitude=0.08", "duration=8"),
    "slow servos, fast": ("circle", "parameters=hobby", "reference.amplitude=0.08", "duration=8",
                          "rig.period=0.001"),
    "frames are lost": ("cure", "parameters=three_legs", "reference.amplitude=0.05", "duration=10"),
    "servo of 1 Hz": ("circle", "plant.servo.bandwidth_hz=1.0", "rig.plate_lag=0.16",
                      "controller.kind=lqr", "reference.omega=0.4", "duration=6"),
    "servo of 0.1 s": ("circle", "plant.servo.dead_time=0.1", "reference.omega=0.4", "duration=6"),
    "rods": ("circle", "parameters=course", "reference.amplitude=0.06", "rig.period=0.004",
             "duration=6"),
    "few frames": ("hold", "sensors.touch.frame_rate=8", "sensors.touch.variance=[0,0]",
                   "controller.rho=30", "duration=6"),
    "play": ("step", "plant.servo.backlash_deg=0.5", "duration=5"),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", HEALTHY)
def test_a_healthy_rig_with_the_rig_file_of_a_virtual_one_raises_no_alarm(name):
    scenario, *settings = HEALTHY[name]
    kind = () if "parameters" in settings[0] else ("plant.kind=lagrange",)
    chosen = load(scenario, (*settings, *kind))
    rig, _, outcome = tracked(chosen, rig=as_served(chosen))
    assert outcome.ending is Ending.FINISHED, outcome.reason
    assert [note.text for _, note in rig.journal] == []


def true_error_percent(chosen, missing=0.0):
    """e_tt (C.7) of the true ball over the wire, a share of periods overslept by up to 6 ms."""
    rig, controller = LockstepRig(chosen), build_controller(chosen)
    rng, ball = np.random.default_rng(0), []

    def keep(tick, measurement):
        ball.append((measurement.time, *rig.plant.devices.state[0]))
        if rng.random() < missing:
            rig.hang = 0.006 * rng.random()

    record = Recorder(round(chosen.duration / rig.period), 1, rig.period)
    (outcome,) = drive(rig, controller, chosen.duration, record, keep=keep)
    assert outcome.ending is Ending.FINISHED
    # no older angle was used
    assert missing or (record["timing"][:, 0, 2] < 1.5 * rig.period).all()
    found = np.array(ball)[np.array(ball)[:, 0] >= chosen.metrics.start]
    r = controller.reference(found[:, 0])[0]
    error = 100 * np.sqrt(((found[:, 1::4] - r) ** 2).sum() / (r**2).sum())
    return error, rig.account()["ledger"]["missed"]


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "overrides"),
    [
        ("circle", ("duration=60", f"sensors.touch.frame_rate={1 / FRAME_INTERVAL_S}")),
        *((name, ()) for name in ("cure", "cure_afl", "cure_backstepping")),
    ],
)
def test_over_the_wire_the_tracking_error_is_within_three_tenths_of_a_point(name, overrides):
    chosen = load(name, overrides)
    wire, missed = true_error_percent(chosen)
    assert not missed
    assert abs(wire - run(chosen).metrics["tracking_error_percent"]) < 0.3


@pytest.mark.long
def test_a_computer_that_misses_periods_costs_the_cure_hardly_anything():
    chosen = load("cure")
    wire, missed = true_error_percent(chosen, missing=0.05)
    assert missed > 500
    assert abs(wire - run(chosen).metrics["tracking_error_percent"]) < 0.3


@pytest.mark.long
def test_the_noise_of_a_screen_is_drawn_anew_for_every_frame(scenario):
    plant = LockstepRig(scenario("plant.kind=lagrange", "sensors.touch.variance=[1e-6,1e-6]")).plant
    found = []
    for _ in range(400):
        plant.advance(FRAME_INTERVAL_S)
        found.append(plant.ball()[0])
    x, y = np.array(found).T
    assert np.std(x) == pytest.approx(1e-3, rel=0.15)
    for each in (x, y):
        assert abs(np.corrcoef(each[1:], each[:-1])[0, 1]) < 0.2  # four standard deviations


class GivesUp(Law):
    name = "gives_up"

    def control(self, t, x, reference, q):
        if t >= 0.2:
            raise ZeroDivisionError("no more ideas")
        return np.full((*x.shape[:-1], 2), 0.5)


def test_a_law_that_raises_on_a_rig_leaves_a_level_plate_and_the_record(scenario, take_in):
    take_in(GivesUp)
    chosen = scenario("plant.kind=lagrange", "duration=0.6", "controller.kind=gives_up")
    rig = LockstepRig(chosen)
    done = run(chosen, rig=rig)
    with pytest.raises(LawError, match="no more ideas"):
        run(chosen)
    assert done.outcome == "aborted"
    assert "no more ideas" in done.metrics["reason"]
    assert done.rows["time"][-1] == pytest.approx(0.198)
    assert np.abs(done.rows["measured_phi"]).max() > 0.005
    assert np.abs(rig.plant.devices.plate()).max() < 0.001
