"""What every test of the package may use."""

import pytest


@pytest.fixture(autouse=True, scope="module")
def pictures(quick_pictures):
    """None of these tests looks at how a picture is laid out."""
