"""Loops about the level plate: their linearisation, poles and margins, and the thesis's designs."""

from controllers.analysis.designs import Assessment, LinearDesign, assess, designs
from controllers.analysis.loops import (
    Loop,
    instability,
    sampled_loop,
    state_feedback_loop,
    unstable,
)
from controllers.analysis.margins import Margins, margins
from controllers.analysis.speed import slow_observer

__all__ = [
    "Assessment",
    "LinearDesign",
    "Loop",
    "Margins",
    "assess",
    "designs",
    "instability",
    "margins",
    "sampled_loop",
    "slow_observer",
    "state_feedback_loop",
    "unstable",
]
