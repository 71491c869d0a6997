"""Loops about the level plate: their linearisation, poles and margins, and the thesis's designs."""

from controllers.analysis.designs import Assessment, LinearDesign, assess, linear_designs
from controllers.analysis.loops import (
    MEASUREMENTS,
    Loop,
    Margins,
    System,
    instability,
    linear_controller,
    margins,
    measured_late,
    sampled_loop,
    slow_observer,
    state_feedback_loop,
    tracking_law,
    unstable,
    whole_periods,
)

__all__ = [
    "MEASUREMENTS",
    "Assessment",
    "LinearDesign",
    "Loop",
    "Margins",
    "System",
    "assess",
    "instability",
    "linear_controller",
    "linear_designs",
    "margins",
    "measured_late",
    "sampled_loop",
    "slow_observer",
    "state_feedback_loop",
    "tracking_law",
    "unstable",
    "whole_periods",
]
