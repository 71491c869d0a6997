"""`controllers.observers`: What holds for every observer."""

import numpy as np
import pytest
from observing import measured

from controllers.interfaces import Measurement
from controllers.observers import (
    DisturbanceObserver,
    ExtendedKalman,
    FrictionKalman,
    FrictionMapKalman,
    Kalman,
    Luenberger,
    NonlinearLuenberger,
)
from controllers.observers.late_ball import LateBall
from controllers.smith import Smith

OBSERVERS = {
    "luenberger": Luenberger,
    "kalman": Kalman,
    "ekf": ExtendedKalman,
    "nonlinear": NonlinearLuenberger,
    "nonlinear with plate observer": lambda: NonlinearLuenberger(plate_observer=True),
    "smith": lambda: Smith(observer=Luenberger(), delay=0.042),
    "disturbance_observer": lambda: DisturbanceObserver(delay=0.005),
    "friction_kalman": lambda: FrictionKalman(delay=0.005),
    "friction_map_kalman": lambda: FrictionMapKalman(delay=0.005, map_pitch=0.1, map_length=0.08),
}
EVERY = pytest.mark.parametrize("make", OBSERVERS.values(), ids=OBSERVERS)


@EVERY
def test_batch_gives_each_rig_what_it_gets_alone(make):
    """Balls felt at times, and frames that come every period, every ninth, and late."""
    rng = np.random.default_rng(3)
    start, u = rng.uniform(-0.2, 0.2, (2, 3, 8)), rng.normal(size=(60, 2, 3, 2))
    y = start[..., ::2] + 0.01 + 1e-3 * rng.normal(size=(60, 2, 3, 4))
    touched = rng.random((60, 2, 3)) > 0.2
    ages = [[[0.0, 0.002 * (tick % 9), 0.004]] * 2 for tick in range(60)]

    def final(rig):
        observer = make()
        observer.start(start[rig])
        for tick, age in enumerate(np.array(ages)):
            now = 0.002 * tick, y[tick][rig].copy(), age[rig], touched[tick][rig]
            observer.correct(Measurement(*now))
            np.testing.assert_array_equal(now[1], y[tick][rig])  # it is not written to
            observer.predict(u[tick][rig])
        return observer.x, observer.further

    together = final(...)
    for rig in np.ndindex(2, 3):
        for one, all_ in zip(final(rig), together, strict=True):
            np.testing.assert_allclose(all_[rig], one, rtol=1e-7, atol=1e-11)


@EVERY
def test_where_a_ball_is_that_is_not_felt_counts_for_nothing_but_the_plate_still_does(make):
    def corrected(ball, touched):
        observer = make()
        observer.start(np.zeros((2, 8)))
        y = np.array([[ball, 0.1, ball, -0.1], [0.01, 0.1, 0.01, -0.1]])
        return observer.correct(measured(y, np.array([touched, True])))[0]

    lost = corrected(0.01, False)
    nowhere = 9.0 if isinstance(make(), LateBall) else np.nan
    np.testing.assert_array_equal(lost, corrected(nowhere, False))
    assert np.abs(lost - corrected(0.01, True)).max() > 1e-6
    assert lost[[2, 6]].all() == getattr(make(), "plate_observer", True)


@EVERY
def test_start_and_estimate_of_a_tick_are_not_changed_by_what_follows(make):
    observer, start, felt = make(), np.full(8, 0.01), np.array(True)
    observer.start(start)
    first = observer.correct(measured(np.zeros(4), felt))
    kept = first.copy()
    observer.predict(np.ones(2))
    observer.correct(measured(np.full(4, 0.02), felt))
    np.testing.assert_array_equal(first, kept)
    np.testing.assert_array_equal(start, np.full(8, 0.01))
