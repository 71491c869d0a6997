"""Bring-up of a rig: everything it needs is found and checked, with advice on what to do."""
