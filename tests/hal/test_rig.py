"""`twin.hal.rig`: The contract every rig behind the seam keeps."""

import numpy as np
import pytest
from every_setting import QUIET
from own_board import VirtualBoard, own_rig

from twin.devices.own import OwnServos
from twin.emulator.lockstep import LockstepRig
from twin.hal.rig import Rig
from twin.hal.supervisor import State
from twin.run.assemble import assemble
from twin.scenario import load

LINKAGE = "plant.linkage={crank_mm=[40,30],rod_mm=[90,100],arm_mm=[100,70],distance_mm=[50,45]}"
PLANTS = {
    "lagrange": ("plant.kind=lagrange",),
    "mujoco": ("plant.kind=mujoco",),
    "lagrange, rods": ("plant.kind=lagrange", LINKAGE),
    "mujoco, rods": ("plant.kind=mujoco", LINKAGE),
}
SIMULATED = tuple(PLANTS)
OWN = ("own hardware", "own hardware without encoder")
OWN_SET = {"plate_lag": 0.004}


def build(kind, scenario):
    """Two simulated rigs, or one of the hardware's kind on emulated devices."""
    if kind in OWN:
        return own_rig(VirtualBoard(encoder=kind == OWN[0], friction=0.002), scenario(), **OWN_SET)
    if kind != "emulated":
        return assemble([scenario(*PLANTS[kind], *QUIET)] * 2).rig
    return LockstepRig(scenario("plant.kind=mujoco", *QUIET))


@pytest.fixture(params=[*SIMULATED, "emulated", *OWN])
def rig(request, scenario):
    return build(request.param, scenario)


@pytest.fixture(params=SIMULATED)
def simulated(request, scenario):
    return build(request.param, scenario)


def count(rig):
    return len(rig.supervisor.state)


def both(rig, rate):
    """The same rate of both axes of every rig."""
    return np.full((count(rig), 2), rate)


def true_state(rig):
    return rig.devices.state if hasattr(rig, "devices") else rig.plant.devices.state


def true_plate(rig):
    if isinstance(servos := getattr(rig, "servos", None), OwnServos):
        return np.array([servos._hardware.board.angle])
    return true_state(rig)[:, 2::4]


def turn(rig, rate, periods):
    for _ in range(periods):
        rig.write(rate)
        rig.wait()
        measurement = rig.read()
    return measurement


def test_time_advances_by_one_period_a_wait(rig):
    with rig:
        assert rig.read().time == 0.0
        rig.wait()
        rig.wait()
        assert rig.read().time == pytest.approx(2 * rig.period)


def test_a_measurement_has_the_shapes_the_interface_promises(rig):
    with rig:
        measurement = rig.read()
        assert measurement.y.shape == (count(rig), 4)
        assert measurement.age.shape == (count(rig),)
        assert measurement.touched.tolist() == [True] * count(rig)
        assert measurement.state is None
        assert rig.fallen.tolist() == rig.diverged.tolist() == [False] * count(rig)


@pytest.mark.short("mujoco*", "own hardware*", "lagrange")
def test_nothing_moves_before_the_start(rig):
    with rig:
        applied = rig.write(both(rig, 0.01))
        assert not applied.any()
        measurement = turn(rig, both(rig, 0.01), 100)
    assert np.abs(measurement.y[:, 1::2]).max() < np.radians(0.05)


@pytest.mark.short("mujoco", "mujoco, rods", "own hardware*")
def test_applied_plate_rates_add_up_to_the_measured_plate_angle(rig):
    goal = np.array([[0.08, -0.05], [-0.03, 0.1]])[: count(rig)]
    with rig:
        rig.start()
        for tick in range(400):
            # a smooth ramp of 0.6 s, then 0.2 s of rest; the ball stays on the area meanwhile
            share = np.sin(np.pi * min(tick / 300, 1.0)) ** 2 / 0.3
            measured = turn(rig, goal * share, 1).y[:, 1::2]
    assert measured == pytest.approx(goal, abs=np.radians(0.05))


def test_the_applied_rates_are_what_is_returned_after_every_clamp(rig):
    with rig:
        rig.start()
        applied = rig.write(both(rig, 10.0))
    assert applied == pytest.approx(both(rig, 7.0 * rig.period))


@pytest.mark.short("mujoco", "own hardware*", "lagrange")
def test_leaving_the_rig_levels_the_plate_even_after_an_error(rig):
    def run_until_it_dies():
        with rig:
            rig.start()
            turn(rig, both(rig, 0.1), 100)
            raise RuntimeError("controller died")

    with pytest.raises(RuntimeError, match="controller died"):
        run_until_it_dies()
    assert (rig.supervisor.state == State.OFF).all()
    assert np.abs(true_plate(rig)).max() < np.radians(0.1)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("kind", ["lagrange", OWN[0]])
def test_leaving_the_rig_levels_both_axes_though_one_is_level(kind, axis, scenario):
    rig = build(kind, scenario)
    with rig:
        rig.start()
        turn(rig, both(rig, 0.1) * (np.arange(2) == axis), 100)
    assert np.abs(true_plate(rig)).max() < np.radians(0.1)


