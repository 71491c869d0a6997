"""Work of others, graded: answers to labs on rigs of their own, laws on the benchmark."""

SCORES_FILE = "scores.json"
"""File with the scores of a finished entry of the benchmark, in its folder."""
