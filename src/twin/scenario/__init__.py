"""Scenarios: one experiment each, written as TOML and strictly checked."""

from twin.base.shipped import shipped_scenarios
from twin.scenario.load import load
from twin.scenario.schema import Scenario

__all__ = ["Scenario", "load", "shipped_scenarios"]
