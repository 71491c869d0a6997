"""`twin.shadow.evidence`.

The ball's start is looked for in every window until it suits, and no longer."""

from __future__ import annotations

import numpy as np
import pytest

from twin.identify.least_squares import STEP_CONTROL, StepControl, fit_starts
from twin.identify.prepare import prepare
from twin.identify.twin_fit import TwinProblem
from twin.scenario import load
from twin.shadow import evidence
from twin.shadow.belief import belief_of, logs
from twin.shadow.evidence import ball_evidence, ball_windows
from twin.shadow.horizon import replays

NO_GAPS = np.zeros((0, 2))


@pytest.fixture(scope="module")
def log():
    """A short run on an uneven screen."""
    chosen = load(
        "excite",
        (
            *("plant.kind=lagrange", "plant.step=0.004", "rig.period=0.004"),
            *("duration=6", "seed=5"),
            "plant.surface.spread_percent=10",
        ),
    )
    return logs([(chosen, chosen)])[0]


@pytest.fixture(scope="module")
def recorded(log):
    """The twin of it, and its windows."""
    belief = belief_of(log)
    return belief, ball_windows(prepare(log), belief, NO_GAPS)[0]


@pytest.mark.long
def test_windows_in_portions_say_what_all_at_once_say(log, recorded, monkeypatch):
    belief, windows = recorded
    whole = ball_evidence(windows, belief)
    run = replays(prepare(log), belief, NO_GAPS)
    monkeypatch.setattr(evidence, "WINDOWS_AT_ONCE", 3)
    assert len(windows) % 3  # the last portion is shorter
    parts = ball_evidence(windows, belief)
    assert parts.end.tolist() == whole.end.tolist()
    assert parts.score == pytest.approx(whole.score, rel=1e-6, abs=1e-9)
    assert parts.information == pytest.approx(whole.information, rel=1e-6, abs=1e-9)
    again = replays(prepare(log), belief, NO_GAPS)
    for name in ("time", "error", "spread", "moved", "path"):
        known = getattr(run, name)
        assert getattr(again, name) == pytest.approx(known, rel=1e-6, abs=1e-9, nan_ok=True)


def test_a_start_that_suits_is_not_looked_for_again(recorded, monkeypatch):
    belief, windows = recorded
    problem, asked = belief.problem(windows), []
    linearise = TwinProblem.linearise

    def counted(self, *given, **more):
        asked.append(len(self.windows))
        return linearise(self, *given, **more)

    first = problem.initial_starts()
    best = fit_starts(problem, belief.theta, first, 8, StepControl(start_tolerance=0.0))
    monkeypatch.setattr(TwinProblem, "linearise", counted)
    found = fit_starts(problem, belief.theta, first, 8)
    assert asked[0] == len(windows)
    assert asked[-1] < asked[0]
    assert asked == sorted(asked, reverse=True)
    reached, least = (
        problem.misfit(linearise(problem, belief.theta, starts, slopes=False).r)
        for starts in (found, best)
    )
    assert reached == pytest.approx(least, abs=3 * STEP_CONTROL.start_tolerance)
    assert found == pytest.approx(best, abs=1e-3)
