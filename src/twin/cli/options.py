"""Options that several commands have, and the check of where they write."""

from __future__ import annotations

from pathlib import Path

import click

from twin.errors import ScenarioError

SETTING = click.option(
    "--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Change a key of the scenario."
)
PLANT = click.option(
    "--plant",
    type=click.Choice(["mujoco", "lagrange"]),
    help="The mechanism, or the exact equations.",
)
JSON = click.option("--json", "as_json", is_flag=True, help="Print JSON and nothing else.")


def check_writable(folder: Path, option: str = "--out") -> None:
    """Find out before the work whether the results can be kept.

    Args:
        folder: Where they go; made if it does not exist.
        option: What named it.

    Raises:
        ScenarioError: If the folder cannot be made or written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
    except OSError as error:
        raise ScenarioError(f"{option} {folder}: cannot be written: {error.strerror}") from error
