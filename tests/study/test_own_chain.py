"""`twin.study.compiled`: The page of the first excitation and the cure counts what it says."""

from __future__ import annotations

from docs import own_chain as page


def test_an_owner_knows_the_rig_s_file_but_not_what_was_drawn():
    (rig,) = page.drawn("hobby", 1)
    assert rig.known == ("parameters=hobby",)
    runs = [page.scenario_of(name, rig) for name in ("excite", "cure")]
    assert runs[0].plant.friction == runs[1].plant.friction
    owner = page.scenario_of("cure", page.Rig("hobby", ()))
    assert runs[1].plant.friction != owner.plant.friction
    assert (runs[1].controller, runs[1].observer) == (owner.controller, owner.observer)


def test_a_lost_ball_is_not_kept_and_an_error_beyond_the_goal_is_not_cured(monkeypatch):
    errors = [page.GOAL_PERCENT, page.GOAL_PERCENT + 0.01, None]
    rows = [
        {"outcome": outcome, "reason": "ball off the plate", "tracking_error_percent": error}
        for outcome, error in zip(("finished", "finished", "fault"), errors, strict=True)
    ]
    monkeypatch.setattr(page, "scenario_of", lambda *_: None)
    monkeypatch.setattr(page, "known", lambda _: rows)
    found = page.found_of([page.Rig("hobby", ())] * 3)
    assert (found.kept, found.cured, found.errors) == (2, 1, errors)


def test_none_of_n_has_the_interval_that_is_known_in_closed_form():
    upper = 100 * (1 - 0.025 ** (1 / 50))
    assert page.share(0, 50) == f"0 of 50 (0 to {upper:.0f} %)"
