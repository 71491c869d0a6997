"""Scenarios: one experiment each, written as TOML and strictly checked."""

from twin.scenario.load import load, shipped
from twin.scenario.schema import Scenario

__all__ = ["Scenario", "load", "shipped"]
