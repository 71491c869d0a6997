"""Counterfactuals: other futures of a run, and the run without one of its effects."""
