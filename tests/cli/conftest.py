import pytest
from command_line import ballplate  # noqa: F401  a fixture

from controllers import catalog
from controllers.catalog import ADDED_FILES_VARIABLE, forget


@pytest.fixture
def own_laws(monkeypatch):
    """What is taken in of one's own laws is forgotten afterwards."""
    monkeypatch.setenv(ADDED_FILES_VARIABLE, "")
    monkeypatch.setattr(catalog, "_registered", {})
    forget()
    yield
    forget()
