"""Every law of the thesis drives the ball home on every observer's estimate."""

import numpy as np
import pytest

from twin.run.finished import run

LAWS = {
    "pole_placement": (),
    "lqr": ("controller.rho=300.0", "controller.kappa=0.3"),
    "feedforward": ("controller.rho=300.0", "controller.kappa=0.3"),
    "afl": (),
    "afl_integral": (),
    "backstepping": ("controller.c=[1.0,2.0,2.5,3.0]",),
    "sliding_mode": ("duration=6", "controller.betas=[1.5,3.0,5.0]", "controller.epsilon=0.3"),
}
OBSERVERS = {
    "ideal": ("sensors.ideal=true",),
    "luenberger": (),
    "kalman": (),
    # From the ball alone it cannot serve every law: backstepping is too fast for it.
    "nonlinear_luenberger": ("observer.plate_observer=true",),
    "ekf": (),
}


@pytest.mark.long
@pytest.mark.parametrize("observer", OBSERVERS)
@pytest.mark.parametrize("law", LAWS)
def test_the_ball_comes_home(scenario, law, observer):
    done = run(
        scenario(
            "duration=3",
            f"controller.kind={law}",
            *LAWS[law],
            f"observer.kind={observer}",
            *OBSERVERS[observer],
            "predictor.delay=0.042",
            "plant.start.x=0.03",
            "plant.start.y=-0.03",
            "plant.friction.rolling_mm=0",
            "reference.x=0",
            "reference.y=0",
        )
    )
    assert done.outcome == "finished"
    late = done.motion.ball[-250:]
    assert np.abs(late).max() < 0.015
    assert np.isfinite(done.record["estimate"]).all()
