"""The cure on the plants it was not designed on; the goals are percentages of the reference."""

import pytest

from twin.run.execute import run
from twin.scenario import load

ARM = 0.6 * 9.81 / 20
"""Friction in m/s^2 of a rolling resistance arm of 1 mm."""


@pytest.mark.long
def test_the_cure_follows_the_circle_on_the_mechanism_as_the_clean_model_does():
    done = run(load("cure"))
    assert done.outcome.ending == "finished"
    assert done.metrics.tracking_error_percent < 0.25


@pytest.mark.long
@pytest.mark.parametrize("rolling", [0.10, 0.27])
def test_a_friction_that_is_not_the_believed_one_is_found_and_made_up_for(rolling):
    done = run(load("cure", [f"plant.friction.rolling_mm={rolling}"]))
    assert done.metrics.tracking_error_percent < 1.0
    known = dict(zip(done.record.further, done.record["further"][-1, 0], strict=True))
    found = {quantity.name: value for quantity, value in known.items()}
    assert abs(found["friction"] - ARM * rolling) < 3 * found["friction_spread"]
    assert found["friction_spread"] < 0.03 / 2  # half of what it began with
