"""`twin.shadow.evidence`: What is missing or late in a log is shown, and is evidence of nothing."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.scenario import load
from twin.shadow.belief import belief_of, logs
from twin.shadow.evidence import clear, gaps
from twin.shadow.follow import shadow

PERIOD = 0.002


@pytest.fixture(scope="module")
def recorded():
    common = ("plant.kind=lagrange", "plant.step=0.002", "duration=10", "seed=5")
    belief = load("excite", common)
    ill = load("excite", (*common, "plant.level_deg=[0.5, 0.0]"))
    return logs([(belief, belief), (belief, ill)])


def late_from(log, since, every, by):
    """A log whose loop was late by some s in every so many rows, and says so in its time."""
    late = np.zeros(len(log.time))
    late[np.searchsorted(log.time, since) :: every] = by
    return replace(log, time=log.time + late)


def missing_from(log, since, every, rows):
    """A log in which some rows in a row are missing after every so many."""
    count = np.arange(len(log.time)) - np.searchsorted(log.time, since)
    return log.rows((count < 0) | (count % every >= rows))


def test_gaps_are_where_rows_are_missing_or_were_taken_late():
    chosen = load("hold", ("plant.kind=lagrange", "duration=0.5"))
    log = logs([(chosen, chosen)])[0].rows(np.r_[0:100, 103:200])
    assert gaps(log, PERIOD) == pytest.approx(np.array([[0.198, 0.206]]))
    late = np.zeros(len(log.time))
    late[[10, 150]] = 0.0004, 0.0012
    found = gaps(replace(log, late=late), PERIOD)
    assert found == pytest.approx(np.array([[0.198, 0.206], [0.306, 0.3072]]))


def test_a_span_is_clear_of_a_gap_only_once_it_is_felt_no_more():
    hole = np.array([[2.0, 2.1]])
    begin, end = np.array([0.0, 1.5, 2.05, 2.2, 3.2]), np.array([1.9, 2.01, 2.2, 3.0, 4.0])
    assert clear(begin, end, hole).tolist() == [True, False, False, True, True]
    assert clear(begin, end, hole, 1.0).tolist() == [True, False, False, False, True]
    assert clear(begin, end, np.zeros((0, 2))).all()


@pytest.mark.long
@pytest.mark.parametrize(
    "broken",
    [
        lambda log: missing_from(log, 3.0, 80, 4),
        lambda log: late_from(log, 3.0, 80, 0.0015),
        lambda log: replace(log, late=np.where(np.arange(len(log.time)) % 80, 0.0, 0.0015)),
    ],
    ids=["missing", "late by its time", "late by its lateness"],
)
def test_a_log_full_of_gaps_is_neither_healthy_nor_ill(recorded, broken):
    healthy, ill = recorded
    assert shadow(ill, belief_of(ill)).verdict == "alarm"
    for log in (healthy, ill):
        said = shadow(broken(log), belief_of(log))
        assert said.verdict == "cannot tell"
        assert len(said.gaps) > 40
        assert said.replays is not None
        run = said.replays
        told = run.time[run.counted]
        inside = (said.gaps[:, 0] > told[:, None]) & (said.gaps[:, 1] < told[:, None] + 1)
        assert not inside.any()
        assert said.tests.soft.end.max(initial=0.0) < 3.3


@pytest.mark.long
def test_a_few_missing_rows_leave_the_rest_of_a_log_its_say(recorded):
    healthy, ill = recorded
    for log, verdict in ((healthy, "healthy"), (ill, "alarm")):
        said = shadow(log.rows(np.r_[0:4900, 4903:5000]), belief_of(log))
        assert said.verdict == verdict
        assert len(said.gaps) == 1
