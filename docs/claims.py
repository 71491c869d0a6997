"""What chapters 5 and 6.2.1 of the thesis claim about the system, derived anew: writes claims.md.

uv run python docs/claims.py

The fields f, g1 and g2 are typed in from (5.9) and compared with the twin's model; brackets, Lie
derivatives, the normal form and its zeros are derived from them with sympy. So is what (5.9) lacks
of Newton and Euler of a rolling sphere; what that costs is run.
"""

from __future__ import annotations

import itertools
from math import degrees, radians
from typing import Any

import numpy as np
import sympy as sp

from controllers.arrays import Array
from controllers.ballplate import BallPlate
from docs.pages import HERE, filled, write
from twin.run.finished import run
from twin.run.metrics import Ending
from twin.scenario import Scenario
from twin.scenario.derived import clean
from twin.scenario.load import load

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
    return [*_rolling(f, inputs), *_ranks(), *_rest(f, inputs), *_normal_form(f, g1, g2)]


def newton_euler() -> tuple[Any, Any, Any]:
    """x'', y'' and n' of a sphere that rolls on the plate, with its spin as the symbol s_z.

    Newton and Euler in the plate's axes, solved for the accelerations; the spin n about the normal
    is s_z seen from the plate. ``twin.sim.plant.exact`` has the same by hand.
    """
    ax, ay, n_rate = sp.symbols("ax ay n_rate")
    m, r, J, s_z = sp.symbols("m r J s_z")  # noqa: N806
    s, c = sp.sin(x3), sp.cos(x3)
    w = sp.Matrix([x8 * c, x4, x8 * s])
    w_rate = sp.Matrix([U[1] * c - x4 * x8 * s, U[0], U[1] * s + x4 * x8 * c])
    place, way = sp.Matrix([x1, x5, D]), sp.Matrix([x2, x6, 0])
    own = sp.Matrix([-x6 / r, x2 / r, s_z])
    acceleration = sp.Matrix([ax, ay, 0]) + w_rate.cross(place) + 2 * w.cross(way)
    acceleration += w.cross(w.cross(place))
    # Rx(theta) Ry(phi) turned back on gravity
    gravity = G * sp.Matrix([s * sp.cos(x7), -sp.sin(x7), -c * sp.cos(x7)])
    force = m * (acceleration - gravity)
    # rate of the third component of W; of the first two from rolling
    turning = sp.Matrix([w_rate[0] - ay / r, w_rate[1] + ax / r, n_rate]) + w.cross(w + own)
    torque = sp.Matrix([r * force[1], -r * force[0], 0])
    found = sp.solve(list(J * turning - torque), (ax, ay, n_rate))
    return found[ax], found[ay], found[n_rate]


def _rolling(f: Any, inputs: Any) -> list[Claim]:
    m, r, J, s_z = sp.symbols("m r J s_z")  # noqa: N806
    whole = m * r**2 + J
    letters = {C1: m * r**2 / whole, C2: (D * m * r**2 + J * r) / whole}
    letters[C3] = (J + 2 * D * m * r) / (m * r)
    thesis = (f + inputs * sp.Matrix(U[:2])).subs(letters)
    *accelerations, spun = newton_euler()
    lacking = [
        sp.factor(sp.simplify(found - thesis[row, 0]))
        for found, row in zip(accelerations, (1, 5), strict=True)
    ]
    locked = [str(each.subs(s_z, 0).factor()) for each in lacking]
    free = [str(sp.factor(each.coeff(s_z))) for each in map(sp.expand, lacking)]
    return [
        claim("5.9", "what Newton and Euler have more in x'', spin locked to the plate", "0",
              locked[0], "(1 - c1) w_z y', w_z = theta' sin(phi)"),
        claim("5.9", "what they have more in y''", "0", locked[1], "-(1 - c1) w_z x'"),
        claim("5.9", "coefficients of a spin s_z against the plate in x'', y''", "0, 0",
              ", ".join(free), "(1 - c1) r w_x and (1 - c1) r w_y"),
        claim("5.9", "rate of the spin about the normal, nothing resisting it", "",
              sp.simplify(spun), "the normal turns away from the ball's other rates"),
    ]  # fmt: skip


