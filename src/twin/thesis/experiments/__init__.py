"""The thesis's experiments, Tables 9.1 to 9.9, predicted by the twin."""
