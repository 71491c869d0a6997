"""`ballplate.rehearsing`: a rig runs what its twin has kept the ball in; else what would do."""

import json
from functools import partial

import numpy as np
import pytest
from own_board import VirtualBoard, board, own_rig

import ballplate as bp
from ballplate import rehearsing
from ballplate.changes import changes_of
from ballplate.rehearsing import rehearse
from ballplate.reporter import Reporter
from twin.base.errors import RigError
from twin.run.connect import ComputingTime
from twin.run.controller_building import build_controller
from twin.run.finished import Run, run
from twin.run.loop import drive
from twin.run.record import Recorder
from twin.scenario import load
from twin.scenario.rig import check_rig, read_rig
from twin.scenario.schema import at_study_step

LATE = ("parameters=hobby", "plant.servo.bandwidth_hz=2.27", "sensors.touch.dead_time=0.04")
"""The board of a person who tried it: servos of 70 ms, a picture of 40 ms."""
WIDE = {"angle_deg": 12.0, "rate_deg": 120.0, "acceleration": 40.0}
"""Limits of a rig file that are no narrower than those of ``hobby``."""
LOGGED = (
    *("time", "measured_x", "measured_phi", "measured_y", "measured_theta"),
    *("age", "touched"),
)
"""Columns of a log of hardware of one's own."""


def tried(*settings, **limits):
    tables = {"backend": "board.py:Board", "limits": limits}  # servos and plate without cams
    rig = check_rig(tables, "rig.toml")
    rehearse("excite", changes_of(settings, {}), Reporter(), "rig.toml", rig)


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


def test_the_twin_keeps_to_the_limits_of_the_rig_file(monkeypatch):
    asked = []
    monkeypatch.setattr(rehearsing, "_lost", lambda each: asked.append(each) or "the law fails")
    with pytest.raises(RigError):
        tried(*LATE, "rig.limits.rate_deg=30", angle_deg=4.0, rate_deg=80.0)
    kept = [(each.rig.limits.angle_deg, each.rig.limits.rate_deg) for each in asked]
    assert len(kept) > 1  # what may keep the ball, too
    assert set(kept) == {(4.0, 30.0)}


def test_where_nothing_keeps_it_a_slower_law_is_named(monkeypatch):
    monkeypatch.setattr(rehearsing, "_lost", lambda _: "the law fails")
    with pytest.raises(RigError, match="the law fails; a slower law or a smaller reference may"):
        tried("parameters=hobby")


@pytest.mark.real_time
def test_a_rig_rehearses_what_says_so_and_nothing_else(monkeypatch, tmp_path):
    tries = []
    monkeypatch.setattr("ballplate.running.rehearse", lambda *given: tries.append(given[-2:]))
    brief = partial(ComputingTime.measured, seconds=0.05)
    monkeypatch.setattr(ComputingTime, "measured", brief)
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
    assert tries == [(str(file), read_rig(file))]


@pytest.mark.long
@pytest.mark.parametrize("rig", ["hobby", "course", "three_legs", "balancer"])
def test_the_shipped_rigs_are_excited_by_the_scenario_as_it_is(rig):
    tried(f"parameters={rig}")


@pytest.mark.long
def test_the_gains_of_the_thesis_are_refused_on_a_late_rig_and_its_lag_would_do():
    with pytest.raises(RigError, match=r"the run ends after [\d.]+ s.*; it stays with rig.plate"):
        tried(*LATE, "rig.plate_lag=0.0", **WIDE)


@pytest.mark.long
def test_the_emulated_board_is_excited_and_identified_in_virtual_time(tmp_path):
    """The board is written without the twin; its numbers are the truth."""
    scenario = load("excite", ["parameters=hobby", "duration=40"])
    hardware = VirtualBoard(encoder=False, lag=board.LAG, late=board.LATE, noise=board.NOISE)
    rig = own_rig(hardware, scenario, plate_lag=board.LAG, steep_deg=0.8)
    controller = build_controller(scenario.in_real_time)
    periods, knows = round(40 / rig.period), controller.observer.knows
    record = Recorder(periods, 1, rig.period, rig.channels, knows)
    (outcome,) = drive(rig, controller, 40, record)
    assert outcome.ending == "finished"
    rows = Run.of(scenario, record, outcome, controller.reference).rows
    log = np.column_stack([rows[name] for name in LOGGED])
    np.savetxt(tmp_path / "log.csv", log, delimiter=",", header=",".join(LOGGED), comments="")
    columns = ",".join(f"{name}={name}" for name in LOGGED)
    found = bp.identify(tmp_path / "log.csv", columns=columns, on="hobby").found
    settings = found.settings({"identified"})
    arm_mm = 1000 * board.FRICTION / board.HOLLOW * 0.02
    assert float(settings["plant.friction.rolling_mm"].split()[0]) == pytest.approx(arm_mm, rel=0.1)
    assert float(settings["predictor.delay"].split()[0]) == pytest.approx(board.LATE, abs=0.02)


DRAWN = 5
"""Drawn rigs about each shipped one."""


@pytest.mark.long
@pytest.mark.parametrize("rig", ["hobby", "course", "three_legs", "balancer"])
def test_the_ball_stays_on_drawn_rigs_and_moves_enough_to_be_identified(rig):
    """Of 5 rigs about each shipped one, their owner knows what its file says."""
    base = [f"parameters={rig}"]
    lost, rolled = [], []
    for number, drawn in enumerate(own_rigs(rig)):
        given = [f"{key}={json.dumps(value)}" for key, value in drawn.items()]
        done = run(at_study_step(load("excite", [*base, *given, "duration=30"])))
        if done.outcome != "finished":
            lost.append((number, done.metrics["reason"]))
            continue
        speed = np.hypot(*np.gradient(done.motion.ball, done.scenario.rig.period, axis=0).T)
        rolled.append(done.scenario.rig.period * int((speed > 0.005).sum()))
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