PATHS = {
    "circle of 0.15 m": (
        'reference={{kind="circle",amplitude=0.15,omega={0}}}', (0.75, 1.25, 1.75, 2.25, 2.5)),
    "line of 0.15 m along both axes": (
        'reference={{kind="sine",amplitude=[0.15,0.15],omega={0}}}', (0.75, 1.25, 1.75, 2.25, 2.5)),
    "eight of 0.15 and 0.075 m": (
        'reference={{kind="lissajous",amplitude=[0.15,0.075],omega=[{0},{1}]}}',
        (0.75, 1.0, 1.25, 1.5, 1.75)),
}  # fmt: skip
"""Reference by name, as a setting of its frequency in rad/s and twice that; and frequencies."""
STEADY, LASTS = 5.0, 10.0
"""When the ball is judged from, and until when, s."""

Cost = tuple[str, float, str, str, str, str]
"""Reference, frequency in rad/s, largest tilt in deg, distance in mm, RMS errors in mm."""


def costs() -> list[Cost]:
    """What the term costs a law that does not know it: AFL on the clean model, two equations."""
    found: list[Cost] = []
    for name, (setting, rates) in PATHS.items():
        for omega in rates:
            keys = f"duration={LASTS}", f"metrics.start={STEADY}", "rig.limits.area=[0.3,0.19]"
            way = setting.format(omega, 2 * omega)
            thesis = clean(load("circle", (*keys, "controller.kind=afl", way)))
            done = [run(each) for each in (thesis, _with_spin(thesis))]
            if any(each.outcome != Ending.FINISHED for each in done):
                found.append((name, omega, "", "the rig cannot follow", "", ""))
                break
            motions = [each.motion for each in done]
            steady = motions[0].time >= STEADY
            apart = np.hypot(*(motions[0].ball - motions[1].ball)[steady].T).max()
            errors = [np.sqrt((each.error[steady] ** 2).sum(axis=1).mean()) for each in motions]
            tilt = np.degrees(np.abs(motions[1].plate[steady]).max())
            of_thesis, of_spin = (f"{1000 * e:.3g}" for e in errors)
            found.append((name, omega, f"{tilt:.1f}", f"{1000 * apart:.2g}", of_thesis, of_spin))
    return found


def _with_spin(scenario: Scenario) -> Scenario:
    """The same on the equations of a ball whose spin is free."""
    plant = scenario.plant.model_copy(update={"ball_spin": "free"})
    return scenario.model_copy(update={"plant": plant})


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


def one_millimetre(found: list[Cost]) -> dict[str, str]:
    """By reference the frequency at which the balls are 1 mm apart, by a straight line of logs."""
    answers = {}
    for name in PATHS:
        rows = [(row[1], float(row[3])) for row in found if row[0] == name and row[4]]
        rates, apart = np.log(np.array(rows)).T
        beyond = f"beyond {rows[-1][0]:g} rad/s, where the rig ends"
        at = f"{np.exp(np.interp(0.0, apart, rates)):.2f} rad/s"
        answers[name] = at if apart[-1] >= 0 else beyond
    return answers


def page(found: list[Claim], run: list[Cost]) -> str:
    """The page."""
    gain = max(float(row[5]) - float(row[4]) for row in run if row[4])
    return filled(
        "claims",
        claims=found,
        costs=run,
        steady=f"{STEADY:g}",
        lasts=f"{LASTS:g}",
        ends=one_millimetre(run),
        gain=f"{gain:.2g}",
    )


if __name__ == "__main__":
    write(HERE / "claims.md", page(claims(), costs()))
