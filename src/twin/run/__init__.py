"""From a scenario to a recorded run: assemble, drive, record, measure, draw, replay."""
