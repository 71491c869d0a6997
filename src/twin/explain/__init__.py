"""Attribution of a scenario's tracking error to effects: all but each, and each alone."""
