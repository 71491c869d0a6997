"""What chapters 5 and 6 of the thesis claim about the system, beside what holds."""

from twin.thesis.claims.check import Claim, check_claims
from twin.thesis.claims.neglected import neglected_rows, size, terms

__all__ = ["Claim", "check_claims", "neglected_rows", "size", "terms"]
