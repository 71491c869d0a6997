"""The twin beside the rig: whether, when and why reality has left the model."""
