"""Bring-up of a rig: everything it needs, found, checked, and said what to do about."""
