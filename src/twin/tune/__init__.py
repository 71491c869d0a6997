"""Gains of laws and observers, tuned over a family of rigs and certified on fresh ones."""
