"""The safety case: everything that can go wrong, done on purpose to an emulated rig."""
