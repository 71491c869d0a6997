"""What every test of the package may use."""

import pytest

from controllers import catalog


@pytest.fixture(autouse=True, scope="module")
def pictures(quick_pictures):
    """None of these tests looks at how a picture is laid out."""


@pytest.fixture(autouse=True, scope="module")
def own_classes():
    """Laws, observers and references that a test gives as objects are forgotten afterwards."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(catalog, "_registered", {})
        catalog.forget()
        yield
    catalog.forget()
