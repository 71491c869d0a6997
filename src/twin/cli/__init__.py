"""The command line ``ballplate``: exit code 0 done, 1 ended badly, 2 wrong request."""

from __future__ import annotations

import errno
import logging
import os
import signal
import sys
import warnings
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import click

from controllers import LAWS_CLOSED_VARIABLE
from twin.base.data_file import read_packaged
from twin.base.errors import LawError, TwinError, printable, shorten, suggest
from twin.base.parts import own_version

if TYPE_CHECKING:
    from twin.cli.options import Command

COMMAND_GROUPS: dict[str, dict[str, str]] = read_packaged("twin.cli", "commands.toml")
"""Groups of commands by purpose, with the place of each command."""

COMMANDS = {name: place for group in COMMAND_GROUPS.values() for name, place in group.items()}
"""Command name to where it is defined; imported only when called, to start fast."""

COMMON_COMMANDS = ("run", "compare", "explain", "sweep", "new", "report", "view", "describe")
"""The commands that are used most, in this order: the help begins with an example of each."""

LONGEST_LINE = 1000
"""Characters of a message: quoted text in it may be of any length."""


def _command(name: str) -> Command:
    module, _, place = COMMANDS[name].partition(":")
    return getattr(import_module(module), place)


class Commands(click.Group):
    """A group of commands that are imported when they are needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names of all commands, in the order of use."""
        del ctx
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """The command of a name."""
        del ctx
        return _command(cmd_name) if cmd_name in COMMANDS else None

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command of the first word, its name, and the words after it.

        Raises:
            UsageError: There is no such command.
        """
        name = args[0]
        if name not in COMMANDS and not name.startswith("-") and not ctx.resilient_parsing:
            meant = suggest(name, COMMANDS) or "; ballplate --help lists all"
            raise click.UsageError(f"No such command '{name}'{meant}")
        return super().resolve_command(ctx, args)

    def format_help_text(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what this is, and an example of each command that is used most."""
        super().format_help_text(ctx, formatter)
        with formatter.section("Most used"):
            for name in COMMON_COMMANDS:
                formatter.write_text(f"ballplate {_command(name).example}")

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write all commands by what a person wants."""
        limit = formatter.width - 4 - max(map(len, COMMANDS))
        for title, names in COMMAND_GROUPS.items():
            commands = {name: _command(name) for name in names}
            with formatter.section(title):
                formatter.write_dl(
                    [(name, each.get_short_help_str(limit)) for name, each in commands.items()]
                )


def _print_version(context: click.Context, _: click.Parameter, asked: object) -> None:
    if asked and not context.resilient_parsing:
        click.echo(f"ballplate, version {own_version()}")
        context.exit()


@click.group(
    cls=Commands,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_print_version,
    help="Show the version and exit.",
)
def ballplate() -> None:
    """A digital twin of a ball-and-plate rig; to begin: ballplate run circle."""


def main(arguments: list[str] | None = None) -> None:
    """Run the command line and exit with its code; a user's mistake is one line."""
    _end_in_order()
    # matrices here are small: further threads only wait for one, on cores that have other work
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # else mujoco looks for a screen when it is imported, in a process of its own
    os.environ["MUJOCO_GL"] = "disable"
    _have_streams()
    warnings.showwarning = _print_warning
    _tell_what_is_executed()
    if "_BALLPLATE_COMPLETE" in os.environ:  # the Tab key runs nothing of the folder it is typed in
        os.environ[LAWS_CLOSED_VARIABLE] = "yes"
    given = sys.argv[1:] if arguments is None else arguments
    if "--out=" in given or ("--out", "") in pairwise(given):
        sys.exit(_fail("--out: names no folder or file"))
    try:
        code = ballplate.main(arguments, prog_name="ballplate", standalone_mode=False)
        _warn_of_broken_files()
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
        code = 0
    except click.ClickException as error:
        code = _fail(error.format_message())
    except (click.Abort, KeyboardInterrupt) as error:
        kept = str(error.__cause__ or "")  # click has made an Abort of it
        code = _fail(f"interrupted: {kept}" if kept else "interrupted", 1)
    except TwinError as error:
        code = _fail(str(error), 1 if isinstance(error, LawError) else 2)
    except OSError as error:
        if error.errno in _BROKEN_OUTPUT_ERRORS and error.filename is None:
            sys.stdout = Path(os.devnull).open("w")  # noqa: SIM115  nothing may be written now
            sys.exit(_fail(f"standard output cannot be written: {error.strerror}", 1))
        if error.errno != errno.ENAMETOOLONG:
            raise
        code = _fail(f"'{shorten(str(error.filename))}': no file can have so long a name")
    except Exception as error:
        if _is_interrupt(error):
            sys.exit(_fail("interrupted", 1))
        catalog = sys.modules.get("controllers.catalog")
        line = catalog.locate_error(error) if catalog else None
        if line is None or sys.flags.dev_mode:
            raise
        code = _fail(line, 1)
    sys.exit(code if isinstance(code, int) else 0)


_BROKEN_OUTPUT_ERRORS = {errno.ENOSPC, errno.EDQUOT, errno.EIO, errno.EBADF}
"""Errors of writing to a full or broken standard output."""


def _is_interrupt(error: BaseException | None) -> bool:
    """Whether Ctrl-C caused an error, as one of a compiled module in the middle of its import."""
    while error is not None and not isinstance(error, KeyboardInterrupt):
        error = error.__cause__ or error.__context__
    return error is not None


def _have_streams() -> None:
    """Have somewhere to print to where whoever began this program has closed its streams."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("w"))  # noqa: SIM115  for the whole program


def _end_in_order() -> None:
    """Let a kill or a closed terminal end a command as Ctrl-C does: plate level, record kept."""
    for name in ("SIGTERM", "SIGHUP"):
        number = getattr(signal, name, None)
        if number is not None and signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, signal.default_int_handler)


def _print_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Tell a warning of some library in one line, without the line of ours that led to it."""
    click.echo(f"ballplate: warning: {' '.join(str(message).split())}", err=True)


class Once(logging.Handler):
    """Tells on standard error which files of others are run, each line once."""

    def __init__(self) -> None:
        super().__init__()
        self._told: set[str] = set()

    def emit(self, record: logging.LogRecord) -> None:
        """Tell it, before it is done."""
        line = record.getMessage()
        if line not in self._told:
            self._told.add(line)
            click.echo(f"ballplate: {printable(line)}", err=True)


def _tell_what_is_executed() -> None:
    """Have each file of others that is about to be run named once."""
    logger = logging.getLogger("ballplate.executes")
    logger.handlers[:] = [Once()]
    logger.setLevel(logging.INFO)
    logger.propagate = False


def _warn_of_broken_files() -> None:
    """Name the files of laws, observers and references that could not be imported."""
    catalog = sys.modules.get("controllers.catalog")
    if catalog is None:
        return
    for line in catalog.broken_so_far():
        click.echo(f"ballplate: warning: not imported: {printable(line)}", err=True)


def _fail(message: str, code: int = 2) -> int:
    line = " ".join(message.split())
    shown = line if len(line) <= LONGEST_LINE else f"{line[:LONGEST_LINE]}..."
    click.echo(f"ballplate: {printable(shown)}", err=True)
    return code
