"""Two readings that defaults rest on: what printed numbers say of encoders and of Table B.1."""

import numpy as np
import pytest

from controllers.state_feedback import LQR
from twin.run.assemble import assemble
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.sim.encoders import COUNTS
from twin.thesis.experiments.instruments import (
    angles,
    off_counts,
    own_ratio,
    printed_ratio,
    turned,
)
from twin.thesis.experiments.joint_friction import TORQUES, loops
from twin.thesis.reproduce.cases import DISTURBANCE


def test_the_printed_angles_are_whole_counts_of_the_default_encoder_and_of_no_other():
    assert len(angles()) == 48
    # printing to 0.0001 deg rounds by 0.0001 / sqrt(12) deg
    assert off_counts(COUNTS) == pytest.approx(1e-4 / np.sqrt(12) * COUNTS / 360, rel=0.1)
    others = [off_counts(counts) for counts in range(8192, COUNTS, 256)]
    assert min(others) > 0.2
    assert load("circle").sensors.encoders.counts == COUNTS


def test_what_table_b1_calls_a_disturbance_is_as_large_as_the_controllers_own_output():
    printed, own = printed_ratio(), own_ratio()
    assert printed[0] == pytest.approx(printed[1], rel=0.05)
    assert own == pytest.approx(printed, rel=0.1)
    # the sharper LQR of Table 9.1 does not fit: it is this law that was running
    assert own_ratio(LQR(rho=300.0, kappa=0.1))[0] > 1.5 * printed[0]
    assert load("circle").disturbance.variance == (0.0, 0.0)


@pytest.mark.long
def test_the_answer_of_a_loop_to_noise_is_that_of_a_loop_that_is_run():
    overrides = (
        *("plant.kind=lagrange", "plant.step=0.002", "plant.friction.rolling_mm=0"),
        *("controller.kind=lqr", "controller.rho=100.0", "controller.kappa=0.1"),
        *("reference.kind=hold", "sensors.touch.dead_time=0", "sensors.touch.grid=0"),
        *("sensors.encoders.counts=0", "duration=20", "metrics.start=0"),
    )
    rig, controller = assemble(load("step", overrides))
    record = Recorder(10_000, 1, 0.002, keep=("applied",))
    drive(rig, controller, 20.0, record)
    applied = record["applied"][2500:, 0].std(axis=0)
    assert applied / np.sqrt([7.2538e-7, 1.7721e-7]) == pytest.approx(own_ratio(), rel=0.05)


def test_a_real_disturbance_would_turn_a_still_plate():
    # by the integral of white noise twice: sqrt(t^3 T / 3) times its deviation
    expected = np.degrees(np.sqrt(np.array(DISTURBANCE) * 0.002 * 10.0**3 / 3))
    assert turned(10.0) == pytest.approx(expected, rel=1e-3)


@pytest.mark.long
def test_dry_friction_of_the_joints_makes_a_loop_and_takes_force_from_the_wheels():
    found = loops()
    assert [each.torque for each in found] == list(TORQUES)
    assert found[0].width < 0.002
    per_torque = [each.width / each.torque for each in found[2:]]
    assert per_torque == pytest.approx([per_torque[0]] * 3, rel=0.01)
    # the spring presses a wheel by so much less as friction over its lever
    lost = (found[0].force - found[-1].force) * 0.16
    assert lost == pytest.approx(found[-1].torque, rel=0.1)
