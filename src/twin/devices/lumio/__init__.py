"""The Lumio Crystal Touch screen: bytes to contacts, contacts to a plausible ball position."""
