"""Chapter 9 predicted as a whole, on the mechanism.

Tests named ``test_characterisation_...`` hold what the twin predicts today within bounds fitted to
that outcome, so that a change is noticed; the bounds are no requirements.
"""

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.thesis.experiments.batch import noise, rolling, simulate
from twin.thesis.experiments.fit import fit, identified
from twin.thesis.experiments.judge import e_tt
from twin.thesis.experiments.predict import deviations, goals, rows
from twin.thesis.experiments.single_runs import STEEL_ARM, approach, loses, steel
from twin.thesis.experiments.tables import FIFTEEN, chosen

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def predicted():
    """Every cell of Tables 9.1 to 9.9 on the mechanism with everything on."""
    return rows()


def test_the_fit_comes_out_as_the_one_that_is_used():
    again = fit(lambda _: None)
    assert (again.reading, again.start) == (identified().reading, identified().start)
    assert again.rolling == pytest.approx(identified().rolling, rel=1e-3)
    assert again.residual == pytest.approx(identified().residual, abs=0.02)


def test_every_prediction_has_a_value(predicted):
    assert len(predicted) == 125
    assert [row for row in predicted if row["predicted"] is None] == []


@pytest.mark.parametrize(
    "sentence",
    [
        "sliding mode improves with frequency",
        "sliding mode is worst",
        "AFL with integral action and backstepping are best",
        "the predictor changes little (less than a quarter)",
        "AFL's error does not grow with frequency",
    ],
)
def test_the_orderings_of_the_thesis_hold(predicted, sentence):
    (goal,) = [goal for goal in goals(predicted) if goal.sentence == sentence]
    assert goal.reached, goal.found


def test_characterisation_with_the_predictor_the_predicted_errors_are_within_4_points(predicted):
    assert np.abs(deviations(predicted, ("9.5", "9.7"))).max() < 4
    assert np.abs(deviations(predicted, ("9.5", "9.7"))).mean() < 2


def test_characterisation_all_15_predicted_errors_are_2_and_a_half_points_off_on_average(predicted):
    # the goal is 2.0, which is not reached: see docs/experiments.md
    assert np.abs(deviations(predicted, FIFTEEN)).mean() < 2.6


def test_characterisation_without_friction_the_twin_errs_by_a_few_percent_at_most(predicted):
    clean = [
        row["frictionless"]
        for row in predicted
        if row["column"] == "e_tt" and row["table"] not in {"9.8", "9.9"}
    ]
    assert max(clean) < 2.5


def test_characterisation_friction_explains_table_9_3_on_the_exact_model_too():
    experiments = chosen(["9.3"])
    rigs = [{**rolling(arm), **noise(0.0)} for arm in (identified().rolling, 0.0)]
    for row, experiment in zip(
        simulate(experiments, rigs, mechanism=False, duration=25.0), experiments, strict=True
    ):
        assert e_tt(row[0], "estimate", 0.0) == pytest.approx(experiment.cells["e_tt"], abs=1.5)
        assert e_tt(row[1], "estimate", 0.0) < 1.5


def test_the_steel_ball_overshoots_more_and_rests_closer_than_the_hollow_one():
    hollow, heavy = approach(BallPlate(), identified().rolling), approach(steel(), STEEL_ARM)
    assert heavy.overshoot > hollow.overshoot
    assert heavy.error < hollow.error / 3


def test_saturated_backstepping_loses_the_ball_from_a_large_error_and_keeps_it_from_a_small_one():
    assert not loses(0.05, 1.0)
    assert loses(0.25, 1.0)
    assert not loses(0.25, 7.0)
