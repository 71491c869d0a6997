"""`twin.tune.search`.

The search on a formula instead of runs: it finds what is known, and keeps what it must."""

import numpy as np
import pytest

from controllers.analysis import margins, sampled_loop, unstable
from controllers.classical import AFL, LQR, SlidingMode
from controllers.observers import Kalman, Luenberger
from controllers.smith import Smith
from twin.run.controller_building import build_controller
from twin.scenario import load
from twin.tune.search import best_of, score, search_all, tail_mean
from twin.tune.trials import Indicators, NominalLoop, Tune, _loop, loop_margins

TABLES = {
    "title": "formula",
    "family": "uncertain",
    "fields": {
        "a": {"loguniform": [0.1, 100.0]},
        "b": {"uniform": [-5.0, 5.0]},
        "c": {"values": ["off", "on"]},
    },
    "tasks": [{"name": "one", "scenario": "circle", "scale": 1.0}],
    "rigs": [4, 8, 16],
    "candidates": 96,
    "round": 8,
}
OPTIMUM = {"a": 3.0, "b": 1.0, "c": "on"}


class Formula:
    """Cost (ln a/3)^2 + (b - 1)^2 + 2 [c is off], raised by each rig's own number.

    Effort is a; the loop has its margin where b is below 4; rig 13 is lost where a is above 20.
    """

    def __init__(self, **changed):
        self.tune = Tune.model_validate(TABLES | changed)
        self.start = {"a": 50.0, "b": -4.0, "c": "off"}
        self.rigs = np.random.default_rng(0).uniform(1, 2, 64)
        self.asked = []

    def loops(self, candidates):
        return [NominalLoop(0.5 if point["b"] < 4 else 0.1, 0.1) for point in candidates]

    def indicators(self, wanted, draw, on):
        self.asked += [(draw, count) for _, count in wanted]
        found = []
        for point, count in wanted:
            values = (
                0.1 + cost(point["a"], point["b"], point["c"] == "off") * self.rigs[:count, None]
            )
            if point["a"] > 20 and count > 13:
                values[13] = np.nan
            effort = np.full_like(values, point["a"])
            found.append(Indicators(values, effort, ()))
        return found


@pytest.fixture(scope="module")
def free():
    formula = Formula(limits={"effort": 1000.0})
    return formula, search_all(formula)


def cost(a, b, off):
    return np.log(a / 3) ** 2 + (b - 1) ** 2 + 2 * off


def test_a_known_optimum_is_found(free):
    formula, candidates = free
    (best,) = best_of(candidates, 1)
    assert best.fields["a"] == pytest.approx(OPTIMUM["a"], rel=0.35)
    assert best.fields["b"] == pytest.approx(OPTIMUM["b"], abs=0.5)
    assert best.fields["c"] == "on"
    worst = np.sort(formula.rigs[:16])[-2:]  # a tenth of 16 rigs: 1.6 of them
    assert (best.last.cost - 0.1) / (worst @ (0.6, 1.0) / 1.6) < 0.5


def test_the_search_is_better_than_as_many_random_candidates(free):
    _, candidates = free
    rng = np.random.default_rng(1)

    def random_best():
        count = sum(bool(each.scores) for each in candidates)
        a, b = 10 ** rng.uniform(-1, 2, count), rng.uniform(-5, 5, count)
        return cost(a, b, rng.random(count) < 0.5).min()

    (best,) = best_of(candidates, 1)
    a, b, c = best.fields.values()
    assert cost(a, b, c == "off") < np.median([random_best() for _ in range(200)])


@pytest.mark.long
def test_the_same_search_again_tries_the_same_candidates(free):
    _, candidates = free
    again = search_all(Formula(limits={"effort": 1000.0}))
    assert [each.as_dict() for each in again] == [each.as_dict() for each in candidates]


def test_the_beginning_is_tried_first_and_on_every_rung(free):
    formula, candidates = free
    assert candidates[0].fields == formula.start
    assert [each.rigs for each in candidates[0].scores] == [4, 8, 16]


def test_only_the_best_go_on_to_more_rigs_and_all_meet_the_draw_of_the_search(free):
    formula, candidates = free
    reached = [sum(len(each.scores) > rung for each in candidates) for rung in range(3)]
    assert reached[0] == 96
    assert reached[1] <= 96 / 2
    assert reached[2] <= reached[1] / 2
    assert {draw for draw, _ in formula.asked} == {formula.tune.draw}
    few = [each.scores[0].cost for each in candidates[1:] if len(each.scores) == 1]
    many = [each.scores[0].cost for each in candidates[1:] if len(each.scores) == 3]
    assert max(many) < np.median(few)


@pytest.mark.long
def test_constraints_bound_the_result_and_are_no_part_of_its_cost():
    formula = Formula(limits={"effort": 1.5})
    (best,) = best_of(search_all(formula), 1)
    assert best.last.kept
    assert 0.8 < best.fields["a"] <= 1.5
    found = formula.indicators([(best.fields, 16)], 1, ())[0]
    assert best.last.cost == tail_mean(found.values[:, 0], 0.1)


