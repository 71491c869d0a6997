"""Plants: what is simulated in place of the real mechanism and ball."""
