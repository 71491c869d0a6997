"""The time that a study is said to take."""

import json

import pytest

from twin.study import experiments as pilot
from twin.study.work import Job


@pytest.fixture
def clock(monkeypatch):
    """A clock and runs whose set-up and simulated second take so long; loading only once."""

    class Clock:
        now, setup, each, loading = 0.0, 0.0, 0.0, 0.0

        def carry_out(self, chunk):
            length = json.loads(chunk[0].scenario)["duration"]
            self.now += self.loading + self.setup + self.each * length * len(chunk)
            self.loading = 0.0

    clock = Clock()
    monkeypatch.setattr(pilot, "perf_counter", lambda: clock.now)
    monkeypatch.setattr(pilot, "carry_out", clock.carry_out)
    return clock


def jobs(count):
    scenario = json.dumps({"duration": 20.0})
    empty = dict.fromkeys(Job._fields, "")
    return [Job(**{**empty, "scenario": scenario}) for _ in range(count)]


def test_a_run_takes_its_share_of_the_set_up_and_its_duration(clock):
    clock.setup, clock.each, clock.loading = 1.2, 0.05, 7.0
    assert pilot.seconds(jobs(4)) == pytest.approx(1.2 / 4 + 20 * 0.05)


def test_on_a_busy_machine_the_estimate_is_too_long_rather_than_negative(clock, monkeypatch):
    clock.setup, clock.each = 1.2, -1.0  # the longer batch took less
    assert 0 < pilot.seconds(jobs(1)) < 60
