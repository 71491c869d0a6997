"""`twin.shadow.possible`: a change that cannot be is no alarm, and any other is found as before."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from twin.identify.logs import MECHANISM_LAG
from twin.scenario import load
from twin.shadow import alarms
from twin.shadow.alarms import CHANGE_TEST, statistic
from twin.shadow.belief import WATCHED_PARAMETERS, Belief
from twin.shadow.evidence import Evidence, log_evidence
from twin.shadow.possible import Limit, limits_of, log_possible

CHANGE_WINDOW = 20


def believed(*settings):
    log = SimpleNamespace(own_lag=MECHANISM_LAG, grips=(0.0,))
    return Belief.of(load("excite", settings), log)


@pytest.mark.parametrize("m", [-0.6, 0.3])
@pytest.mark.parametrize("b", [-9.0, 4.0])
def test_in_one_dimension_it_is_the_integral_over_the_truncated_prior(m, b):
    A, V, least = 7.0, 0.4, -0.2
    d = np.linspace(least, 8, 400_001)
    prior = np.exp(-((d - m) ** 2) / (2 * V))
    exact = np.trapezoid(np.exp(b * d - A * d**2 / 2) * prior, d) / np.trapezoid(prior, d)
    one = np.ones((1, 1))
    args = (A * one, b * one[0], V * one, m * one[0])
    found = log_evidence(*args) + log_possible(*args, Limit(one[0], least))
    assert found == pytest.approx(np.log(exact), abs=1e-7)


@pytest.mark.parametrize("least", [-1.5, 0.1])
def test_in_two_dimensions_it_is_the_integral_over_the_truncated_prior(least):
    A = np.array([[5.0, 2.0], [2.0, 3.0]])
    V = np.array([[0.5, -0.2], [-0.2, 0.8]])
    b, m, weights = np.array([-4.0, 1.5]), np.array([0.2, -0.1]), np.array([0.6, 0.8])
    # across and along the limit, a unit of either being a unit of d
    nodes, shares = np.polynomial.legendre.leggauss(100)
    across, along = least + (6 - least) * (nodes + 1) / 2, 6 * nodes
    d = across[:, None, None] * weights + along[:, None] * np.array([-0.8, 0.6])
    off = d - m
    prior = np.exp(-np.einsum("...i,ij,...j", off, np.linalg.inv(V), off) / 2)
    likelihood = np.exp(d @ b - np.einsum("...i,ij,...j", d, A, d) / 2)
    total, possible = (shares @ each @ shares for each in (likelihood * prior, prior))
    found = log_evidence(A, b, V, m) + log_possible(A, b, V, m, Limit(weights, least))
    assert found == pytest.approx(np.log(total / possible), abs=1e-7)


def test_a_limit_is_where_ratio_lag_and_gap_are_at_their_least():
    belief = believed(
        "plant.friction.breakaway_ratio=1.3",
        "plant.servo.bandwidth_hz=10",
        "plant.servo.backlash_deg=0.1",
    )
    off = dict.fromkeys(WATCHED_PARAMETERS, 0.0)
    off |= {"breakaway": -0.3, "lag": -1 / (2 * np.pi * 10), "narrow_play": -2.0}  # of 0.05 deg
    d = np.array([*off.values()])
    for limit in limits_of(belief).values():
        assert limit.weights @ d == pytest.approx(limit.least)
        assert limit.least < 0


def test_a_belief_is_possible_even_where_it_is_below_the_limit():
    belief = believed()
    belief.values["breakaway"] = 0.9
    assert limits_of(belief)["breakaway"].least == 0


def windows_of(seen, change, information):
    """A minute of windows that show d along one direction, which changes after a third of them."""
    spans = np.stack((np.arange(60.0), np.arange(1.0, 61.0)), axis=-1)
    off = np.where(np.arange(60) >= CHANGE_WINDOW, change, 0.0)
    A = np.tile(information * np.outer(seen, seen), (60, 1, 1))
    return Evidence.of(WATCHED_PARAMETERS, spans, A, information * off[:, None] * seen)


@pytest.mark.parametrize(
    ("cause", "change", "information"),
    [
        ("breakaway", 1.8, 30.0),
        ("servo lag", 0.012, 4e5),
        ("lost motion", np.radians(0.4), 1e6),
    ],
)
def test_only_a_possible_change_is_an_alarm_and_no_later_than_without_a_limit(
    monkeypatch, cause, change, information
):
    belief = believed(
        "plant.friction.breakaway_ratio=1.05",
        "plant.servo.bandwidth_hz=150",
        "plant.servo.backlash_deg=0.02",
    )
    seen = limits_of(belief)[cause].weights
    less, more = (windows_of(seen, sign * change, information) for sign in (-1, 1))

    def alarmed(windows):
        return np.flatnonzero(statistic(windows, belief) > CHANGE_TEST.threshold_llr)

    assert not len(alarmed(less))
    first = alarmed(more)[0]
    monkeypatch.setattr(alarms, "limits_of", lambda _: {})
    assert len(alarmed(less))
    assert CHANGE_WINDOW <= first <= alarmed(more)[0]
