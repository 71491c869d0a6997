"""Studies: many runs of a scenario, and what they say about its parameters."""
