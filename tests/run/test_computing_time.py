"""`twin.run.loop`.

A law that takes its time: what that costs, told alike however long it is said to take."""

import time
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
import pytest

import ballplate
from controllers import catalog
from controllers.classical import LQR
from twin.run.controller_building import build_controller
from twin.run.loop import simulate
from twin.run.tables import FIRST_LABELS, indicators
from twin.scenario import load

SETTINGS = {"plant.kind": "lagrange", "plant.start.x": 0.05, "duration": 1.2, "metrics.start": 0}


@dataclass(frozen=True, kw_only=True)
class Sleeping(LQR):
    """Takes 5 ms and a little more, by the clock."""

    name: ClassVar[str] = "sleeping"

    def command(self, now):
        time.sleep(0.005)
        return super().command(now)


@pytest.fixture(autouse=True, scope="module")
def laws():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalog, "_registered", {"sleeping": Sleeping})
        catalog.forget()
        yield
    catalog.forget()


def run(**settings):
    keys = {key.replace("__", "."): value for key, value in settings.items()}
    return ballplate.run("hold", {**SETTINGS, "controller.rho": 30000, **keys})


def test_what_the_clock_says_costs_what_the_same_number_costs(monkeypatch):
    """A clock that only the law's sleep moves, so that no other program on the machine is in it."""
    now = [7.0]
    monkeypatch.setattr("controllers.controller.perf_counter", lambda: now[0])
    monkeypatch.setattr(time, "sleep", lambda seconds: now.__setitem__(0, now[0] + seconds))
    number = run(controller__kind="lqr", controller__computing_time=0.005)
    slept = run(controller__kind="sleeping", controller__computing_time="measured")
    assert list(slept) == list(number)
    for name in number:
        np.testing.assert_allclose(slept[name], number[name], rtol=0, atol=1e-12, err_msg=name)


def test_a_law_that_sleeps_is_late_only_where_its_time_is_measured():
    slept = run(controller__kind="sleeping", controller__computing_time="measured", duration=0.1)
    assert np.nanmin(slept["computing_time"]) >= 0.005
    assert slept.metrics["late_percent"] == 100
    prompt = run(controller__kind="lqr", duration=0.1)
    assert prompt.metrics["late_percent"] is None
    unmeasured = run(controller__kind="sleeping", duration=0.1)
    np.testing.assert_array_equal(unmeasured["true_x"], prompt["true_x"])


def test_rigs_of_a_batch_have_each_their_own_and_measuring_is_for_one_alone():
    keys = [f"{key}={value}" for key, value in SETTINGS.items() if key != "duration"]
    times = (0, 0.001, 0.005, 0.03)
    each = [
        load("hold", [*keys, "duration=0.4", f"controller.computing_time={time}"]) for time in times
    ]
    found = simulate(each)
    assert [one["late_percent"] for one in found] == [None, 0, 100, 100]
    assert found[0]["rms_error"] == found[1]["rms_error"]
    assert len({one["rms_error"] for one in found}) == 3
    assert simulate(each[2:3]) == found[2:3]
    measured = load("hold", [*keys, 'controller.computing_time="measured"'])
    assert build_controller(measured).timed
    with pytest.raises(
        ballplate.TwinError, match="computing_time: 'measured' works for a single run"
    ):
        ballplate.rig(["hold"] * 2, {**SETTINGS, "controller.computing_time": "measured"})


def test_what_time_passes_by_itself_takes_none_besides():
    late = load("circle", ["controller.computing_time=0.03"])
    assert late.without_computing_time == load("circle", [])
    assert not hasattr(build_controller(late.without_computing_time).law, "computing_time")


def test_compare_has_a_column_where_a_command_was_late():
    prompt, in_time, late = (
        run(controller__kind="lqr", controller__computing_time=time, duration=0.1).summary()
        for time in (0, 0.001, 0.005)
    )
    assert in_time["late_percent"] == 0
    for other, there in ((late, True), (in_time, False)):
        found = indicators("", {"prompt": prompt, "other": other}, FIRST_LABELS)
        assert ("late commands" in {row[0] for row in found.rows}) is there


@dataclass(frozen=True, kw_only=True)
class Alone(ballplate.laws.Law):
    """Has no linearisation, and a plan with something of a compiled library in it."""

    name: ClassVar[str] = "alone"

    def start(self, x, reference, period):
        return [memoryview(b"compiled")]

    def command(self, now):
        return -50 * now.x[..., 2::4] - 14 * now.x[..., 3::4]


@pytest.mark.long
def test_a_law_that_acts_by_command_alone_may_take_its_time():
    """Neither the warning of a linear loop nor a snapshot asks it for what it has not."""
    keys = {"controller.computing_time": 0.005, "controller.period": 0.01, "duration": 5.1}
    assert ballplate.run("hold", {"controller": Alone(), **SETTINGS, **keys}).finished