def test_a_rig_that_is_left_without_levelling_stands_still(scenario):
    rig = build("lagrange", scenario)
    rig.levelling_s = 0.0
    with rig:
        rig.start()
        turn(rig, both(rig, 0.1), 50)
    left = true_plate(rig).copy()
    assert np.abs(left).min() > np.radians(0.2)
    for _ in range(20):
        rig.wait()
    assert true_plate(rig) == pytest.approx(left, abs=1e-3)


@pytest.mark.short("lagrange-0.3", "mujoco--0.3", "own hardware*")
@pytest.mark.parametrize("rate", [-0.3, 0.3])
def test_a_plate_that_passes_its_level_as_the_rig_is_left_is_brought_to_rest_there(rig, rate):
    with rig:
        rig.start()
        turn(rig, both(rig, -rate), 50)
        while np.max(rate * rig.read().y[:, 1::2]) < 0:
            turn(rig, both(rig, rate), 1)
    assert np.abs(true_plate(rig)).max() < np.radians(0.1)
    if not isinstance(getattr(rig, "servos", None), OwnServos):
        assert np.abs(true_state(rig)[:, 3::4]).max() < 0.1  # rad/s, of 0.3


@pytest.mark.short("mujoco", "own hardware")
@pytest.mark.parametrize("kind", [*SIMULATED, "emulated", OWN[0]])
def test_a_plate_is_levelled_as_it_is_measured_not_as_its_commands_add_up(kind, scenario):
    rig = build(kind, scenario)
    with rig:
        rig.start()
        turn(rig, both(rig, 0.05), 50)
        turn(rig, both(rig, 0.0), 50)
        while np.abs(rig.read().y[:, 1::2]).max() > np.radians(0.15):
            turn(rig, both(rig, -0.01), 1)
        rig.supervisor.angle = both(rig, 0.0)  # as after periods that were missed
    assert np.abs(true_plate(rig)).max() < np.radians(0.1)


@pytest.mark.short("lagrange", "mujoco", "own hardware*")
def test_a_tilted_plate_sends_the_ball_the_way_of_the_thesis(rig):
    with rig:
        rig.start()
        measurement = turn(rig, both(rig, 0.2), 250)
    # x'' ~ +c1 g sin(phi) and y'' ~ -c1 g sin(theta).
    assert (measurement.y[:, 0] > 0.01).all()
    assert (measurement.y[:, 2] < -0.01).all()


def test_measured_and_true_plate_agree_and_the_truth_stays_off_the_measurement(simulated):
    with simulated:
        simulated.start()
        measurement = turn(simulated, np.full((2, 2), 0.1), 100)
        assert measurement.y == pytest.approx(simulated.devices.state[:, 0::2])


@pytest.mark.long
def test_a_plate_whose_drives_drift_is_held_however_far_its_commands_add_up(simulated):
    drift, gain, added = 0.06, 8.0, 0.0
    simulated.devices._drift = np.full((2, 2), drift * simulated.devices.plant.ratio)
    simulated.devices._disturbance.silent = False
    simulated.devices._disturbance.draw = lambda: 0.0
    with simulated:
        simulated.start()
        measured = simulated.read().y
        for _ in range(1750):
            applied = simulated.write(-gain * measured[:, 1::2])
            added = added + simulated.period * applied
            simulated.wait()
            measured = simulated.read().y
        assert (np.abs(added) > np.radians(11)).all()  # far beyond what the cams can do
        assert measured[:, 1::2] == pytest.approx(np.full((2, 2), drift / gain), rel=0.1)


@pytest.mark.parametrize("period", [0.0005, 0.002, 0.0025, 0.004, 0.005, 0.01, 0.02])
def test_the_plate_is_looked_at_again_every_20_ms_at_any_period(period, scenario, monkeypatch):
    seen, look = [], Rig._anchor
    monkeypatch.setattr(Rig, "_anchor", lambda rig: (seen.append(rig), look(rig)))
    rig, controller = assemble(scenario(f"rig.period={period}", "plant.step=0.0005"))
    with rig:
        controller.start(rig.read())
        rig.start()
        seen.clear()
        turn(rig, np.zeros((1, 2)), round(0.4 / period))
        assert len(seen) == 20


@pytest.mark.short("hobby-0.05-0.2")
@pytest.mark.parametrize(
    ("on", "dead_time", "most"),
    [
        pytest.param("hobby", 0.0, 0.2, marks=pytest.mark.long),
        ("hobby", 0.05, 0.2),
        ("hobby", 0.1, 0.5),
        ("three_legs", 0.1, 0.5),
        pytest.param("three_legs", 0.0, 0.2, marks=pytest.mark.long),
        pytest.param("three_legs", 0.05, 0.2, marks=pytest.mark.long),
    ],
)
def test_a_rig_is_left_level_with_late_drives_too(on, dead_time, most):
    late = f"plant.servo.dead_time={dead_time}"
    rig = assemble(load("circle", [f"parameters={on}", late])).rig
    with rig:
        rig.read()
        rig.start()
        turn(rig, np.array([[0.4, -0.25]]), 120)
        tilted = np.abs(true_plate(rig)).max()
    assert tilted > np.radians(1.0)
    assert np.abs(true_plate(rig)).max() < np.radians(most)
