import pytest

from twin.cli import main


@pytest.fixture
def ballplate(capsys, tmp_path, monkeypatch):
    """Calls the command line in an empty folder; its code, output and errors."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments):
        with pytest.raises(SystemExit) as caught:
            main(list(arguments))
        out, err = capsys.readouterr()
        return caught.value.code, out, err

    return call
