"""Loops about the level plate: their linearisation, poles and margins, and the thesis's designs."""

from controllers.analysis.designs import Assessment, LinearDesign, assess, designs
from controllers.analysis.linearise import System, linear_controller, tracking_law, whole_periods
from controllers.analysis.loops import (
    MEASUREMENTS,
    Loop,
    instability,
    measured_late,
    sampled_loop,
    state_feedback_loop,
    unstable,
)
from controllers.analysis.margins import Margins, margins
from controllers.analysis.speed import slow_observer

__all__ = [
    "MEASUREMENTS",
    "Assessment",
    "LinearDesign",
    "Loop",
    "Margins",
    "System",
    "assess",
    "designs",
    "instability",
    "linear_controller",
    "margins",
    "measured_late",
    "sampled_loop",
    "slow_observer",
    "state_feedback_loop",
    "tracking_law",
    "unstable",
    "whole_periods",
]
