"""What chapters 5 and 6.2.1 of the thesis claim about the system, derived anew: writes claims.md.

uv run python docs/claims.py

The fields f, g1 and g2 are typed in from (5.9) and compared with the twin's model; brackets, Lie
derivatives, the normal form and its zeros are derived from them with sympy.
"""

from __future__ import annotations

import itertools
from math import degrees, radians
from typing import Any

import numpy as np
import sympy as sp
from pages import HERE, filled, write

from controllers.arrays import Array
from controllers.ballplate import BallPlate

MODEL = BallPlate()
X = x1, x2, x3, x4, x5, x6, x7, x8 = sp.symbols("x1:9")
U = sp.symbols("u1:3")
C1, C2, C3, D, G = LETTERS = sp.symbols("c1 c2 c3 d g", positive=True)
NUMBERS = dict(zip(LETTERS, (MODEL.c1, MODEL.c2, MODEL.c3, MODEL.d, MODEL.gravity), strict=True))
TILT, TURN = radians(10), radians(35)
OPERATING = np.array((0.25, 0.25, TILT, TURN, 0.15, 0.25, TILT, TURN))
"""Bounds of the state in operation: area, plate angle and rate of chapter 3; ball to 0.25 m/s."""
ZERO = 1e-10
"""Share of the largest singular value below which one counts as zero; real zeros are at 1e-16."""


def fields() -> tuple[Any, Any, Any]:
    """f, g1, g2 of (5.9) as columns, typed in from the thesis."""
    s, c = sp.sin(x3), sp.cos(x3)
    turning = -D / 2 * x8**2 * sp.sin(2 * x3) + x1 * x8**2 * s**2 + 2 * x6 * x8 * s + x1 * x4**2
    coupling = -C3 * x4 * x8 * s - 2 * x1 * x4 * x8 * c - 2 * x2 * x8 * s + x5 * x8**2
    f2 = C1 * (turning + G * s * sp.cos(x7))
    f6 = C1 * (coupling - G * sp.sin(x7))
    f = sp.Matrix([x2, f2, x4, 0, x6, f6, x8, 0])
    g1 = sp.Matrix([0, -C2, 0, 1, 0, 0, 0, 0])
    g2 = sp.Matrix([0, C1 * x5 * s, 0, 0, 0, -C1 * x1 * s + C2 * c, 0, 1])
    return f, g1, g2


def bracket(a: Any, b: Any) -> Any:
    """The bracket [a, b]; ad_f g with the sign of (5.28) is ``bracket(g, f)`` here."""
    return a.jacobian(X) * b - b.jacobian(X) * a


def controllability(order: int = 3) -> Any:
    """Q of (5.27): g1, g2, ad_f g1, ... up to an order, shape (8, 2 (order + 1))."""
    f, *columns = fields()
    for _ in range(order):
        columns += [bracket(g, f) for g in columns[-2:]]
    return sp.Matrix.hstack(*columns)


def observability(outputs: tuple[int, ...], order: int) -> Any:
    """O of (5.19) for measured states, with Lie derivatives up to an order, input u."""
    f, g1, g2 = fields()
    blocks = [sp.Matrix([X[i] for i in outputs])]
    for _ in range(order):
        blocks.append(blocks[-1].jacobian(X) * (f + g1 * U[0] + g2 * U[1]))
    return sp.Matrix.vstack(*(block.jacobian(X) for block in blocks))


def at(matrix: Any, states: Array) -> Array:
    """A matrix at states of shape (K, 8) and u = 0, shape (K, rows, columns)."""
    found = sp.lambdify((X,), matrix.subs(NUMBERS).subs(dict.fromkeys(U, 0)), cse=True)
    return np.array([found(state) for state in states], float)


def rank(matrices: Array, *, columns_are_states: bool = False) -> tuple[Array, float]:
    """Ranks by singular values, states in units of the operating range, and the weakest share."""
    scaled = matrices * OPERATING if columns_are_states else matrices / OPERATING[:, None]
    values = np.linalg.svd(scaled, compute_uv=False)
    shares = values / values[:, :1]
    return (shares > ZERO).sum(axis=1), float(shares[shares > ZERO].min())


