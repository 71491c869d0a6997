"""`twin.study.compiled`: The page of the record's rig measures what it says, on such rigs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from docs import cyberrunner as page
from twin.run.metrics import Motion
from twin.run.plants import build_friction
from twin.scenario.load import load
from twin.study.schema import read_family

PLAN = page.planned("cyberrunner")


def tilt_at_which_a_ball_rolls(scenario, age):
    """Degrees of tilt at which gravity just overcomes the friction of a contact of an age."""
    friction, model = build_friction([scenario]), scenario.plant.model
    taken = friction.deceleration(model, np.zeros(8), np.array(age))
    relative = friction.map(np.zeros(2))[0]
    return float(np.degrees(np.arcsin(taken / relative / (5 / 7 * model.gravity))))


def test_friction_of_the_shipped_rig_is_what_was_measured_in_degrees():
    shipped = load("hold", ["parameters=cyberrunner"])
    assert 0.3 <= tilt_at_which_a_ball_rolls(shipped, 0.0) <= 0.6
    assert 1.5 <= tilt_at_which_a_ball_rolls(shipped, 1.0) <= 2.4
    arms = read_family("cyberrunner").parameters["plant.friction.rolling_mm"].uniform
    ends = [load("hold", ["parameters=cyberrunner", f"{arm}"]) for arm in (
        f"plant.friction.rolling_mm={arms[0]}", f"plant.friction.rolling_mm={arms[1]}",
    )]  # fmt: skip
    assert [tilt_at_which_a_ball_rolls(each, 0.0) for each in ends] == pytest.approx(
        [0.3, 0.6], abs=0.005
    )


def circling(radius, behind):
    """A ball on a circle of a radius in m, an angle in rad behind a reference of 40 mm."""
    time = np.arange(0, 8, 0.002)
    turn = 2 * np.pi * time / 8
    paths = [
        r * np.stack((np.cos(turn - late), np.sin(turn - late)), axis=-1)
        for r, late in ((radius, behind), (0.04, 0.0))
    ]
    ball, reference = paths
    return Motion(time=time, ball=ball, plate=0 * ball, u=0 * ball, reference=reference)


def test_a_ball_late_on_the_path_is_on_the_path_but_behind():
    late = circling(0.04, 0.1)
    every = np.ones(len(late.time), bool)
    found = page.errors(late, every, late.reference)
    assert found["largest"] < 3e-5  # half of the way of a period
    assert found["rms"] == pytest.approx(0.08 * np.sin(0.05), rel=1e-9)  # a chord
    wide = circling(0.043, 0.0)
    found = page.errors(wide, every, wide.reference)
    assert [found[name] for name in ("median", "p90", "largest", "rms")] == pytest.approx(
        [0.003] * 4, abs=1e-6
    )


def test_laps_are_those_of_the_shape_and_a_lost_ball_has_none(monkeypatch):
    away = circling(0.04, 0.0)
    ball = away.ball + np.where(away.time >= 4, 0.005, 0.0)[:, None] * away.ball / 0.04
    monkeypatch.setattr(page, "LAPS", {"first": 0, "third": 2})
    monkeypatch.setattr(page, "motions_of", iter)
    run = replace(away, ball=ball)
    found = page.followed([run, None], {"start": 1.0, "lap": 1.0})
    assert [each["median"] for each in found["first"]] == [pytest.approx(0, abs=1e-9), None]
    found = page.followed([run], {"start": 3.0, "lap": 1.0})
    assert found["first"][0]["median"] == pytest.approx(0, abs=1e-9)
    assert found["third"][0]["rms"] == pytest.approx(0.005, rel=1e-6)


def test_what_is_turned_off_gives_way_to_no_rig():
    rigs = page.drawn(PLAN, PLAN["draw"], 2)
    (cure,) = [law for law in PLAN["laws"] if law["name"] == page.CURE]
    assert rigs[0][0]["plant.surface.slope_deg"] > 0
    for cause, keys in PLAN["causes"].items():
        runs = page.scenarios(PLAN, cure, [*PLAN["hold"]["set"], *keys], rigs)
        for run in runs:
            assert run.plant.ball.radius == 0.0065
            given = run.model_dump(mode="json")
            for key in keys:
                name, _, value = key.partition("=")
                at = given
                for part in name.split("."):
                    at = at[part]
                assert np.all(np.equal(at, float(value))), cause


def test_what_is_kept_is_of_the_functions_that_made_it(monkeypatch):
    keys = []
    monkeypatch.setattr(page, "kept", lambda _, key, make: keys.append(key))
    for change in (None, "held", "motions_of"):
        with monkeypatch.context() as changed:
            if change:
                changed.setattr(page, change, page.errors)
            page.known("hold", [], page.held, 10.0)
    assert len(set(keys)) == 3


@pytest.mark.long
def test_the_best_gains_are_those_of_no_lost_ball_and_least_error(monkeypatch):
    asked = []

    def kept(name, runs, make, *how):
        asked.append((name, len(runs), *how))
        costs = [0.02] * how[0]
        costs[3], costs[5] = None, 0.01
        return costs

    monkeypatch.setattr(page, "known", kept)
    how = PLAN["search"]
    law = page.with_gains(PLAN, PLAN["laws"][1])
    assert asked == [("search", how["candidates"] * how["rigs"], how["candidates"], 6.284)]
    assert (law["lost"], law["cost"]) == (1, 0.01)
    assert law["found"] in law["set"][0]
    rng = np.random.default_rng(how["seed"])
    ranges = [np.log(ends) for ends in PLAN["laws"][1]["gains"].values()]
    drawn = [[np.exp(rng.uniform(*ends)) for ends in ranges] for _ in range(6)][5]
    assert law["found"] == f"rho={drawn[0]:.4g},kappa={drawn[1]:.4g}"
    assert page.with_gains(PLAN, PLAN["laws"][2]) == PLAN["laws"][2]


def test_rows_count_a_lost_ball_as_worst():
    good = {"median": 0.002, "p90": 0.004, "largest": 0.006, "rms": 0.005}
    rows = [good, good | {"median": 0.004}, page.errors(None, None, None)]
    cells = ("PID", "4.0", "-", "4.0", "6.0", "5.0", "1 of 3", "1")
    assert page.row("PID", rows, 3.2) == cells
