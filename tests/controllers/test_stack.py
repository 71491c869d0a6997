"""Tests of `controllers.per_rig`."""

import numpy as np
import pytest
from observing import measured

from controllers.per_rig import SampledReference
from controllers.references import Circle
from twin.run.controller_building import build_controller
from twin.run.finished import run
from twin.scenario import load

PERIOD = 0.002


def measurement(tick, y):
    return measured(y)._replace(time=tick * PERIOD)


def test_the_requested_rate_is_the_integral_of_the_laws_acceleration():
    controller = build_controller(load("hold"))
    y = np.array([[0.01, 0.0, 0.0, 0.0]])
    controller.start(measurement(0, y))
    total = np.zeros((1, 2))
    for tick in range(20):
        step = controller.command(measurement(tick, y))
        total = total + PERIOD * step.acceleration
        assert step.rate == pytest.approx(total)
        assert controller.applied(step.rate) == pytest.approx(step.acceleration)


def test_the_observer_predicts_from_what_was_applied_not_from_what_was_requested():
    controller = build_controller(load("hold"))
    y = np.array([[0.1, 0.0, 0.0, 0.0]])
    controller.start(measurement(0, y))
    assert abs(controller.command(measurement(0, y)).rate[0, 0]) > 0
    controller.applied(np.zeros((1, 2)))
    assert controller.observer.x[0, 3] == 0.0


def test_the_sampled_reference_is_the_reference_on_and_off_the_grid():
    circle = Circle(amplitude=0.15, omega=1.0)
    sampled = SampledReference(circle, PERIOD)
    for t in (0.0, 0.002, 3.0, 2.998, 0.0013, 700 * PERIOD, 8.0):
        assert sampled(t) == pytest.approx(circle(t), abs=1e-13)
    times = np.linspace(0, 5, 7)
    assert np.array_equal(sampled(times), circle(times))


@pytest.mark.parametrize("observer", ["friction_kalman", "luenberger"])
def test_periods_that_were_left_out_are_made_up_for_with_what_is_known_of_them(observer):
    # the plate goes on at its rate meanwhile, and nobody looks at the ball
    keys = ["controller.kind=afl_integral", f"observer.kind={observer}", "predictor.delay=0.042"]
    measured = np.random.default_rng(4).normal(size=(300, 1, 4)) * 1e-3
    measured[..., 1] = 2e-3 * np.arange(300)[:, None]
    left_out = {100, 101, 102, 103, 130, 200, 201}

    def gone_through(skip):
        controller = build_controller(load("circle", keys))
        controller.start(measurement(0, measured[0]))
        for tick in range(300):
            now = measurement(tick, measured[tick])
            if tick in left_out:
                if skip:
                    continue
                later = next(each for each in range(tick, 300) if each not in left_out)
                before = next(each for each in range(tick, 0, -1) if each not in left_out)
                share = (tick - before) / (later - before)
                now.y[..., 0::2] = measured[later][..., 0::2]
                now.y[..., 1::2] = (1 - share) * measured[before][..., 1::2] + (
                    share * measured[later][..., 1::2]
                )
                now = now._replace(touched=np.zeros(1, bool), age=now.age + PERIOD)
            step = controller.command(now)
            controller.applied(controller.rate if tick in left_out else step.rate)
        return controller, step

    (one, last), (other, known) = gone_through(skip=True), gone_through(skip=False)
    np.testing.assert_allclose(last.estimate, known.estimate, rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(one.memory, other.memory, rtol=1e-6)
    assert np.abs(one.memory).max() > 0


@pytest.mark.long
@pytest.mark.parametrize("observer", ["luenberger", "kalman", "ekf", "ideal"])
def test_no_observer_lets_the_plate_resonance_ring_up(observer):
    chosen = load(
        "hold",
        [
            "duration=4",
            "controller.kind=afl",
            "controller.gains=[180,162,66,13]",
            f"observer.kind={observer}",
            f"sensors.ideal={'true' if observer == 'ideal' else 'false'}",
            "sensors.encoders.variance=[0,0]",
            "disturbance.variance=[1e-2,1e-2]",
        ],
    )
    plate = run(chosen).record["state"][:, 0, 2::4]
    # The angle minus its mean over one resonance period is the ringing.
    kernel = np.ones(38) / 38
    slow = np.apply_along_axis(lambda angle: np.convolve(angle, kernel, "valid"), 0, plate)
    ringing = np.abs(plate[19:-18] - slow)
    early, late = ringing[250:750].max(axis=0), ringing[-500:].max(axis=0)
    assert (late < 3 * early).all()
    assert late.max() < np.radians(0.05)
