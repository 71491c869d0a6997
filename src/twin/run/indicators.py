"""The indicators of a run, their units and words; nothing heavy is imported with them."""

from pathlib import Path

from twin.data_file import read_toml

INDICATORS: dict[str, dict[str, str]] = read_toml(Path(__file__).with_suffix(".toml"))
"""Every indicator with ``unit``, ``words`` and the unit it is ``printed`` with."""
UNITS = {name: about["unit"] for name, about in INDICATORS.items() if "unit" in about}
"""Unit of every indicator as JSON has it."""
METRICS = tuple(
    name
    for name in INDICATORS
    if name not in {"outcome", "outcome_time", "judged_from", "real_time_factor"}
)
"""Those that a motion is judged by."""
LEFT = ("fell", "lost", "diverged")
"""Endings after which no error is told: that of a ball that is gone would flatter its run."""
