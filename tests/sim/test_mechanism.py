"""`twin.sim.plant.mechanism`: The MuJoCo plant: N mechanisms behind the plant interface."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import mujoco
import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.base.errors import ModelError
from twin.base.shipped import model_path
from twin.hal.cams import CamTable
from twin.hal.linkage import Linkage
from twin.sim.plant.exact import ExactPlant
from twin.sim.plant.friction import Friction
from twin.sim.plant.interface import Parts
from twin.sim.plant.mechanism import Mechanism
from twin.sim.plant.model import load_model

BALL = BallPlate()
TICK = 2
"""Physics steps in a control period of these tests."""
BESIDE = np.array([[0.6, 0.0, 0.0, 0.0]])
"""Beside the screen: a ball started there falls off."""

RODS = Parts(
    linkage=Linkage(crank=(0.04, 0.03), rod=(0.09, 0.1), arm=(0.1, 0.07), distance=(0.05, 0.045)),
    size=(0.7, 0.395),
)


ROUND = Parts(size=(0.7, 0.7), rounded=True)
ROUND_RODS = replace(RODS, size=(0.7, 0.7), rounded=True)


@pytest.fixture(
    params=[None, RODS, ROUND, ROUND_RODS], ids=["cams", "rods", "round cams", "round rods"]
)
def mechanism(request):
    """Makes mechanisms of both kinds and shapes, which have the same ball and surface."""
    return partial(Mechanism, parts=request.param)


def read_telemetry(plant, *channels):
    """What the rigs tell beside their states, shape (N, channels)."""
    return plant.telemetry()[:, [plant.channels.index(each) for each in channels]]


def motion(t):
    """Motor speeds for a smooth plate motion on both axes, (2,)."""
    return 1.5 * np.sin([3 * t, 4 * t])


def test_at_the_start_the_plate_is_level_and_the_ball_where_it_was_put(mechanism):
    plant = mechanism(rigs=2)
    ball = np.array([[0.1, 0.02, -0.05, 0.03], [-0.2, 0.0, 0.1, -0.1]])
    plant.start(ball)
    assert plant.state[:, [0, 1, 4, 5]] == pytest.approx(ball)
    assert plant.state[:, [2, 3, 6, 7]] == pytest.approx(np.zeros((2, 4)))
    assert plant.motor == pytest.approx(np.zeros((2, 2)), abs=1e-5)


def test_a_ball_started_in_motion_rolls_from_the_first_step_on(mechanism):
    plant = mechanism(friction=Friction(rolling=0.0))
    speed = np.array([0.3, -0.2])
    plant.start(np.array([[0.0, speed[0], 0.0, speed[1]]]))
    for _ in range(100):
        plant.advance(np.zeros((1, 2)), TICK)
    # the plate gives way a little under the moving ball; a sliding ball would lose 40 %
    assert plant.state[0, [1, 5]] == pytest.approx(speed, rel=2e-3)


def test_the_state_is_that_of_a_plain_simulation_at_the_present_instant():
    plant = Mechanism()
    plant.start(np.array([[0.05, 0.1, -0.02, 0.05]]))
    model = mujoco.MjModel.from_xml_path(str(model_path()))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("level").id)
    radius = data.qpos[model.joint("ball").qposadr[0] + 2] - 0.122
    data.joint("ball").qpos[:2] = 0.05, -0.02
    data.joint("ball").qvel = [0.1, 0.05, 0, -0.05 / radius, 0.1 / radius, 0]
    mujoco.mj_forward(model, data)
    for k in range(200):
        rate = motion(k * TICK * plant.step)
        plant.advance(rate[None], TICK)
        data.actuator("servo_phi").ctrl, data.actuator("servo_theta").ctrl = rate
        mujoco.mj_step(model, data, TICK)
    now = mujoco.MjData(model)
    now.qpos, now.qvel = data.qpos, data.qvel
    mujoco.mj_kinematics(model, now)
    x, y, _ = now.body("plate").xmat.reshape(3, 3).T @ now.joint("ball").qpos[:3]
    state = plant.state[0]
    assert state[[0, 4]] == pytest.approx([x, y], abs=1e-12)
    assert state[[2, 6]] == pytest.approx(
        [float(now.joint("phi").qpos[0]), float(now.joint("theta").qpos[0])], abs=1e-12
    )


def test_the_velocities_are_the_rates_of_the_positions():
    plant = Mechanism()
    plant.start(np.array([[0.05, 0.1, -0.02, 0.05]]))
    rows = []
    for k in range(400):
        plant.advance(motion(k * plant.step)[None], 1)
        rows.append(plant.state[0])
    rows = np.array(rows)[100:]
    slope = (rows[2:, 0::2] - rows[:-2, 0::2]) / (2 * plant.step)
    middle = (rows[1:-1, 1::2] + rows[2:, 1::2]) / 2
    # the semi-implicit step moves positions with the speed at its end
    assert slope == pytest.approx(middle, abs=2e-5)


def test_the_motor_ratio_is_the_slope_of_the_mechanism_at_level():
    plant = Mechanism(rigs=2)
    plant.start(np.repeat(BESIDE, 2, axis=0))
    for sign in (np.array([[0.1, 0.0], [0.0, 0.1]]), np.zeros((2, 2))):
        plant.advance(sign, 1000)
    plate = plant.state[:, [2, 6]]
    slope = np.array([plant.motor[0, 0] / plate[0, 0], plant.motor[1, 1] / plate[1, 1]])
    assert slope == pytest.approx([plant.ratio] * 2, rel=0.03)


def test_any_number_of_threads_gives_the_same_bits(mechanism):
    rng = np.random.default_rng(7)
    rates = rng.uniform(-2, 2, (50, 5, 2))
    start = np.zeros((5, 4))
    start[:, 0] = np.linspace(-0.2, 0.2, 5)
    friction = Friction(rolling=np.linspace(0, 4e-4, 5))
    plants = [mechanism(rigs=5, threads=n, friction=friction) for n in (1, 3)]
    for plant in plants:
        plant.start(start)
        for rate in rates:
            plant.advance(rate, TICK)
    assert np.array_equal(plants[0].state, plants[1].state)
    assert np.array_equal(plants[0].motor, plants[1].motor)


def test_a_rolling_ball_slows_down_with_the_friction_of_its_own_rig(mechanism):
    lever = np.array([0.0, 1e-4, 2e-4, 4e-4])
    plant = mechanism(rigs=4, friction=Friction(rolling=lever))
    plant.start(np.tile([-0.1, 0.2, 0.0, 0.0], (4, 1)))
    plant.advance(np.zeros((4, 2)), 500)
    slowing = (0.2 - plant.state[:, 1]) / 0.5
    assert slowing == pytest.approx(
        BALL.c1 * BALL.gravity * lever / BALL.radius, abs=2e-3, rel=0.02
    )


@pytest.mark.short("cams*", "rods*")
def test_the_servo_does_not_droop_under_the_spring(mechanism):
    plant = mechanism()
    plant.start(BESIDE)
    plant.advance(np.zeros((1, 2)), 2000)
    before = plant.motor
    plant.advance(np.zeros((1, 2)), 10000)
    assert plant.motor == pytest.approx(before, abs=1e-9)


def test_the_servo_takes_the_motor_as_far_as_its_speed_says(mechanism):
    plant = mechanism()
    plant.start(BESIDE)
    plant.advance(np.array([[0.3, -0.2]]), 1000)
    plant.advance(np.zeros((1, 2)), 1000)
    # what is left is the change of the spring's torque over the servo's stiffness
    assert plant.motor[0] == pytest.approx([0.3, -0.2], abs=1e-3)


def test_a_wish_for_more_speed_gets_the_operating_limit():
    plant = Mechanism()
    plant.start(BESIDE)
    plant.advance(np.full((1, 2), 1000.0), 20)
    before = plant.motor
    plant.advance(np.full((1, 2), 1000.0), 20)
    assert (plant.motor - before)[0] / (20 * plant.step) == pytest.approx([20, 20], rel=0.1)


def test_the_torque_stays_within_its_peak():
    plant = Mechanism()
    plant.start(BESIDE)
    torques = []
    for k in range(400):
        plant.advance(np.full((1, 2), 20.0 if k // 20 % 2 else -20.0), 1)
        torques.append(read_telemetry(plant, "torque_phi_Nm", "torque_theta_Nm"))
    assert np.abs(torques).max() == pytest.approx(12.3)


@pytest.mark.long
def test_a_ball_at_rest_on_the_level_plate_drifts_less_than_a_micrometre_in_a_minute(mechanism):
    plant = mechanism()
    away = 0.0
    for _ in range(600):
        plant.advance(np.zeros((1, 2)), 100)
        away = max(away, float(np.hypot(*plant.state[0, [0, 4]])))
    assert away < 1e-6


@pytest.mark.long
def test_a_minute_of_random_servo_noise_brings_neither_warning_nor_nan(mechanism):
    rng = np.random.default_rng(3)
    amplitude = np.array([[0.5], [20.0]])
    hold = 10
    plant = mechanism(rigs=2)
    for _ in range(60_000 // hold):
        plant.advance(amplitude * rng.uniform(-1, 1, (2, 2)), hold)
        assert np.isfinite(plant.state).all()
    assert not plant.warnings.any()


def test_numbers_that_run_away_are_told_and_leave_neither_line_nor_file(
    tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    plant = Mechanism(rigs=2)
    plant._qvel[1] = 1e12
    plant.advance(np.zeros((2, 2)), 2)
    assert plant.diverged.tolist() == [False, True]
    assert not list(tmp_path.iterdir())
    assert not any(capfd.readouterr())


@pytest.mark.long
def test_the_wheels_stay_on_their_cams_over_8_degrees_at_7_rad_per_s2_on_both_axes():
    plant, amplitude = Mechanism(rigs=3), math.radians(8)
    plant.start(np.repeat(BESIDE, plant.rigs, axis=0))
    omega = math.sqrt(7 / amplitude)
    t = np.arange(0, 6, TICK * plant.step)
    s = np.minimum(t / 2, 1)
    begin = s**3 * (10 - 15 * s + 6 * s**2)
    phi = np.stack([np.sin(omega * t)] * 3, axis=-1)
    theta = np.stack([np.sin(omega * t + shift) for shift in (0, math.pi, math.pi / 2)], axis=-1)
    plate = amplitude * begin[:, None, None] * np.stack([phi, theta], axis=-1)
    wheels, torques, reached = [], [], []
    for rate in np.diff(CamTable.packaged().motor(plate), axis=0) / (TICK * plant.step):
        for _ in range(TICK):
            plant.advance(rate, 1)
            wheels.append(read_telemetry(plant, "wheel_phi_N", "wheel_theta_N"))
            torques.append(read_telemetry(plant, "torque_phi_Nm", "torque_theta_Nm"))
        reached.append(plant.state[:, [2, 6]])
    assert np.degrees(np.ptp(reached, axis=0)) == pytest.approx(np.full((3, 2), 16), abs=0.5)
    assert np.min(wheels) > 25
    assert np.abs(torques).max() < 12.3
    # heating goes with the mean square: the motors could do this all day
    assert np.sqrt(np.mean(np.square(torques[2000:]), axis=0)).max() < 4.57


def test_a_wheel_can_lift_off_its_cam():
    plant = Mechanism()
    plant.start(BESIDE)
    plant.advance(np.array([[5.0, 0.0]]), 150)
    plant.advance(np.array([[-20.0, 0.0]]), 30)
    assert read_telemetry(plant, "wheel_phi_N") == 0
    assert not plant.warnings.any()


@pytest.mark.parametrize("rigs", [1, 20])
def test_from_a_round_plate_the_ball_falls_where_the_circle_ends_beside_square_ones(rigs):
    there = np.array([0.23, 0.2, 0.23, 0.2])  # 325 mm from the middle, outwards at 283 mm/s
    for disc, square in (
        (ROUND, Parts(size=(0.7, 0.7))),
        (ROUND_RODS, replace(RODS, size=(0.7,) * 2)),
    ):
        parts = [disc if rig % 3 == 0 else square for rig in range(rigs)]
        plant = Mechanism(rigs=rigs, parts=parts, friction=Friction(rolling=0.0))
        plant.start(np.tile(there, (rigs, 1)))
        for tick in range(60):
            plant.advance(np.zeros((rigs, 2)), 2)
            out = np.hypot(0.23, 0.23) + 0.2 * np.sqrt(2) * 0.002 * (tick + 1)
            if abs(out - 0.35) > 5e-4:
                assert plant.on_plate.tolist() == [out < 0.35 or part is square for part in parts]
        assert out > 0.35
        plant.advance(np.zeros((rigs, 2)), 150)
        fell = np.array([part is disc for part in parts])
        height = plant._qpos[:, plant._at.ball_pose][:, 2]
        assert (height[fell] < 0.1).all()
        assert height[~fell] == pytest.approx(np.full(rigs - fell.sum(), 0.142), abs=1e-3)


@pytest.mark.parametrize("sides", [(0.5, 0.6), (0.5, 0.5)])
def test_mass_and_inertia_of_another_plate_are_those_of_a_slab_of_its_shape(sides):
    """That of the file is a uniform box of 0.7 x 0.395 x 0.05 m and 5.5 kg; rods carry glass."""
    (a, b), rounded = sides, sides[0] == sides[1]
    across, along = np.random.default_rng(1).uniform(-0.5, 0.5, (2, 400_000)) * [[a], [b]]
    kept = np.hypot(across, along) < a / 2 if rounded else np.full(across.shape, True)
    area = a * b * kept.mean()
    for parts, per_area, thick in (
        (Parts(), 5.5 / (0.7 * 0.395), 0.05),
        (RODS, 2500 * 0.003, 0.003),
    ):
        model = load_model(parts=replace(parts, size=sides, rounded=rounded))
        plate = model.body("plate")
        mass = per_area * area
        assert plate.mass[0] == pytest.approx(mass, rel=3e-3)
        xx, yy = np.mean(across[kept] ** 2), np.mean(along[kept] ** 2)
        zz = thick**2 / 12
        moments = mass * np.array([yy + zz, xx + zz, xx + yy])
        turn = np.zeros(9)
        mujoco.mju_quat2Mat(turn, plate.iquat)
        axes = turn.reshape(3, 3)
        found = axes @ np.diag(plate.inertia) @ axes.T
        assert found == pytest.approx(np.diag(moments), rel=7e-3, abs=1e-4)


@pytest.mark.short("cams-0.02", "rods-None", "round *-0.25")
@pytest.mark.parametrize("height", [None, 0.02, 0.25])
def test_a_ball_on_a_plate_that_moves_follows_the_exact_equations(mechanism, height):
    parts = replace(mechanism.keywords["parts"] or Parts(), height=height)
    plant = Mechanism(friction=Friction(rolling=0.0), parts=parts)
    high = BallPlate().height if height is None else height
    told, other = (ExactPlant(model=BallPlate(height=each)) for each in (high, high + 0.05))
    ball = np.array([[0.02, 0.02, -0.03, 0.01]])
    for each in (plant, told, other):
        each.start(ball)
    for tick in range(1000):
        wave = np.sin(tick * np.array([0.006, 0.008]))
        tilt_rate = 0.5 * wave**2 * np.cos(tick * np.array([0.006, 0.008]))
        plant.advance((plant.ratio * tilt_rate)[None], 1)
        told.advance(plant.state[:, 3::4], 1)
        other.advance(plant.state[:, 3::4], 1)
    assert np.abs(plant.state[0, 2::4]).max() > np.radians(1)
    assert plant.state[:, 0::4] == pytest.approx(told.state[:, 0::4], abs=1e-4)
    assert np.abs(plant.state - other.state)[:, 0::4].max() > 5e-4


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (None, "no such file"),
        ("this is no xml", "XML"),
        ("<mujoco><worldbody/></mujoco>", "missing joint theta"),
    ],
)
def test_a_model_that_cannot_be_used_is_refused_in_one_line(tmp_path, text, says):
    path = tmp_path / "other.xml"
    if text is not None:
        path.write_text(text, encoding="utf-8")
    with pytest.raises(ModelError, match=says) as caught:
        load_model(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wrong", [{"rigs": 0}, {"step": 0.0}, {"step": math.nan}], ids=str)
def test_impossible_numbers_are_refused(wrong):
    with pytest.raises(ModelError):
        Mechanism(**wrong)


def test_a_rolling_friction_too_small_to_simulate_is_refused():
    with pytest.raises(ModelError, match="rolling friction"):
        Mechanism(friction=Friction(rolling=1e-6))


def test_dry_friction_of_the_plates_joints_is_lost_motion_that_presses_the_wheels_less():
    torque = 3.0
    plant = Mechanism(rigs=2, parts=[Parts(), Parts(joint_friction=torque)])
    plant.start(np.repeat(BESIDE, 2, axis=0))
    assert plant.state[:, 2] == pytest.approx(np.zeros(2), abs=1e-9)
    lag = []
    for sign in (1.0, -1.0):
        # there, past level, and on at 1 deg/s of the plate: no time to creep
        rate = np.full((2, 2), sign * plant.ratio * math.radians(1.0)) * (1.0, 0.0)
        plant.advance(rate, round(0.5 / plant.step) if sign > 0 else round(1.0 / plant.step))
        lag.append(np.degrees(plant.motor[:, 0] / plant.ratio - plant.state[:, 2]))
    width = lag[0] - lag[1]
    # friction presses the wheel's contact by torque over lever, which is a spring of 80 kN/m
    lever, stiffness = 0.16, 8e4
    expected = math.degrees(2 * torque / (stiffness * lever**2))
    assert width[1] - width[0] == pytest.approx(expected, rel=0.03)


@pytest.mark.short("cams", "round rods")
def test_many_rigs_are_seen_as_the_engines_own_sensors_see_one(mechanism):
    rate = np.array([0.9, -0.6])
    one, many = mechanism(rigs=1), mechanism(rigs=20)
    for plant in (one, many):
        plant.start(np.tile([0.1, 0.05, -0.05, 0.1], (plant.rigs, 1)))
        for _ in range(200):
            plant.advance(np.tile(rate, (plant.rigs, 1)), 2)
    assert many.state[7] == pytest.approx(one.state[0], abs=1e-12)
    assert many.on_plate.all()


def test_a_ball_that_rolls_over_the_edge_is_off_the_plate_for_one_rig_and_for_many(mechanism):
    for rigs in (1, 20):
        plant = mechanism(rigs=rigs)
        plant.start(np.tile([0.34, 0.5, 0.0, 0.0], (rigs, 1)))
        assert plant.on_plate.all()
        plant.advance(np.zeros((rigs, 2)), 40)
        assert not plant.on_plate.any()


# Why a law must not be fed the true plate rate: the plate's resonance answers


PERIOD = 0.002
GAINS = (72.0, 150.0, 70.0, 20.0)
"""Of position, speed, plate angle and plate rate; stable by the ball-and-plate model alone."""
assert np.roots([1, *reversed(GAINS)]).real.max() < 0


def ringing(true_rate):
    """Largest plate rate in rad/s in the last second of six under a full state feedback."""
    plant = Mechanism()
    plant.start(np.array([[0.05, 0.0, -0.05, 0.0]]))
    table = CamTable.packaged()
    angle = rate = np.zeros((1, 2))
    motor = table.motor(angle)
    k1, sign = BallPlate().k1, np.array([1, -1])
    position, speed, tilt, damping = GAINS
    last = []
    for _ in range(round(6 / PERIOD)):
        x = plant.state
        ball = (position * x[:, [0, 4]] + speed * x[:, [1, 5]]) / k1 * sign
        plate_rate = x[:, [3, 7]] if true_rate else rate
        u = np.clip(-ball - tilt * x[:, [2, 6]] - damping * plate_rate, -7, 7)
        rate = rate + PERIOD * u
        angle = np.clip(angle + PERIOD * rate, -0.17, 0.17)
        after = table.motor(angle)
        plant.advance((after - motor) / PERIOD, 2)
        motor = after
        last.append(np.abs(plant.state[0, [3, 7]]).max())
    return max(last[-round(1 / PERIOD) :])


@pytest.mark.long
def test_feedback_of_the_true_plate_rate_excites_the_resonance_and_of_the_commanded_does_not():
    assert ringing(true_rate=True) > 0.1
    assert ringing(true_rate=False) < 0.02


@pytest.mark.parametrize("parts", [None, ROUND], ids=["cams", "round cams"])
def test_numpy_sees_one_ball_by_the_same_bits_as_among_others(parts):
    start = np.array([[0.1, 0.02, -0.05, 0.03], [0.34, 0.5, 0.0, 0.1], [-0.2, 0.0, 0.1, -0.1]])
    many = Mechanism(rigs=3, parts=parts, sensing=False)
    many.start(start)
    each = [Mechanism(parts=parts, sensing=False) for _ in start]
    for plant, ball in zip(each, start, strict=True):
        plant.start(ball[None])
    for tick in range(60):
        many.advance(np.tile(motion(0.002 * tick), (3, 1)), TICK)
        for plant in each:
            plant.advance(motion(0.002 * tick)[None], TICK)
        assert np.array_equal(many.state, np.concatenate([plant.state for plant in each]))
        assert np.array_equal(many.on_plate, np.concatenate([plant.on_plate for plant in each]))
    assert many.on_plate.tolist() == [True, False, True]


def test_numpy_sees_a_ball_where_the_sensors_of_the_engine_see_it(mechanism):
    both = [mechanism(rigs=2, sensing=sensing) for sensing in (True, False)]
    for plant in both:
        plant.start(np.array([[0.1, 0.02, -0.05, 0.03], [-0.2, 0.0, 0.1, -0.1]]))
        for tick in range(50):
            plant.advance(np.tile(motion(0.002 * tick), (2, 1)), TICK)
    assert both[1].state == pytest.approx(both[0].state, abs=1e-9)
