"""What a command line that a page or a help shows is taken for."""

import shlex

import click


def parsed(ballplate, line):
    """The command of a line of that group, and what click reads of it; runs nothing."""
    name, *words = shlex.split(line.split(" > ")[0], comments=True)
    command = ballplate.get_command(click.Context(ballplate), name)
    assert command is not None, f"no command {name}"
    if isinstance(command, click.Group):
        name, *words = words
        command = command.commands[name]
    return command, command.make_context(name, words).params
