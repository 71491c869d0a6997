"""`controllers.controller`.

A law with a period of its own, against the sampled-data loop that python-control designs."""

from dataclasses import dataclass, field

import control
import numpy as np
import pytest
from observing import measured

from controllers.analysis import loop_row
from controllers.ballplate import BallPlate
from controllers.controller import Controller, HeldLaw
from controllers.interfaces import Law, Observer, Quantity
from controllers.observers import Ideal
from controllers.per_rig import PerRigLaw, PerRigReference
from controllers.references import Hold

T = 0.002
A, B, _ = BallPlate().linear()
PLANT = control.ss(A, B, np.eye(8), 0)
FIRST = np.array([0.05, 0.0, 0.01, 0.0, -0.03, 0.1, 0.0, 0.02])


@dataclass(frozen=True, kw_only=True)
class Gain(Law):
    """u = -K x."""

    name = "gain"
    K: np.ndarray = field(default_factory=lambda: np.zeros((2, 8)))

    def control(self, t, x, reference, q):
        return -x @ self.K.T


class Told(Observer):
    """What is measured is the state."""

    def correct(self, measurement):
        self.x = measurement.state
        return self.x

    def predict(self, u):
        pass


def designed(period):
    """Closed loop and gain of the discrete regulator at a period."""
    sampled = control.c2d(PLANT, period, "zoh")
    K, _, _ = control.dlqr(sampled, np.diag([1e3, 1e2, 1, 1] * 2), np.eye(2))
    return sampled.A - sampled.B @ K, np.asarray(K)


def measurement_at(tick, x):
    return measured(x[:, 0::2])._replace(time=tick * T, state=x)


def controlled(law, x, observer=Told):
    """A controller that has started at states x, one a rig."""
    controller = Controller(law, observer(), PerRigReference([Hold()] * len(x), T), T)
    controller.start(measurement_at(0, x))
    return controller


def driven(law, rigs, ticks):
    """States of a linear plant and its inputs at every tick."""
    step = control.c2d(PLANT, T, "zoh")
    x, path, inputs = np.tile(FIRST, (rigs, 1)), [], []
    controller = controlled(law, x)
    for tick in range(ticks):
        u = controller.applied(controller.command(measurement_at(tick, x)).rate)
        path.append(x)
        inputs.append(u)
        x = x @ step.A.T + u @ step.B.T
    return np.array(path), np.array(inputs)


@pytest.mark.parametrize("ticks", [2, 5, 20])
def test_a_law_of_every_kth_tick_is_the_loop_sampled_at_k_t(ticks):
    closed, K = designed(ticks * T)
    path, inputs = driven(HeldLaw(Gain(K=K), ticks), 1, 40 * ticks)
    x = FIRST
    for number in range(40):
        np.testing.assert_allclose(path[number * ticks, 0], x, atol=1e-9)
        held = inputs[number * ticks : (number + 1) * ticks, 0]
        np.testing.assert_allclose(held, np.broadcast_to(-K @ x, (ticks, 2)), atol=1e-8)
        x = closed @ x


@dataclass(frozen=True, kw_only=True)
class Needing(Law):
    """Commands what it needs."""

    needs: tuple[str, ...]
    control = None

    def command(self, now):
        return now.needed


class Knowing(Told):
    """Knows three things, which the ball's position tells."""

    knows = tuple(Quantity(name, "1") for name in "abc")

    @property
    def further(self):
        return self.x[:, :1] + [1.0, 2.0, 3.0]


def test_laws_side_by_side_are_each_given_what_they_need():
    law = PerRigLaw(
        [Needing(needs=("c", "a")), Needing(needs=("b", "c")), Needing(needs=("a", "b"))]
    )
    x = np.zeros((3, 8))
    x[:, 0] = 10, 20, 30
    u = controlled(law, x, Knowing).command(measurement_at(0, x)).rate / T
    np.testing.assert_allclose(u, [[13, 11], [22, 23], [31, 32]])


def test_laws_side_by_side_give_the_control_and_the_remarks_of_each():
    gains = [Gain(K=factor * designed(T)[1]) for factor in (1.0, 2.0)]
    laws = [gains[0], HeldLaw(gains[1], 4), gains[0]]
    law, x = PerRigLaw(laws), np.arange(24.0).reshape(3, 8) / 100
    u = law.control(0.0, x, Hold(), np.zeros((3, 0)))
    factors = np.array([[1.0], [2.0], [1.0]])
    np.testing.assert_allclose(u, -factors * (x @ gains[0].K.T))
    assert law.remarks == laws[1].remarks
    assert law.model is gains[0].model


