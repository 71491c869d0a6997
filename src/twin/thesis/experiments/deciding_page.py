"""Which measurements on the rig would decide between what is left, as a part of the page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from twin.markdown import table
from twin.thesis.experiments.deciding import Outcome
from twin.thesis.experiments.explained import stored
from twin.thesis.experiments.ingredients import VariantResult
from twin.thesis.experiments.joint_friction import Loop


def deciding(
    outcomes: Sequence[Outcome], variants: Sequence[VariantResult], found: Sequence[Loop]
) -> list[str]:
    """The section: each measurement, and what the twin predicts for every outcome of it.

    Args:
        outcomes: What records would show.
        variants: With ingredients left out and hypotheses put in.
        found: What a slow triangle shows on mechanisms with dry friction.
    """
    known = stored()["all"]
    slope = math.degrees(known["friction"] / 20.0)
    lines = [
        (
            f"{each.table}, {each.row}",
            each.case,
            f"{each.time:.1f}",
            f"{each.frequency:.2f}",
            f"{each.amplitude:.3f}",
        )
        for each in outcomes
    ]
    head = ("experiment", "if", "phi is largest at [s]", "oscillation [Hz]", "rms [deg]")
    by_name = {each.variant.name: each for each in variants}
    modes = {
        label: " ".join(
            f"{row['explained']:.1f}"
            for row in by_name[name].rows
            if row["table"] == "9.9" and row["column"] == "e_tt"
        )
        for label, name in (
            ("case 2", "the explanation"),
            ("as printed", "sliding mode as printed"),
        )
    }
    return [
        "## Which measurement would decide, cheapest first\n",
        "1. **When the maxima occur** (time axes of the records): decides the start, by the table.",
        "2. **A slow triangle of 1 deg on the plate**, motor against plate encoder, ball off: "
        "`ballplate calibrate lost-motion --rig FILE`, and the same on the virtual rig, `--set "
        f"plant.servo.backlash_deg={known['play']:.2f}`, which finds the number put in. By play "
        f"the loop is {known['play']:.2f} deg wide with flat corners; by hysteresis of elastic "
        "parts its corners are round; by vibration, or if nothing is lost, there is no loop.",
        *_joint_friction(known["play"], found),
        "3. **Frequency of the residual oscillation under AFL and under backstepping**: by play it "
        "differs from law to law as in the table, by a vibrating spring it is one for both.",
        "4. **AFL with and without predictor in turns on one day, a tilt test before and after**: "
        f"the ball starts to roll at {slope:.2f} deg if friction is that with predictor, at "
        f"{slope * known['without_predictor']:.2f} deg if that without. If friction is the same "
        "within the day, the gap between the series comes from something else.",
        f"5. **Sliding mode with both settings**: Table 9.9 is {modes['case 2']} % by case 2 and "
        f"{modes['as printed']} % as printed.\n",
        table(head, lines),
    ]


def _joint_friction(play: float, found: Sequence[Loop]) -> list[str]:
    small, large = (next(each for each in found if each.torque == t) for t in (0.15, 7.0))
    still = next(each for each in found if each.torque == 0)
    needed = large.torque * play / large.width
    return [
        "   Dry friction of the plate's joints makes flat corners as well "
        "(`plant.plate.joint_friction`; mechanism only, at no measurable cost): it winds up wheels "
        f"and cams, by {1000 * large.width / large.torque:.0f} mdeg of loop per N m. A loop of "
        f"{play:.2f} deg takes {needed:.1f} N m, and at {large.torque:g} N m what presses the "
        f"wheel on its cam falls from {still.force:.0f} to {large.force:.0f} N. Dry bushes have "
        f"some {small.torque:g} N m, a loop of {small.width:.3f} deg: joint friction alone does "
        "not make it. The motors' torque tells the two apart: by friction it jumps at a reversal.",
    ]