def operating_grid() -> Array:
    """Lower bound, middle and upper bound of every state, shape (2916, 8).

    Without negative x or y, which are mirror images: the model does not change with the signs of
    x, x', phi, phi' together, nor with those of y, y', theta, theta'.
    """
    levels = [(0, 1) if state in (0, 4) else (-1, 0, 1) for state in range(8)]
    return np.array(list(itertools.product(*levels))) * OPERATING


CASES = (
    ("theta = pi/2, phi = phi' = theta' = 0", {2: 0, 3: 0, 6: 0.5, 7: 0}, 4,
     "for every position and velocity of the ball"),
    ("phi = pi/2, phi' = theta' = 0", {2: 0.5, 3: 0, 7: 0}, 6,
     "for every theta and ball; but * = 0 and diamond = 0 only with the ball at 0"),
    ("theta = pi/2, phi' = theta' = 0, phi = 0.1", {2: 0.1 / np.pi, 3: 0, 6: 0.5, 7: 0}, 8,
     "an 'other case' of the thesis, yet singular for every phi"),
    ("theta = -pi/2, phi = phi' = theta' = 0", {2: 0, 3: 0, 6: -0.5, 7: 0}, 8,
     "the mirror image of the first case"),
    ("phi = -pi/2, phi' = theta' = 0", {2: -0.5, 3: 0, 7: 0}, 8,
     "the mirror image of the second case"),
    ("theta = pi/2, the plate moving", {6: 0.5}, 8, "for nearly every motion"),
    ("phi = pi/2, the plate moving", {2: 0.5}, 8, "for nearly every motion"),
)  # fmt: skip
"""Conditions after (5.29): words, angles in pi and rates, the thesis's rank of Q, a note."""

Claim = tuple[str, str, str, str, bool | None, str]
"""Equation, quantity, thesis, found, whether they agree (None: the thesis has nothing), note."""


def claim(equation: str, quantity: str, thesis: str, found: Any, note: str = "") -> Claim:
    """A claim that holds if what is found reads as in the thesis."""
    agrees = str(found) == thesis if thesis else None
    return equation, quantity, thesis, str(found), agrees, note


def claims() -> list[Claim]:
    """Every claim of chapters 5 and 6.2.1 beside what holds."""
    f, g1, g2 = fields()
    states = np.random.default_rng(0).uniform(-1, 1, (20, 8)) * OPERATING
    inputs = sp.Matrix.hstack(g1, g2)
    assert np.allclose(at(f, states)[..., 0], MODEL.f(states))
    assert np.allclose(at(inputs, states), MODEL.g(states))
    return [*_ranks(), *_rest(f, inputs), *_normal_form(f, g1, g2)]


def _ranks() -> list[Claim]:
    grid, Q = operating_grid(), controllability()  # noqa: N806
    low, _ = rank(at(observability((0, 2, 4, 6), 1), grid), columns_are_states=True)
    ball, ball_weak = rank(at(observability((0, 4), 3), grid), columns_are_states=True)
    whole, weak = rank(at(Q, grid))
    found = [
        claim("5.21", "rank of O over the operating range", "8", low.min(),
              "already the outputs and their first derivative give it"),
        claim("7.9", "rank of O from the ball's position alone", "", ball.min(),
              f"with 3 derivatives; weakest direction {ball_weak:.2g} of the strongest"),
        claim("5.29", "row of x in Q, columns ad_f g1, ad_f g2, at x' = y' = 0, no turning",
              "*, c2", ", ".join(str(sp.simplify(Q[0, k])) for k in (2, 3)),
              "printed in swapped columns"),
        claim("5.29", "rank of Q over the operating range", "8", whole.min(),
              f"by ad_f^3 already; weakest direction {weak:.2g} of the strongest"),
    ]  # fmt: skip
    for condition, fixed, thesis, note in CASES:
        x = np.random.default_rng(0).uniform(-1, 1, (20, 8)) * OPERATING
        for index, value in fixed.items():
            x[:, index] = np.pi * value
        ranks = ", ".join(map(str, np.unique(rank(at(Q, x))[0])))
        found.append(claim("5.29", f"rank of Q at {condition}", f"{thesis}", ranks, note))
    return found


