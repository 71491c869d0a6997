"""The twin that runs alongside the rig: whether, when and why reality has left the model."""
