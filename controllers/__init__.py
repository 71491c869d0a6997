"""Control laws, observers, predictor and analysis: numpy, scipy and control only."""
