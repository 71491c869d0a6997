"""`twin.scenario.load`: tables of a scenario for plates that follow late."""

import pytest

from twin.base.errors import ScenarioError
from twin.scenario.load import check, read, resolve

PID = {"controller": {"kind": "pid"}}


def resolved(lagging, *settings):
    tables, source = read("hold")
    return check(*resolve({**tables, "lagging": lagging}, source, settings))


@pytest.mark.parametrize(("lag", "kind"), [(0.0, "lqr"), (0.05, "lqr"), (0.06, "pid")])
def test_they_lie_over_its_own_above_their_lag_only(lag, kind):
    assert resolved({"above": 0.05, **PID}, ("rig.plate_lag", lag)).controller.kind == kind


def test_without_a_lag_of_their_own_every_lag_is_above():
    assert resolved(PID, ("rig.plate_lag", 0.001)).controller.kind == "pid"


def test_a_setting_lies_over_them():
    late = ("rig.plate_lag", 0.1)
    assert resolved(PID, late, ("controller.kind", "afl")).controller.kind == "afl"


@pytest.mark.parametrize(
    ("lagging", "words"),
    [
        (3, "lagging: must be a table of tables, got 3"),
        ({"above": "much"}, "lagging.above: must be a lag in s, got 'much'"),
        ({"above": -1.0}, "lagging.above: must be a lag in s, got -1.0"),
        ({"controler": {}}, "controler: unknown key"),
    ],
)
def test_a_mistake_in_them_is_one_line(lagging, words):
    with pytest.raises(ScenarioError, match=words):
        resolved(lagging, ("rig.plate_lag", 0.1))
