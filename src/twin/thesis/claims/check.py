"""What chapters 5 and 6.2.1 claim about the structure of the system, beside what holds."""

# ruff: noqa: N806 - equations of the thesis in its letters

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from controllers.arrays import Array
from controllers.ballplate import MEASURED, BallPlate
from twin.thesis.claims import normal_form, structure


class Claim(NamedTuple):
    """One claim of the thesis and what was found.

    Attributes:
        equation: Its number in the thesis.
        quantity: What it is about.
        thesis: What the thesis has, or None.
        found: What holds for the model.
        agrees: Whether the two agree; None where the thesis has nothing.
        note: What else there is to say.
    """

    equation: str
    quantity: str
    thesis: str | None
    found: str
    agrees: bool | None
    note: str = ""


def check_claims(model: BallPlate | None = None) -> list[Claim]:
    """Check every claim of chapters 5 and 6.2.1 on the model."""
    m = model or BallPlate()
    return [*_observability(m), *_controllability(m), *_linearisation(m), *_normal_form(m)]


def _observability(model: BallPlate) -> list[Claim]:
    grid = structure.operating_grid()
    low = structure.rank(structure.observability(model, grid, order=1), columns_are_states=True)
    rng = np.random.default_rng(0)
    x = rng.uniform(-1, 1, (200, 8)) * structure.OPERATING
    whole = structure.observability(model, x, u=(3.0, -2.0))
    full = structure.rank(whole, columns_are_states=True)
    ball = structure.observability(model, grid, order=3, outputs=MEASURED[0::2])
    alone = structure.rank(ball, columns_are_states=True)
    least = int(min(low.rank.min(), full.rank.min()))
    return [
        Claim(
            "5.21",
            "rank of O over the operating range",
            "8",
            f"{least}",
            least == 8,
            "already the outputs and their first derivative give it",
        ),
        Claim(
            "7.9",
            "rank of O from the ball's position alone",
            None,
            f"{int(alone.rank.min())}",
            None,
            f"with 3 derivatives; weakest direction {alone.weakest.min():.2g} of the strongest",
        ),
    ]


def _controllability(model: BallPlate) -> list[Claim]:
    Q = structure.controllability(model, structure.operating_grid(), order=3)
    found = structure.rank(Q)
    least = int(found.rank.min())
    y, phi = 0.1, 0.1
    row = structure.controllability(model, np.array([0, 0, phi, 0, y, 0, 0, 0]), order=1)[0]
    swapped = np.isclose(row[2], model.c2) and np.isclose(row[3], -model.c1 * y * math.sin(phi))
    rows = [
        Claim(
            "5.29",
            "row of x in Q, columns ad_f g1, ad_f g2",
            "*, c2",
            "c2, *" if swapped else "neither",
            False,
            "printed in swapped columns; the * is -c1 y sin(phi)",
        ),
        Claim(
            "5.29",
            "rank of Q over the operating range",
            "8",
            f"{least}",
            least == 8,
            f"by ad_f^3 already; weakest direction {found.weakest.min():.2g} of the strongest",
        ),
    ]
    for case in structure.SINGULAR_CASES:
        ranks = case.ranks(model)
        rows.append(
            Claim(
                "5.29",
                f"rank of Q at {case.condition}",
                f"{case.thesis}",
                ", ".join(map(str, ranks)),
                ranks == [case.thesis],
                case.note,
            )
        )
    return rows


def _linearisation(model: BallPlate) -> list[Claim]:
    places = [(x, y) for x in (-0.25, 0, 0.25) for y in (-0.15, 0, 0.15)]
    turns = [(0, 0), (0, 1), (1, 0), (1, 1)]
    rest = np.array([normal_form.equilibrium(x, y, k) for x, y in places for k in turns])
    level = np.array([normal_form.equilibrium(x, y) for x, y in places])
    A, B, _ = model.linear()
    spread = max(np.abs(model.jacobian(level) - A).max(), np.abs(model.g(level) - B).max())
    return [
        Claim(
            "5.33",
            "largest |f| at rest, phi, theta = k pi, ball anywhere",
            "0",
            f"{np.abs(model.f(rest)).max():.1g}",
            bool(np.abs(model.f(rest)).max() < 1e-12),
            "phi and theta each with a k of its own; within 10 deg only the level plate",
        ),
        Claim(
            "5.35",
            "change of A, B with the ball's position on the level plate",
            "0",
            f"{spread:.1g}",
            bool(spread < 1e-12),
        ),
        Claim(
            "5.35b",
            "B[6, 2] in m",
            f"{-model.c2:.5f}",
            f"{B[5, 1]:.5f}",
            bool(np.isclose(B[5, 1], -model.c2)),
            "printed -c2; +c2 holds, and (6.7b) uses it",
        ),
        Claim(
            "5.35",
            "largest open-loop |pole| in 1/s",
            None,
            f"{np.abs(np.linalg.eigvals(A)).max():.1g}",
            None,
            "two chains of four integrators",
        ),
    ]


def _normal_form(model: BallPlate) -> list[Claim]:
    grid = structure.operating_grid()
    degree = normal_form.relative_degree(model, np.zeros(8))
    determinant = np.abs(normal_form.decoupling_determinant(model, grid))
    angle = math.degrees(math.atan(model.c4 / 0.25))
    bracket = np.abs(normal_form.input_bracket(model, grid)).max()
    printed = -(model.c2 * model.k1 + model.c1)
    ratio = model.c1 / model.c2
    found, formula, typo = normal_form.zeros(model)
    return [
        Claim(
            "6.16", "relative degree of x, y", "2, 2", f"{degree[0]}, {degree[1]}", degree == (2, 2)
        ),
        Claim(
            "6.19",
            "rank of A(x) over the operating range",
            "2",
            "2" if determinant.min() > 1e-6 else "less",
            bool(determinant.min() > 1e-6),
            f"|det A| {determinant.min():.3g} to {determinant.max():.3g} m²; zero where "
            f"tan(phi) = c4/x, at x = 0.25 m for phi = {angle:.1f} deg",
        ),
        Claim(
            "6.25",
            "largest component of the bracket of g1, g2",
            "0",
            f"{bracket:.1g}",
            bool(bracket < 1e-12),
        ),
        Claim(
            "6.30",
            "L_g1 of the exponent of tau5, k1 and k2 of (6.41)",
            "0",
            f"{printed:.3f}",
            False,
            "a solution only with k1 = 1, k2 = -c2; see normal_form.internal",
        ),
        Claim(
            "6.38",
            "A_n[2, 1] in 1/s²",
            f"{ratio:.3f}",
            f"{ratio * model.gravity:.3f}",
            False,
            f"printed without g, which would give ±{typo[1]:.3f} 1/s; (6.39) has it",
        ),
        Claim(
            "6.39",
            "eigenvalues of the zero dynamics in 1/s",
            _signed(formula),
            _signed(found),
            bool(np.allclose(found, formula, rtol=1e-6)),
            "both pairs coincide, c1/c2 being 1/c4: not minimum phase",
        ),
    ]


def _signed(values: Array) -> str:
    """Values that come as +- pairs, largest first."""
    half = len(values) // 2
    if not np.allclose(values[:half], -values[: -half - 1 : -1]):
        return ", ".join(f"{value:+.4f}" for value in values)
    return ", ".join(f"±{value:.4f}" for value in values[:half])
