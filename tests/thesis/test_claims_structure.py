import math

import numpy as np
import pytest
import sympy as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from controllers.ballplate import BallPlate
from twin.thesis.claims.structure import (
    OPERATING,
    SINGULAR_CASES,
    controllability,
    determinant_at_rest,
    observability,
    operating_grid,
    rank,
)
from twin.thesis.claims.taylor import flow

MODEL = BallPlate()
X = sp.symbols("x1:9")
C1, C2, C3, D, G = sp.symbols("c1 c2 c3 d g", positive=True)
U = sp.symbols("u1:3")
VALUES = (
    (C1, MODEL.c1),
    (C2, MODEL.c2),
    (C3, MODEL.c3),
    (D, MODEL.d),
    (G, MODEL.gravity),
)


@pytest.fixture(scope="module")
def fields() -> tuple[sp.Matrix, sp.Matrix, sp.Matrix]:
    """f, g1, g2 of (5.9), typed in from the thesis."""
    x1, x2, x3, x4, x5, x6, x7, x8 = X
    s, c = sp.sin(x3), sp.cos(x3)
    f2 = C1 * (
        -D / 2 * x8**2 * sp.sin(2 * x3)
        + x1 * x8**2 * s**2
        + 2 * x6 * x8 * s
        + x1 * x4**2
        + G * s * sp.cos(x7)
    )
    f6 = C1 * (
        -C3 * x4 * x8 * s - 2 * x1 * x4 * x8 * c - 2 * x2 * x8 * s + x5 * x8**2 - G * sp.sin(x7)
    )
    f = sp.Matrix([x2, f2, x4, 0, x6, f6, x8, 0])
    g1 = sp.Matrix([0, -C2, 0, 1, 0, 0, 0, 0])
    g2 = sp.Matrix([0, C1 * x5 * s, 0, 0, 0, -C1 * x1 * s + C2 * c, 0, 1])
    return f, g1, g2


@pytest.fixture(scope="module")
def brackets(fields) -> sp.Matrix:
    """g1, g2, ad_f g1, ... ad_f^3 g2 by (5.28)."""
    f, *columns = fields
    for _ in range(3):
        for g in columns[-2:]:
            columns.append(g.jacobian(X) * f - f.jacobian(X) * g)
    return sp.Matrix.hstack(*columns)


def random_states(count, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 8))


@pytest.mark.long
def test_taylor_coefficients_give_the_brackets_of_5_28(brackets):
    exact = sp.lambdify((X,), brackets.subs(VALUES))
    factorials = np.repeat([math.factorial(k) for k in range(4)], 2)
    for x in random_states(5):
        found = controllability(MODEL, x, order=3) * factorials
        assert np.allclose(found, exact(x), rtol=1e-12, atol=1e-11)


@pytest.mark.long
def test_taylor_coefficients_give_the_lie_derivatives_of_5_18(fields):
    f, g1, g2 = fields
    F = f + g1 * U[0] + g2 * U[1]
    blocks = [sp.Matrix([X[0], X[2], X[4], X[6]])]
    for _ in range(3):
        blocks.append(blocks[-1].jacobian(X) * F)
    O = sp.Matrix.vstack(*(block.jacobian(X) for block in blocks))  # noqa: E741
    exact = sp.lambdify((X, U), O.subs(VALUES))
    factorials = np.repeat([math.factorial(k) for k in range(4)], 4)[:, np.newaxis]
    for x in random_states(5, seed=1):
        found = observability(MODEL, x, order=3, u=(0.7, -1.3)) * factorials
        assert np.allclose(found, exact(x, (0.7, -1.3)), rtol=1e-12, atol=1e-11)


def test_the_taylor_series_of_the_flow_is_the_solution_of_the_differential_equation():
    x, u, t = random_states(1)[0], (0.5, -0.4), 0.02
    end = solve_ivp(
        lambda _, x: MODEL.derivative(x, np.array(u)), (0, t), x, rtol=1e-13, atol=1e-14
    ).y[:, -1]
    powers = t ** np.arange(9)
    assert np.allclose(powers @ flow(MODEL, x, 8, u).x, end, rtol=0, atol=1e-12)


@pytest.mark.long
def test_the_determinant_of_a_resting_plate_has_the_closed_form(brackets):
    c1, g = C1, G
    form = c1**4 * g**4 * (1 - c1 * sp.sin(X[2]) ** 2) ** 2
    form *= sp.cos(X[2]) ** 2 * sp.cos(X[6]) ** 4
    at_rest = brackets.subs({X[3]: 0, X[7]: 0})
    assert sp.simplify(at_rest.det(method="berkowitz") - form) == 0


def test_the_numerical_determinant_is_the_closed_form():
    x = random_states(20, seed=2)
    x[:, [3, 7]] = 0
    scale = np.prod([math.factorial(k) for k in range(4)]) ** 2
    found = np.linalg.det(controllability(MODEL, x, order=3)) * scale
    assert np.allclose(found, determinant_at_rest(MODEL, x), rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize(
    ("fixed", "expected"),
    [
        ({X[2]: 0, X[6]: sp.pi / 2}, 4),
        ({X[2]: sp.pi / 2}, 6),
        ({X[6]: sp.pi / 2}, 6),
        ({X[2]: 0, X[6]: 0}, 8),
    ],
)
def test_symbolic_ranks_at_rest_hold_for_any_ball(brackets, fixed, expected):
    at_rest = brackets.subs({X[3]: 0, X[7]: 0, **fixed}).applyfunc(sp.simplify)
    assert at_rest.rank() == expected


@pytest.mark.long
@pytest.mark.parametrize("case", SINGULAR_CASES[:5], ids=lambda case: case.condition)
def test_numerical_ranks_with_all_brackets_are_the_symbolic_ones(case, brackets):
    exact = {index: sp.nsimplify(value / math.pi) * sp.pi for index, value in case.fixed.items()}
    if case.fixed.get(2) == 0.1:
        exact[2] = sp.Rational(1, 10)
    at_point = brackets.subs({X[i]: value for i, value in exact.items()}).subs(VALUES[3:])
    symbolic = at_point.applyfunc(sp.simplify).rank()
    assert case.ranks(MODEL) == [symbolic]


def test_the_operating_range_is_observable_and_controllable_everywhere():
    grid = operating_grid()
    O = observability(MODEL, grid, order=1)  # noqa: E741
    assert (rank(O, columns_are_states=True).rank == 8).all()
    assert (rank(controllability(MODEL, grid, order=3)).rank == 8).all()


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([slice(0, 4), slice(4, 8)]))
def test_mirrored_states_have_the_same_rank(seed, group):
    x = np.random.default_rng(seed).uniform(-1, 1, 8) * OPERATING
    mirrored = x.copy()
    mirrored[group] *= -1
    both = rank(controllability(MODEL, np.array([x, mirrored]), order=3)).weakest
    assert np.isclose(*both, rtol=1e-9)
