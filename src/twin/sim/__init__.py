"""What is simulated: plants, sensors, drives, and the rig made of them."""
