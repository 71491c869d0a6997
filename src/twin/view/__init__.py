"""The live view and the replay: a run as entities of the Rerun viewer."""
