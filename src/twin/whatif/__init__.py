"""Other futures from a moment of a run: what would have happened."""
