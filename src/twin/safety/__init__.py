"""The safety case: everything that can go wrong, done on purpose on a rehearsed rig."""
