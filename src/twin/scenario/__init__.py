"""Scenarios: one experiment each, written as TOML and strictly checked."""

from twin.scenario.load import load
from twin.scenario.schema import Scenario
from twin.shipped import shipped

__all__ = ["Scenario", "load", "shipped"]
