"""What is wrong in a trace: findings with stable codes, ranked, and the verdict that follows."""

from twin.devices.akd.findings.finding import Finding, Kind, Severity, kinds
from twin.devices.akd.findings.verdict import Verdict, assess

__all__ = ["Finding", "Kind", "Severity", "Verdict", "assess", "kinds"]
