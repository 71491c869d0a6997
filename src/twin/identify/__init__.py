"""Fits the twin's parameters to a recorded run, and says which of them the run shows."""
