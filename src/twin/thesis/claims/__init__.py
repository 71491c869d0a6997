"""How large the terms are that the flat model of chapter 6 leaves out."""

from twin.thesis.claims.neglected import neglected_rows, size, terms

__all__ = ["neglected_rows", "size", "terms"]
