import pytest
from command_line import ballplate

from controllers import catalog
from controllers.catalog import ADDED, forget
from twin.cli import main


@pytest.fixture
def ballplate(capsys, tmp_path, monkeypatch):
    """Calls the command line in an empty folder; its code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(list(map(str, arguments)))
        out, err = capsys.readouterr()
        return caught.value.code, out, err

    return call


@pytest.fixture
def own_laws(monkeypatch):
    """What is taken in of one's own laws is forgotten afterwards."""
    monkeypatch.setenv(ADDED, "")
    monkeypatch.setattr(catalog, "_registered", {})
    forget()
    yield
    forget()
