"""`twin.thesis`.

The page on chapters 5 and 6.2.1: what it derives, beside what the errata and the model say."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigvals

from controllers.ballplate import BallPlate
from docs import claims as page

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def claims():
    return page.claims()


@pytest.mark.parametrize(
    ("equation", "disagreements"),
    [
        ("5.9", 3),
        ("5.21", 0),
        ("5.29", 4),
        ("5.33", 0),
        ("5.35b", 1),
        ("6.16", 0),
        ("6.38", 1),
        ("6.39", 0),
    ],
)
def test_the_claims_disagree_with_the_thesis_where_the_errata_and_the_ranks_say(
    equation, disagreements, claims
):
    rows = [row for row in claims if row[0] == equation]
    assert rows
    assert sum(row[4] is False for row in rows) == disagreements


def test_the_committed_page_is_what_the_script_derives(claims):
    assert page.page(claims, page.costs()) == Path(page.__file__).with_suffix(".md").read_text(
        encoding="utf-8"
    )


def test_the_zeros_of_the_linear_plant_are_those_of_the_page(claims):
    A, B, _ = BallPlate().linear()
    pencil = np.block([[A, B], [np.eye(8)[[0, 4]], np.zeros((2, 2))]])
    found = eigvals(pencil, np.diag([1.0] * 8 + [0.0] * 2))
    finite = np.sort(found[np.abs(found) < 1e3].real)
    (row,) = [row for row in claims if row[0] == "6.39"]
    shown = {abs(float(word)) for word in row[3].split(", ")}
    assert np.abs(finite) == pytest.approx(np.full(4, shown.pop()), rel=1e-4)
    assert not shown
