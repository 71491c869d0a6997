"""Tests of `controllers.analysis`."""

import re
from dataclasses import dataclass

import control
import numpy as np
import pytest

from controllers.analysis import (
    System,
    close,
    instability,
    linear_law,
    margins,
    sampled_loop,
    state_feedback_loop,
)
from controllers.ballplate import BallPlate
from controllers.classical import AFL, LQR, AFLIntegral, Backstepping, PolePlacement, SlidingMode
from controllers.design import sample
from controllers.interfaces import Measurement
from controllers.observers import (
    ExtendedKalman,
    Ideal,
    Kalman,
    Luenberger,
    NonlinearLuenberger,
)
from controllers.references import Hold
from controllers.smith import Smith

T = 0.002
A, B, C = BallPlate().linear()
OMEGA = np.geomspace(0.1, 100, 50)
AFL_CH9 = AFL(gains=(180, 162, 66, 13))
AFLI_CH9 = AFLIntegral(gains=(200, 132, 51, 12, 4))
BS_CH9 = Backstepping(c=(2, 3, 4, 5.5))


def same(found, expected, rtol=1e-6):
    """Whether two sets of poles are the same in some order."""
    found = list(np.asarray(found, complex))
    for pole in np.asarray(expected, complex):
        nearest = min(found, key=lambda other: abs(other - pole), default=np.inf)
        if abs(nearest - pole) > rtol * (1 + abs(pole)):
            return False
        found.remove(nearest)
    return not found


@pytest.mark.parametrize(
    ("law", "flat", "poles"),
    [
        (AFL_CH9, True, (-4.469 + 1.112j, -2.031 + 2.089j)),
        (AFLI_CH9, True, (-6.622, -3.436, -0.961 + 2.784j, -0.0203)),
        (BS_CH9, True, (-2.535 + 0.835j, -4.715 + 5.914j)),
        (LQR(rho=100, kappa=0.1), False, (-1.799 + 1.907j, -2.646 + 1.248j)),
    ],
    ids=["AFL", "AFL+I", "BS", "LQR"],
)
def test_the_gains_of_chapter_9_give_the_poles_of_erratum_35(law, flat, poles):
    expected = {complex(p) for q in poles for p in (q, np.conj(q))}
    found = state_feedback_loop(law, flat=flat).poles()
    assert same(found, [*expected, *expected], rtol=3e-4)


@pytest.mark.parametrize("rho", [10.0, 100.0, 1000.0])
def test_no_frequency_makes_the_return_difference_of_an_lqr_less_than_one(rho):
    loop = state_feedback_loop(LQR(rho=rho, kappa=0.3))
    assert (np.abs(loop.sensitivity("u1", OMEGA)) <= 1 + 1e-9).all()
    found = margins(loop, "u1")
    assert found.phase >= 60
    assert found.gain_up is None
    assert found.gain_down < 0.5


def transfer_of_axis_x(law):
    """Loop gain of a static law cut at u1, by python-control."""
    K = -linear_law(law).D[:1, :4]
    return control.ss(A[:4, :4], B[:4, :1], K, 0)


@pytest.mark.parametrize("law", [PolePlacement(), AFL_CH9, BS_CH9], ids=lambda law: law.name)
def test_margins_are_those_of_the_transfer_function(law):
    L = transfer_of_axis_x(law)
    found = margins(state_feedback_loop(law), "u1")
    gain, phase, _, _, crossover, _ = control.stability_margins(L)
    disk = control.disk_margins(L, np.geomspace(0.1, 100, 2000))[0]
    assert found.gain_down == pytest.approx(gain, rel=1e-3)
    assert found.phase == pytest.approx(phase, rel=1e-3)
    assert found.crossover == pytest.approx(crossover, rel=1e-3)
    assert found.delay == pytest.approx(np.radians(phase) / crossover, rel=2e-3)
    assert found.disk == pytest.approx(disk, rel=2e-3)


@pytest.mark.parametrize("law", [AFL(poles=(-3, -4, -5, -6)), BS_CH9], ids=lambda law: law.name)
def test_a_dead_time_beyond_the_delay_margin_makes_the_loop_unstable(law):
    allowed = margins(sampled_loop(law, Luenberger()), "x").delay
    below, above = (
        sampled_loop(law, Luenberger(), dead_time=share * allowed).poles()[0].real
        for share in (0.97, 1.03)
    )
    assert below < 0 < above


def two_axes(a, k, period=0.0):
    """Loop of x' = a x + u, or of x[n+1] = a x[n] + u, with u = -k x, on two axes alike."""
    one, no_states = np.eye(2), np.zeros((0, 0))
    plant = System(a * one, one, one, 0 * one, period)
    law = System(no_states, np.zeros((0, 2)), np.zeros((2, 0)), -k * one, period)
    return close(plant, law, ("x", "y"))


