"""`ballplate.rehearsing`: a rig runs what its twin has kept the ball in; else what would do."""

import json

import numpy as np
import pytest

import ballplate as bp
from ballplate import rehearsing
from ballplate.changes import changes_of
from ballplate.rehearsing import rehearse
from ballplate.reporter import Reporter
from twin.base.errors import RigError
from twin.run.finished import run
from twin.scenario import load
from twin.scenario.schema import at_study_step

LATE = ("parameters=hobby", "plant.servo.bandwidth_hz=2.27", "sensors.touch.dead_time=0.04")
"""The board of a person who tried it: servos of 70 ms, a picture of 40 ms."""


def tried(*settings):
    rehearse("excite", changes_of(settings, {}), Reporter(), "rig.toml")


def test_a_plate_that_follows_late_is_led_by_a_law_that_knows_it():
    assert load("excite").controller.kind == "afl"
    late = load("excite", ["parameters=hobby"])
    assert (late.controller.kind, late.rig.plate_lag) == ("stable_inversion", 0.06)
    assert late.observer.kind == "friction_map_kalman"
    assert load("excite", ["parameters=course"]).controller.kind == "afl"  # 40 ms
    own = load("excite", ["parameters=hobby", "controller={kind='afl', gains=[20,24,18,6]}"])
    assert (own.controller.kind, own.controller.gains) == ("afl", [20, 24, 18, 6])


def test_a_lost_ball_is_refused_with_the_first_change_that_keeps_it(monkeypatch):
    asked = []

    def lost(scenario):
        asked.append(scenario)
        return "" if scenario.rig.plate_lag else "the run ends after 3.9 s, fell: off the plate"

    monkeypatch.setattr(rehearsing, "_lost", lost)
    with pytest.raises(RigError) as refused:
        tried(*LATE, "rig.plate_lag=0.0")
    assert str(refused.value) == (
        "on rig.toml: on the twin of this rig the run ends after 3.9 s, fell: off the plate; it "
        "stays with rig.plate_lag=0.07"
    )
    assert [each.controller.kind for each in asked] == ["afl", "stable_inversion"]


def test_where_nothing_keeps_it_a_slower_law_is_named(monkeypatch):
    monkeypatch.setattr(rehearsing, "_lost", lambda _: "the law fails")
    with pytest.raises(RigError, match="the law fails; a slower law or a smaller reference may"):
        tried("parameters=hobby")


@pytest.mark.real_time
def test_a_rig_rehearses_what_says_so_and_nothing_else(monkeypatch, tmp_path):
    tries = []
    monkeypatch.setattr("ballplate.running.rehearse", lambda *given: tries.append(given[-1]))
    file = tmp_path / "rig.toml"
    (tmp_path / "mine.py").write_text(
        "from ballplate.hardware import Hardware, Reading\n"
        "class B(Hardware):\n"
        "  measure = lambda self: Reading(0.0, 0.0, self.time())\n"
        "  start = command = stop = lambda *_: None\n"
    )
    file.write_text('backend = "mine.py:B"\n')
    for scenario in ("hold", "excite"):
        bp.run(scenario, on=str(file), duration=0.01)
    assert tries == [str(file)]


@pytest.mark.long
@pytest.mark.parametrize("rig", ["hobby", "course", "three_legs", "balancer"])
def test_the_shipped_rigs_are_excited_by_the_scenario_as_it_is(rig):
    tried(f"parameters={rig}")


@pytest.mark.long
def test_the_gains_of_the_thesis_are_refused_on_a_late_rig_and_its_lag_would_do():
    with pytest.raises(RigError, match=r"the run ends after [\d.]+ s.*; it stays with rig.plate"):
        tried(*LATE, "rig.plate_lag=0.0")


DRAWN = 12
"""Drawn rigs about each shipped one."""


@pytest.mark.long
@pytest.mark.parametrize("rig", ["hobby", "course", "three_legs", "balancer"])
def test_the_ball_stays_on_drawn_rigs_and_moves_enough_to_be_identified(rig):
    """Of each 12 rigs about a shipped one, their owner knows what its file says."""
    base = [f"parameters={rig}"]
    lost, rolled = [], []
    for number, drawn in enumerate(own_rigs(rig)):
        given = [f"{key}={json.dumps(value)}" for key, value in drawn.items()]
        done = run(at_study_step(load("excite", [*base, *given, "duration=30"])))
        if done.outcome != "finished":
            lost.append((number, done.metrics["reason"]))
            continue
        speed = np.hypot(*np.gradient(done.motion.ball, done.scenario.rig.period, axis=0).T)
        rolled.append(done.scenario.rig.period * int((speed > 0.01).sum()))
    assert lost == []
    assert min(rolled) > 5.0  # s; what identify asks for


def own_rigs(rig):
    """Settings of rigs about a shipped one."""
    from twin.study.schema import draw_rigs, read_family
    from twin.study.work import Builder

    family, builder = read_family("own"), Builder("excite")
    relative = {key for key, each in family.parameters.items() if each.relative}
    for each in draw_rigs(family, 7, DRAWN):
        whole = builder.whole_keys((f"parameters={rig}",), each.point, relative)
        yield {**whole, "seed": each.seed}
