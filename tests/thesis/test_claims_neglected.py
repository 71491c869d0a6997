import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from controllers.ballplate import BallPlate
from twin.thesis.neglected import size, terms

MODEL = BallPlate()
STATES = arrays(float, (3, 8), elements=st.floats(-1, 1))
INPUTS = arrays(float, (3, 2), elements=st.floats(-7, 7))


@given(STATES, INPUTS)
def test_the_neglected_terms_are_the_left_of_6_42(x, u):
    x1, x2, x3, x4, x5, x6, _, x8 = x.T
    m, s = MODEL, np.sin(x3)
    a = -m.d / 2 * x8**2 * np.sin(2 * x3) + x1 * x8**2 * s**2 + 2 * x6 * x8 * s + x1 * x4**2
    b = -m.c3 * x4 * x8 * s - 2 * x1 * x4 * x8 * np.cos(x3) - 2 * x2 * x8 * s + x5 * x8**2
    assert np.allclose(terms(m, x, u).neglected, np.transpose([a, b]), atol=1e-12)


@given(STATES, INPUTS)
def test_the_main_terms_are_the_right_of_6_42(x, u):
    expected = MODEL.gravity * np.transpose([np.sin(x[:, 2]), -np.sin(x[:, 6])])
    assert np.allclose(terms(MODEL, x, u).main, expected, atol=1e-12)


@given(STATES, INPUTS)
def test_all_terms_together_are_the_exact_acceleration(x, u):
    total = sum(terms(MODEL, x, u))
    exact = MODEL.derivative(x, u)[:, [1, 5]] / MODEL.c1
    assert np.allclose(total, exact, atol=1e-12)


@given(STATES, INPUTS)
def test_the_unlisted_terms_are_plate_accelerations_and_the_cosine_of_theta(x, u):
    m, s, c = MODEL, np.sin(x[:, 2]), np.cos(x[:, 2])
    slope = m.gravity * s * (np.cos(x[:, 6]) - 1)
    a = slope - m.c4 * u[:, 0] + x[:, 4] * s * u[:, 1]
    b = (-x[:, 0] * s + m.c4 * c) * u[:, 1]
    assert np.allclose(terms(m, x, u).unlisted, np.transpose([a, b]), atol=1e-12)


def test_sizes_of_sines_are_their_amplitudes_and_root_mean_squares():
    t = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    main = np.transpose([4 * np.sin(t), 2 * np.cos(t)])
    found = size(np.transpose([np.sin(t), np.ones_like(t)]), main)
    assert np.allclose(found.largest, 1, atol=1e-5)
    assert np.allclose(found.peak_ratio, [1 / 4, 1 / 2], atol=1e-5)
    assert np.allclose(found.rms_ratio, [1 / 4, 1 / np.sqrt(2)], atol=1e-9)


def test_a_ratio_to_nothing_is_no_number():
    assert np.isnan(size(np.zeros((5, 2)), np.zeros((5, 2))).rms_ratio).all()