def test_a_tick_that_is_missed_delays_the_law_but_takes_no_period_from_it():
    law = HeldLaw(Gain(K=designed(0.01)[1]), 5)
    held = law.start(np.zeros((1, 8)), Hold(), T)
    ticks = [0, 1, 4, 6, 7, 9, 10, 11, 21, 25]
    assert [tick for tick in ticks if held.due(tick * T)] == [0, 6, 10, 21, 25]


def test_the_analysis_leaves_the_hold_out_and_says_so():
    _, K = designed(T)
    law = HeldLaw(Gain(K=K), 100)
    found, plain = (loop_row(each, Ideal(period=T), 0.0) for each in (law, law.law))
    held = control.c2d(PLANT, 100 * T, "zoh")
    assert np.abs(np.linalg.eigvals(held.A - held.B @ K)).max() > 1
    assert found["stable"]
    assert found.pop("hold_left_out")
    assert not plain.pop("hold_left_out")
    assert found == plain
    assert any("every 100 control periods" in line for line in law.remarks)


def late_and_held(K, ticks, late):
    """Matrix of state and last command over a law's period, its command so many ticks late."""
    step = control.c2d(PLANT, T, "zoh")
    tick = np.block([[step.A, step.B], [np.zeros((2, 8)), np.eye(2)]])  # of (x, u), u held
    arrived = np.linalg.matrix_power(tick, late).copy()
    arrived[8:] = np.hstack([-K, np.zeros((2, 2))])  # of the state at the beginning
    return np.linalg.matrix_power(tick, ticks - late) @ arrived


@pytest.mark.parametrize(("time", "ticks"), [(1.5 * T, 2), (0.005, 3), (6 * T, 6), (0.031, 16)])
def test_a_law_that_computes_for_n_periods_is_the_loop_with_n_minus_1_periods_of_delay(time, ticks):
    """The discrete loop of period n T whose input comes (n - 1) T late, by its matrix."""
    _, K = designed(ticks * T)
    path, _ = driven(HeldLaw(Gain(K=K), 1, time), 1, 20 * ticks)
    closed, x = late_and_held(K, ticks, ticks - 1), np.concatenate([FIRST, np.zeros(2)])
    for number in range(20):
        np.testing.assert_allclose(path[number * ticks, 0], x[:8], atol=1e-9)
        x = closed @ x


@pytest.mark.parametrize("time", [1e-9, T])
def test_what_is_computed_within_a_period_is_in_time_to_the_bit(time):
    _, K = designed(T)
    found, _ = driven(HeldLaw(Gain(K=K), 1, time), 1, 200)
    np.testing.assert_array_equal(found, driven(Gain(K=K), 1, 200)[0])


def test_a_slow_law_of_its_own_period_is_late_within_it_and_leaves_out_what_it_misses():
    """A period of 4 ticks: 3 ticks of computing come 2 late, 5 ticks take every second period."""
    inner = Gain(K=designed(T)[1])
    for time, every, late in ((3 * T, 4, 2), (5 * T, 8, 4)):
        path, inputs = driven(HeldLaw(inner, 4, time), 1, 40)
        for begin in range(0, 32, every):
            held = inputs[begin + late : begin + late + every, 0]
            np.testing.assert_allclose(held, np.tile(-inner.K @ path[begin, 0], (every, 1)))


def test_rigs_side_by_side_have_each_their_laws_period_and_computing_time():
    gain = Gain(K=designed(6 * T)[1])
    laws = [HeldLaw(gain, 1, 6 * T), gain, HeldLaw(gain, 1, 0.005), HeldLaw(gain, 10)]
    together, _ = driven(PerRigLaw(laws), len(laws), 120)
    for rig, law in enumerate(laws):
        np.testing.assert_allclose(together[:, rig], driven(law, 1, 120)[0][:, 0], atol=1e-12)


def test_the_controller_tells_computing_time_and_lateness_of_each_period():
    gain = Gain(K=designed(T)[1])
    told, x = [], np.tile(FIRST, (2, 1))
    controller = controlled(PerRigLaw([HeldLaw(gain, 1, 0.005), gain]), x)
    for tick in range(8):
        told.append(controller.command(measurement_at(tick, x)).computing)
        controller.applied(np.zeros((2, 2)))
    took, late = np.moveaxis(np.array(told), -1, 0)
    np.testing.assert_array_equal(took[:, 0], [0.005, *[np.nan] * 2] * 2 + [0.005, np.nan])
    np.testing.assert_allclose(late[:, 0] / T, [1, 2, 2, 3, 4, 2, 3, 4])
    np.testing.assert_array_equal(told[5][1], [0.0, 0.0])
