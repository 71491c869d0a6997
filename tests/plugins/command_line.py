"""Calls the command line as a shell does."""

import pytest

from twin.cli import main


def called(capsys, *arguments):
    """The exit code of a command, what it prints, and its errors."""
    with pytest.raises(SystemExit) as caught:
        main(list(map(str, arguments)))
    return caught.value.code, *capsys.readouterr()
