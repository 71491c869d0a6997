"""Fits the twin's parameters to a recorded run, and reports which of them the run determines."""
