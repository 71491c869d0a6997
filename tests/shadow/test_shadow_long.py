"""The shadow on the mechanism: drives, screen, and a better twin that is proposed."""

from __future__ import annotations

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from click.testing import CliRunner

from twin.cli.understand import shadow as command
from twin.identify.log import read
from twin.run.finished import run, save
from twin.scenario import load
from twin.shadow.belief import believed
from twin.shadow.diagnosis import THRESHOLD
from twin.shadow.follow import shadow
from twin.shadow.simulated import logs

pytestmark = pytest.mark.long

ROLLING = '[{at=10.0, set={"plant.friction.rolling_mm"=0.234}}]'
CHANGES = {
    "healthy": "[]",
    "servo lag": '[{at=10.0, set={"plant.servo.bandwidth_hz"=8.0}}]',
    "lost motion": '[{at=10.0, set={"plant.servo.backlash_deg"=0.1}}]',
    "sensor noise": '[{at=10.0, set={"sensors.touch.variance"=[1.632e-6, 3.987e-7]}}]',
    "another ball": '[{at=10.0, set={"plant.ball.mass"=0.263, "plant.ball.inertia"=4.208e-5, '
    '"plant.friction.rolling_mm"=0.05}}]',
}
"""What happens to rigs beside each other, by the cause that is right."""


def told(change, duration):
    common = (f"duration={duration}", "seed=5")
    return load("excite", common), load("excite", (*common, f"change={change}"))


@pytest.fixture(scope="module")
def found():
    recorded = logs([told(change, 28) for change in CHANGES.values()])
    return {name: shadow(log, believed(log)) for name, log in zip(CHANGES, recorded, strict=True)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder of a mechanism whose friction has risen."""
    path = tmp_path_factory.mktemp("run") / "drifted"
    done = run(told(ROLLING, 40)[1])
    save(done, path, {"run": done.motion})
    return path


def test_the_mechanism_is_healthy_beside_the_exact_twin(found):
    assert found["healthy"].verdict == "healthy"
    assert found["healthy"].error_1s < 1e-3


@pytest.mark.parametrize("cause", [name for name in CHANGES if name != "healthy"])
def test_a_change_is_an_alarm_in_time_with_the_right_cause_before_all_others(found, cause):
    alarm = found[cause].alarms[0]
    assert 10 < alarm.time < 20
    assert alarm.causes[0].name == cause


def test_a_healthy_rig_with_play_under_the_cure_raises_no_alarm():
    chosen = load("cure", ("plant.servo.backlash_deg=0.2", "plant.step=0.002"))
    (log,) = logs([(chosen, chosen)])
    said = shadow(log, believed(log))
    assert said.verdict == "healthy"
    assert said.ratio.max() < THRESHOLD / 3


def test_the_command_says_when_and_why_and_proposes_what_a_run_takes(folder):
    done = CliRunner().invoke(command, [str(folder), "--json"])
    numbers = json.loads(done.stdout[done.stdout.index("{") :])
    assert done.exit_code == 0  # click's own; the value returned is the exit code of ballplate
    assert numbers["alarms"][0]["causes"][0]["name"] == "rolling friction"
    assert numbers.keys() >= {"score_median", "inside_band_percent", "replay_error_1s_mm"}
    proposal = numbers["proposal"]
    assert proposal["held_out_error_after_mm"] < 0.95 * proposal["held_out_error_before_mm"]
    text = (folder / "parameters-1.toml").read_text(encoding="utf-8")
    assert all(f"# {word}: " in text for word in ("parent", "data", "version"))
    scenario = load("circle", (f"parameters={folder / 'parameters-1.toml'}",))
    assert scenario.plant.friction.rolling_mm == pytest.approx(0.234, rel=0.03)
    scores = pq.read_table(folder / "shadow.parquet")
    assert scores.schema.field("error_x").metadata[b"unit"] == b"m"
    assert "rolling friction" in (folder / "shadow.html").read_text(encoding="utf-8")


def test_a_twin_that_knows_of_the_change_raises_no_alarm_after_it(folder):
    log = read(folder)
    known = shadow(log, believed(log, ("plant.friction.rolling_mm=0.234",)))
    late = [alarm for alarm in known.alarms if alarm.since > 14]
    assert not late
    after = known.replays.counted & (known.replays.time > 10)
    assert np.median(known.replays.score[after]) < 2