def test_optuna_is_told_what_violates_a_constraint_and_what_was_given_up(monkeypatch):
    import optuna

    create, studies = optuna.create_study, []
    monkeypatch.setattr(
        optuna, "create_study", lambda **k: studies.append(create(**k)) or studies[0]
    )
    candidates = search_all(Formula(limits={"effort": 1.5}, candidates=32))
    for trial, candidate in zip(studies[0].trials, candidates, strict=True):
        kept = candidate.last is not None and candidate.last.kept
        assert all(value <= 0 for value in trial.constraints.values()) == kept
        last = candidate.last
        whole = last is not None and last.rigs == 16 and last.cost is not None
        assert trial.state.name == ("COMPLETE" if whole else "PRUNED")


def test_a_loop_without_margin_is_never_run(free):
    _, candidates = free
    assert all(each.fields["b"] < 4 for each in candidates if each.scores)
    assert sum(bool(each.scores) for each in candidates) == 96, "and takes nothing from the budget"


def test_a_lost_rig_is_worse_than_any_cost(free):
    formula, _ = free
    loop = NominalLoop(0.5, 0.1)
    costly, losing = (
        score(formula.tune, loop, each)
        for each in formula.indicators(
            [({"a": 0.1, "b": -5.0, "c": "off"}, 16), ({"a": 21.0, "b": 1.0, "c": "on"}, 16)], 1, ()
        )
    )
    assert (losing.lost, losing.cost) == (1, None)
    assert costly.rank < losing.rank


@pytest.mark.parametrize("tail", [0.1, 0.25, 1.0])
def test_the_tail_is_the_conditional_value_at_risk(tail):
    costs = np.random.default_rng(0).lognormal(size=37)
    # the definition: the least over t of t + mean(max(cost - t, 0)) / tail, at one of the costs
    defined = min(t + np.maximum(costs - t, 0).mean() / tail for t in costs)
    assert tail_mean(costs, tail) == pytest.approx(defined)
    assert tail_mean(costs[:1], tail) == costs[0]


def test_a_controller_that_is_refused_has_no_margin_is_never_run_and_says_why():
    class Refusing(Formula):
        def loops(self, candidates):
            loops = super().loops(candidates)
            refused = NominalLoop.none(ValueError("b: must be below 3"))
            return [
                refused if point["b"] >= 3 else loop
                for point, loop in zip(candidates, loops, strict=True)
            ]

    candidates = search_all(Refusing(limits={"effort": 1000.0}, candidates=24))
    told = [each.as_dict() for each in candidates if each.fields["b"] >= 3]
    assert told
    for each in told:
        assert each["refused"] == "b: must be below 3"
        assert (each["disk_margin"], each["delay_margin"], each["rigs"]) == (None, None, 0)
        assert each["margins_with_observer"] is None


HAND = (180.0, 162.0, 66.0, 13.0)


@pytest.mark.long
def test_the_least_margin_of_all_cuts_counts_and_the_loop_bears_that_much():
    law, observer = AFL(gains=HAND), Smith(observer=Luenberger(), delay=0.042)
    found = loop_margins(law, observer, dead_time=0.042)
    at_ball = margins(sampled_loop(law, observer, dead_time=0.042), "x").delay

    def stable(more):
        loop = sampled_loop(law, observer, dead_time=0.042 + more)
        return not len(unstable(np.linalg.eigvals(loop.A)))

    # further dead time comes in where the ball is measured; at the input less is borne
    assert stable(0.98 * at_ball)
    assert not stable(1.02 * at_ball)
    assert found.delay < at_ball


@pytest.mark.long
def test_an_unstable_loop_has_no_margin():
    found = loop_margins(AFL(gains=HAND), Luenberger(), dead_time=0.5)
    assert (found.disk, found.delay) == (0.0, 0.0)


@pytest.mark.long
def test_drives_so_slow_that_the_ball_swings_have_no_margin():
    """tests/cli/test_analyse.py simulates them: fading at 2.2 Hz, growing at 1.6 Hz."""
    law = AFL(gains=(180, 162, 66, 13))
    observer = build_controller(load("hold")).observer
    disks = [
        loop_margins(law, observer, dead_time=0.042, lag=1 / (2 * np.pi * corner)).disk
        for corner in (2.2, 1.6)
    ]
    assert disks[0] > 0.05
    assert disks[1] == 0.0
    on = _loop(load("circle", ["parameters=hobby"]).model_dump_json())
    assert on.delay < 0.015  # 62 ms if its servos were fast and its frames at once


def test_a_law_that_switches_has_none_that_could_be_told():
    found = loop_margins(SlidingMode(), Luenberger(), dead_time=0.042)
    assert (found.disk, found.delay) == (None, None)


def test_behind_an_observer_without_linearisation_the_law_is_judged_with_the_full_state():
    class Learns(Kalman):
        """Keeps what it remembers where nobody sees it."""

        def correct(self, measurement):
            x = super().correct(measurement)
            self.count = getattr(self, "count", 0) + 1
            if self.count > 1:
                self.x = np.zeros_like(x)
            return self.x

    law = LQR(rho=100.0, kappa=0.1)
    plain = loop_margins(law, Kalman(), dead_time=0.0)
    found = loop_margins(law, Learns(), dead_time=0.0)
    assert plain.observed
    assert not found.observed
    # Safonov and Athans 1977: an LQR bears half the gain, or 60 deg; sampled, nearly that
    assert found.disk == pytest.approx(1.0, abs=0.15)
    assert found.disk > plain.disk
