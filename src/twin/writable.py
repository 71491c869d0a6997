"""Whether results can be written where they are to go."""

from __future__ import annotations

from pathlib import Path

from twin.errors import ScenarioError


def check_writable(folder: Path, option: str = "--out") -> None:
    """Check before the work that the results can be written; nothing is left of the check.

    Args:
        folder: Where they go; it need not exist.
        option: The option that named it.

    Raises:
        ScenarioError: If the folder cannot be made or written.
    """
    above = [each for each in (folder, *folder.parents) if not each.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        probe = folder / ".writable"
        probe.touch()
        probe.unlink()
        for each in above:
            each.rmdir()
    except OSError as error:
        raise ScenarioError(f"{option} {folder}: cannot be written: {error.strerror}") from error
