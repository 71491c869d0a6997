"""Makers of the generated pages of this folder, of their site and of their pictures."""
