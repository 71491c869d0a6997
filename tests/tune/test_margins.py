"""Margins of the nominal loop that a candidate must have."""

import numpy as np
import pytest

from controllers.analysis import margins, sampled_loop, unstable
from controllers.linear import LQR
from controllers.nonlinear import AFL, SlidingMode
from controllers.observers import Kalman, Luenberger
from controllers.smith import Smith
from twin.tune.trials import loop_margins

HAND = (180.0, 162.0, 66.0, 13.0)


def test_the_least_margin_of_all_cuts_counts_and_the_loop_bears_that_much():
    law, observer = AFL(gains=HAND), Smith(observer=Luenberger(), delay=0.042)
    found = loop_margins(law, observer, dead_time=0.042)
    at_ball = margins(sampled_loop(law, observer, dead_time=0.042), "x").delay

    def stable(more):
        loop = sampled_loop(law, observer, dead_time=0.042 + more)
        return not len(unstable(loop.eigenvalues()))

    # further dead time comes in where the ball is measured; at the input less is borne
    assert stable(0.98 * at_ball)
    assert not stable(1.02 * at_ball)
    assert found.delay < at_ball


@pytest.mark.long
def test_an_unstable_loop_has_no_margin():
    found = loop_margins(AFL(gains=HAND), Luenberger(), dead_time=0.5)
    assert (found.disk, found.delay) == (0.0, 0.0)


def test_a_law_that_switches_has_none_that_could_be_told():
    found = loop_margins(SlidingMode(), Luenberger(), dead_time=0.042)
    assert (found.disk, found.delay) == (None, None)


def test_behind_an_observer_without_linearisation_the_law_is_judged_with_the_full_state():
    class Learns(Kalman):
        """Keeps what it remembers where nobody sees it."""

        def correct(self, measurement):
            x = super().correct(measurement)
            self.count = getattr(self, "count", 0) + 1
            if self.count > 1:
                self.x = np.zeros_like(x)
            return self.x

    law = LQR(rho=100.0, kappa=0.1)
    plain = loop_margins(law, Kalman(), dead_time=0.0)
    found = loop_margins(law, Learns(), dead_time=0.0)
    assert plain.observed
    assert not found.observed
    # Safonov and Athans 1977: an LQR bears half the gain, or 60 deg; sampled, nearly that
    assert found.disk == pytest.approx(1.0, abs=0.15)
    assert found.disk > plain.disk
