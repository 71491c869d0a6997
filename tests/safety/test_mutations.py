"""The fault matrix can fail: without what a row relies on it turns bad, and for that reason."""

from contextlib import nullcontext
from dataclasses import replace

import pytest

from twin.safety.cases import CASES
from twin.safety.mutations import MUTATIONS, MutationResult, jobs, judged, run_mutated
from twin.safety.reaction import Stopper
from twin.safety.row import FaultRow
from twin.safety.trial import Trial

BY_NAME = {mutation.name: mutation for mutation in MUTATIONS}
CASE = {case.name: case for case in CASES}
AT_REST = {"stopped_by", "state"}
TORQUE = {"torque_off", "torque"}
GOES_ON = {*AT_REST, *TORQUE, "standstill"}


@pytest.fixture
def early(monkeypatch):
    """The fault comes while the ball goes over to the circle: the plate turns quickly."""
    monkeypatch.setattr("twin.safety.trial.BEGIN", 1.3)
    monkeypatch.setattr("twin.safety.trial.AFTER", 0.8)


def tried(name, mutation):
    case, known = CASE[name], BY_NAME.get(mutation)
    with known.apply() if known else nullcontext():
        changed = known.changed(case) if known else case
        return Trial(changed).row(recover=False)


# The first four of "quick stop removed" and the first three of "host stop removed" are rows that
# stay good in both where only the motors' rates are looked at, long after.
WITHOUT = [
    ("quick stop removed", "Drive phi is in another mode", AT_REST | TORQUE),
    ("quick stop removed", "The motor encoder of drive phi jumps", AT_REST | TORQUE),
    ("quick stop removed", "The heartbeat of drive phi gets lost", AT_REST | TORQUE),
    ("quick stop removed", "Drive phi has no DC link", AT_REST | TORQUE),
    ("quick stop removed", "Drive phi runs the wrong way", {*AT_REST, "standstill"}),
    ("host stop removed", "Drive phi is in another mode", {*AT_REST, "torque_off"}),
    ("host stop removed", "The motor encoder of drive phi jumps", {*AT_REST, "torque_off"}),
    ("host stop removed", "Drive phi runs the wrong way", {*AT_REST, "standstill", "tilt"}),
    ("heartbeat watch never written", "The CAN adapter is pulled", GOES_ON),
    ("refused for another reason", "STO is open", {"reason", "line", "state"}),
    ("levelling removed", "The touch screen is unplugged", {*AT_REST, "standstill"}),
    ("STO not wired", "The STO input of drive phi opens", {"detected", "reason", "stopped_by"}),
    ("refused for another reason", "Drive theta is absent", {"reason"}),
]
QUICK = {8, 12}


@pytest.mark.parametrize(
    ("mutation", "name", "failures"),
    [
        pytest.param(*each, marks=() if at in QUICK else pytest.mark.long, id=f"{each[0]}-{at}")
        for at, each in enumerate(WITHOUT)
    ],
)
def test_without_what_it_relies_on_a_row_is_bad_and_with_it_good(early, mutation, name, failures):
    assert failures <= set(tried(name, mutation).failures)
    assert tried(name, "").failures == ()


@pytest.mark.long
@pytest.mark.parametrize("mutation", MUTATIONS, ids=[each.name for each in MUTATIONS])
def test_every_row_that_relies_on_what_a_mutation_takes_away_turns_bad(mutation):
    rows = [run_mutated(job) for job in jobs((mutation,))]
    result = judged(mutation, rows)
    assert result.unnoticed == ()
    assert result.noticed


def test_every_line_of_defence_can_be_taken_away_and_rows_rely_on_it():
    lines = [Stopper.LEVELLING, Stopper.QUICK_STOP, Stopper.HEARTBEAT, Stopper.STO]
    for line in lines:
        relying = [case for case in CASES if line in case.stoppers and not case.refused]
        assert len(relying) >= 2
        taken = [each for each in MUTATIONS if all(map(each.concerns, relying))]
        assert taken


def test_every_refusal_is_tried_for_another_reason():
    concerned = [case for case in CASES if BY_NAME["refused for another reason"].concerns(case)]
    assert concerned == [case for case in CASES if case.before and case.expected]
    changed = [BY_NAME["refused for another reason"].changed(case) for case in concerned]
    assert {each.act for each in changed} == {case.act for case in concerned}
    for case, other in zip(concerned, changed, strict=True):
        assert other == replace(case, act=other.act)
        assert other.act is not case.act


def row(**more):
    """A good row of a stop, changed."""
    fields = {
        "name": "row",
        "condition": "encoder jump",
        "severity": "stop",
        "allowed": 0.01,
        "detected": 0.006,
        "ending": "fault",
        "line": "encoder jump",
        "whole": True,
        "recovered": True,
        "reason": "encoder jump",
        "reason_expected": "encoder jump",
        "stopped_by": ("quick stop",) * 2,
        "stopped_by_expected": ("quick stop",) * 2,
        "state": ("off",) * 2,
        "state_expected": ("off",) * 2,
        "standstill": 0.02,
        "standstill_limit": 0.022,
        "torque_off": 0.022,
        "torque_off_limit": 0.026,
        "tilt": 0.03,
        "tilt_limit": 0.031,
        "ball": (0.1, 0.05),
        "ball_limit": (0.11, 0.06),
        "ball_later": (0.3, 0.3),
        "torque": False,
        "says": True,
        "why": {},
    }
    return FaultRow(**{**fields, **more})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("detected", 0.011),
        ("detected", None),
        ("reason", "drive fault"),
        ("stopped_by", ("quick stop", "nobody")),
        ("state", ("on", "off")),
        ("standstill", 0.023),
        ("standstill", None),
        ("torque_off", 0.03),
        ("torque_off", None),
        ("tilt", 0.032),
        ("ball", (0.1, 0.07)),
        ("torque", True),
        ("whole", False),
        ("recovered", False),
    ],
)
def test_a_row_is_bad_for_each_thing_that_it_judges_alone(key, value):
    assert row().good
    bad = row(**{key: value})
    assert bad.failures == (key,)
    assert not bad.good
    unsafe = {"stopped_by", "state", "standstill", "torque_off", "tilt", "ball", "torque"}
    assert bad.safe == (key not in unsafe)
    assert bad.as_dict()["failures"] == (key,)


def test_a_refusal_must_be_noticed_by_its_reason_and_not_by_something_else():
    mutation = BY_NAME["refused for another reason"]
    late, other = row(name="late", detected=1.0), row(name="other", reason="drive fault")
    result = judged(mutation, [late, other])
    assert result.rows == {"other": ("reason",)}
    assert result.unnoticed == ("late",)
    assert not result.noticed


def test_a_mutation_that_concerns_no_row_is_not_noticed():
    assert not MutationResult("none", "", {}, ()).noticed
