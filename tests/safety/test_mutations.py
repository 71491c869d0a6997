"""`twin.safety`.

The fault matrix can fail: without what a row relies on it turns bad, and for that reason.

A row that stays good without what it relies on proves nothing: one line of defence after the other
is taken away, and every row that relies on it must turn bad.
"""

from contextlib import ExitStack, nullcontext
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from twin.devices.akd.axis import Axis, AxisRequest
from twin.devices.akd.remote import Remote
from twin.devices.akd.servos import AkdServos
from twin.emulator.drive import EmulatedDrive
from twin.hal.interface import Clamp
from twin.hal.supervisor import Supervisor
from twin.safety.fault_row import FaultRow
from twin.safety.faults import CASE_GROUPS, CASES
from twin.safety.limits import Stopper
from twin.safety.trial import Trial

AT_START = CASE_GROUPS["at_start"]
CASE = {case.name: case for case in CASES}
ALONE = "Supervisor alone: the screen says nothing any more, and waits for 1 s itself"
OTHER = "refused for another reason"


def relies(stopper):
    return [case for case in CASES if stopper in case.stoppers]


def named(*names):
    return [CASE[name] for name in names]


def together(*patches):
    with ExitStack() as stack:
        for each in patches:
            stack.enter_context(each)
        return stack.pop_all()


def no_quick_stop():
    return patch.object(AkdServos, "quick_stop", lambda _: None)


def close(servos):
    if servos._transport is not None:
        servos._transport.close()
        servos._transport = None


def no_watch():
    modules = ("bringup", "servos")
    return together(*(patch(f"twin.devices.akd.{m}.monitoring", lambda _: 0) for m in modules))


def change_new_objects(cls, change):
    """Objects of a class, changed as soon as they are made."""
    make = cls.__init__

    def init(self, *arguments, **more):
        make(self, *arguments, **more)
        change(self)

    return patch.object(cls, "__init__", init)


def bounds(change):
    """Supervisors with other bounds, those that one rig alone is compared with included."""

    def changed(self):
        self._bounds = change(self._bounds)
        self._bounds_of_one = self._bounds[0].tolist()

    return change_new_objects(Supervisor, changed)


def without_bound(at):
    return bounds(lambda known: np.where(np.arange(4) == at, np.inf, known))


def watching(name, change):
    """Supervisors one of whose methods takes other arguments."""
    method = getattr(Supervisor, name)
    return patch.object(Supervisor, name, lambda self, *given: method(self, *change(*given)))


def half_the_way(clamp):
    clamp._whole_way, clamp._per_angle = 2 * clamp._whole_way, 2 * clamp._per_angle


def old_rate():
    sent = Axis.next_rpdo1

    def next_rpdo1(self):
        data = sent(self)
        if self.request is AxisRequest.ENABLE:
            self.kept = data[2:]
        return data[:2] + getattr(self, "kept", data[2:])

    return patch.object(Axis, "next_rpdo1", next_rpdo1)


def no_torque_limit():
    """356Eh and 356Fh stay as the drive has them, and are not read back."""
    written = Remote.write

    def write(self, index, sub, value):
        return None if index in {0x356E, 0x356F} else written(self, index, sub, value)

    return patch.object(Remote, "write", write)


MUTATIONS = {
    "levelling removed": (
        relies(Stopper.LEVELLING),
        lambda: patch.object(Clamp, "towards_level", lambda _, angle: np.zeros_like(angle)),
    ),
    "quick stop removed": (relies(Stopper.QUICK_STOP), no_quick_stop),
    "host stop removed": (
        relies(Stopper.QUICK_STOP),
        lambda: together(no_quick_stop(), patch.object(AkdServos, "stop", close)),
    ),
    "heartbeat watch never written": (relies(Stopper.HEARTBEAT), no_watch),
    "STO not wired": (
        relies(Stopper.STO),
        lambda: patch.object(EmulatedDrive, "open_sto", lambda _: None),
    ),
    OTHER: (AT_START, nullcontext),
    "area limits exchanged": (
        named(
            "The ball is pushed out of its area along x",
            "The ball is pushed out of its area along y",
        ),
        lambda: bounds(lambda known: known[:, [2, 1, 0, 3]]),
    ),
    "angle bound on theta only": (
        named("The plate is turned past its limit by force, phi"),
        lambda: without_bound(1),
    ),
    "angle bound on phi only": (
        named("The plate is turned past its limit by force, theta"),
        lambda: without_bound(3),
    ),
    "lost after twice the time": (
        named(ALONE),
        lambda: patch("twin.hal.supervisor.BALL_LOST_AFTER_S", 0.2),
    ),
    "a ball not felt is ignored": (
        named(ALONE),
        lambda: watching("watch", lambda y, touched: (y, np.ones_like(touched))),
    ),
    "torque limit not written": (
        named("The CAN adapter is pulled", "The ball is lifted (pen-up)"),
        no_torque_limit,
    ),
    "half of the braking way": (
        named("The controller asks for the fastest turn for good"),
        lambda: change_new_objects(Clamp, half_the_way),
    ),
    "ball speed along x only": (
        named("The ball is pushed too fast along y"),
        lambda: watching("_watch_speed", lambda ball, felt: (ball * np.array([1.0, 0.0]), felt)),
    ),
    "old rate kept in a fault": (
        named("Zero rate alone: the motor encoder jumps, and no quick stop reaches the drives"),
        old_rate,
    ),
}
"""What is taken away: the rows that rely on it, and what takes it away while a context lasts."""
KEYS = {OTHER: "reason", "torque limit not written": "held"}
"""What must be among the failures of a row, where not anything will do."""

