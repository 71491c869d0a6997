"""The indicators of a run, their units and words; nothing heavy is imported with them."""

import tomllib
from pathlib import Path

INDICATORS: dict[str, dict[str, str]] = tomllib.loads(
    Path(__file__).with_suffix(".toml").read_text(encoding="utf-8")
)
"""Every indicator with ``unit``, ``words`` and the unit it is ``printed`` with."""
UNITS = {name: about["unit"] for name, about in INDICATORS.items() if "unit" in about}
"""Unit of every indicator as JSON has it."""
LEFT = ("fell", "lost", "diverged")
"""Endings after which no error is told: that of a ball that is gone would flatter its run."""
