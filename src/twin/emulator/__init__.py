"""A virtual rig: emulated drives and touch screen that speak the bytes of the real ones."""