AT_REST = {"stopped_by", "state"}
TORQUE = {"torque_off", "torque"}
GOES_ON = {*AT_REST, *TORQUE, "standstill"}


@pytest.fixture
def early(monkeypatch):
    """The fault comes while the ball goes over to the circle: the plate turns quickly."""
    monkeypatch.setattr("twin.safety.trial.FAULT_BEGIN_S", 1.3)
    monkeypatch.setattr("twin.safety.trial.RUN_AFTER_S", 0.8)


def tried(case, mutation):
    """The row of a case without something; for another reason what is done is the next row's."""
    if mutation == OTHER:
        case = replace(case, act=AT_START[(AT_START.index(case) + 1) % len(AT_START)].act)
    with MUTATIONS[mutation][1]() if mutation else nullcontext():
        return Trial(case).row(recover=False)


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
QUICK = {12}


@pytest.mark.parametrize(
    ("mutation", "name", "failures"),
    [
        pytest.param(*each, marks=() if at in QUICK else pytest.mark.long, id=f"{each[0]}-{at}")
        for at, each in enumerate(WITHOUT)
    ],
)
def test_without_what_it_relies_on_a_row_is_bad_and_with_it_good(early, mutation, name, failures):
    assert failures <= set(tried(CASE[name], mutation).failures)
    assert tried(CASE[name], "").failures == ()


@pytest.mark.long
@pytest.mark.parametrize("mutation", MUTATIONS)
def test_every_row_that_relies_on_what_a_mutation_takes_away_turns_bad(mutation):
    rows = [tried(case, mutation) for case in MUTATIONS[mutation][0]]
    assert rows
    key = KEYS.get(mutation)
    noticed = [key in row.failures if key else not row.good for row in rows]
    assert [row.name for row, bad in zip(rows, noticed, strict=True) if not bad] == []


def test_rows_rely_on_every_line_of_defence():
    for line in (Stopper.LEVELLING, Stopper.QUICK_STOP, Stopper.HEARTBEAT, Stopper.STO):
        assert len([case for case in relies(line) if not case.refused]) >= 2


GOOD = FaultRow(
    name="row",
    condition="encoder jump",
    severity="stop",
    allowed=0.01,
    detected=0.006,
    ending="fault",
    line="encoder jump",
    whole=True,
    recovered=True,
    reason="encoder jump",
    reason_expected="encoder jump",
    stopped_by=("quick stop",) * 2,
    stopped_by_expected=("quick stop",) * 2,
    state=("off",) * 2,
    state_expected=("off",) * 2,
    standstill=0.02,
    standstill_limit=0.022,
    torque_off=0.022,
    torque_off_limit=0.026,
    tilt=0.03,
    tilt_limit=0.031,
    ball=(0.1, 0.05),
    ball_limit=(0.11, 0.06),
    ball_later=(0.3, 0.3),
    torque=False,
    held=True,
    says=True,
)
"""A row of a stop."""


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
    assert GOOD.good
    bad = replace(GOOD, **{key: value})
    assert bad.failures == (key,)
    assert not bad.good
    unsafe = {"stopped_by", "state", "standstill", "torque_off", "tilt", "ball", "torque", "held"}
    assert bad.safe == (key not in unsafe)
    assert bad.as_dict()["failures"] == (key,)
