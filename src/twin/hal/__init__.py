"""Hardware abstraction layer: one rig, simulated or real, behind one seam."""
