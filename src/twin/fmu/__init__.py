"""The rig of a scenario as an FMU, and a drive as a node of a simulated bus: C, described."""
