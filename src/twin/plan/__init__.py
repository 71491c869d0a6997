"""What an experiment will tell about a rig, forecast before anything is recorded."""