def _rest(f: Any, inputs: Any) -> list[Claim]:
    still = {x2: 0, x4: 0, x6: 0, x8: 0}
    turned = f.subs(still).subs(
        {x3: sp.Symbol("k", integer=True) * sp.pi, x7: sp.Symbol("n", integer=True) * sp.pi}
    )
    level = still | {x3: 0, x7: 0}
    A, B = f.jacobian(X).subs(level), inputs.subs(level)  # noqa: N806
    ball = (A.free_symbols | B.free_symbols) & set(X)
    poles = sorted(A.subs({x1: 0, x5: 0}).eigenvals().items())
    return [
        claim("5.33", "f at rest, phi and theta multiples of pi, ball anywhere", "0",
              0 if turned.is_zero_matrix else turned,
              "phi and theta each with a k of its own; within 10 deg only the level plate"),
        claim("5.35", "states that A and B on the level plate depend on", "none",
              ", ".join(map(str, ball)) or "none"),
        claim("5.35b", "B[6, 2]", "-c2", B[5, 1],
              f"+c2 = {MODEL.c2:.5f} m holds, and (6.7b) uses it"),
        claim("5.35", "open-loop poles", "",
              ", ".join(f"{pole} ({count} times)" for pole, count in poles),
              "two chains of four integrators"),
    ]  # fmt: skip


def _normal_form(f: Any, g1: Any, g2: Any) -> list[Claim]:
    inputs = sp.Matrix.hstack(g1, g2)
    accelerations = sp.Matrix([x2, x6]).jacobian(X)
    decoupling = accelerations * inputs
    degree = "2, 2" if all(decoupling[i, :].norm() != 0 for i in (0, 1)) else "?"
    determinant = np.abs(at(decoupling.det() * sp.ones(1, 1), operating_grid()))
    commute = sp.simplify(bracket(g1, g2))
    still = {x1: 0, x2: 0, x5: 0, x6: 0}
    u = sp.simplify(decoupling.subs(still).solve(-(accelerations * f).subs(still)))
    rates = sp.Matrix([x4, u[0], x8, u[1]])
    eta = (x3, x4, x7, x8)
    A = rates.jacobian(eta).subs(dict.fromkeys(eta, 0))  # noqa: N806
    zeros = sorted((float(z) for z in A.subs(NUMBERS).eigenvals()), reverse=True)
    formula = (np.sqrt(MODEL.gravity / MODEL.c4), np.sqrt(MODEL.c1 / MODEL.c2 * MODEL.gravity))
    slip = np.sqrt(MODEL.c1 / MODEL.c2)
    angle = degrees(np.arctan(MODEL.c4 / 0.25))
    return [
        claim("6.16", "relative degree of x, y", "2, 2", degree),
        claim("6.19", "rank of A(x) over the operating range", "2",
              2 if determinant.min() > 1e-6 else "less",
              f"abs(det A) {determinant.min():.3g} to {determinant.max():.3g} m²; zero where "
              f"tan(phi) = c4/x, at x = 0.25 m for phi = {angle:.1f} deg"),
        claim("6.25", "bracket of g1, g2", "0", 0 if commute.is_zero_matrix else commute,
              "so internal coordinates exist"),
        claim("6.30", "L_g1 of the exponent of tau5, k1 and k2 of (6.41)", "0",
              f"{-(MODEL.c2 * MODEL.k1 + MODEL.c1):.3f}", "a solution only with k1 = 1, k2 = -c2"),
        claim("6.38", "A_n[2, 1]", "c1/c2", A[1, 0],
              f"printed without g, which would give ±{slip:.3f} 1/s; (6.39) has it"),
        ("6.39", "eigenvalues of the zero dynamics in 1/s",
         ", ".join(f"±{value:.4f}" for value in formula),
         ", ".join(f"{value:+.4f}" for value in zeros),
         bool(np.allclose(np.abs(zeros), formula[0]) and np.isclose(*formula)),
         "±sqrt(g/c4) and ±sqrt(c1 g/c2), which coincide, c1/c2 being 1/c4: not minimum phase"),
    ]  # fmt: skip


def page(found: list[Claim]) -> str:
    """The page."""
    return filled("claims", claims=found)


if __name__ == "__main__":
    write(HERE / "claims.md", page(claims()))
