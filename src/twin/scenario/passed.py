"""The configurations of rigs that have passed ``doctor --move`` on this computer.

A small file of the user: fingerprints of rig files (`RigFile.fingerprint`), the newest last. A
change of a rig file, its cam table or its backend gives a new fingerprint. The file lies in
``$XDG_STATE_HOME/ballplate``, by default ``~/.local/state/ballplate``.
"""

from __future__ import annotations

import json
import os
from pathlib import Path

from twin.base.writing import write_whole
from twin.scenario.rig import RigFile

MOST_KEPT = 200
"""Number of configurations that are remembered."""


def passed_file() -> Path:
    """Where they are kept; it need not exist."""
    state = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    return Path(state) / "ballplate" / "doctor-passed.json"


def has_passed(rig: RigFile) -> bool:
    """Whether the doctor has moved a rig of this configuration, and found nothing wrong."""
    return rig.fingerprint in _read()


def note_result(rig: RigFile, *, passed: bool) -> None:
    """Remember what the doctor found of a rig that it moved; what fails is forgotten.

    Args:
        rig: The rig.
        passed: Whether no check failed.

    Raises:
        RecordError: If the file cannot be written.
    """
    known = [each for each in _read() if each != rig.fingerprint]
    if passed:
        known.append(rig.fingerprint)
    write_whole(passed_file(), json.dumps(known[-MOST_KEPT:], indent=1) + "\n")


def _read() -> list[str]:
    """The fingerprints; none where the file is missing or damaged."""
    try:
        known = json.loads(passed_file().read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [each for each in known if isinstance(each, str)] if isinstance(known, list) else []
