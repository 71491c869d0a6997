"""The fault matrix can fail: without what a row relies on it turns bad, and for that reason.

A row that stays good without what it relies on proves nothing: one line of defence after the other
is taken away, and every row that relies on it must turn bad.
"""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass, replace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest

from controllers.arrays import Array
from twin.devices.akd import bringup
from twin.devices.akd.axis import Axis, AxisRequest
from twin.devices.akd.servos import AkdServos
from twin.emulator.drive import EmulatedDrive
from twin.hal.interface import Clamp
from twin.hal.supervisor import Supervisor
from twin.safety.case import FaultCase
from twin.safety.cases import AT_START, CASES
from twin.safety.reaction import Stopper
from twin.safety.row import FaultRow
from twin.safety.trial import Trial


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """One thing taken away.

    Attributes:
        name: What, in words.
        change: What is done to the program instead, in words.
        concerns: Which rows rely on it.
        apply: Takes it away while the context lasts.
        changed: The case that is carried out in place of a row's.
        key: What must be among the row's failures; empty for any.
    """

    name: str
    change: str
    concerns: Callable[[FaultCase], bool]
    apply: Callable[[], AbstractContextManager[Any]] = nullcontext
    changed: Callable[[FaultCase], FaultCase] = lambda case: case
    key: str = ""

    def noticed(self, row: FaultRow) -> bool:
        """Whether a row turned bad, for what it had to."""
        return self.key in row.failures if self.key else not row.good


def _relies(*stoppers: Stopper) -> Callable[[FaultCase], bool]:
    return lambda case: not set(stoppers).isdisjoint(case.stoppers)


def _no_quick_stop() -> AbstractContextManager[Any]:
    return patch.object(AkdServos, "quick_stop", lambda _: None)


def _close(servos: AkdServos) -> None:
    if servos._transport is not None:
        servos._transport.close()
        servos._transport = None


def _no_stop() -> AbstractContextManager[Any]:
    with ExitStack() as stack:
        stack.enter_context(_no_quick_stop())
        stack.enter_context(patch.object(AkdServos, "stop", _close))
        return stack.pop_all()


def _no_watch() -> AbstractContextManager[Any]:
    with ExitStack() as stack:
        for module in ("bringup", "sdo_poll"):
            stack.enter_context(patch(f"twin.devices.akd.{module}.monitoring", lambda _: 0))
        return stack.pop_all()


def _no_levelling() -> AbstractContextManager[Any]:
    def stay(_: Clamp, angle: Array) -> Array:
        return np.zeros_like(angle)

    return patch.object(Clamp, "towards_level", stay)


def _no_sto() -> AbstractContextManager[Any]:
    return patch.object(EmulatedDrive, "open_sto", lambda _: None)


def _other_reason(case: FaultCase) -> FaultCase:
    """The case with what is done in the next row of those that must be refused."""
    at = AT_START.index(case)
    return replace(case, act=AT_START[(at + 1) % len(AT_START)].act)


def _named(*names: str) -> Callable[[FaultCase], bool]:
    return lambda case: case.name in names


def _made(cls: type, change: Callable[[Any], None]) -> AbstractContextManager[Any]:
    """Objects of a class, changed as soon as they are made."""
    made = cls.__init__

    def init(self: Any, *arguments: Any, **more: Any) -> None:
        made(self, *arguments, **more)
        change(self)

    return patch.object(cls, "__init__", init)


def _supervised(name: str, instead: Callable[[Supervisor], Any]) -> AbstractContextManager[Any]:
    """Supervisors with another method or bounds, made of the object itself."""
    return _made(Supervisor, lambda self: setattr(self, name, instead(self)))


def _bounds(change: Callable[[Array], Array]) -> AbstractContextManager[Any]:
    return _supervised("_bounds", lambda self: change(self._bounds))


def _without_bound(at: int) -> Callable[[], AbstractContextManager[Any]]:
    return lambda: _bounds(lambda bounds: np.where(np.arange(4) == at, np.inf, bounds))


def _deaf(self: Supervisor) -> Callable[..., Any]:
    watch = type(self).watch
    return lambda y, touched: watch(self, y, np.ones_like(touched))


def _speed_along_x(self: Supervisor) -> Callable[..., Any]:
    watch = type(self)._watch_speed
    return lambda ball, touched: watch(self, ball * np.array([1.0, 0.0]), touched)


def _half_the_way() -> AbstractContextManager[Any]:
    def twice(clamp: Clamp) -> None:
        clamp._whole_way, clamp._per_angle = 2 * clamp._whole_way, 2 * clamp._per_angle

    return _made(Clamp, twice)


def _old_rate() -> AbstractContextManager[Any]:
    sent = Axis.next_rpdo1

    def next_rpdo1(self: Axis) -> bytes:
        data = sent(self)
        if self.request is AxisRequest.ENABLE:
            self.kept = data[2:]  # type: ignore[attr-defined]
        return data[:2] + getattr(self, "kept", data[2:])

    return patch.object(Axis, "next_rpdo1", next_rpdo1)


def _no_torque_limit() -> AbstractContextManager[Any]:
    written = bringup.Remote.write

    def write(self: Any, index: int, sub: int, value: int) -> Any:
        return None if index in {0x356E, 0x356F} else written(self, index, sub, value)

    return patch.object(bringup.Remote, "write", write)


