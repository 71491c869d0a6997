"""The simulation: plants, sensors, drives, and the rig made of them."""
