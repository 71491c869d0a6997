"""Tests of `twin.run.finished`."""

import json

import numpy as np
import pytest

import twin.run.finished
from twin.base.errors import ScenarioError
from twin.run.assemble import assemble
from twin.run.finished import run, save
from twin.run.metrics import Ending

pytestmark = pytest.mark.usefixtures("no_pictures")


def test_with_ideal_sensors_the_sampled_loop_follows_the_continuous_one(scenario):
    # The linear closed loop of the design, by the matrix exponential: an independent truth.
    from scipy.linalg import expm

    chosen = scenario(
        "duration=3",
        "sensors.ideal=true",
        "observer.kind=ideal",
        "disturbance.variance=[0,0]",
        "plant.friction.rolling_mm=0",
        "reference.x=0.01",
        "reference.y=-0.01",
    )
    done = run(chosen)
    law = assemble(chosen).controller.law
    A, B, _ = law.model.linear()
    goal = np.zeros(8)
    goal[0::4] = 0.01, -0.01
    for tick in (250, 750, 1499):
        expected = goal - expm((A - B @ law.K) * done.record.time[tick]) @ goal
        assert done.motion.ball[tick] == pytest.approx(expected[0::4], abs=5e-5)


@pytest.mark.long
def test_a_rig_stopped_at_its_limits_levels_the_plate_and_says_why(scenario):
    done = run(
        scenario(
            "duration=8", "plant.start.x_rate=0.06", "plant.start.x=0.245", "rig.limits.margin=0.0"
        )
    )
    assert done.outcome == Ending.ABORTED
    assert "left the area" in done.metrics["reason"]
    assert np.abs(done.motion.plate[-1]).max() < 1e-3


@pytest.mark.long
@pytest.mark.parametrize("kind", ["lagrange", "mujoco"])
def test_a_run_whose_numbers_run_away_has_diverged_and_is_saved(
    scenario, monkeypatch, tmp_path, kind
):
    chosen = scenario(f"plant.kind={kind}", "duration=2")
    rig, controller = assemble(chosen)
    plant, advance = rig.devices.plant, rig.devices.plant.advance

    def run_away(rate, steps):
        advance(rate, steps)
        if rig.devices.time == pytest.approx(0.5):
            (plant._x if kind == "lagrange" else plant._qvel)[:] = 1e300

    monkeypatch.setattr(plant, "advance", run_away)
    monkeypatch.setattr(twin.run.assemble, "assemble", lambda *_, **__: (rig, controller))
    with np.errstate(all="ignore"):
        done = run(chosen)
    assert done.outcome == Ending.DIVERGED
    assert 0.5 < done.metrics["outcome_time"] < 0.8
    save(done, tmp_path, {"run": done.motion})
    assert json.loads((tmp_path / "metrics.json").read_text())["outcome"] == "diverged"


def test_ctrl_c_levels_the_plate_and_ends_a_run_as_aborted_with_its_record(
    scenario, monkeypatch, tmp_path
):
    chosen = scenario()
    rig, controller = assemble(chosen)
    original, tilts = controller.command, []

    def interrupted(measurement):
        tilts.append(np.abs(rig.devices.state[0, 2::4]).max())
        if len(tilts) == 50:
            raise KeyboardInterrupt
        return original(measurement)

    monkeypatch.setattr(controller, "command", interrupted)
    monkeypatch.setattr(twin.run.assemble, "assemble", lambda *_, **__: (rig, controller))
    done = run(chosen)
    assert done.interrupted
    assert done.outcome == Ending.ABORTED
    assert done.record.length == 49
    assert tilts[-1] > 2e-3
    assert np.abs(rig.devices.state[0, 2::4]).max() < 1e-3
    save(done, tmp_path, {"run": done.motion})
    assert json.loads((tmp_path / "metrics.json").read_text())["outcome"] == "aborted"


def test_a_reference_outside_the_operating_area_is_refused(scenario):
    with pytest.raises(ScenarioError, match=r"rig\.limits\.area"):
        run(scenario("reference.x=0.3"))


def test_one_ball_off_its_plate_is_told_of_all_rigs(scenario):
    rig, _ = assemble([scenario("plant.kind=lagrange")] * 2)
    assert not rig.any_fallen
    rig.devices.plant.start(np.array([[0.0] * 4, [0.4, 0.0, 0.0, 0.0]]))
    rig.wait()
    assert rig.any_fallen
    assert rig.fallen.tolist() == [False, True]
