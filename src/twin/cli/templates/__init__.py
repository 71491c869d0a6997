"""What ``ballplate new`` writes: working examples, renamed."""
