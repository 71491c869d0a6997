"""Runs of a scenario: assemble, drive, record, measure, draw, replay."""
