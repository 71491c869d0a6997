"""One table of many runs, what each is beside what it gave; and the time it is said to take."""

import json

import pytest

from twin.run.batch import simulate
from twin.scenario import load
from twin.study import experiments, work
from twin.study.experiments import Store, evaluate
from twin.study.schema import METRICS
from twin.study.work import Job, ScenarioRuns


def scenarios():
    hold = ["plant.kind=lagrange", "duration=0.06"]
    kept = [load("hold", [*hold, f"plant.friction.rolling_mm={mm}"]) for mm in (0.1, 0.3)]
    return [*kept, load("hold", [*hold, "plant.start.x=0.34", "plant.start.x_rate=9"])]


LABELS = {"rig": [0, 1, 2], "task": ["one", "one", "flung"]}


@pytest.mark.parametrize("seen", [False, True])
def test_every_run_has_its_labels_and_what_it_gave_in_the_order_asked(tmp_path, seen):
    runs = ScenarioRuns(scenarios(), seen=seen)
    found = evaluate(runs, LABELS, Store(tmp_path), processes=1)
    assert list(found.columns) == ["rig", "task", "outcome", "reason", *METRICS]
    assert {name: found[name].tolist() for name in LABELS} == LABELS
    assert found["outcome"].tolist() == ["finished", "finished", "fell"]
    alone = [simulate([each], seen=seen)[0]["rms_error"] for each in scenarios()[:2]]
    assert found["rms_error"].tolist()[:2] == alone
    assert found["rms_error"].isna().tolist() == [False, False, True]


@pytest.mark.parametrize("in_memory", [False, True])
def test_a_run_that_is_kept_is_not_made_again_under_other_labels(tmp_path, monkeypatch, in_memory):
    store = Store(None if in_memory else tmp_path)
    first = evaluate(ScenarioRuns(scenarios()), LABELS, store, processes=1)
    monkeypatch.setattr(work, "simulate", None)
    again, kept = ScenarioRuns(scenarios()[::-1]), store if in_memory else Store(tmp_path)
    found = evaluate(again, {"candidate": [7, 8, 9]}, kept, processes=1)
    assert in_memory == (list(tmp_path.iterdir()) == [])
    assert found["candidate"].tolist() == [7, 8, 9]
    assert found["u_rms"].tolist()[1:] == first["u_rms"].tolist()[1::-1]
    assert found["outcome"].tolist() == first["outcome"].tolist()[::-1]


def test_what_the_rigs_computer_sees_is_another_run_than_the_truth():
    keys = [
        {task.key for task in ScenarioRuns(scenarios(), seen=seen).tasks} for seen in (False, True)
    ]
    assert not keys[0] & keys[1]


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
    monkeypatch.setattr(experiments, "perf_counter", lambda: clock.now)
    monkeypatch.setattr(experiments, "carry_out", clock.carry_out)
    return clock


def jobs(count):
    scenario = json.dumps({"duration": 20.0})
    empty = dict.fromkeys(Job._fields, "")
    return [Job(**{**empty, "scenario": scenario}) for _ in range(count)]


def test_a_run_takes_its_share_of_the_set_up_and_its_duration(clock):
    clock.setup, clock.each, clock.loading = 1.2, 0.05, 7.0
    assert experiments.seconds(jobs(4)) == pytest.approx(1.2 / 4 + 20 * 0.05)


def test_on_a_busy_machine_the_estimate_is_too_long_rather_than_negative(clock, monkeypatch):
    clock.setup, clock.each = 1.2, -1.0  # the longer batch took less
    assert 0 < experiments.seconds(jobs(1)) < 60
