"""`twin.study.experiments`.

Error over friction on the exact model, against what linear theory says of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from twin.study.answers import answers
from twin.study.experiments import Store, carry
from twin.study.schema import Study
from twin.study.work import Work

GAINS = (180.0, 162.0, 66.0, 13.0)
ARMS = (0.05, 0.18, 0.4)
IDEAL = (
    "plant.kind=lagrange",
    "plant.step=0.01",
    "rig.period=0.01",
    "sensors.ideal=true",
    "observer.kind=ideal",
    "predictor.delay=0.0",
    "sensors.touch={dead_time=0.0, grid=0, variance=[0.0, 0.0]}",
    "sensors.encoders={counts=0, variance=[0.0, 0.0]}",
    "disturbance.variance=[0.0, 0.0]",
)


def errors(folder: Path, omega: float, duration: float, start: float) -> np.ndarray:
    """Errors in m of the AFL on a circle for each friction, from a whole study."""
    about = Study.model_validate(
        {
            "title": "exact",
            "scenario": "circle",
            "set": [
                *IDEAL,
                f"reference.omega={omega}",
                f"duration={duration}",
                f"metrics.start={start}",
            ],
            "method": "grid",
            "parameters": {"plant.friction.rolling_mm": {"values": list(ARMS)}},
        }
    )
    work = Work(about)
    (found,) = answers(work, carry(work, Store(folder), processes=1))
    return 0.15 * np.array([each.median for each in found.curves[0].spreads]) / 100


def deceleration() -> np.ndarray:
    """What rolling friction takes from a ball on a level plate, m/s^2."""
    ball = BallPlate()
    return ball.c1 * np.array(ARMS) / 1000 / ball.radius * ball.gravity


@pytest.mark.long
@pytest.mark.parametrize(
    ("omega", "duration", "start", "within"),
    [(0.2, 45.0, 28.0, 0.03), (0.75, 24.0, 12.0, 0.01)],
)
def test_the_error_is_the_loops_gain_for_a_turning_disturbance(
    tmp_path, omega, duration, start, within
) -> None:
    # friction turns with the ball, so that it is one complex amplitude; (6.59) with it in x''
    s = 1j * omega
    p0, p1, p2, p3 = GAINS
    gain = abs((s**2 + p3 * s + p2) / (s**4 + p3 * s**3 + p2 * s**2 + p1 * s + p0))
    found = errors(tmp_path, omega, duration, start)
    assert found == pytest.approx(gain * deceleration(), rel=within)