OUTSIDE = (
    Mutation(
        name="area limits exchanged",
        change="the ball may be where y may along x, and the other way round",
        concerns=_named(
            "The ball is pushed out of its area along x",
            "The ball is pushed out of its area along y",
        ),
        apply=lambda: _bounds(lambda bounds: bounds[:, [2, 1, 0, 3]]),
    ),
    Mutation(
        name="angle bound on theta only",
        change="phi may be any",
        concerns=_named("The plate is turned past its limit by force, phi"),
        apply=_without_bound(1),
    ),
    Mutation(
        name="angle bound on phi only",
        change="theta may be any",
        concerns=_named("The plate is turned past its limit by force, theta"),
        apply=_without_bound(3),
    ),
    Mutation(
        name="lost after twice the time",
        change="the supervisor waits for the ball for 0.2 s",
        concerns=_named(
            "Supervisor alone: the screen says nothing any more, and waits for 1 s itself"
        ),
        apply=lambda: patch("twin.hal.supervisor.LOST_AFTER", 0.2),
    ),
    Mutation(
        name="a ball not felt is ignored",
        change="the supervisor takes every position for one that was felt",
        concerns=_named(
            "Supervisor alone: the screen says nothing any more, and waits for 1 s itself"
        ),
        apply=lambda: _supervised("watch", _deaf),
    ),
    Mutation(
        name="torque limit not written",
        change="356Eh and 356Fh stay as the drive has them, and are not read back",
        concerns=_named("The CAN adapter is pulled", "The ball is lifted (pen-up)"),
        apply=_no_torque_limit,
        key="held",
    ),
    Mutation(
        name="half of the braking way",
        change="the clamp counts on twice the acceleration",
        concerns=_named("The controller asks for the fastest turn for good"),
        apply=_half_the_way,
    ),
    Mutation(
        name="ball speed along x only",
        change="y may be as fast as it likes",
        concerns=_named("The ball is pushed too fast along y"),
        apply=lambda: _supervised("_watch_speed", _speed_along_x),
    ),
    Mutation(
        name="old rate kept in a fault",
        change="the drives are sent the last rate, not zero, until the bus is closed",
        concerns=_named(
            "Zero rate alone: the motor encoder jumps, and no quick stop reaches the drives"
        ),
        apply=_old_rate,
    ),
)
"""Changes of the supervisor and of the bring-up, with rows that rely on what they change."""

MUTATIONS = (
    Mutation(
        name="levelling removed",
        change="where the plate is to be levelled, the rate is zero",
        concerns=_relies(Stopper.LEVELLING),
        apply=_no_levelling,
    ),
    Mutation(
        name="quick stop removed",
        change="the host never requests a quick stop",
        concerns=_relies(Stopper.QUICK_STOP),
        apply=_no_quick_stop,
    ),
    Mutation(
        name="host stop removed",
        change="the host writes nothing to stop the drives; it closes the bus",
        concerns=_relies(Stopper.QUICK_STOP),
        apply=_no_stop,
    ),
    Mutation(
        name="heartbeat watch never written",
        change="1016h of the drives stays 0, and the host takes 0 for right when it asks",
        concerns=_relies(Stopper.HEARTBEAT),
        apply=_no_watch,
    ),
    Mutation(
        name="STO not wired",
        change="opening the input does nothing",
        concerns=_relies(Stopper.STO),
        apply=_no_sto,
    ),
    Mutation(
        name="refused for another reason",
        change="another row's fault is made before switching on: refused, but not for what is said",
        concerns=lambda case: case in AT_START,
        changed=_other_reason,
        key="reason",
    ),
    *OUTSIDE,
)
"""Every mutation, the lines of defence in their order."""

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
    ("quick stop removed", "Drive phi is in another mode", {*AT_REST, "torque_off"}),
    ("quick stop removed", "The motor encoder of drive phi jumps", {*AT_REST, "torque_off"}),
    ("quick stop removed", "The heartbeat of drive phi gets lost", {*AT_REST, "torque_off"}),
    ("quick stop removed", "Drive phi has no DC link", AT_REST),
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
    concerned = [case for case in CASES if mutation.concerns(case)]
    rows = [tried(case.name, mutation.name) for case in concerned]
    assert rows
    assert [row.name for row in rows if not mutation.noticed(row)] == []


def test_every_line_of_defence_can_be_taken_away_and_rows_rely_on_it():
    lines = [Stopper.LEVELLING, Stopper.QUICK_STOP, Stopper.HEARTBEAT, Stopper.STO]
    for line in lines:
        relying = [case for case in CASES if line in case.stoppers and not case.refused]
        assert len(relying) >= 2
        taken = [each for each in MUTATIONS if all(map(each.concerns, relying))]
        assert taken


def test_every_refusal_is_tried_for_another_reason():
    concerned = [case for case in CASES if BY_NAME["refused for another reason"].concerns(case)]
    assert concerned == list(AT_START)
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
        "held": True,
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
        ("held", False),
        ("whole", False),
        ("recovered", False),
    ],
)
def test_a_row_is_bad_for_each_thing_that_it_judges_alone(key, value):
    assert row().good
    bad = row(**{key: value})
    assert bad.failures == (key,)
    assert not bad.good
    unsafe = {"stopped_by", "state", "standstill", "torque_off", "tilt", "ball", "torque", "held"}
    assert bad.safe == (key not in unsafe)
    assert bad.as_dict()["failures"] == (key,)


def test_a_refusal_must_be_noticed_by_its_reason_and_not_by_something_else():
    mutation = BY_NAME["refused for another reason"]
    assert not mutation.noticed(row(name="late", detected=1.0))
    assert mutation.noticed(row(name="other", reason="drive fault"))
