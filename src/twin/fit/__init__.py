"""Parameters from tables of measured indicators, where no log of the runs was kept."""
