"""Tests of `twin.base.errors`."""

from __future__ import annotations

import pytest

from twin.base.errors import plural


@pytest.mark.parametrize(
    ("count", "words"),
    [(0, "0 runs"), (1, "1 run"), (2, "2 runs"), (1000, "1000 runs")],
)
def test_a_number_of_things_agrees_with_its_word(count, words):
    assert plural(count, "run") == words


def test_a_word_may_have_a_plural_of_its_own():
    assert plural(1, "batch", "batches") == "1 batch"
    assert plural(3, "batch", "batches") == "3 batches"
