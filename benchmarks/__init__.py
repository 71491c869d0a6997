"""Measurements of speed; ``python -m benchmarks`` prints every goal beside what is reached."""
