from dataclasses import replace

import numpy as np
import pytest

from controllers.ballplate import BallPlate
from controllers.controller import PerRigLaw, PerRigReference
from controllers.interfaces import Law
from controllers.nonlinear import AFL, AFLIntegral
from controllers.observers import ExtendedKalman, Ideal, Kalman, Luenberger, NonlinearLuenberger
from controllers.references import Sine
from twin.hal.cams import FixedRatio
from twin.sim.drives import DriveModel
from twin.sim.plant.exact import ExactPlant
from twin.sim.rig import SimulatedDevices
from twin.sim.sensors import EncoderModel, TouchModel
from twin.thesis.reproduce.cases import (
    BALL,
    DISTURBANCE,
    PLATE,
    ConstantGain,
    SimulationCase,
    continuous,
    draw,
    kalman_gain,
    laws,
    paths,
    repeated,
    streams,
)
from twin.thesis.reproduce.simulated import (
    ContinuousLoop,
    exact,
    full_state,
    sampled,
    with_observer,
)

MODEL = BallPlate()
AXES = {"kind": "sine", "amplitude": 0.15, "omega": 1.0, "wave": ["sin", "cos"]}
FULL = SimulationCase(duration=3.0, controller={"kind": "afl"}, reference=AXES)
OBSERVED = SimulationCase(
    duration=3.0, controller={"kind": "afl"}, reference=AXES, observer={"kind": "ekf"}
)
OTHER = {"kind": "afl_integral"}


def observed(**changes):
    return replace(OBSERVED, **changes)


def test_without_noise_an_observer_that_starts_right_changes_nothing():
    truth, (found,) = full_state(FULL), with_observer([OBSERVED], 0.005)
    assert np.abs(found.estimate - found.state).max() < 1e-12
    assert found.state[::2, 0] == pytest.approx(truth.state[::5, 0], abs=2e-7)


@pytest.mark.long
def test_without_noise_the_predictor_removes_the_dead_time():
    (truth,), (found,) = (
        exact([observed(dead_time=tau, predicted=tau > 0)]) for tau in (0.0, 0.042)
    )
    assert found.state == pytest.approx(truth.state, abs=1e-12)
    (late,) = exact([observed(dead_time=0.042)])
    assert np.abs(late.state - truth.state).max() > 1e-3


def test_the_delayed_ball_is_the_ball_of_a_dead_time_ago():
    # An observer that only counts: its memory integrates the innovation of x without gain.
    class Watch(ConstantGain):
        def rate(self, x, memory, u, e):
            seen.append(e[0, 0] + x[0, 0])
            return super().rate(x, memory, u, e)

    seen = []
    loop = ContinuousLoop(
        law=AFL(),
        reference=PerRigReference([Sine(omega=1.0)], 0.01),
        rigs=1,
        estimator=Watch(MODEL, np.zeros((8, 4)), exact=True),
        dead_time=0.042,
        step=0.01,
    )
    x, _, _ = loop.run(2.0)
    times = 0.01 * np.arange(201)
    whole = np.array(seen[::4])  # the first of four stages is at the step itself
    fine, _, _ = ContinuousLoop(
        law=loop.law, reference=loop.reference, rigs=1, estimator=loop.estimator, step=0.002
    ).run(2.0)
    at = np.rint((times - 0.042) / 0.002).astype(int)
    assert whole == pytest.approx(np.where(at < 0, 0.0, fine[at.clip(0), 0, 0]), abs=1e-8)
    assert np.abs(x).max() > 0.1


def test_noise_is_what_the_simulated_devices_draw_and_the_same_for_every_case():
    period, hold, rigs = 0.01, 0.1, 3
    devices = SimulatedDevices(
        ExactPlant(rigs=2 * rigs, step=period),
        period=period,
        touch=TouchModel(dead_time=0.0, grid=0, variance=BALL),
        encoders=EncoderModel(counts=0, variance=PLATE),
        drives=DriveModel(disturbance=DISTURBANCE),
        hold=10,
        seeds=streams(rigs, 2),
    )
    noise = repeated(draw(2.0, rigs, hold), 2)
    assert noise.measured.shape == (21, 2 * rigs, 4)
    rate = np.zeros((2 * rigs, 2))
    for tick in range(200):
        interval = tick // 10
        ball = devices.read().position - devices.state[:, 0::4]
        plate = devices.plate() - devices.state[:, 2::4]
        assert ball == pytest.approx(noise.measured[interval][:, 0::2], abs=1e-15)
        assert plate == pytest.approx(noise.measured[interval][:, 1::2], abs=1e-15)
        devices.wait()
        rate += period * noise.disturbance[interval]
        assert devices.state[:, 3::4] == pytest.approx(rate, abs=1e-15)


