"""Tests of `twin.cli.understand`."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from controllers.classical import SlidingMode
from twin.cli.understand import analyse
from twin.run.finished import run
from twin.scenario import load

pytestmark = pytest.mark.long


def call(*arguments):
    result = CliRunner(env={"COLUMNS": "200"}).invoke(analyse, arguments, catch_exceptions=False)
    assert result.exit_code == 0
    return result.stdout


def test_json_has_poles_and_margins_of_the_loop_at_every_cut():
    content = json.loads(call("sine", "--json"))
    assert set(content) == {"scenario", "loop"}
    loop = content["loop"]
    assert loop["stable"]
    assert all(real < 0 for real, _ in loop["poles"])
    assert set(loop["margins"]) == {"u1", "u2", "x", "y"}
    for cut in loop["margins"].values():
        assert set(cut) >= {"gain_down", "gain_up", "phase", "disk", "delay"}
        assert cut["disk"] > 0


TOLD = {
    "sine": ("delay ms", "u1", "poles in 1/s"),
    f"sine controller.kind={SlidingMode.name}": ("has no linearisation",),
    "hold controller.kind=pole_placement controller.poles=[-30,-31,-32,-33]": (
        "the sampled loop is unstable about the level plate",
    ),
}


@pytest.mark.parametrize("asked", TOLD)
def test_people_get_tables_and_words(asked):
    scenario, *changes = asked.split()
    text = call(scenario, *(part for change in changes for part in ("--set", change)))
    assert all(words in text for words in TOLD[asked])


def test_full_state_feedback_is_analysed_too():
    ideal = ("--set", "observer.kind=ideal", "--set", "sensors.ideal=true")
    found = json.loads(call("sine", *ideal, "--json"))
    assert found["loop"]["observer"] == "ideal"
    assert found["loop"]["stable"]


EVEN = (
    *("plant.kind=lagrange", "plant.friction.rolling_mm=0", "sensors.touch.grid=0"),
    *("sensors.touch.variance=[0,0]", "sensors.encoders.variance=[0,0]"),
    *("sensors.encoders.counts=0", "plant.start.x=0.001", "duration=12", "metrics.start=0"),
    *("controller.kind=afl", "controller.gains=[180,162,66,13]"),
)


@pytest.mark.parametrize("corner", [2.2, 1.6])
def test_a_ball_behind_slow_drives_swings_and_grows_or_fades_as_the_poles_say(corner):
    slow = (*EVEN, f"plant.servo.bandwidth_hz={corner}")
    found = json.loads(call("hold", *(part for each in slow for part in ("--set", each)), "--json"))
    (real, imaginary), (same, _), (next_real, _), *_ = found["loop"]["poles"]
    assert real == pytest.approx(same)
    assert next_real < real - 0.5  # soon gone
    assert found["loop"]["stable"] == (real < 0) == (corner > 1.8)
    motion = run(load("hold", slow)).motion
    late = motion.time > 5
    x, time = motion.ball[late, 0], motion.time[late]
    (ends,) = np.nonzero((np.abs(x[1:-1]) > np.abs(x[:-2])) & (np.abs(x[1:-1]) >= np.abs(x[2:])))
    rate, _ = np.polyfit(time[1 + ends], np.log(np.abs(x[1 + ends])), 1)
    assert rate == pytest.approx(real, abs=0.03)
    assert np.pi / np.diff(time[1 + ends]).mean() == pytest.approx(abs(imaginary), rel=0.01)


def test_a_loop_of_one_axis_has_no_cut_of_the_second():
    loop = json.loads(call("circle", "--on", "tube", "--json"))["loop"]
    assert set(loop["margins"]) == {"u1", "x"}
