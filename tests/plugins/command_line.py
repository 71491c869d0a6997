"""Calls the command line as a shell does."""

from functools import partial

import pytest

from twin.cli import main


def called(capsys, *arguments):
    """The exit code of a command, what it prints, and its errors."""
    with pytest.raises(SystemExit) as caught:
        main(list(map(str, arguments)))
    return caught.value.code, *capsys.readouterr()


@pytest.fixture
def ballplate(capsys, tmp_path, monkeypatch):
    """Calls the command line in an empty folder; its code, output and errors."""
    monkeypatch.chdir(tmp_path)
    return partial(called, capsys)
