"""Control laws, observers, predictor and analysis: numpy, scipy and control only."""

LAWS_CLOSED_VARIABLE = "BALLPLATE_LAWS_CLOSED"
"""Environment variable that, when set, keeps files of the folder ``laws`` from being run."""
