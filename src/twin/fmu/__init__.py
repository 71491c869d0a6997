"""The rig of a scenario as an FMU: one C source, described for FMI 2.0 and 3.0."""
