"""The controller of a scenario as C source for a board without an operating system."""