@pytest.mark.parametrize(
    ("a", "k", "period", "down", "up"),
    [
        (1.0, 1.2, 0.0, 1 / 1.2, None),  # L(0) = -k
        (-2.0, -0.5, 0.0, None, 4.0),  # L(0) = k / 2
        (-2.0, 5.0, 0.0, None, None),
        (0.0, 0.5, 0.0, None, None),  # an integrator
        (1.0, 0.5, 0.1, None, 4.0),  # L(-1) = -k / 2
        (1.5, 1.0, 0.1, 0.5, 2.5),  # L(1) = -2 k, L(-1) = -k / 2.5
    ],
)
def test_gain_margins_count_crossings_at_frequency_0_and_half_the_sampling_rate(
    a, k, period, down, up
):
    found = margins(two_axes(a, k, period), "u1")
    assert (found.gain_down, found.gain_up) == (pytest.approx(down), pytest.approx(up))
    edge = 1.0 if period else 0.0

    def beyond(factor):
        """How far the pole farthest out is beyond the edge of the stable region."""
        z = np.linalg.eigvals(two_axes(a, factor * k, period).A)
        return (np.abs(z) if period else z.real).max() - edge

    assert all(beyond(g) == pytest.approx(0, abs=1e-9) for g in (down, up) if g)
    assert beyond((down or 0.01) * 1.01) < 0
    assert beyond((up or 100.0) * 0.99) < 0 or up is None


def test_margins_of_an_unstable_loop_do_not_exist():
    assert margins(sampled_loop(LQR(rho=1e9), Luenberger()), "u1") is None


def behind_predictor(observer, delay=0.042):
    return instability(LQR(), Smith(observer=observer, delay=delay), dead_time=delay)


def test_the_predicted_luenberger_observer_becomes_unstable_above_56_ms():
    assert behind_predictor(Luenberger(), 0.056) is None
    assert "0.212+24.1j" in behind_predictor(Luenberger(), 0.057)


def test_every_observer_as_it_comes_bears_the_dead_time_of_the_screen():
    for kind in (Luenberger, Kalman, NonlinearLuenberger, ExtendedKalman):
        assert behind_predictor(kind()) is None
    assert "unstable" in behind_predictor(NonlinearLuenberger(poles=(-8, -10, -14, -16)))


def run(law, observer, x, ticks, delay):
    """Law and observer themselves on the linear plant, the ball measured ``delay`` ticks late."""
    Ad, Bd = sample(A, B, T)
    observer.start(np.zeros(8))
    q, past, states = np.zeros(law.memory), [np.zeros(2)] * delay, []
    reference, touched, age = Hold(), np.array(True), np.zeros(())
    for k in range(ticks):
        states.append(x)
        past.append(x[0::4])
        y = x[0::2].copy()
        y[0::2] = past[k]
        estimate = observer.correct(Measurement(k * T, y, age, touched, state=x)).copy()
        u = law.control(k * T, estimate, reference, q)
        q = q + T * law.memory_rate(k * T, estimate, reference, q)
        observer.predict(u)
        x = Ad @ x + Bd @ u
    return np.array(states)


@pytest.mark.parametrize(
    ("law", "make", "delay"),
    [
        (LQR(), Luenberger, 0),
        (LQR(), Ideal, 0),
        (AFLI_CH9, Kalman, 21),
        (BS_CH9, lambda: NonlinearLuenberger(plate_observer=True), 3),
        (AFL_CH9, lambda: Smith(observer=ExtendedKalman(), delay=0.042), 21),
        (AFLI_CH9, lambda: Smith(observer=Luenberger(), delay=0.0), 0),
        (AFL_CH9, lambda: Smith(observer=Luenberger(), delay=0.035), 21),
    ],
)
def test_the_linear_loop_moves_like_the_real_objects(law, make, delay):
    loop = sampled_loop(law, make(), dead_time=delay * T)
    s = np.zeros(len(loop.A))
    s[:8] = 1e-4 * np.array([1, -2, 1, 0, -1, 1, 1, 0])
    real = run(law, make(), s[:8].copy(), 300, delay)
    for expected in real:
        assert np.allclose(s[:8], expected, rtol=0, atol=1e-3 * np.abs(real).max())
        s = loop.A @ s


def test_a_sliding_mode_has_no_linearisation():
    with pytest.raises(ValueError, match="sliding_mode"):
        sampled_loop(SlidingMode(), Luenberger())
    assert instability(SlidingMode(), Luenberger()) is None


@dataclass(kw_only=True)
class Secretive(Luenberger):
    """An observer that remembers the last measurement where nobody looks."""

    def start(self, x):
        super().start(x)
        self._last = [np.zeros_like(x)[..., 0::2]]

    def correct(self, measurement):
        late, self._last[0] = self._last[0], measurement.y
        return super().correct(
            Measurement(measurement.time, late, measurement.age, measurement.touched)
        )


def test_an_observer_with_hidden_memory_is_refused_rather_than_misjudged():
    with pytest.raises(ValueError, match="cannot be linearised"):
        sampled_loop(LQR(), Secretive())


@pytest.mark.long
def test_how_late_a_ball_may_be_seen_is_where_powers_of_the_loop_begin_to_grow():
    law, observer = LQR(), Luenberger()
    told = instability(law, observer, dead_time=0.4)
    (held,) = map(int, re.findall(r"holds a ball that is seen (\d+) ms late, not 400 ms$", told))

    def grown(late):
        """Norm of the loop's matrix to the power of 2^22, more than two hours."""
        A = sampled_loop(law, observer, dead_time=late).A
        for _ in range(22):
            A = A @ A
            A = A / max(1.0, np.linalg.norm(A) / 1e100)
        return np.linalg.norm(A)

    assert grown(held / 1000) < 1
    assert grown(held / 1000 + observer.period) > 1e6
