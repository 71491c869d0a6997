"""Chapters 5 and 6.2.1 as code: structure of the system, loops about the level plate, margins."""

from controllers.analysis.designs import Assessment, Design, assess, designs
from controllers.analysis.findings import Finding, findings
from controllers.analysis.loops import (
    Loop,
    instability,
    sampled_loop,
    sampled_poles,
    state_feedback_loop,
    unstable,
)
from controllers.analysis.margins import Margins, margins
from controllers.analysis.neglected import Size, Terms, size, terms
from controllers.analysis.speed import slow_observer

__all__ = [
    "Assessment",
    "Design",
    "Finding",
    "Loop",
    "Margins",
    "Size",
    "Terms",
    "assess",
    "designs",
    "findings",
    "instability",
    "margins",
    "sampled_loop",
    "sampled_poles",
    "size",
    "slow_observer",
    "state_feedback_loop",
    "terms",
    "unstable",
]
