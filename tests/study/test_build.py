"""Scenarios of a study's points."""

from __future__ import annotations

import pytest

from twin.errors import ScenarioError
from twin.study.work import Builder


def test_a_law_that_says_nothing_of_a_key_has_its_default() -> None:
    build = Builder("circle")
    fixed = ("controller.kind=tvlqr",)
    assert build.value(fixed, "controller.Q.1") == 2000.0
    assert build.value((*fixed, "controller.Q=[1.0, 2.0, 3.0, 4.0]"), "controller.Q.1") == 2.0
    changed = build(fixed, {"controller.Q.1": 0.5}, {"controller.Q.1"})
    assert changed.controller.settings["Q"] == [20000.0, 1000.0, 100.0, 10.0]


def test_what_a_law_must_be_told_has_no_default() -> None:
    with pytest.raises(ScenarioError, match=r"controller\.frequency: not given"):
        Builder("circle").value(("controller.kind=tvlqr",), "controller.frequency")
