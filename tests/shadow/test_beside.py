"""Many logs at once say what each says alone, and nothing is replayed that is known already."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin.identify.levenberg_marquardt import SETTLED, fit_starts
from twin.identify.prepare import prepare
from twin.identify.problem import Problem
from twin.scenario import load
from twin.shadow.ball import Expansion, ball_evidence, ball_windows
from twin.shadow.belief import believed
from twin.shadow.evidence import Evidence
from twin.shadow.horizon import Replays, replays
from twin.shadow.injections import logs

OTHER = (
    "plant.friction.rolling_mm=0.25",
    "plant.friction.breakaway_ratio=1.4",
    "sensors.touch.dead_time=0.045",
    "plant.surface.spread_percent=10",
)


@pytest.fixture(scope="module")
def recorded():
    """Two rigs with their twins: the log as it can be used, the belief, and the windows."""
    common = ("plant.kind=lagrange", "duration=6", "seed=5", "plant.friction.breakaway_ratio=1.2")
    rigs = [load("excite", common), load("excite", (*common, *OTHER))]
    found = []
    for log in logs([(each, each) for each in rigs]):
        belief, clean = believed(log), prepare(log)
        found.append((clean, belief, ball_windows(clean, belief, np.zeros((0, 2)))[0]))
    return found


def test_evidence_of_several_twins_is_that_of_each_alone(recorded):
    (_, one, first), (_, other, second) = recorded
    shifted = one.theta[0] * [1.3, *np.ones(one.theta.size - 1)]
    wanted = [Expansion(first, one), Expansion(second, other), Expansion(first, one, shifted)]
    alone = [ball_evidence([each])[0] for each in wanted]
    for together, each in zip(ball_evidence(wanted), alone, strict=True):
        for name in ("begin", "end", "information", "score", "height", "dispersion"):
            known = getattr(each, name)
            assert getattr(together, name) == pytest.approx(known, rel=1e-6, abs=1e-9)
    assert isinstance(alone[0], Evidence)
    assert not np.allclose(alone[0].score, alone[2].score)


def test_replays_of_several_logs_are_those_of_each_alone(recorded, monkeypatch):
    some = [(log, belief, np.zeros((0, 2))) for log, belief, _ in recorded]
    alone = [replays([each], 1.0, 1.0)[0] for each in some]
    monkeypatch.setattr("twin.shadow.beside.AT_ONCE", 3)  # in portions that end within a log
    for together, each in zip(replays(some, 1.0, 1.0), alone, strict=True):
        assert isinstance(together, Replays)
        for name in ("time", "error", "spread", "told", "path"):
            known = getattr(each, name)
            assert getattr(together, name) == pytest.approx(known, rel=1e-6, abs=1e-9, nan_ok=True)


@pytest.mark.parametrize(
    "other",
    [
        lambda belief: replace(belief, grip=0.2),
        lambda belief: replace(belief, model=replace(belief.model, inertia=4e-6)),
    ],
    ids=["grip", "ball"],
)
def test_twins_that_differ_in_what_a_batch_has_once_are_replayed_apart(recorded, other):
    (clean, belief, _), _ = recorded
    some = [(clean, each, np.zeros((0, 2))) for each in (belief, other(belief))]
    alone = [replays([each], 1.0, 1.0)[0] for each in some]
    assert not np.allclose(alone[0].error, alone[1].error, rtol=1e-6, equal_nan=True)
    for together, each in zip(replays(some, 1.0, 1.0), alone, strict=True):
        assert together.error == pytest.approx(each.error, rel=1e-6, abs=1e-9, nan_ok=True)


def test_a_start_that_suits_is_not_looked_for_again(recorded, monkeypatch):
    _, belief, windows = recorded[1]
    problem, asked = belief.problem(windows), []
    linearise = Problem.linearise

    def counted(self, *given, **more):
        asked.append(len(self.windows))
        return linearise(self, *given, **more)

    first = problem.initial_starts()
    with monkeypatch.context() as patched:
        patched.setattr("twin.identify.levenberg_marquardt.SETTLED", 0.0)
        best = fit_starts(problem, belief.theta, first, 8)
    monkeypatch.setattr(Problem, "linearise", counted)
    found = fit_starts(problem, belief.theta[:, None].repeat(len(windows), axis=1), first, 8)
    assert asked[0] == len(windows)
    assert asked[-1] < asked[0]
    assert asked == sorted(asked, reverse=True)
    reached, least = (
        problem.misfit(linearise(problem, belief.theta, starts, slopes=False).r)
        for starts in (found, best)
    )
    assert reached == pytest.approx(least, abs=3 * SETTLED)
    assert found == pytest.approx(best, abs=1e-3)
