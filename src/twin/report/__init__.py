"""Reports of recorded runs: what happened, in words, numbers and pictures."""
