"""`twin.shadow.follow`.

The twin beside a run in progress: says what it says afterwards, and never disturbs the run."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from twin.cli.runs import run as run_command
from twin.cli.understand import shadow as shadow_command
from twin.identify.logs import read
from twin.identify.prepare import prepare
from twin.run.opened import open_run
from twin.scenario import load
from twin.shadow import follow, learning
from twin.shadow.causes import Alarm, Cause
from twin.shadow.evidence import Evidence
from twin.shadow.follow import Shadow
from twin.shadow.horizon import CHI_SQUARE_95, Replays
from twin.shadow.report import Commentary, TwinStream, examine

SETTINGS = (
    "plant.kind=lagrange",
    "duration=26",
    "seed=5",
    'change=[{at=9.0, set={"plant.friction.rolling_mm"=0.234}}]',
)
"""A run whose friction rises."""


def replays(error, time):
    """Replays with errors in m, the predicted spread being 1 mm along both axes."""
    count = len(error)
    spread = np.broadcast_to(1e-6 * np.eye(2), (count, 2, 2))
    told = np.ones(count, bool)
    path = np.zeros((count, 51, 2)) + np.arange(51)[:, None] / 1000
    return Replays(np.asarray(time), np.asarray(error), spread, told, path)


class Scripted:
    """In the place of a follower: has an alarm at the second time it is asked."""

    period = 0.002

    def __init__(self):
        self.result = Shadow(tests=None)
        self.asked = 0

    def take(self, rows):
        return True

    def ask(self, *, whole=False):
        self.asked += 1
        count = 10 * self.asked
        self.result.replays = replays(np.full((count, 2), 1e-3), np.arange(count))
        if self.asked == 2:
            self.result.alarms.append(Alarm(17.0, 17.0, 20.0, ()))
        if not whole:
            return []
        cause = Cause("level", 1.0, "phi +0.100 deg")
        self.result.alarms[0] = Alarm(17.0, 15.5, 20.0, (cause,))
        return self.result.alarms


def test_an_alarm_is_one_line_and_its_causes_are_one_when_they_are_settled():
    lines, drawn = [], []
    commentary = Commentary(Scripted(), lines.append)
    tell = lambda found, events: drawn.append((len(found.time), events))  # noqa: E731
    for _ in range(2):
        commentary.take({"time": np.zeros(1)}, tell)
    commentary.end(tell, 0)
    alarms = [line for line in lines if "alarm" in line]
    assert alarms == [
        "twin: alarm at 17.0 s: reality has left the model; causes at 33 s",
        "twin: alarm at 17.0 s, since about 15.5 s: level (phi +0.100 deg)",
    ]
    assert any("score 1.20 (1: as predicted), 100 % of 10 replays" in line for line in lines)
    assert [count for count, _ in drawn] == [10, 10, 10]  # every replay is drawn once
    assert [time for time, _ in drawn[1][1]] == [17.0]


def test_the_band_that_is_drawn_is_the_band_of_the_verdict():
    run = replays([[1e-3, 0.0], [2.4e-3, 0.0], [2.5e-3, 0.0]], [0.0, 1.0, 2.0])
    assert ((run.distance <= run.band) == (run.square <= CHI_SQUARE_95)).all()
    assert run.band == pytest.approx(np.sqrt(CHI_SQUARE_95) / 1000)  # in every direction
    batches = {each.entity: each for each in TwinStream("a", load("circle")).batches(run, [])}
    assert batches["/a/twin_error_mm/band"].time.tolist() == [1, 2, 3]
    ball = batches["/a/mechanism/cardan/plate/twin_ball"]
    assert ball.time[[0, 50, 51]] == pytest.approx([0.0, 1.0, 1.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The folder of a run that its twin was beside, and what was printed."""
    path = tmp_path_factory.mktemp("run") / "drifted"
    changes = [part for text in SETTINGS for part in ("--set", text)]
    done = CliRunner().invoke(
        run_command, ["excite", *changes, "--shadow", "--json", "--out", str(path)]
    )
    assert done.exit_code == 0, done.output
    return path, done


@pytest.mark.long
def test_a_run_beside_its_twin_leaves_what_the_twin_says_of_it_afterwards(folder, tmp_path):
    path, done = folder
    said = json.loads(done.stdout)["shadow"]
    assert said["alarms"][0]["causes"][0]["name"] == "rolling friction"
    again = CliRunner().invoke(shadow_command, [str(path), "--json", "--out", str(tmp_path)])
    afterwards = json.loads(again.stdout[again.stdout.index("{") :])
    differing = {name for name in said if said[name] != afterwards[name]}
    assert differing <= {"log"}
    assert (path / "shadow.html").is_file()


@pytest.mark.long
@pytest.mark.parametrize("noise_known", [True, False])
def test_what_is_said_while_a_run_goes_on_is_what_is_said_afterwards(
    folder, noise_known, monkeypatch, tmp_path
):
    path, _ = folder
    (recorded,) = open_run(path)
    scored = examine(path, tmp_path).replays
    if noise_known:  # what only the whole log tells
        sigma = prepare(read(path)).sigma
        monkeypatch.setattr(learning, "prepare", lambda log: replace(prepare(log), sigma=sigma))
    follower = follow.LiveFollower(recorded.scenario, "the run")
    rows = recorded.rows
    alarms = []
    for first in range(0, len(rows["time"]), 170):
        if follower.take({name: values[first : first + 170] for name, values in rows.items()}):
            alarms += follower.ask()
    alarms += follower.ask(whole=True)
    afterwards = json.loads((path / "shadow.json").read_text(encoding="utf-8"))
    live = follower.result.replays
    assert live.time == pytest.approx(scored.time)
    counted = live.counted
    assert counted.tolist() == scored.counted.tolist()
    expected = scored.score[counted]
    rel, least = (0.01, 0.005) if noise_known else (0.25, 0.06)
    assert live.score[counted] == pytest.approx(expected, rel=rel, abs=least)
    assert [alarm.time for alarm in alarms] == pytest.approx(
        [alarm["time"] for alarm in afterwards["alarms"]], abs=0.05
    )
    names = [alarm["causes"][0]["name"] for alarm in afterwards["alarms"]]
    assert [alarm.causes[0].name for alarm in alarms] == names


@pytest.mark.long
def test_a_twin_that_learns_beside_a_run_says_nothing_before_and_what_it_learned(folder):
    (recorded,) = open_run(folder[0])
    follower = follow.LiveFollower(recorded.scenario, "the run", learning=True)
    for first in range(0, len(recorded.rows["time"]), 500):
        rows = {name: values[first : first + 500] for name, values in recorded.rows.items()}
        if follower.take(rows):
            follower.ask()
        learned = rows["time"][-1] > follow.LEARNING_S + follow.PENDING_S + follow.STRIDE_S
        assert bool(follower.result.taught) >= learned
        assert rows["time"][-1] > follow.LEARNING_S or not follower.result.taught
    assert follower.result.replays.time[0] >= follow.LEARNING_S - 1.0


def test_a_new_window_that_ends_before_an_old_one_is_neither_dropped_nor_is_an_old_one_told_twice():
    first, second = (
        Evidence.of(("lag",), spans, np.zeros((len(spans), 1, 1)), np.zeros((len(spans), 1)))
        for spans in (np.array([[0.0, 1.0], [1.0, 3.0]]), np.array([[1.0, 2.0]]))
    )
    assert Evidence.concatenate([first, second]).end.tolist() == [1.0, 3.0, 2.0]