@pytest.mark.parametrize(("law", "other"), [(AFL(), AFLIntegral()), (AFLIntegral(), AFL())])
def test_each_group_of_rigs_has_its_own_law_and_path(law, other):
    sines = Sine(omega=0.5), Sine(omega=1.0, wave=("sin", "cos"))
    each = PerRigLaw([law, law, other, other])
    both = PerRigReference([sines[0], sines[0], sines[1], sines[1]], 0.25)
    rng = np.random.default_rng(1)
    x, q = rng.normal(0, 0.1, (4, 8)), rng.normal(0, 0.1, (4, 2))
    u, slope = (getattr(each, name)(0.75, x, both, q) for name in ("control", "memory_rate"))
    for one, path, own in zip((law, other), sines, (slice(2), slice(2, 4)), strict=True):
        mine = q[own, : one.memory]
        assert u[own] == pytest.approx(one.control(0.75, x[own], path, mine), abs=1e-15)
        rate = one.memory_rate(0.75, x[own], path, mine)
        assert slope[own, : one.memory] == pytest.approx(rate, abs=1e-15)
        assert not slope[own, one.memory :].any()


def test_the_laws_and_paths_of_cases_stand_run_by_run_and_are_shared_where_equal():
    cases = [replace(OBSERVED, seeds=2), replace(OBSERVED, seeds=1, controller=OTHER)]
    first, second, third = laws(cases)
    assert first is second
    assert third == AFLIntegral()
    assert len({id(law) for law in laws([*cases, cases[0]])}) == 2
    reference = paths([cases[0], replace(cases[1], reference={"kind": "hold", "x": 0.1})], 0.01)
    assert reference(np.array([0.3]))[0, 0].shape == (3, 2)
    assert reference(0.3)[0, 2] == pytest.approx([0.1, 0.0])


def test_under_continuous_control_a_law_asked_ahead_gets_the_reference_of_that_time():
    class Ahead(Law):
        def control(self, t, x, reference, q):
            seen.append((t, reference(t + 0.25)[0], reference(np.array([t, t + 1.0]))[0]))
            return np.zeros((len(x), 2))

    seen = []
    sines = [Sine(omega=1.0), Sine(omega=2.0)]
    ContinuousLoop(
        law=PerRigLaw([Ahead()] * 2),
        reference=PerRigReference(sines, 0.01),
        rigs=2,
        estimator=ConstantGain(MODEL, np.zeros((8, 4)), exact=True),
        step=0.01,
    ).run(0.1)
    for t, ahead, both in seen:
        for rig, sine in enumerate(sines):
            assert ahead[rig] == pytest.approx(sine(t + 0.25)[0], abs=1e-15)
            assert both[:, rig] == pytest.approx(sine(np.array([t, t + 1.0]))[0], abs=1e-15)


def error_matrix(estimator):
    """d(x_hat')/d(x_hat) at the origin with y = 0, by central differences."""
    memory, out = estimator.start(1), np.zeros((8, 8))
    for i, h in enumerate(np.full(8, 1e-6)):
        rates = [
            estimator.rate(x, memory, np.zeros((1, 2)), -x[:, 0::2])[0]
            for x in (h * np.eye(8)[i : i + 1], -h * np.eye(8)[i : i + 1])
        ]
        out[:, i] = (rates[0] - rates[1])[0] / (2 * h)
    return out


@pytest.mark.parametrize("kind", [Luenberger, NonlinearLuenberger])
def test_continuous_luenberger_observers_have_the_poles_asked_for(kind):
    poles = (-8.0, -10.0, -14.0, -16.0)
    found = np.linalg.eigvals(error_matrix(continuous(kind(poles=poles))))
    assert np.sort(found.real) == pytest.approx(np.sort([*poles, *poles]), rel=1e-3)


def test_the_continuous_kalman_gain_is_the_limit_of_the_discrete_one():
    Q, R = (1e-4, 3e-5), (7e-7, 2e-7, 2e-10, 1e-10)
    discrete = Kalman(Q=Q, R=R, period=1e-5)
    gain = kalman_gain(MODEL, Q, R)
    assert pytest.approx(gain, rel=1e-3, abs=1e-3 * np.abs(gain).max()) == discrete.L / 1e-5


def test_the_continuous_ekf_starts_in_the_steady_state_of_its_riccati_equation():
    Q, R = (1e-4, 3e-5), (7e-7, 2e-7, 2e-10, 1e-10)
    ekf = continuous(ExtendedKalman(Q=Q, R=R))
    x, e = np.zeros((1, 8)), np.array([[1e-3, 1e-3, -1e-3, 2e-3]])
    start = ekf.start(1)
    rate, slope = ekf.rate(x, start, np.zeros((1, 2)), e)
    assert np.abs(slope).max() < 1e-9 * np.abs(start).max()
    assert rate == pytest.approx(e @ kalman_gain(MODEL, Q, R).T, rel=1e-6, abs=1e-12)


def test_an_observer_without_a_continuous_form_is_refused():
    with pytest.raises(TypeError, match="no continuous form"):
        continuous(Ideal())


def test_direct_transmission_and_law_agree_on_the_sampled_exact_plant():
    truth, (found,) = full_state(FULL), sampled([FULL])
    assert FixedRatio().ratio == 1.0
    assert np.abs(found.state[:, 0] - truth.state[:, 0]).max() < 2e-3
