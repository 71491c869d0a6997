"""Which effect makes how much of a scenario's tracking error: remove each, and try each alone."""
