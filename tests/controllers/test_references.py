"""Tests of `controllers.references`."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import cumulative_simpson

from controllers.references import Circle, Hold, Lissajous, Path, Sine, Step, Transition

length = st.floats(0.01, 0.2)
omega = st.floats(0.2, 2.0)
seconds = st.floats(0.5, 10.0)
spot = st.tuples(st.floats(-0.2, 0.2), st.floats(-0.15, 0.15))

circles = st.builds(Circle, amplitude=length, omega=omega, start=st.none() | seconds)
figures = st.builds(
    Lissajous,
    amplitude=st.tuples(length, length),
    omega=st.tuples(omega, omega),
    phase=st.floats(-math.pi, math.pi),
    start=st.none() | seconds,
)
transitions = st.builds(Transition, start=spot, end=spot, time=seconds, duration=seconds)
sines = st.builds(Sine, amplitude=st.tuples(length, length), omega=st.tuples(omega, omega))


@st.composite
def paths(draw):
    # Points on rays of different direction never coincide.
    radii = draw(st.lists(st.floats(0.05, 0.15), min_size=3, max_size=7))
    angles = 2 * math.pi * np.arange(len(radii)) / len(radii)
    points = tuple((r * math.cos(a), r * math.sin(a)) for r, a in zip(radii, angles, strict=True))
    duration = draw(st.floats(4.0, 12.0))
    ramp = draw(st.sampled_from((None, duration / 2)))
    closed = draw(st.booleans())
    return Path(points=points, duration=duration, closed=closed, time=1.0, ramp=ramp)


smooth = st.one_of(circles, figures, transitions, sines, paths())
ALL = [Hold(x=0.1, y=-0.1), Step(time=1.0), Sine(wave=("sin", "cos")), Circle(), Lissajous()]
ALL += [Transition(), Path(), Path(closed=True)]


def joints(reference):
    """Times at which a reference goes over from one formula to the next."""
    match reference:
        case Circle() | Lissajous():
            faster = np.abs(reference.omega).max()
            start = reference.start
            return 0.0, 1.5 * math.pi / faster if start is None else start
        case Transition():
            return reference.time, reference.time + reference.duration
        case Path():
            t, T = reference.time, reference.duration
            ramp = reference.ramp or T / 4
            return (t, t + ramp) if reference.closed else (t, t + ramp, t + T - ramp, t + T)
    return ()


@settings(max_examples=25)
@given(reference=smooth, k=st.integers(0, 3))
def test_each_derivative_integrates_to_the_one_below(reference, k):
    ends = [0.0, *sorted({t for t in joints(reference) if 0 < t < 20}), 20.0]
    for a, b in itertools.pairwise(ends):
        # A path has kinks in its fourth derivative.
        t = np.linspace(a, b, 20001 if k == 3 and isinstance(reference, Path) else 2001)
        r = reference(t)
        gained = cumulative_simpson(r[k + 1], x=t, axis=0)
        scale = np.abs(r[k]).max() + np.abs(r[k + 1]).max() * (b - a)
        np.testing.assert_allclose(r[k, 1:] - r[k, 0], gained, rtol=0, atol=1e-6 * scale + 1e-12)


@settings(max_examples=30)
@given(reference=st.one_of(circles, figures, transitions, paths()))
def test_position_and_four_derivatives_are_continuous_where_formulas_meet(reference):
    scale = np.abs(reference(np.linspace(0, 25, 501))).max(axis=(1, 2))
    # The next derivative up may move a value by its size times the gap.
    gap = 1e-7 * np.append(scale[1:], 10 * scale[4]) + 1e-8 * scale + 1e-12
    for joint in joints(reference):
        before, after = reference(joint - 1e-9), reference(joint + 1e-9)
        assert (np.abs(after - before).max(axis=1) < gap).all()


@pytest.mark.parametrize("shape", [(), (3,), (2, 5), (0,)])
@pytest.mark.parametrize("reference", ALL, ids=range(len(ALL)))
def test_an_array_of_times_gives_what_each_time_alone_gives(reference, shape):
    t = np.random.default_rng(1).uniform(-1, 20, shape)
    together = reference(t)
    assert together.shape == (5, *shape, 2)
    for i in np.ndindex(shape):
        alone = reference(float(t[i]))
        np.testing.assert_allclose(together[(slice(None), *i)], alone, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize(
    "reference", [Sine(amplitude=0.1, omega=0.5, wave=("sin", "cos")), Circle(amplitude=0.1)]
)
def test_sine_and_cosine_make_the_circle_of_appendix_d(reference):
    A, w, t = 0.1, 0.5, np.linspace(3 * math.pi, 40, 101)
    s, c = np.sin(w * t), np.cos(w * t)
    x = A * np.array((s, w * c, -(w**2) * s, -(w**3) * c, w**4 * s))
    y = A * np.array((c, -w * s, -(w**2) * c, w**3 * s, w**4 * c))
    np.testing.assert_allclose(reference(t), np.stack((x, y), axis=-1), atol=1e-15)


@settings(max_examples=25)
@given(reference=circles)
def test_the_circle_starts_along_a_polynomial_of_degree_nine(reference):
    _, T = joints(reference)
    samples = reference(np.linspace(0, T, 41)[:-1])[0]
    # The tenth difference of a polynomial of degree nine is zero, that of a sine is not.
    tenth = np.diff(samples[::3], n=10, axis=0)
    np.testing.assert_allclose(tenth, 0, atol=2**10 * 1e-12)


@settings(max_examples=25)
@given(reference=st.one_of(circles, figures, transitions, paths()))
def test_the_ball_waits_at_rest_before_it_sets_off(reference):
    t = joints(reference)[0]
    r = reference(np.array((t - 3.0, t)))
    np.testing.assert_array_equal(r[:, 0], r[:, 1])
    assert not r[1:].any()


@settings(max_examples=30)
@given(
    amplitude=st.tuples(length, length),
    omega=st.tuples(omega, omega),
    phase=st.floats(-math.pi, math.pi),
)
def test_the_default_start_of_a_figure_passes_its_amplitude_by_less_than_one_percent(
    amplitude, omega, phase
):
    reference = Lissajous(amplitude=amplitude, omega=omega, phase=phase)
    reach = np.abs(reference(np.linspace(0, 30, 1001))[0]).max(axis=0)
    assert (reach <= np.multiply(amplitude, 1.01)).all()


def test_the_default_start_of_a_circle_stays_within_its_amplitude_and_acceleration():
    A, w = 0.15, 0.7
    r = Circle(amplitude=A, omega=w)(np.linspace(0, 1.5 * math.pi / w, 2001))
    assert np.abs(r[0]).max() <= A * (1 + 1e-9)
    assert np.abs(r[2]).max() <= 1.07 * A * w**2


def test_a_circle_without_start_begins_in_full_motion():
    np.testing.assert_allclose(Circle(start=0)(0.0)[0], (0, 0.15))


def test_a_negative_frequency_goes_round_the_other_way():
    t = np.linspace(0, 30, 301)
    forth, back = Circle(omega=0.5)(t), Circle(omega=-0.5)(t)
    late = t > 1.5 * math.pi / 0.5
    np.testing.assert_allclose(back[0, late], forth[0, late] * (-1, 1), atol=1e-15)


def test_a_transition_is_the_polynomial_of_degree_nine_with_four_derivatives_zero_at_both_ends():
    polynomial = np.polynomial.Polynomial((0, 0, 0, 0, 0, 126, -420, 540, -315, 70))
    s, duration = np.linspace(0, 1, 201), 2.5
    r = Transition(start=(0.2, 0), end=(0.15, 0.1), time=-1.0, duration=duration)(s * duration - 1)
    for k in range(5):
        share = polynomial.deriv(k)(s) if k else polynomial(s)
        expected = (k == 0) * np.array((0.2, 0)) + share[:, np.newaxis] * (-0.05, 0.1)
        np.testing.assert_allclose(r[k] * duration**k, expected, rtol=0, atol=1e-10)


def test_before_and_after_a_reference_stands_still_for_ever_or_keeps_its_pace():
    far = np.array((1e3, 1e6))
    for reference in (Transition(end=(0.1, 0.07)), Path(points=((0, 0), (0.05, 0.1), (0.1, 0.07)))):
        before, after = reference(-far), reference(far)
        # a path's pieces come out of a linear system: some ten roundings of lengths of 0.1 m
        np.testing.assert_allclose(before[0], np.zeros((2, 2)), rtol=0, atol=1e-14)
        np.testing.assert_allclose(after[0], ((0.1, 0.07), (0.1, 0.07)), rtol=0, atol=1e-14)
        assert not before[1:].any()
        assert not after[1:].any()
    lap = Path(closed=True, duration=8.0)
    np.testing.assert_allclose(lap(3.0 + 8.0 * far), lap(3.0 + 8.0 * np.ones(2)), atol=1e-8)


@settings(max_examples=25)
@given(reference=paths())
def test_a_path_passes_through_its_points_in_order(reference):
    t = np.linspace(0, 1 + 2 * reference.duration, 20001)
    places = reference(t)[0]
    seen = 0
    for point in reference.points:
        distance = np.hypot(*(places[seen:] - point).T)
        near = np.flatnonzero(distance < 5e-4)
        assert near.size
        seen += int(near[0])


@settings(max_examples=30)
@given(reference=paths())
def test_a_path_ends_at_rest_or_repeats_itself(reference):
    t = 1.0 + reference.duration * np.array((0.6, 1.0, 1.7))
    if reference.closed:
        again = reference(t + reference.duration)
        np.testing.assert_allclose(again, reference(t), atol=1e-9)
    else:
        r = reference(t[1:])
        np.testing.assert_allclose(r[0], np.tile(reference.points[-1], (2, 1)), atol=1e-12)
        np.testing.assert_allclose(r[1:], 0, atol=1e-9)


def test_a_path_may_shed_speed_as_soon_as_it_has_gathered_it():
    # Whether both times agree, or which is earlier by rounding, differs from one to the next.
    for time, duration in np.random.default_rng(2).uniform(4, 12, (30, 2)):
        path = Path(points=((0, 0), (0.1, 0.05)), duration=duration, time=time, ramp=duration / 2)
        r = path(time + duration * np.array((0.5, 1.0)))
        np.testing.assert_allclose(r[0], ((0.05, 0.025), (0.1, 0.05)), atol=1e-12)
        np.testing.assert_allclose(r[1, 0] * duration, (0.2, 0.1), atol=1e-12)


def test_a_path_of_two_points_is_a_straight_line():
    r = Path(points=((0, 0), (0.1, 0.05)))(np.linspace(0, 8, 101))
    np.testing.assert_allclose(r[..., 0], 2 * r[..., 1], atol=1e-12)


def test_a_step_jumps_at_its_time_without_any_derivative():
    r = Step(start=(0, 0.1), end=(0.15, -0.1), time=2.0)(np.array((1.999, 2.0, 9.0)))
    np.testing.assert_array_equal(r[0], ((0, 0.1), (0.15, -0.1), (0.15, -0.1)))
    assert not r[1:].any()


def test_what_a_reference_returns_can_be_changed_without_changing_the_reference():
    for reference in ALL:
        reference(3.0)[:] = 7.0
        assert np.abs(reference(3.0)).max() < 1
